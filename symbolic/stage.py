"""Functions that are not straight-line code, between expressions that are: loops, and programs that may end early."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A function that fills in `symbols` from the values of `arguments`, which depend on earlier stages' symbols."""

    symbols: tuple[ca.SX, ...]
    arguments: tuple[ca.SX, ...]
    run: Callable[[Sequence[ca.MX]], Sequence[ca.MX]]
    instructions: int  # carried out at most

    @property
    def column(self) -> ca.SX:
        """All symbols, one below the other."""
        return ca.vertcat(*map(ca.vec, self.symbols))


def used_stages(columns: Sequence[ca.SX], stages: Sequence[Stage]) -> list[Stage]:
    """Those of the stages, in order, that the columns depend on."""
    used, needed = list[Stage](), ca.vertcat(*columns)
    for stage in reversed(stages):
        if ca.depends_on(needed, stage.column):
            used.insert(0, stage)
            needed = ca.vertcat(needed, *map(ca.vec, stage.arguments))
    return used


def composed(
    name: str,
    given: Sequence[ca.SX],
    columns: Sequence[ca.SX],
    stages: Sequence[Stage],
    labels: tuple[list[str], list[str]],
) -> tuple[ca.Function, int]:
    """The function `given` -> `columns` through the stages, and how many instructions it carries out at most.

    `labels` are the names of what goes in and comes out. What a part after a stage needs that does not depend on
    that stage is computed before it, once.
    """
    if not stages:
        function = ca.Function(name, given, ca.cse(list(columns)), *labels)
        return function, function.n_instructions()
    parts = [*(list(stage.arguments) for stage in stages), list(columns)]
    kept: list[ca.SX] = []  # symbols of what each part takes over from the part before it
    for k in reversed(range(1, len(parts))):
        earlier = ca.vertcat(*given, *(stage.column for stage in stages[: k - 1]))
        parts[k], symbols, values = ca.extract_parametric(parts[k], earlier, {"extract_trivial": True})
        parts[k - 1].append(ca.vertcat(*map(ca.vec, values)))
        kept.insert(0, ca.vertcat(*map(ca.vec, symbols)))
    inputs = [ca.MX.sym(label, column.numel()) for label, column in zip(labels[0], given, strict=True)]
    count, values_in, symbols_in = 0, list(inputs), list(given)
    for k, stage in enumerate(stages):
        part = ca.Function(f"{name}_part_{k}", symbols_in, ca.cse(parts[k]))
        *arguments, rest = part.call(values_in)
        values_in, symbols_in = [rest, *stage.run(arguments)], [kept[k], *stage.symbols]
        count += part.n_instructions() + stage.instructions
    last = ca.Function(f"{name}_part_{len(stages)}", symbols_in, ca.cse(parts[-1]))
    return ca.Function(name, inputs, last.call(values_in), *labels), int(count + last.n_instructions())
