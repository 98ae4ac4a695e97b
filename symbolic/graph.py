"""Scalar expressions as a graph in which nothing is there twice: what the emitter turns into C."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from heapq import heapify, heappop, heappush
from typing import Self

import casadi as ca

CONDITIONS = {"lt", "le", "eq", "ne", "not", "and", "or"}
FUSED = ("fmadd", "fmsub", "fnmadd")
"""Of a, b and c: a b + c, a b - c and c - a b, rounded once."""

LATENCY = {
    **{"add": 3, "sub": 3, "mul": 3, "div": 13, "sqrt": 20, "sin": 60, "cos": 60, "atan2": 80, "select": 2, "mask": 4},
    **dict.fromkeys(FUSED, 4),
    "choice": 2,
}
"""Cycles of an operation on a desktop processor; the others take about one. Only their proportions matter."""

_SUMS = ("add", "sub")
_COMMUTES = {"add", "mul", "eq", "ne", "and", "or"}
_OPERATIONS = {
    ca.OP_ADD: "add",
    ca.OP_SUB: "sub",
    ca.OP_MUL: "mul",
    ca.OP_DIV: "div",
    ca.OP_NEG: "neg",
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "abs",
    ca.OP_COPYSIGN: "copysign",
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_ATAN2: "atan2",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
    ca.OP_FMAX: "max",
    ca.OP_FMIN: "min",
    ca.OP_LT: "lt",
    ca.OP_LE: "le",
    ca.OP_EQ: "eq",
    ca.OP_NE: "ne",
    ca.OP_NOT: "not",
    ca.OP_AND: "and",
    ca.OP_OR: "or",
}
SHORT_FORMS: dict[int, Callable[["Graph", Sequence[int]], int]] = {
    ca.OP_ASSIGN: lambda graph, x: x[0],
    ca.OP_SQ: lambda graph, x: graph.node("mul", x[0], x[0]),
    ca.OP_TWICE: lambda graph, x: graph.node("add", x[0], x[0]),
    ca.OP_INV: lambda graph, x: graph.node("div", graph.constant(1.0), x[0]),
    ca.OP_IF_ELSE_ZERO: lambda graph, x: graph.node("select", graph.condition(x[0]), x[1], graph.constant(0.0)),
}


@dataclass(frozen=True, slots=True)
class Node:
    """An operation on earlier nodes, a constant, or entry `entry` of the array `array` that is given."""

    operation: str
    arguments: tuple[int, ...] = ()
    value: float = 0.0
    array: int = -1
    entry: int = -1


@dataclass(slots=True)
class Graph:
    """Nodes, each after those it needs, and no two alike.

    Real and boolean nodes are told apart, and choices are one node. Quotients are products with a reciprocal where
    that is shared or ready early, and sums add first what is ready first. Signs move outward: −x y is one product
    and, where it is added, one difference. Reciprocals and sums round otherwise than the expressions that they come
    from, all else as these; zeros may have either sign.
    """

    nodes: list[Node] = field(default_factory=list)
    results: list[list[int]] = field(default_factory=list)
    depth: list[int] = field(default_factory=list)  # of each node, cycles until it is there at best
    _numbers: dict[Node, int] = field(default_factory=dict)

    @classmethod
    def of(cls, given: Sequence[ca.SX], results: Sequence[ca.SX]) -> Self:
        """The graph of dense columns `results` of the symbols `given`; raises ValueError for an unknown operation."""
        function = ca.Function("graph", list(given), [ca.densify(ca.vec(result)) for result in results])
        plain = cls()
        plain._read(function)
        graph = cls()
        graph._follow(plain)
        return graph

    def node(self, operation: str, *arguments: int) -> int:
        """The number of the simplest node that stands for this operation."""
        simpler = self._simplified(operation, arguments)
        if simpler is not None:
            return simpler
        if operation in _COMMUTES:
            arguments = tuple(sorted(arguments))
        return self._numbered(Node(operation, arguments))

    def number(self, node: Node) -> int | None:
        """Where this node is; None where it is not there."""
        return self._numbers.get(node)

    def constant(self, value: float) -> int:
        """A constant."""
        return self._numbered(Node("constant", value=value + 0.0))

    def condition(self, i: int) -> int:
        """Node i as a condition: itself where it is one, else whether it is not zero."""
        node = self.nodes[i]
        if node.operation in CONDITIONS:
            return i
        if node.operation == "select" and [self._value(k) for k in node.arguments[1:]] == [1.0, 0.0]:
            return node.arguments[0]
        return self.node("ne", i, self.constant(0.0))

    def real(self, i: int) -> int:
        """Node i as a number: 1 or 0 for a condition."""
        if self.nodes[i].operation not in CONDITIONS:
            return i
        return self._numbered(Node("select", (i, self.constant(1.0), self.constant(0.0))))

    def needed(self, roots: Sequence[int] | None = None) -> list[int]:
        """What the roots, by default all results, depend on, themselves included, in order."""
        stack = list(roots) if roots is not None else [i for result in self.results for i in result]
        found: set[int] = set()
        while stack:
            i = stack.pop()
            if i not in found:
                found.add(i)
                stack += self.nodes[i].arguments
        return sorted(found)

    def operations(self, roots: Sequence[int] | None = None) -> int:
        """How many operations that is."""
        return sum(bool(self.nodes[i].arguments) for i in self.needed(roots))

    def fused(self) -> "Graph":
        """The same with a b + c, a b - c and c - a b as one node each where the product is used nowhere else.

        Of two products in a sum it is the one that is ready last: the other one is there by then.
        """
        needed = self.needed()
        uses = Counter(k for i in needed for k in self.nodes[i].arguments)
        uses.update(i for result in self.results for i in result)
        graph = Graph()
        here: dict[int, int] = {}
        for i in needed:
            node = self.nodes[i]
            operation, arguments = node.operation, node.arguments
            products = [k for k in arguments if self.nodes[k].operation == "mul" and uses[k] == 1]
            if operation in _SUMS and products:
                product = max(products, key=self.depth.__getitem__)
                operation = "fmadd" if operation == "add" else "fmsub" if product == arguments[0] else "fnmadd"
                arguments = (*self.nodes[product].arguments, sum(arguments) - product)
            here[i] = graph._numbered(replace(node, operation=operation, arguments=tuple(here[k] for k in arguments)))
        graph.results = [[here[i] for i in result] for result in self.results]
        return graph

    def without_branches(self) -> "Graph":
        """The same with masks and choices in place of selects where one condition makes several between results.

        Of those a compiler makes a branch, and all that is computed after it waits for a guess to be made good.
        """
        needed = self.needed()
        choices = [self.nodes[i].arguments for i in needed if self.nodes[i].operation == "select"]
        between_results = [x[0] for x in choices if any(self.nodes[k].arguments for k in x[1:])]
        several = {condition for condition, count in Counter(between_results).items() if count > 1}
        graph = Graph()
        here: dict[int, int] = {}
        for i in needed:
            node = self.nodes[i]
            arguments = tuple(here[k] for k in node.arguments)
            if node.operation == "select" and node.arguments[0] in several:
                mask = graph._numbered(Node("mask", arguments[:1]))
                here[i] = graph._numbered(Node("choice", (mask, *arguments[1:])))
            else:
                here[i] = graph._numbered(replace(node, arguments=arguments))
        graph.results = [[here[i] for i in result] for result in self.results]
        return graph

    def _read(self, function: ca.Function) -> None:
        work: dict[int, int] = {}
        outputs = [[0] * function.size1_out(k) for k in range(function.n_out())]
        for k in range(function.n_instructions()):
            code, into, given = (
                function.instruction_id(k),
                function.instruction_output(k),
                function.instruction_input(k),
            )
            if code == ca.OP_INPUT:
                work[into[0]] = self._numbered(Node("given", array=given[0], entry=given[1]))
            elif code == ca.OP_CONST:
                work[into[0]] = self.constant(function.instruction_constant(k))
            elif code == ca.OP_OUTPUT:
                outputs[into[0]][into[1]] = self.real(work[given[0]])
            else:
                work[into[0]] = self._operation(code, [work[i] for i in given])
        self.results = outputs

    def _operation(self, code: int, arguments: Sequence[int]) -> int:
        if code in SHORT_FORMS:
            first = arguments[0] if code in (ca.OP_IF_ELSE_ZERO, ca.OP_ASSIGN) else self.real(arguments[0])
            return SHORT_FORMS[code](self, [first, *map(self.real, arguments[1:])])
        if code not in _OPERATIONS:
            raise ValueError(f"no C for CasADi's operation {code}")
        operation = _OPERATIONS[code]
        as_wanted = self.condition if operation in ("not", "and", "or") else self.real
        return self.node(operation, *map(as_wanted, arguments))

    def _follow(self, plain: "Graph") -> None:
        """Take over another graph, quotients with shared denominators as products, sums in the order of readiness."""
        needed = plain.needed()
        nodes = [plain.nodes[i] for i in needed]
        divided = Counter(node.arguments[1] for node in nodes if node.operation == "div")
        uses = Counter(k for node in nodes for k in node.arguments)
        uses.update(i for result in plain.results for i in result)
        within = {k for node in nodes if node.operation in _SUMS for k in node.arguments if uses[k] == 1}
        here: dict[int, int] = {}
        for i, node in zip(needed, nodes, strict=True):
            if node.operation in _SUMS:
                if i not in within:
                    here[i] = self._sum([(sign, here[k]) for sign, k in plain._terms(i, within)])
            elif node.operation == "div":
                x, y = node.arguments
                here[i] = self._quotient(here[x], here[y], often=divided[y] > 1)
            elif node.arguments:
                here[i] = self.node(node.operation, *(here[k] for k in node.arguments))
            else:
                here[i] = self._numbered(node)
        self.results = [[here[i] for i in result] for result in plain.results]

    def _quotient(self, x: int, y: int, often: bool) -> int:
        """X / y, or x times the reciprocal of y, where that is shared or there before x is."""
        if often or self.depth[x] > self.depth[y] + LATENCY["mul"]:
            return self.node("mul", x, self.node("div", self.constant(1.0), y))
        return self.node("div", x, y)

    def _terms(self, root: int, within: set[int]) -> list[tuple[int, int]]:
        """Signs and nodes that add up to the root, sums that are used nowhere else taken apart."""
        found: list[tuple[int, int]] = []
        stack = [(1, root)]
        while stack:
            sign, i = stack.pop()
            node = self.nodes[i]
            if node.operation in _SUMS and (i == root or i in within):
                first, second = node.arguments
                stack += [(sign if node.operation == "add" else -sign, second), (sign, first)]
            else:
                found.append((sign, i))
        return found

    def _sum(self, terms: Sequence[tuple[int, int]]) -> int:
        """The sum of signed nodes, those that are ready first added first: the shortest way through."""
        waiting = [(self.depth[i], k, sign, i) for k, (sign, i) in enumerate(terms)]
        heapify(waiting)
        while len(waiting) > 1:
            (_, k, sign, x), (_, _, other, y) = heappop(waiting), heappop(waiting)
            if sign == other:
                total = self.node("add", x, y)
            elif sign > 0:
                total = self.node("sub", x, y)
            else:
                sign, total = 1, self.node("sub", y, x)
            heappush(waiting, (self.depth[total], k, sign, total))
        _, _, sign, total = waiting[0]
        return total if sign > 0 else self.node("neg", total)

    def _numbered(self, node: Node) -> int:
        if node not in self._numbers:
            self._numbers[node] = len(self.nodes)
            self.nodes.append(node)
            ready = max((self.depth[i] for i in node.arguments), default=0)
            self.depth.append(ready + LATENCY.get(node.operation, 1) * bool(node.arguments))
        return self._numbers[node]

    def _value(self, i: int) -> float | None:
        node = self.nodes[i]
        return node.value if node.operation == "constant" else None

    def _negated(self, i: int) -> int | None:
        """X where node i is −x."""
        node = self.nodes[i]
        return node.arguments[0] if node.operation == "neg" else None

    def _simplified(self, operation: str, x: Sequence[int]) -> int | None:
        rule = getattr(self, f"_{operation}", None)
        return rule(*x) if rule else None

    def _neg(self, x: int) -> int | None:
        value = self._value(x)
        if value is not None:
            return self.constant(-value)
        node = self.nodes[x]
        if node.operation == "sub":
            return self.node("sub", node.arguments[1], node.arguments[0])
        return self._negated(x)

    def _add(self, x: int, y: int) -> int | None:
        for a, b in ((x, y), (y, x)):
            if self._value(a) == 0.0:
                return b
            minus = self._negated(b)
            if minus is not None:
                return self.node("sub", a, minus)
        return self._either(x, y)

    def _either(self, x: int, y: int) -> int | None:
        """(c ? a : 0) + (c ? 0 : b), which is how CasADi says c ? a : b."""
        for one, other in ((self.nodes[x], self.nodes[y]), (self.nodes[y], self.nodes[x])):
            alike = one.operation == other.operation == "select" and one.arguments[0] == other.arguments[0]
            if alike and self._value(one.arguments[2]) == 0.0 == self._value(other.arguments[1]):
                return self.node("select", one.arguments[0], one.arguments[1], other.arguments[2])
        return None

    def _or(self, x: int, y: int) -> int | None:
        """Without the constant that a chain of alternatives begins with."""
        never = self.node("ne", self.constant(0.0), self.constant(0.0))
        return y if x == never else x if y == never else None

    def _sub(self, x: int, y: int) -> int | None:
        if self._value(y) == 0.0:
            return x
        if self._value(x) == 0.0:
            return self.node("neg", y)
        minus = self._negated(y)
        if minus is not None:
            return self.node("add", x, minus)
        minus = self._negated(x)
        return None if minus is None else self.node("neg", self.node("add", minus, y))

    def _mul(self, x: int, y: int) -> int | None:
        for a, b in ((x, y), (y, x)):
            value = self._value(a)
            if value == 1.0:
                return b
            if value == -1.0:
                return self.node("neg", b)
            if value is not None and value < 0:
                return self.node("neg", self.node("mul", self.constant(-value), b))
            minus = self._negated(a)
            if minus is not None:
                return self.node("neg", self.node("mul", minus, b))
            chosen = self.nodes[a]
            if chosen.operation == "select" and [self._value(k) for k in chosen.arguments[1:]] == [1.0, 0.0]:
                return self.node("select", chosen.arguments[0], b, self.constant(0.0))
        return None

    def _div(self, x: int, y: int) -> int | None:
        value = self._value(y)
        if value == 1.0:
            return x
        for a, b, first in ((x, y, True), (y, x, False)):
            minus = self._negated(a)
            if minus is not None:
                return self.node("neg", self.node("div", *((minus, b) if first else (b, minus))))
        return None

    def _not(self, x: int) -> int | None:
        node = self.nodes[x]
        return node.arguments[0] if node.operation == "not" else None

    def _select(self, condition: int, x: int, y: int) -> int | None:
        if x == y:
            return x
        node = self.nodes[condition]
        if node.operation == "not":
            return self.node("select", node.arguments[0], y, x)
        for k, one in ((1, self.nodes[x]), (2, self.nodes[y])):
            if one.operation == "select" and one.arguments[0] == condition:  # the same question again
                return self.node("select", condition, *((one.arguments[1], y) if k == 1 else (x, one.arguments[2])))
        return None
