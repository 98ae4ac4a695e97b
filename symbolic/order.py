"""The order of statements in C: in a long run of assignments, what most waits for comes first.

Neither a compiler nor a processor changes much of a long order: the one keeps to it where it moves instructions at all,
the other sees a few hundred at once. Written one result after the other, a chain of quotients is begun when all before
it is done, and then nothing is left to do beside it.
"""

import re
from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from itertools import groupby

from clikgen.symbolic.graph import LATENCY

WINDOW = 256  # operations that a desktop processor looks at together, and orders by itself
ISSUE_WIDTH = 3  # operations that it begins in a cycle
PIECE = 300  # assignments ordered together: what is computed long before it is needed leaves the registers
# as Block.named writes them
_ASSIGNMENT = re.compile(r" *const \w+ (t\d+) = (.*);")
_NAME = re.compile(r"\bt\d+\b")
_OPERATION = re.compile(r" ([-+*/?]) |(sqrt|atan2|fma|mask|choice)f?\(")
_KINDS = {"+": "add", "-": "sub", "*": "mul", "/": "div", "?": "select", "fma": "fmadd"}
_SLOTS = {"div": 4, "sqrt": 5, "atan2": 40}  # of the ISSUE_WIDTH of a cycle; others take one


def ordered(lines: Sequence[str]) -> Iterator[str]:
    """The same lines, long runs of assignments to new names t1, t2, … in the order in which a piece is done soonest.

    List scheduling (Cooper and Torczon, Engineering a Compiler, section 12.3): of the assignments whose operands are
    there, the next is that with the longest critical path to the end of the piece, in cycles of `LATENCY`, where
    `ISSUE_WIDTH` operations begin in a cycle. Any other line stays where it is, and nothing moves across it.
    """
    for found, run in groupby(lines, lambda line: _ASSIGNMENT.fullmatch(line) is not None):
        kept = list(run)
        for first in range(0, len(kept), PIECE):
            piece = kept[first : first + PIECE]
            yield from _scheduled(piece) if found else piece


def _scheduled(lines: list[str]) -> Iterator[str]:
    names, values = zip(*(match.groups() for match in map(_ASSIGNMENT.fullmatch, lines) if match), strict=True)
    kinds = [[_KINDS.get(sign or call, call) for sign, call in _OPERATION.findall(value)] for value in values]
    if sum(map(len, kinds)) <= WINDOW:
        yield from lines
        return
    place = {name: k for k, name in enumerate(names)}
    needs = [{place[name] for name in _NAME.findall(value) if name in place} for value in values]
    users: list[list[int]] = [[] for _ in lines]
    for k, before in enumerate(needs):
        for i in before:
            users[i].append(k)
    delay = [sum(LATENCY[kind] for kind in own) for own in kinds]
    path = list(delay)  # the critical one, from the beginning of an assignment to the end of the piece
    for k in reversed(range(len(lines))):
        path[k] += max((path[i] for i in users[k]), default=0)

    cycle, missing, there = 0.0, [len(before) for before in needs], [0.0] * len(lines)
    waiting = [(0.0, k) for k, count in enumerate(missing) if not count]  # heap: operands known, there from a cycle on
    able: list[tuple[int, int]] = []  # heap: operands there
    while waiting or able:
        cycle = max(cycle, waiting[0][0]) if not able else cycle
        while waiting and waiting[0][0] <= cycle:
            k = heappop(waiting)[1]
            heappush(able, (-path[k], k))
        k = heappop(able)[1]
        yield lines[k]
        cycle += sum(_SLOTS.get(kind, 1) for kind in kinds[k]) / ISSUE_WIDTH
        for i in users[k]:
            there[i] = max(there[i], cycle + delay[k])
            missing[i] -= 1
            if not missing[i]:
                heappush(waiting, (there[i], i))
