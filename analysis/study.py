"""What an analysis has to say: figures, tables, verdicts in words, its assumptions, one JSON document."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clikgen.analysis.plates import Plate


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its title, its column heads, its rows as text."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """One analysis of a controller."""

    title: str
    verdicts: Sequence[str]
    tables: Sequence[Table]
    plates: Sequence[Plate]
    assumptions: Sequence[str]
    document: Mapping[str, Any]
    holds: bool = True  # False where something is guaranteed and was not found
