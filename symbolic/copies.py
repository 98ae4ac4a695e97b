"""Copies from one array into another as nested loops."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Level:
    """A loop: how often, and by how much the index that is written and the one that is read move each time."""

    times: int
    to: int
    source: int


@dataclass(frozen=True, slots=True)
class Grid:
    """Entries that are copied by loops within each other, the outermost first, from these two indices on."""

    to: int
    source: int
    levels: tuple[Level, ...] = ()

    @property
    def filled(self) -> list[int]:
        """The indices that are written."""
        indices = [self.to]
        for level in self.levels:
            indices = [start + k * level.to for start in indices for k in range(level.times)]
        return indices


def grids(pairs: Sequence[tuple[int, int]]) -> list[Grid]:
    """Grids that stand for these copies (to, source), in this order: what goes on evenly is one loop, and so on."""
    found = [Grid(*pair) for pair in pairs]
    while True:
        merged = _merged(found)
        if len(merged) == len(found):
            return merged
        found = merged


def _merged(found: Sequence[Grid]) -> list[Grid]:
    """Grids of one shape that follow each other evenly as one, as many at once as there are."""
    merged, at = list[Grid](), 0
    while at < len(found):
        first, times = found[at], 1
        if at + 1 < len(found):
            to, source = found[at + 1].to - first.to, found[at + 1].source - first.source
            while at + times < len(found) and found[at + times] == Grid(
                first.to + times * to, first.source + times * source, first.levels
            ):
                times += 1
        merged.append(Grid(first.to, first.source, (Level(times, to, source), *first.levels)) if times > 1 else first)
        at += times
    return merged


def moved(first: int, counters: Iterable[tuple[str, int]]) -> str:
    """The C expression of an index that counters move by so much from `first` on."""
    terms = [name if step == 1 else f"{name} * {step}" for name, step in counters if step]
    return " + ".join([str(first)] * bool(first or not terms) + terms)
