"""The order of statements against what any order must keep, and against a machine that looks no further than it can."""

import itertools
import random
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.symbolic.order import ISSUE_WIDTH, PIECE, WINDOW, ordered

LOOKS = 48  # statements that the machine below sees at once


@st.composite
def runs(draw):
    """Assignments of sums of products, quotients and roots of what was assigned before, and of what is given."""
    source, count = random.Random(draw(st.integers(0, 10**6))), draw(st.integers(1, 3 * PIECE))
    lines = []
    for k in range(count):
        known = [f"t{i}" for i in range(max(0, k - draw(st.sampled_from([5, 100]))), k)] + ["q[0]", "q[1]"]
        a, b, c = (source.choice(known) for _ in range(3))
        lines.append(f"  const double t{k} = {source.choice([f'{a} * {b} + {c}', f'{a} / {b}', f'sqrt({a}) - {b}'])};")
    return lines


def names(line):
    return re.findall(r"\bt\d+\b", line)


@given(runs())
def test_every_statement_is_there_once_and_after_what_it_needs(lines):
    found = list(ordered(lines))
    assert sorted(found) == sorted(lines)
    known = set()
    for line in found:
        new, *needed = names(line)
        assert known.issuperset(needed)
        known.add(new)


@given(runs())
def test_nothing_moves_across_anything_but_an_assignment_to_a_new_name(lines):
    half = len(lines) // 2
    between = "  q_next[0] = t0;"
    found = list(ordered([*lines[:half], between, *lines[half:]]))
    assert found[half] == between
    assert sorted(found[:half]) == sorted(lines[:half])


def test_a_product_and_a_sum_in_one_are_an_operation():
    sums = [f"  const double t{k} = clikgen_fma(q[{k}], q[{k + 1}], q[{k + 2}]);" for k in range(WINDOW)]
    lines = sums + quotients(WINDOW, 12)
    assert list(ordered(lines)).index(lines[WINDOW]) == 0
    assert list(ordered(sums)) == sums


def products(count):
    return [f"  const double t{k} = q[{k}] * q[{k + 1}];" for k in range(count)]


def quotients(first, count):
    """Each of the one before."""
    return [f"  const double t{first + k} = q[0] / {f't{first + k - 1}' if k else 'q[1]'};" for k in range(count)]


def test_a_chain_of_quotients_is_begun_first_and_the_rest_is_done_beside_it():
    found = list(ordered(products(WINDOW) + quotients(WINDOW, 12)))
    places = [found.index(line) for line in quotients(WINDOW, 12)]
    assert places[0] == 0
    apart = [after - before for before, after in itertools.pairwise(places)]
    # as many begin in between as a quotient takes cycles, 13 in the model
    assert all(13 * ISSUE_WIDTH - 2 <= one <= 17 * ISSUE_WIDTH for one in apart[:4])


def test_a_run_that_a_processor_sees_at_once_stays_as_it_is():
    lines = products(WINDOW - 12) + quotients(WINDOW - 12, 12)
    assert list(ordered(lines)) == lines


def cycles(lines):
    """Of a machine that begins ISSUE_WIDTH of the first LOOKS statements in a cycle, once their operands are there."""
    done, waiting, cycle = {}, list(lines), 0
    while waiting:
        begun = 0
        for line in waiting[:LOOKS]:
            new, *needed = names(line)
            if begun < ISSUE_WIDTH and all(done.get(one, float("inf")) <= cycle for one in needed):
                done[new] = cycle + (13 if "/" in line else 20 if "sqrt" in line else 4)
                waiting.remove(line)
                begun += 1
        cycle += 1
    return max(done.values())


@pytest.mark.parametrize("count", [WINDOW, PIECE - 20])
def test_a_machine_that_sees_few_statements_at_once_is_done_sooner(count):
    lines = products(count) + quotients(count, 12)
    assert cycles(lines) > 1.5 * cycles(list(ordered(lines)))
