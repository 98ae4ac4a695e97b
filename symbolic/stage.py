"""Procedures: expressions, with loops and programs that may end early between them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import casadi as ca

from clikgen.symbolic.graph import Graph

STRAIGHT = 6000  # operations up to which straight-line code is no trouble


@dataclass(frozen=True, slots=True, eq=False)
class Stage(ABC):
    """What fills in `symbols` from the values of `arguments`, which depend on earlier stages' symbols."""

    name: str
    symbols: tuple[ca.SX, ...]
    arguments: tuple[ca.SX, ...]

    @property
    def column(self) -> ca.SX:
        """All symbols, one below the other."""
        return ca.vertcat(*map(ca.vec, self.symbols))

    @property
    @abstractmethod
    def operations(self) -> int:
        """How many operations are carried out at most."""

    def without_unused(self, needed: ca.SX) -> Self:
        """The same without what `needed` does not depend on, where that saves work."""
        return self

    @abstractmethod
    def run(self, values: Sequence[ca.MX]) -> Sequence[ca.MX]:
        """The values of the symbols by CasADi's own means."""


@dataclass(frozen=True, slots=True, eq=False)
class Procedure:
    """The columns `results` as expressions of the columns `given` and of the symbols of `stages`, in this order."""

    name: str
    given: tuple[ca.SX, ...]
    results: tuple[ca.SX, ...]
    stages: tuple[Stage, ...] = ()

    @classmethod
    def of(cls, name: str, given: Sequence[ca.SX], results: Sequence[ca.SX], stages: Sequence[Stage]) -> "Procedure":
        """The procedure with those of the stages that its results depend on."""
        used, needed = list[Stage](), ca.vertcat(*map(ca.vec, results))
        for stage in reversed(stages):
            if ca.depends_on(needed, stage.column):
                stage = stage.without_unused(needed)
                used.insert(0, stage)
                needed = ca.vertcat(needed, *map(ca.vec, stage.arguments))
        return cls(name, tuple(given), tuple(results), tuple(used))

    def depends_on(self, symbols: ca.SX) -> bool:
        """Whether a result or a stage does."""
        needed = (*self.results, *(argument for stage in self.stages for argument in stage.arguments))
        return bool(ca.depends_on(ca.vertcat(*map(ca.vec, needed)), symbols))

    def graph(self) -> Graph:
        """The graph of `given` and the stages' symbols; its results are the stages' arguments, then the results."""
        symbols = (*self.given, *(symbol for stage in self.stages for symbol in stage.symbols))
        wanted = (*(argument for stage in self.stages for argument in stage.arguments), *self.results)
        return Graph.of([ca.vec(symbol) for symbol in symbols], wanted)

    def straightened(self) -> "Procedure":
        """The same with loops only where they are long."""
        return self.unrolled(lambda loop: loop.operations <= STRAIGHT)

    def unrolled(self, paying: "Callable[[Loop], bool]") -> "Procedure":
        """The same without the loops for which that pays, inner ones first."""
        kept: list[Stage] = []
        known = list[ca.SX](), list[ca.SX]()  # symbols of loops that are gone, and what they stand for
        for stage in self.stages:
            arguments = _with(stage.arguments, *known)
            if isinstance(stage, Loop):
                stage = replace(stage, body=stage.body.unrolled(paying))
                if paying(stage) and not stage.body.stages:
                    known[0].extend(stage.symbols)
                    known[1].extend(stage.inlined(arguments))
                    continue
            kept.append(replace(stage, arguments=tuple(arguments)))
        return replace(self, results=tuple(_with(self.results, *known)), stages=tuple(kept))

    @property
    def operations(self) -> int:
        """How many operations one evaluation carries out at most."""
        return self.graph().operations() + sum(stage.operations for stage in self.stages)

    def casadi(self, labels: tuple[list[str], list[str]] | None = None) -> ca.Function:
        """The same as CasADi's function, with the names of what goes in and comes out.

        What a part after a stage needs that does not depend on that stage is computed before it, once.
        """
        names = labels or ([f"i{k}" for k in range(len(self.given))], [f"o{k}" for k in range(len(self.results))])
        if not self.stages:
            return ca.Function(self.name, self.given, ca.cse(list(self.results)), *names)
        parts = [*(list(stage.arguments) for stage in self.stages), list(self.results)]
        kept: list[ca.SX] = []  # symbols of what each part takes over from the part before it
        for k in reversed(range(1, len(parts))):
            earlier = ca.vertcat(*map(ca.vec, self.given), *(stage.column for stage in self.stages[: k - 1]))
            parts[k], symbols, values = ca.extract_parametric(parts[k], earlier, {"extract_trivial": True})
            parts[k - 1].append(ca.vertcat(*map(ca.vec, values)))
            kept.insert(0, ca.vertcat(*map(ca.vec, symbols)))
        inputs = [ca.MX.sym(name, *column.shape) for name, column in zip(names[0], self.given, strict=True)]
        values_in, symbols_in = list(inputs), list(self.given)
        for k, stage in enumerate(self.stages):
            part = ca.Function(f"{self.name}_part_{k}", symbols_in, ca.cse(parts[k]))
            *arguments, rest = part.call(values_in)
            values_in, symbols_in = [rest, *stage.run(arguments)], [kept[k], *stage.symbols]
        last = ca.Function(f"{self.name}_part_{len(self.stages)}", symbols_in, ca.cse(parts[-1]))
        return ca.Function(self.name, inputs, last.call(values_in), *names)


