"""C99 text from procedures: scalar functions in double or float, and steps of many robots at once."""

import math
import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Literal

from clikgen.symbolic import elementary
from clikgen.symbolic.copies import Grid, grids, moved
from clikgen.symbolic.graph import CONDITIONS, FUSED, Graph, Node
from clikgen.symbolic.least_squares import ROUNDING
from clikgen.symbolic.order import ordered
from clikgen.symbolic.program_code import program_call
from clikgen.symbolic.quadratic_program import Solution
from clikgen.symbolic.stage import Loop, Procedure

Real = Literal["double", "float"]
LANES = 16  # robots side by side
SIDE_BY_SIDE = "CLIKGEN_SIMD"
PREAMBLE = """\
/* Loops that may run side by side do, given -DCLIKGEN_OPENMP -fopenmp-simd. */
#ifdef CLIKGEN_OPENMP
#define CLIKGEN_SIMD _Pragma("omp simd")
#else
#define CLIKGEN_SIMD
#endif
"""
COPIED = 16  # as many numbers, or more, are copied by loops
WIDEST = 56  # characters of an expression; a longer one is given a name
IN_FLOAT = {ROUNDING: 2.0**-17, -ROUNDING: -(2.0**-17)}
"""Constants that stand for rounding in double, and what stands for it in single precision: 64 times 2^-23."""

LEAST_FLOAT = 1e-30
"""A constant that keeps zero away is no nearer to it in single precision: its inverse is not infinite."""

_BINARY = {"add": ("+", 4), "sub": ("-", 4), "mul": ("*", 5), "div": ("/", 5)}
_RELATION = {"lt": "<", "le": "<=", "eq": "==", "ne": "!="}
_JOINED = {"and": "&", "or": "|"}
_ATOM, _CALL, _SIGN = 9, 8, 6


@dataclass(frozen=True, slots=True)
class Text:
    """An expression of C and how tightly it binds: from 1, a choice, to _ATOM, a name or a number."""

    text: str
    level: int = _ATOM

    def within(self, level: int) -> str:
        """The expression as an operand of something that binds as tightly as `level`."""
        return self.text if self.level >= level else f"({self.text})"


@dataclass(frozen=True, slots=True)
class Array:
    """A matrix in memory, `rows` high, whose entries are counted column by column.

    Entry (r, i) is at name[offset + r * row_stride + i * column_stride + column], and that is put into `lanes`.
    """

    name: str
    rows: int
    row_stride: int
    column_stride: int
    offset: int = 0
    column: str = ""  # a loop's counter, where the matrix is one column of a greater one
    lanes: str = ""  # "{} * LANES + lane" for numbers of many robots side by side

    def index(self, entry: int) -> int:
        """Where an entry is, but for `column`."""
        return self.offset + entry % self.rows * self.row_stride + entry // self.rows * self.column_stride

    def at(self, entry: int) -> str:
        """The C expression of an entry."""
        return self.named(str(self.index(entry)) if not self.column else self._moved(self.index(entry)))

    def named(self, index: str) -> str:
        """The C expression at an index."""
        return f"{self.name}[{self.lanes.format(index if index.isdigit() else f'({index})') if self.lanes else index}]"

    def _moved(self, index: int) -> str:
        return f"{index} + {self.column}" if index else self.column


@dataclass(frozen=True, slots=True)
class Scalars:
    """Numbers that each have an expression of their own."""

    texts: tuple[Text, ...]

    def at(self, entry: int) -> str:
        """The C expression of an entry."""
        return self.texts[entry].within(_ATOM)


@dataclass(frozen=True, slots=True)
class _Run:
    """Entries that are one loop: `count` of them from `first` on, of an array that goes on before and after."""

    first: int
    count: int


@dataclass(slots=True)
class Names:
    """New names of variables, and what the text needs besides."""

    real: Real
    lanes: bool = False  # whether all of it stands in a loop over robots
    count: int = 0
    helpers: set[str] = field(default_factory=set)
    functions: set[str] = field(default_factory=set)  # whole, to stand before it

    def new(self, letter: str = "t") -> str:
        """A letter and the next number."""
        self.count += 1
        return f"{letter}{self.count}"


