"""Expressions as graphs: the same function in exact arithmetic, nothing twice, and the shortest way through.

Exact arithmetic is that of fractions, in which neither the order of a sum nor a reciprocal matters. Roots and angles
are left open: any function will do that gives the same for the same, as the graph knows nothing else of them.
"""

from collections import Counter
from fractions import Fraction
from hashlib import sha256
from itertools import combinations
from math import ceil, floor, log2

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.symbolic.graph import CONDITIONS, FUSED, LATENCY, Graph

OPERATIONS = {
    "add": lambda x, y, _: x + y,
    "sub": lambda x, y, _: x - y,
    "mul": lambda x, y, _: x * y,
    "div": lambda x, y, _: x / y,
    "neg": lambda x, *_: -x,
    "square": lambda x, *_: x**2,
    "twice": lambda x, *_: 2 * x,
    "inverse": lambda x, *_: 1 / x,
    "abs": lambda x, *_: ca.fabs(x),
    "max": lambda x, y, _: ca.fmax(x, y),
    "min": lambda x, y, _: ca.fmin(x, y),
    "floor": lambda x, *_: ca.floor(x),
    "ceil": lambda x, *_: ca.ceil(x),
    "lt": lambda x, y, _: x < y,
    "le": lambda x, y, _: x <= y,
    "eq": lambda x, y, _: x == y,
    "ne": lambda x, y, _: x != y,
    "not": lambda x, *_: ca.logic_not(x),
    "and": lambda x, y, _: ca.logic_and(x, y),
    "or": lambda x, y, _: ca.logic_or(x, y),
    "if_else": ca.if_else,
    "sqrt": lambda x, *_: ca.sqrt(x),
    "sin": lambda x, *_: ca.sin(x),
    "cos": lambda x, *_: ca.cos(x),
    "atan2": lambda x, y, _: ca.atan2(x, y),
    "copysign": lambda x, y, _: ca.copysign(x, y),
}
OPEN = {"sqrt", "sin", "cos", "atan2"}
ROUNDED = {"div", "inverse", *OPEN}  # in doubles; the others are exact for halves of whole numbers that are not huge
SIGNED = {"copysign"}  # of zeros, which have either sign in a graph, and none in fractions

numbers = st.integers(0, 10**6)


def programs(operations):
    """Lists of operations, each on any three of what is there so far."""
    return st.lists(st.tuples(st.sampled_from(sorted(operations)), numbers, numbers, numbers), min_size=1, max_size=14)


def carried_out(program):
    """Inputs, and what a program makes of them: expressions of two columns and a few constants."""
    inputs = [ca.SX.sym("p", 2), ca.SX.sym("q", 1)]
    found = [*ca.vertsplit(inputs[0]), inputs[1], *map(ca.SX, (0.0, 1.0, -1.0, 2.5))]
    for operation, *at in program:
        found.append(OPERATIONS[operation](*(found[i % len(found)] for i in at)))
    return inputs, [ca.vertcat(*found[-3:]), found[-1] + found[-2]]


def left_open(name):
    """Some function of fractions."""

    def value(*x):
        digest = sha256(repr((name, *map(Fraction, x))).encode()).digest()
        return Fraction(digest[0] - 128, 1 + digest[1])

    return value


