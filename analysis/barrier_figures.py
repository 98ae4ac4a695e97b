"""The sampled barrier in pictures: clearances against the margin over time, and the margin over the sampling time."""

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from clikgen.analysis.drawing import COMMANDED, ERROR, QUIET, STYLE, TRACED
from clikgen.analysis.measured_barrier import ROUNDING, Kept
from clikgen.analysis.plates import Plate

Array = NDArray[np.float64]

MOST = 3  # points that are shown
ABOVE, BELOW = 4.0, 1.6  # how much of the clearance is shown on either side of zero, in margins
SMALLEST = 1e-8  # [m] a margin below this is drawn as large


@dataclass(frozen=True, slots=True)
class Sampled:
    """A point of interest at one sampling time."""

    period: float
    """T [s]."""
    margin: float
    """m of the rollout [m]."""
    greatest: float
    """The greatest m_k [m]."""
    there: float
    """m_k where the clearance was least [m]."""
    intrusion: float
    """How far it fell below zero there [m]."""


def clearance_plate(names: Sequence[str], cases: Mapping[int, Sequence[Kept]], period: float) -> Plate:
    """Clearances over time against what is guaranteed of them: points by their labels a row each, cases a column each.

    The first MOST points are shown that came near their margin in one case at least, or the first one.
    """
    found = {(number, each.label): each for number, kept in cases.items() for each in kept}
    near = [name for name in names if any(_near(found[number, name]) for number in cases)]
    shown = (near or list(names))[:MOST]
    t = period * np.arange(len(found[next(iter(cases)), shown[0]].clearance), dtype=np.float64)
    columns: dict[str, Array] = {"t [s]": t}
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.9 * len(cases) + 0.6, 2.1 * len(shown) + 1.4), layout="constrained")
        grid = figure.subplots(len(shown), len(cases), sharex=True, squeeze=False)
        for row, name in zip(grid, shown, strict=True):
            for axes, number in zip(row, cases, strict=True):
                point, label = found[number, name], f"case {number}: {name}"
                _clearance(axes, t, point)
                axes.set_title(label, loc="left")
                columns |= {f"{label} h [m]": point.clearance, f"{label} −m_k [m]": -point.bound}
        for axes in grid[-1]:
            axes.set_xlabel("t [s]")
        entries = [
            Line2D([], [], color=TRACED, label="clearance $h = d - s$, measured"),
            Line2D([], [], color=ERROR, label="$-m_k$: it cannot fall below"),
            Patch(facecolor=ERROR, alpha=0.12, label="excluded by the theory"),
        ]
        figure.legend(handles=entries, loc="outside lower center", ncols=3)
        figure.suptitle(f"The last of the clearance, and what the barrier guarantees of it at T = {1e3 * period:g} ms")
    caption = (
        "Clearance of the points that came nearest to their margin, close to zero, and −m_k, the bound that follows "
        "step by step from how their paths curve and from what the barrier does not know of the nearest obstacle."
    )
    return Plate("barrier_clearance", caption, figure, columns)


def _near(point: Kept) -> bool:
    """Whether there is something of its clearance to be seen."""
    return point.least < ABOVE * _scale(point)


def _scale(point: Kept) -> float:
    """What a clearance is drawn on the scale of: its margin, or how far it fell below zero [m]."""
    return max(float(np.max(point.bound)), -point.least, SMALLEST)


def _clearance(axes: Axes, t: Array, point: Kept) -> None:
    """One point: h and −m_k, zoomed in on the margin."""
    greatest = _scale(point)
    factor, unit = (1e3, "mm") if greatest > 1e-4 else (1e6, "µm")
    low, high = -BELOW * factor * greatest, ABOVE * factor * greatest
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    axes.fill_between(t, -factor * point.bound, low, color=ERROR, alpha=0.12, linewidth=0)
    axes.plot(t, -factor * point.bound, color=ERROR, linewidth=1.0)
    axes.plot(t, np.clip(factor * point.clearance, 2 * low, 2 * high), color=TRACED)
    axes.set(ylim=(low, high), xlim=(t[0], t[-1]), ylabel=f"$h$ [{unit}]")
    if not _near(point):
        nearest = f"never nearer than {1e3 * point.least:.3g} mm"
        axes.text(0.5, 0.8, nearest, transform=axes.transAxes, color=QUIET, ha="center")


def period_plate(name: str, samples: Sequence[Sampled]) -> Plate:
    """Margin and intrusion of one point over the sampling time, both logarithmic."""
    T, m, greatest, there, below = (1e3 * np.array(column) for column in zip(*map(astuple, samples), strict=True))
    seen = below > 1e3 * ROUNDING
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 4.6), layout="constrained")
        axes = figure.subplots()
        axes.plot(T, m, color=COMMANDED, linestyle="--", marker="o", markersize=4, label="margin $m$")
        axes.plot(T, greatest, color=ERROR, marker="o", markersize=4, label="greatest $m_k$")
        if seen.any():
            axes.plot(T[seen], there[seen], "_", color=ERROR, markersize=14, label="$m_k$ where $h$ is least")
            axes.plot(T[seen], below[seen], "s", color=TRACED, markersize=5, label="$-h$ there, measured")
        axes.set(xscale="log", yscale="log", xlabel="sampling time T [ms]", ylabel="[mm]")
        axes.set_xticks(T, [f"{one:g}" for one in T])
        axes.set_xticks([], minor=True)
        axes.legend()
        figure.suptitle(f"{name}: the margin over the sampling time")
    never = "" if seen.all() else " Where no square is drawn, the clearance never fell below zero."
    caption = f"Case 1 at several sampling times: a margin that is due to curvature halves with T.{never}"
    columns = {"T": T, "m": m, "greatest m_k": greatest, "m_k where h is least": there, "−h there": below}
    data = {f"{column} [{'ms' if column == 'T' else 'mm'}]": values for column, values in columns.items()}
    return Plate("barrier_margin_over_period", caption, figure, data)