Symbols = Sequence[ca.SX]
Body = Callable[[Symbols, Symbols, Symbols, list[Stage]], tuple[Sequence[ca.SX], Sequence[ca.SX]]]
"""What an iteration makes of what is carried, its columns and what is shared: what is carried on, and its results.

Stages of its own it adds to the list.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Loop(Stage):
    """`count` times the body, each time with its own columns of `over`, and with what the time before carried on.

    `arguments` are what is carried at first, (k, 1) each, the columns, (rows, count) each, and what is shared, of
    these what the body needs; the symbols are what is carried in the end, and the results of all iterations side by
    side. The body is given and gives the same, a column of each.
    """

    count: int
    carried: int  # how many of the arguments, and of the symbols, are carried on
    over: int  # how many of the arguments go by columns
    body: Procedure

    @classmethod
    def of(
        cls,
        name: str,
        body: Body,
        carried: Sequence[ca.SX],
        over: Sequence[ca.SX],
        shared: Sequence[ca.SX],
    ) -> "Loop":
        """The loop whose body is a function of symbols."""
        count = over[0].shape[1]
        mine = [ca.SX.sym("carried", *one.shape) for one in carried]
        columns = [ca.SX.sym("column", one.shape[0]) for one in over]
        alike = [ca.SX.sym("shared", *one.shape) for one in shared]
        stages: list[Stage] = []
        onward, results = body(mine, columns, alike, stages)
        given = (*mine, *columns, *alike)
        symbols = [ca.SX.sym(name, *one.shape) for one in onward]
        symbols += [ca.SX.sym(name, one.numel(), count) for one in results]
        return cls(
            name=name,
            symbols=tuple(symbols),
            arguments=(*carried, *over, *shared),
            count=count,
            carried=len(mine),
            over=len(columns),
            body=Procedure.of(name, given, ca.cse([*onward, *results]), stages),
        )

    @property
    def operations(self) -> int:
        """Those of the body, as often as it runs."""
        return self.count * self.body.operations

    def without_unused(self, needed: ca.SX) -> Self:
        """Without what is not needed, carried values too, and with the arguments that the others take."""
        used = {k for k, one in enumerate(self.symbols) if ca.depends_on(needed, ca.vec(one))}
        while True:
            results = [self.body.results[k] for k in sorted(used)]
            body = Procedure.of(self.name, self.body.given, results, self.body.stages)
            takes = {k for k, one in enumerate(body.given) if body.depends_on(ca.vec(one))}
            more = {k for k in takes if k < self.carried} - used
            if not more:
                break
            used |= more
        takes |= {k for k in used if k < self.carried}
        return replace(
            self,
            symbols=tuple(self.symbols[k] for k in sorted(used)),
            arguments=tuple(self.arguments[k] for k in sorted(takes)),
            carried=sum(k < self.carried for k in used),
            over=sum(self.carried <= k < self.carried + self.over for k in takes),
            body=replace(body, given=tuple(body.given[k] for k in sorted(takes))),
        )

    def inlined(self, arguments: Sequence[ca.SX]) -> list[ca.SX]:
        """What the symbols stand for, as expressions; the body has no stages."""
        return self._iterated(self.body.casadi(), arguments)

    def run(self, values: Sequence[ca.MX]) -> list[ca.MX]:
        """One call of the body after the other."""
        function = self.body.casadi()
        if not self.carried:
            alike = list(range(self.over, function.n_in()))
            return list(function.map(f"{self.name}_each", "serial", self.count, alike, []).call(list(values)))
        return self._iterated(function, values)

    def _iterated(self, function: ca.Function, values: Sequence[Any]) -> list[Any]:
        carried = list(values[: self.carried])
        columns = values[self.carried : self.carried + self.over]
        shared = values[self.carried + self.over :]
        results: list[Sequence[Any]] = []
        for i in range(self.count):
            outputs = function.call([*carried, *(one[:, i] for one in columns), *shared])
            carried = outputs[: self.carried]
            results.append(outputs[self.carried :])
        return [*carried, *(ca.horzcat(*one) for one in zip(*results, strict=True))]


def looped(
    name: str,
    body: Body,
    carried: Sequence[ca.SX],
    over: Sequence[ca.SX],
    shared: Sequence[ca.SX],
    stages: list[Stage],
) -> tuple[tuple[ca.SX, ...], tuple[ca.SX, ...]]:
    """What a loop added to the stages carries in the end, and its results side by side."""
    loop = Loop.of(name, body, carried, over, shared)
    stages.append(loop)
    return loop.symbols[: len(carried)], loop.symbols[len(carried) :]


def _with(expressions: Sequence[ca.SX], symbols: Sequence[ca.SX], values: Sequence[ca.SX]) -> Sequence[ca.SX]:
    """The expressions with values for symbols."""
    if not symbols:
        return expressions
    return ca.substitute(list(expressions), list(symbols), list(values))