EXACT = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y if y else Fraction(0),  # whatever it is, it is the same for x · 1/y
    "neg": lambda x: -x,
    "abs": abs,
    "max": max,
    "min": min,
    "floor": lambda x: Fraction(floor(x)),
    "ceil": lambda x: Fraction(ceil(x)),
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "not": lambda x: not x,
    "and": lambda x, y: bool(x and y),
    "or": lambda x, y: bool(x or y),
    "select": lambda c, x, y: x if c else y,
    "mask": bool,
    "choice": lambda c, x, y: x if c else y,
    "copysign": lambda x, y: abs(x) if y >= 0 else -abs(x),
    "fmadd": lambda x, y, z: x * y + z,
    "fmsub": lambda x, y, z: x * y - z,
    "fnmadd": lambda x, y, z: z - x * y,
    **{name: left_open(name) for name in OPEN},
}
IN_NUMPY = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.abs,
    "max": np.maximum,
    "min": np.minimum,
    "floor": np.floor,
    "ceil": np.ceil,
    "lt": np.less,
    "le": np.less_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "not": np.logical_not,
    "and": np.logical_and,
    "or": np.logical_or,
    "select": np.where,
    "sqrt": np.sqrt,
    "sin": np.sin,
    "cos": np.cos,
    "atan2": np.arctan2,
}
BY_CASADI = {
    ca.OP_ASSIGN: lambda x: x,
    ca.OP_ADD: EXACT["add"],
    ca.OP_SUB: EXACT["sub"],
    ca.OP_MUL: EXACT["mul"],
    ca.OP_DIV: EXACT["div"],
    ca.OP_NEG: EXACT["neg"],
    ca.OP_SQ: lambda x: x * x,
    ca.OP_TWICE: lambda x: 2 * x,
    ca.OP_INV: lambda x: EXACT["div"](Fraction(1), x),
    ca.OP_FABS: abs,
    ca.OP_FMAX: max,
    ca.OP_FMIN: min,
    ca.OP_FLOOR: EXACT["floor"],
    ca.OP_CEIL: EXACT["ceil"],
    ca.OP_LT: EXACT["lt"],
    ca.OP_LE: EXACT["le"],
    ca.OP_EQ: EXACT["eq"],
    ca.OP_NE: EXACT["ne"],
    ca.OP_NOT: EXACT["not"],
    ca.OP_AND: EXACT["and"],
    ca.OP_OR: EXACT["or"],
    ca.OP_IF_ELSE_ZERO: lambda c, x: x if c else Fraction(0),
    ca.OP_SQRT: EXACT["sqrt"],
    ca.OP_SIN: EXACT["sin"],
    ca.OP_COS: EXACT["cos"],
    ca.OP_ATAN2: EXACT["atan2"],
    ca.OP_COPYSIGN: EXACT["copysign"],
}


def of_graph(graph, arrays, meaning, constant):
    """The results of a graph for arrays of inputs."""
    values = []
    for node in graph.nodes:
        if node.operation == "given":
            values.append(arrays[node.array][node.entry])
        elif node.operation == "constant":
            values.append(constant(node.value))
        else:
            values.append(1 * meaning[node.operation](*(values[i] for i in node.arguments)))  # conditions are 0 and 1
    return [[values[i] for i in column] for column in graph.results]


def of_function(function, arrays):
    """The same of CasADi's list of instructions, in fractions."""
    work, results = {}, [[None] * function.size1_out(k) for k in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, into, given = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[into[0]] = arrays[given[0]][given[1]]
        elif code == ca.OP_CONST:
            work[into[0]] = Fraction(function.instruction_constant(k))
        elif code == ca.OP_OUTPUT:
            results[into[0]][into[1]] = Fraction(work[given[0]])
        else:
            work[into[0]] = BY_CASADI[code](*(Fraction(work[i]) for i in given))
    return results


def finite(results):
    """Whether all constants are: CasADi computes 1/0 at once."""
    function = ca.Function("f", ca.symvar(ca.veccat(*results)), results)
    constants = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CONST)
    return all(np.isfinite(function.instruction_constant(k)) for k in constants)


# ---- The same function ----


@given(programs(OPERATIONS), st.lists(st.integers(-6, 6), min_size=3, max_size=3))
def test_a_graph_is_its_expressions_whatever_root_and_sine_are(program, values):
    inputs, results = carried_out(program)
    if not finite(results):
        return
    p, q, r = (Fraction(value, 2) for value in values)
    graph = Graph.of(inputs, results)
    exact = [list(map(Fraction, column)) for column in of_graph(graph, [[p, q], [r]], EXACT, Fraction)]
    assert exact == of_function(ca.Function("f", inputs, [ca.densify(one) for one in results]), [[p, q], [r]])
    for same in (graph.fused(), graph.without_branches(), graph.fused().without_branches()):
        assert exact == [list(map(Fraction, column)) for column in of_graph(same, [[p, q], [r]], EXACT, Fraction)]


@given(programs(OPERATIONS.keys() - ROUNDED - SIGNED), st.integers(0, 2**32 - 1))
def test_a_graph_equals_casadi_s_evaluation_where_nothing_is_rounded(program, seed):
    """Halves of whole numbers: neither the order of a sum nor anything else is visible."""
    inputs, results = carried_out(program)
    p, q = (np.random.default_rng(seed).integers(-6, 7, (rows, 64)) / 2 for rows in (2, 1))
    expected = [np.array(one) for one in ca.Function("f", inputs, results).map(64).call([ca.DM(p), ca.DM(q)])]
    if np.max(np.abs(np.concatenate(expected))) > 2.0**40:
        return
    found = of_graph(Graph.of(inputs, results), [p, q], IN_NUMPY, float)
    for rows, array in zip(found, expected, strict=True):
        for row, other in zip(rows, array, strict=True):
            np.testing.assert_array_equal(np.broadcast_to(row, 64), other)


