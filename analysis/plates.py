"""A figure with what it shows in words and in numbers: saved as PNG, SVG and CSV."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clikgen.analysis import drawing
from clikgen.analysis.figures import save
from clikgen.runtime.documents import write_atomically

Columns = Mapping[str, NDArray[np.floating]]


@dataclass(frozen=True, slots=True, eq=False)
class Plate:
    """A figure, the sentence that says what to see in it, and its data: name with unit -> values (k,)."""

    name: str
    caption: str
    figure: Figure
    data: Columns


def save_plates(plates: Sequence[Plate], folder: Path, progress: Callable[[str], None] = drawing.ignore) -> list[Path]:
    """Write every plate to `folder` as NAME.png, NAME.svg and NAME.csv; raises BadInput when it cannot."""
    paths = save({plate.name: plate.figure for plate in plates}, folder, ("png", "svg"), progress)
    for plate in plates:
        path = folder / f"{plate.name}.csv"
        write_atomically(path, csv_text(plate.data).encode())
        paths.append(path)
    return paths


def csv_text(columns: Columns) -> str:
    """The columns under their names, all digits; a column shorter than the longest ends in empty cells."""
    rows = zip_longest(*(np.ravel(values).tolist() for values in columns.values()))
    lines = [",".join("" if value is None else repr(float(value)) for value in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"