@dataclass(slots=True)
class Block:
    """Statements that compute nodes of a procedure's graph, each once, in a scope of C."""

    procedure: Procedure
    given: list[Array | Scalars]  # what the procedure is given, and then the symbols of its stages so far
    names: Names
    lines: list[str]
    indent: str = "  "
    repeated: bool = False  # whether it is the body of a loop
    graph: Graph = field(init=False)
    _known: dict[int, Text] = field(default_factory=dict)
    _uses: Counter[int] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self.graph = self.procedure.graph().fused()
        if not self.repeated and not self.names.lanes:  # vectors choose by themselves, and guesses help a long loop
            self.graph = self.graph.without_branches()
        needed = self.graph.needed()
        self._uses = Counter(k for i in needed for k in self.graph.nodes[i].arguments)
        self._uses.update(i for result in self.graph.results for i in result)

    # ---- statements ----

    def line(self, text: str) -> None:
        """One line."""
        self.lines.append(self.indent + text)

    def run(self) -> list[list[int]]:
        """Write all stages; the nodes of the results are left, by column."""
        if not self.names.lanes:
            self._sines_and_cosines()
        results = iter(self.graph.results)
        for stage in self.procedure.stages:
            arguments = [next(results) for _ in stage.arguments]
            if isinstance(stage, Loop) and self.names.lanes:
                self._unrolled(stage, arguments)
            elif isinstance(stage, Loop):
                self._loop(stage, arguments)
            elif isinstance(stage, Solution):
                self.given += program_call(self, stage, arguments)
            else:
                raise TypeError(f"no C for a stage of type {type(stage).__name__}")
        return list(results)

    @contextmanager
    def braces(self, opening: str) -> Iterator[None]:
        """A block in braces, whose names are not known after it."""
        known, indent = dict(self._known), self.indent
        self.line(f"{opening} {{")
        self.indent += "  "
        yield
        self.indent = indent
        self.line("}")
        self._known = known

    def filled(self, nodes: Sequence[int], rows: int, name: str) -> Array:
        """The matrix of these nodes, column by column, in memory: where it is, or in a new array."""
        there = self._in_place(nodes, rows)
        if there:
            return there
        columns = len(nodes) // rows
        array = Array(self.names.new(name), rows, columns, 1)
        if all(self.graph.nodes[i].operation == "constant" for i in nodes):
            by_row = [
                self.constant(self.graph.nodes[nodes[i * rows + r]].value) for r in range(rows) for i in range(columns)
            ]
            self.lines += table(self.names.real, array.name, by_row, self.indent)
            return array
        self._write(array, nodes, f"{self.names.real} {array.name}[{len(nodes)}];")
        return array

    def result(self, name: str, nodes: Sequence[int]) -> None:
        """Write the nodes into the array of a result."""
        self._write(Array(name, len(nodes), 1, 0), nodes)

    def _write(self, array: Array, nodes: Sequence[int], *before: str) -> None:
        """Write the nodes into a matrix, after what they need and the lines `before`; many at once in loops."""
        copies = self._copies(array, nodes)
        copied = {at for _, grid in copies for at in grid.filled}
        values = {entry: self.value(i) for entry, i in enumerate(nodes) if array.index(entry) not in copied}
        for line in (*before, *(f"{array.at(entry)} = {value};" for entry, value in values.items())):
            self.line(line)
        for source, grid in copies:
            counters = [self.names.new("k") for _ in grid.levels]
            for depth, (k, level) in enumerate(zip(counters, grid.levels, strict=True)):
                self.line(f"{'  ' * depth}for (int {k} = 0; {k} < {level.times}; ++{k})")
            to = moved(grid.to, zip(counters, (level.to for level in grid.levels), strict=True))
            there = moved(grid.source, zip(counters, (level.source for level in grid.levels), strict=True))
            self.lines[-1] += f" {array.name}[{to}] = {source}[{there}];"

    def _copies(self, array: Array, nodes: Sequence[int]) -> list[tuple[str, Grid]]:
        """Of the nodes those that lie evenly in other arrays, many in each: the arrays' names and where."""
        places: dict[str, list[tuple[int, int]]] = {}
        for entry, i in enumerate(nodes):
            node = self.graph.nodes[i]
            source = self.given[node.array] if node.operation == "given" else None
            if isinstance(source, Array) and not source.column and not source.lanes:
                places.setdefault(source.name, []).append((array.index(entry), source.index(node.entry)))
        every = [(name, grid) for name, pairs in places.items() for grid in grids(sorted(pairs))]
        return [(name, grid) for name, grid in every if len(grid.filled) >= COPIED]

    def _in_place(self, nodes: Sequence[int], rows: int) -> Array | None:
        """Where the matrix lies already with even strides; None where it does not."""
        parts = [self.graph.nodes[i] for i in nodes]
        if any(part.operation != "given" or part.array != parts[0].array for part in parts):
            return None
        array = self.given[parts[0].array]
        if not isinstance(array, Array):
            return None
        at = [array.index(part.entry) for part in parts]
        row = at[1] - at[0] if rows > 1 else 0
        column = at[rows] - at[0] if len(at) > rows else 0
        if any(at[k] != at[0] + k % rows * row + k // rows * column for k in range(len(at))):
            return None
        return Array(array.name, rows, row, column, at[0], array.column, array.lanes)

    # ---- loops ----

    def _loop(self, loop: Loop, arguments: Sequence[Sequence[int]]) -> None:
        """`for` with the body in braces; what it carries are variables, what it results in arrays."""
        k, name = self.names.new("k"), self.names.new(loop.name)
        carried = [[self._variable(self.value(i)) for i in column] for column in arguments[: loop.carried]]
        bound: list[Array | Scalars] = [Scalars(tuple(map(Text, column))) for column in carried]
        for j in range(loop.carried, loop.carried + loop.over):
            matrix = self.filled(arguments[j], loop.arguments[j].shape[0], f"{loop.name}_of")
            bound.append(_column(matrix, k))
        for j in range(loop.carried + loop.over, len(arguments)):
            bound.append(self._shared(arguments[j], loop.arguments[j].shape[0]))
        results = []
        for j, symbol in enumerate(loop.symbols[loop.carried :]):
            rows = symbol.shape[0]
            results.append(Array(f"{name}_{j}", rows, loop.count, 1))
            self.line(f"{self.names.real} {name}_{j}[{rows * loop.count}];")
        if not loop.carried and not self.names.lanes:
            self.line(SIDE_BY_SIDE)
        with self.braces(f"for (int {k} = 0; {k} < {loop.count}; ++{k})"):
            body = Block(loop.body, bound, self.names, self.lines, self.indent, repeated=True)
            columns = body.run()
            onward = [[body.value(i) for i in column] for column in columns[: loop.carried]]
            for array, column in zip(results, columns[loop.carried :], strict=True):
                for r, i in enumerate(column):
                    body.line(f"{_column(array, k).at(r)} = {body.value(i)};")
            pairs = [pair for own, news in zip(carried, onward, strict=True) for pair in zip(own, news, strict=True)]
            moved = [(mine, new) for mine, new in pairs if mine != new]
            before = {mine for mine, _ in moved}  # which are not what they were once the first is assigned
            ready = [
                (mine, new if new.isidentifier() and new not in before else body.named(new)) for mine, new in moved
            ]
            for mine, new in ready:
                body.line(f"{mine} = {new};")
        self.given += [Scalars(tuple(map(Text, column))) for column in carried]
        self.given += results

    def _unrolled(self, loop: Loop, arguments: Sequence[Sequence[int]]) -> None:
        """The same operations one iteration after the other: within a loop over robots there is no other loop."""
        texts = [[Text(self.atom(i)) for i in column] for column in arguments]
        carried, shared = texts[: loop.carried], texts[loop.carried + loop.over :]
        matrices = texts[loop.carried : loop.carried + loop.over]
        results: list[list[Text]] = [[] for _ in loop.symbols[loop.carried :]]
        for k in range(loop.count):
            heights = [len(matrix) // loop.count for matrix in matrices]
            columns = [matrix[k * m : (k + 1) * m] for matrix, m in zip(matrices, heights, strict=True)]
            given = [Scalars(tuple(column)) for column in (*carried, *columns, *shared)]
            body = Block(loop.body, list(given), self.names, self.lines, self.indent)
            found = [[Text(body.atom(i)) for i in column] for column in body.run()]
            carried = found[: loop.carried]
            for result, column in zip(results, found[loop.carried :], strict=True):
                result += column
        self.given += [Scalars(tuple(column)) for column in (*carried, *results)]

    def _variable(self, value: str) -> str:
        name = self.names.new("v")
        self.line(f"{self.names.real} {name} = {value};")
        return name

    def _shared(self, nodes: Sequence[int], rows: int) -> Array | Scalars:
        there = self._in_place(nodes, rows)
        if there or len(nodes) > 16:
            return there or self.filled(nodes, rows, "shared")
        return Scalars(tuple(Text(self.atom(i)) for i in nodes))

    # ---- expressions ----

    def value(self, root: int) -> str:
        """The expression of a node, once what it needs has been written; without parentheses around it."""
        return self._text(root).text

    def atom(self, root: int) -> str:
        """The same as a variable or a constant, which may be written more than once."""
        text = self._text(root)
        if text.level < _ATOM and self.graph.nodes[root].arguments:
            text = self._known[root] = Text(self.named(text.text))
        return text.within(_ATOM)

    def named(self, value: str, kind: str = "") -> str:
        """A new variable of this value."""
        name = self.names.new()
        self.line(f"const {kind or self.names.real} {name} = {value};")
        return name

    def _text(self, root: int) -> Text:
        for i in self._missing(root):
            if i not in self._known:
                self._known[i] = self._kept(i, self._expression(self.graph.nodes[i]))
        return self._known[root]

    def _missing(self, root: int) -> list[int]:
        """What the node needs that is not known yet, in order."""
        stack, found = [root], set[int]()
        while stack:
            i = stack.pop()
            if i not in found and i not in self._known:
                found.add(i)
                stack += self.graph.nodes[i].arguments
        return sorted(found)

    def constant(self, value: float) -> str:
        """A constant, exact to the last bit."""
        if self.names.real == "double":
            return repr(value)
        value = IN_FLOAT.get(value, value)
        text = repr(math.copysign(max(abs(value), LEAST_FLOAT), value) if value else value)
        return f"{text if set(text) & set('.en') else text + '.0'}f"

    def _kept(self, i: int, text: Text) -> Text:
        """The expression, or the variable it has been given to where it is used more often or long."""
        node = self.graph.nodes[i]
        if self.names.lanes and node.operation == "given" and "[" in text.text:
            return Text(self.named(text.text))  # a load within a choice keeps the loop over robots from vectors
        if not node.arguments or node.operation in ("sin", "cos"):
            return text
        often = self._uses[i] > 1 and not self._is_sign(node)
        if len(text.text) <= (30 if node.operation in CONDITIONS else 0 if often else WIDEST):
            return text
        mask = "uint64_t" if self.names.real == "double" else "uint32_t"
        kind = "int" if node.operation in CONDITIONS else mask if node.operation == "mask" else ""
        return Text(self.named(text.text, kind))

    def _is_sign(self, node: Node) -> bool:
        return node.operation == "neg" and not self.graph.nodes[node.arguments[0]].arguments

    def _expression(self, node: Node) -> Text:
        x = [self._known[k] for k in node.arguments]
        operation = node.operation
        if operation == "given":
            return Text(self.given[node.array].at(node.entry))
        if operation == "constant":
            return Text(self.constant(node.value), _ATOM if node.value >= 0 else _SIGN)
        if operation in _BINARY:
            sign, level = _BINARY[operation]
            # the right operand's parentheses keep the order of the operations
            return Text(f"{x[0].within(level)} {sign} {x[1].within(level + 1)}", level)
        if operation == "neg":
            return _negative(x[0])
        if operation in _RELATION:
            return Text(f"{x[0].within(4)} {_RELATION[operation]} {x[1].within(4)}", 3)
        if operation in _JOINED:
            return Text(f"{x[0].within(_ATOM)} {_JOINED[operation]} {x[1].within(_ATOM)}", 2)
        if operation == "not":
            return Text(f"!{x[0].within(_ATOM)}", _SIGN)
        if operation == "select":
            return Text(f"{x[0].within(3)} ? {x[1].within(2)} : {x[2].within(2)}", 1)
        if operation in ("max", "min"):
            a, b = map(self.atom, node.arguments)
            return Text(f"{a} {'>' if operation == 'max' else '<'} {b} ? {a} : {b}", 1)
        if operation in FUSED:
            return self._fused(node)
        if operation in ("sin", "cos"):
            return self._sine_or_cosine(operation, node.arguments[0], x[0].text)
        return self._call(operation, [one.text for one in x])

    def _fused(self, node: Node) -> Text:
        """A product and a sum in one call, of operands that leave room on a line."""
        for i in sorted(node.arguments, key=lambda i: -len(self._known[i].text)):
            if sum(len(self._known[k].text) for k in node.arguments) > WIDEST:
                self.atom(i)
        first, second, last = (self._known[i] for i in node.arguments)
        if node.operation == "fnmadd":
            first = _negative(first)
        elif node.operation == "fmsub":
            last = _negative(last)
        return self._call("fma", [first.text, second.text, last.text])

    def _sines_and_cosines(self) -> None:
        """Of all angles that are given, side by side."""
        nodes = self.graph.nodes
        turned = [nodes[i].arguments[0] for i in self.graph.needed() if nodes[i].operation in ("sin", "cos")]
        angles = [i for i in dict.fromkeys(turned) if nodes[i].operation == "given"]
        if len(angles) < 2:
            return
        k, angle = self.names.new("k"), self.filled(angles, 1, "angle")
        runs = self._runs(angle, angles)
        sine, cosine, count = self.names.new("sine"), self.names.new("cosine"), sum(run.count for run in runs)
        self.line(f"{self.names.real} {sine}[{count}], {cosine}[{count}];")
        self.names.helpers.add("sincos")
        place = 0
        for run in runs:
            there = _column(replace(angle, offset=angle.index(run.first)), k).at(0)
            at = f"{place} + {k}" if place else k
            self.line(SIDE_BY_SIDE)
            call = f"clikgen_sincos({there}, &{sine}[{at}], &{cosine}[{at}]);"
            self.line(f"for (int {k} = 0; {k} < {run.count}; ++{k}) {call}")
            for j in range(max(run.first, 0), min(run.first + run.count, len(angles))):
                for name, array in (("sin", sine), ("cos", cosine)):
                    number = self.graph.number(Node(name, (angles[j],)))
                    if number is not None:
                        self._known[number] = Text(f"{array}[{place + j - run.first}]")
            place += run.count

    def _runs(self, angle: Array, angles: Sequence[int]) -> tuple[_Run, ...]:
        """In which runs angles are turned into sines and cosines: all at once, unless that takes vectors more.

        Three angles more than whole vectors of four would be a pair and a single one. They are turned as four: with the
        angle before them or, where there is none, with what lies beside them in their array.
        """
        count = len(angles)
        if count % 4 != 3:
            return (_Run(0, count),)
        if count > 4:
            return _Run(0, count - 3), _Run(count - 4, 4)
        array = self.given[self.graph.nodes[angles[0]].array]
        if isinstance(array, Array) and array.name == angle.name and array.row_stride == angle.column_stride == 1:
            if angle.offset + count < array.offset + array.rows:
                return (_Run(0, 4),)
            if angle.offset > array.offset:
                return (_Run(-1, 4),)
        return (_Run(0, count),)

    def _call(self, operation: str, arguments: Sequence[str]) -> Text:
        suffix = "f" if self.names.real == "float" else ""
        if operation in ("sqrt", "abs", "copysign"):
            return Text(f"{'f' * (operation == 'abs')}{operation}{suffix}({', '.join(arguments)})", _CALL)
        self.names.helpers.add("choice" if operation == "mask" else operation)
        return Text(f"clikgen_{operation}({', '.join(arguments)})", _CALL)

    def _sine_or_cosine(self, operation: str, angle: int, text: str) -> Text:
        """Both, once for each angle."""
        self.names.helpers.add("sincos")
        sine, cosine = self.names.new("s"), self.names.new("c")
        self.line(f"{self.names.real} {sine}, {cosine};")
        self.line(f"clikgen_sincos({text}, &{sine}, &{cosine});")
        pair = {"sin": Text(sine), "cos": Text(cosine)}
        for name, value in pair.items():
            number = self.graph.number(Node(name, (angle,)))
            if number is not None:
                self._known[number] = value
        return pair[operation]


def _negative(text: Text) -> Text:
    return Text(f"-({text.text})" if text.text.startswith("-") else f"-{text.within(_SIGN)}", _SIGN)


def _column(matrix: Array, counter: str) -> Array:
    """The column of a matrix that a loop's counter stands for."""
    moved = counter if matrix.column_stride == 1 else f"{counter} * {matrix.column_stride}"
    column = f"{matrix.column} + {moved}" if matrix.column else moved
    return Array(matrix.name, matrix.rows, matrix.row_stride, 0, matrix.offset, column, matrix.lanes)


def table(real: Real, name: str, values: Sequence[str], indent: str = "  ") -> list[str]:
    """The lines of an array of constants."""
    text = f"static const {real} {name}[{len(values)}] = {{{', '.join(values)}}};"
    return textwrap.wrap(
        text,
        120,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def function_text(procedure: Procedure, inputs: Sequence[str], outputs: Sequence[str], names: Names) -> str:
    """A function of one robot in CasADi's calling convention, its arguments by their names."""
    real = names.real
    given = [Array(name, column.numel(), 1, 0) for name, column in zip(inputs, procedure.given, strict=True)]
    block = Block(procedure, list(given), names, [])
    for name, nodes in zip(outputs, block.run(), strict=True):
        block.result(name, nodes)
    lines = [
        f"int {procedure.name}(const {real} **arg, {real} **res, long long int *iw, {real} *w, int mem) {{",
        *_bound(inputs, outputs, block),
        *ordered(block.lines),
        "  (void)iw, (void)w, (void)mem;",
        "  return 0;",
        "}",
    ]
    return "\n".join(lines) + "\n"


def lanes_text(procedure: Procedure, inputs: Sequence[str], outputs: Sequence[str], names: Names) -> str:
    """A function of LANES robots side by side, `<name>_lanes(arg, res)`; the procedure has loops, no other stages."""
    place = "{} * LANES + lane"
    columns = zip(inputs, procedure.given, strict=True)
    given = [Array(name, column.numel(), 1, 0, lanes=place) for name, column in columns]
    block = Block(procedure, list(given), names, [], "    ")
    for name, nodes in zip(outputs, block.run(), strict=True):
        for entry, node in enumerate(nodes):
            block.line(f"{name}[{entry} * LANES + lane] = {block.value(node)};")
    signature = f"void {procedure.name}_lanes(const {names.real} *const *arg, {names.real} *const *res)"
    lines = [
        f"enum {{ LANES = {LANES} }};\n",
        f"{signature};\n",
        f"{signature} {{",
        *_bound(inputs, outputs, block),
        f"  {SIDE_BY_SIDE}",
        "  for (int lane = 0; lane < LANES; ++lane) {",
        *block.lines,
        "  }",
        "}",
    ]
    return "\n".join(lines) + "\n"


def module_text(functions: Sequence[str], names: Names) -> str:
    """The functions that were written with these names, after all that they need."""
    simd = [PREAMBLE] if any(SIDE_BY_SIDE in function for function in functions) else []
    helpers = elementary.text(names.real, names.helpers)
    return "\n".join(("#include <math.h>\n", *simd, helpers, *sorted(names.functions), *functions))


def _bound(inputs: Sequence[str], outputs: Sequence[str], block: Block) -> list[str]:
    """The arguments that the block uses by their names; they do not overlap."""
    real, text = block.names.real, "\n".join(block.lines)
    used = [(k, name) for k, name in enumerate(inputs) if re.search(rf"\b{name}\[", text)]
    return [
        *(f"  const {real} *restrict const {name} = arg[{k}];" for k, name in used),
        *(f"  {real} *restrict const {name} = res[{k}];" for k, name in enumerate(outputs)),
    ]