@pytest.mark.parametrize("operation", sorted(ROUNDED))
def test_a_rounded_operation_equals_casadi_s(operation):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    result = OPERATIONS[operation](x, y, None)
    given = np.random.default_rng(0).uniform(0.1, 3, (2, 1000)) * [[1.0], [-1.0 if operation == "atan2" else 1.0]]
    expected = np.array(ca.Function("f", [x, y], [result]).map(1000).call([ca.DM(given[:1]), ca.DM(given[1:])])[0])
    ((found,),) = of_graph(Graph.of([x, y], [result]), [given[:1], given[1:]], IN_NUMPY, float)
    # numpy's and libm's functions within one unit in the last place each
    np.testing.assert_allclose(found, expected[0], rtol=4e-16, atol=0)


# ---- Its nodes ----


def of(*results):
    """The graph of expressions of all their symbols."""
    return Graph.of(ca.symvar(ca.veccat(*results)), results)


def counted(*results):
    """How many operations of each kind the graph of the expressions has."""
    graph = of(*results)
    return Counter(graph.nodes[i].operation for i in graph.needed() if graph.nodes[i].arguments)


def depths(*results):
    """Cycles until each result is there at best."""
    graph = of(*results)
    return [graph.depth[i] for column in graph.results for i in column]


@given(programs(OPERATIONS))
def test_no_two_nodes_are_alike_and_each_stands_after_those_it_needs(program):
    _, results = carried_out(program)
    if not finite(results):
        return
    graph = of(*results)
    seen = set()
    for i, node in enumerate(graph.nodes):
        assert all(k < i for k in node.arguments)
        of_two = node.operation in ("add", "mul", "eq", "ne", "and", "or")
        arguments = tuple(sorted(node.arguments)) if of_two else node.arguments
        seen.add((node.operation, arguments, node.value, node.array, node.entry))
    assert len(seen) == len(graph.nodes)


@given(programs(OPERATIONS))
def test_conditions_and_numbers_are_told_apart(program):
    _, results = carried_out(program)
    if finite(results):
        expect_conditions_where_they_belong(of(*results))


@pytest.mark.parametrize("number", [lambda c: c**2, lambda c: 2 * c, lambda c: 1 / c, lambda c: c + c, lambda c: -c])
def test_a_condition_in_a_sum_or_a_product_is_a_number(number):
    expect_conditions_where_they_belong(of(number(a < b)))


def expect_conditions_where_they_belong(graph):
    for node in graph.nodes:
        conditions = [graph.nodes[k].operation in CONDITIONS for k in node.arguments]
        if node.operation in ("not", "and", "or"):
            assert all(conditions)
        elif node.operation == "select":
            assert conditions == [True, False, False]
        else:
            assert not any(conditions)
    assert not any(graph.nodes[i].operation in CONDITIONS for column in graph.results for i in column)


@given(programs(OPERATIONS))
def test_a_depth_is_that_of_the_longest_way(program):
    _, results = carried_out(program)
    if not finite(results):
        return
    graph = of(*results)
    for node, depth in zip(graph.nodes, graph.depth, strict=True):
        before = max((graph.depth[k] for k in node.arguments), default=0)
        assert depth == before + (LATENCY.get(node.operation, 1) if node.arguments else 0)


def test_needed_is_what_the_roots_depend_on_and_nothing_else():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    graph = of(ca.sin(x * y), ca.sqrt(x))
    (sine,), (root,) = graph.results
    assert [graph.nodes[i].operation for i in graph.needed([root])] == ["given", "sqrt"]
    assert {graph.nodes[i].operation for i in graph.needed([sine])} == {"given", "mul", "sin"}
    assert len(graph.needed()) == 5
    assert (graph.operations(), graph.operations([sine]), graph.operations([root])) == (3, 2, 1)
    assert [graph.number(node) for node in graph.nodes] == list(range(len(graph.nodes)))
    assert Graph().number(graph.nodes[sine]) is None


a, b, c, d = (ca.SX.sym(name) for name in "abcd")
v = ca.vertcat(b, c, d)

SHAPES = {
    "the same twice": ([a * b + c, c + b * a], {"mul": 1, "add": 1}),
    "a square": ([a**2], {"mul": 1}),
    "twice": ([2 * a], {"add": 1}),
    # choices
    "a choice": ([ca.if_else(a < b, c, a * b)], {"lt": 1, "mul": 1, "select": 1}),
    "a choice or zero": ([ca.if_else(a < b, c, 0), ca.if_else(a < b, 0, c)], {"lt": 1, "select": 2}),
    "a choice of vectors": ([ca.if_else(a < b, v, 2.0 * v)], {"lt": 1, "add": 3, "select": 3}),
    "a choice by a number": ([ca.if_else(a, b, c)], {"ne": 1, "select": 1}),
    "a choice by its opposite": ([ca.if_else(ca.logic_not(a < b), c, d)], {"lt": 1, "select": 1}),
    "a choice inside one": ([ca.if_else(a < b, ca.if_else(c < d, a, b), c)], {"lt": 2, "select": 2}),
    "the same question again": (
        [ca.if_else(a < b, ca.if_else(a < b, c, d), ca.if_else(a < b, d, a))],
        {"lt": 1, "select": 1},
    ),
    "no choice": ([ca.if_else(a < b, c, c)], {}),
    "a chain of choices": (
        [ca.if_else(a < 1, 5, ca.if_else(a < 2, 6, ca.if_else(a < 3, 7, b)))],
        {"lt": 3, "select": 3},
    ),
    "alternatives": (
        [ca.if_else(ca.logic_or(ca.logic_or(ca.SX(0), a < b), c < d), a, b)],
        {"lt": 2, "or": 1, "select": 1},
    ),
    "a condition as a number": ([a < b], {"lt": 1, "select": 1}),
    "a condition as a factor": ([(a < b) * c], {"lt": 1, "select": 1}),
    "a condition of conditions": (
        [ca.logic_and(a < b, ca.logic_not(c <= d))],
        {"lt": 1, "le": 1, "not": 1, "and": 1, "select": 1},
    ),
    # quotients
    "a quotient": ([a / b], {"div": 1}),
    "many quotients": ([v / a, d / b], {"div": 2, "mul": 3}),
    "a reciprocal that is there": ([1 / a, b / a], {"div": 1, "mul": 1}),
    "a quotient that waits": ([ca.sqrt(a) / b], {"sqrt": 1, "div": 1, "mul": 1}),
    "a quotient that waits for its divisor": ([a / ca.sqrt(b)], {"sqrt": 1, "div": 1}),
    # signs
    "a negative product": ([(-a) * b], {"mul": 1, "neg": 1}),
    "two signs": ([(-a) * (-b), (-c) / (-d)], {"mul": 1, "div": 1}),
    "a product taken away": ([a + (-b) * c, a - b * c], {"mul": 1, "sub": 1}),
    "a product that is not taken away": ([a - (-b) * c], {"mul": 1, "add": 1}),
    "a difference the other way": ([-(a - b)], {"sub": 1}),
    "a negative constant": ([a + (-2.5) * b], {"mul": 1, "sub": 1}),
    "minus one": ([-1.0 * a], {"neg": 1}),
    "a sum of negatives": ([-a - b], {"add": 1, "neg": 1}),
    "a sum used twice": ([a + b + c, (a + b) * d], {"add": 2, "mul": 1}),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_a_graph_has_no_more_operations_than_it_needs(shape):
    results, expected = SHAPES[shape]
    assert counted(*results) == expected


def test_a_division_by_a_shared_divisor_is_a_product_with_one_reciprocal():
    columns = [ca.SX.sym("x", 50), ca.SX.sym("y")]
    graph = Graph.of(columns, [columns[0] / columns[1]])
    (reciprocal,) = (i for i, node in enumerate(graph.nodes) if node.operation == "div")
    assert graph.nodes[graph.nodes[reciprocal].arguments[0]].value == 1.0
    for result in graph.results[0]:
        assert graph.nodes[result].operation == "mul"
        assert reciprocal in graph.nodes[result].arguments


# ---- Sums ----


@pytest.mark.parametrize("n", [2, 3, 4, 5, 8, 16, 17, 100, 1000])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_sum_of_n_terms_is_there_after_log2_n_additions(n, sign):
    x = ca.SX.sym("x", n)
    total = sign * x[0]
    for k in range(1, n):
        total = total + x[k] if k % 3 else total - x[k]
    rounds = ceil(log2(n))
    if sign > 0:
        assert depths(total) == [rounds * LATENCY["add"]]
        assert sum(counted(total).values()) == n - 1
    else:  # −x₀ may be the last one to be taken away
        assert depths(total)[0] <= rounds * LATENCY["add"] + 1


def earliest(ready):
    """When the sum of terms can be there that are ready at these times: the best of all orders."""
    if len(ready) == 1:
        return ready[0]
    best = []
    for i, j in combinations(range(len(ready)), 2):
        rest = [one for k, one in enumerate(ready) if k not in (i, j)]
        best.append(earliest([*rest, max(ready[i], ready[j]) + LATENCY["add"]]))
    return min(best)


@pytest.mark.parametrize("seed", range(20))
def test_no_order_of_a_sum_is_faster(seed):
    rng = np.random.default_rng(seed)
    factors = rng.integers(0, 8, 5)
    terms = []
    for k, count in enumerate(factors):
        term = ca.SX.sym(f"x{k}")
        for j in range(count):
            term = term * ca.SX.sym(f"f{k}_{j}")
        terms.append(term)
    assert depths(sum(terms)) == [earliest([int(count) * LATENCY["mul"] for count in factors])]


# ---- Products that are added ----


def fused(*results):
    """The operations of each kind in the fused graph of the expressions."""
    graph = of(*results).fused()
    return Counter(graph.nodes[i].operation for i in graph.needed() if graph.nodes[i].arguments)


@given(programs(OPERATIONS))
def test_no_product_that_is_added_once_and_used_nowhere_else_is_left_alone(program):
    _, results = carried_out(program)
    if not finite(results):
        return
    plain = of(*results)
    graph = plain.fused()
    nodes = [graph.nodes[i] for i in graph.needed()]
    uses = Counter(k for node in nodes for k in node.arguments)
    uses.update(i for column in graph.results for i in column)
    for node in nodes:
        if node.operation in ("add", "sub"):
            assert not any(graph.nodes[k].operation == "mul" and uses[k] == 1 for k in node.arguments)
    pairs = sum(node.operation in FUSED for node in nodes)
    assert graph.operations() + pairs == plain.operations()


def test_a_product_and_a_sum_are_one_operation_whatever_their_signs():
    assert fused(a * b + c) == {"fmadd": 1}
    assert fused(a * b - c) == {"fmsub": 1}
    assert fused(c - a * b) == {"fnmadd": 1}
    assert fused(a * b + c * d) == {"mul": 1, "fmadd": 1}
    assert fused(a**2 + 2.0) == {"fmadd": 1}


def test_a_product_that_is_wanted_elsewhere_is_not_computed_twice():
    assert fused(a * b + c, a * b - d) == {"mul": 1, "add": 1, "sub": 1}
    assert fused(a * b + c, a * b) == {"mul": 1, "add": 1}
    assert fused(a * b + a * b) == {"mul": 1, "add": 1}


def test_of_two_products_the_one_that_is_ready_last_is_added():
    graph = of(a * b + ca.sqrt(c) * d).fused()
    ((last,),) = graph.results
    _, _, first = graph.nodes[last].arguments
    assert {graph.nodes[k].operation for k in graph.nodes[first].arguments} == {"given"}


# ---- Choices ----


def chosen(*results):
    """The operations of each kind in the graph without branches of the expressions."""
    graph = of(*results).without_branches()
    return Counter(graph.nodes[i].operation for i in graph.needed() if graph.nodes[i].arguments)


def test_several_choices_between_results_by_one_condition_share_a_mask():
    assert chosen(ca.if_else(a < b, a * c, d), ca.if_else(a < b, d, a + c)) == {
        **{"lt": 1, "mul": 1, "add": 1, "mask": 1, "choice": 2}
    }


def test_a_choice_alone_or_between_what_is_given_stays_as_it_is():
    assert chosen(ca.if_else(a < b, a * c, d)) == {"lt": 1, "mul": 1, "select": 1}
    assert chosen(ca.if_else(a < b, c, d), ca.if_else(a < b, d, c)) == {"lt": 1, "select": 2}


# ---- What it is not for ----

UNKNOWN = [ca.exp, ca.log, ca.tan, ca.asin, ca.acos, ca.atan, ca.sinh, ca.sign, ca.erf, ca.log1p]
UNKNOWN_OF_TWO = [ca.fmod, ca.power, ca.hypot, ca.remainder]


@pytest.mark.parametrize("function", UNKNOWN + UNKNOWN_OF_TWO, ids=lambda function: function.__name__)
def test_an_unknown_operation_is_refused(function):
    result = function(a, b) if function in UNKNOWN_OF_TWO else function(a)
    with pytest.raises(ValueError, match="no C for CasADi's operation"):
        Graph.of([a, b], [result])


def test_a_condition_made_a_number_and_back_is_the_same_condition():
    graph = Graph()
    condition = graph.node("lt", graph.constant(1.0), graph.constant(2.0))
    number = graph.real(condition)
    assert graph.nodes[number].operation == "select"
    assert graph.condition(number) == condition
    assert graph.real(number) == number
    assert graph.nodes[graph.condition(graph.constant(3.0))].operation == "ne"
