"""Chatter in pictures: the regimes of the normal map, prediction against measurement, and depths over time."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import ArrayLike, NDArray

from clikgen.analysis.chatter import Comparison, Regime, Span, iterate
from clikgen.analysis.drawing import COMMANDED, QUIET, STYLE
from clikgen.analysis.plates import Plate
from clikgen.runtime.documents import BadInput

Array = NDArray[np.float64]

COLOURS: dict[Regime, str] = {
    "sawtooth": "#0072B2",
    "Nyquist two-cycle": "#D55E00",
    "long runs outside": "#009E73",
    "aperiodic": "#CC79A7",
}
MARKERS: dict[Regime, str] = {
    "sawtooth": "o",
    "Nyquist two-cycle": "s",
    "long runs outside": "^",
    "aperiodic": "D",
}
LOWEST, HIGHEST = 1e-3, 10.0  # c/b that the regime map shows
STRONGEST = 6.0  # βK_oT that it shows at least
SHOWN = 26  # samples in a panel of depths over time
LIMIT = 0.05  # the band around "measured as predicted"


def chatter_plates(comparisons: Sequence[Comparison]) -> list[Plate]:
    """The regime map, prediction against measurement, and an example of every regime, from single-point contacts.

    Raises BadInput when none of them cycles.
    """
    cycling = [each for each in comparisons if each.measured.period is not None and each.map.b > 0]
    if not cycling:
        raise BadInput("no contact that chatters: nothing to compare with the normal map")
    with mpl.rc_context(STYLE):
        return [_regimes(cycling), _agreement(cycling), _examples(cycling)]


def _regimes(comparisons: Sequence[Comparison]) -> Plate:
    """The plane of βK_oT and c/b, parted by the closed forms, with every measured contact in it."""
    gain = np.array([2 * (1 - each.map.a) for each in comparisons])
    ratio = np.array([each.map.c / each.map.b for each in comparisons])
    figure = Figure(figsize=(9.0, 6.2), layout="constrained")
    axes = figure.subplots()
    strongest = max(STRONGEST, 1.1 * float(gain.max()))
    _regions(axes, strongest)
    for each, x, y in zip(comparisons, gain, ratio, strict=True):
        _mark(axes, each, x, y)
    axes.set(xlim=(0.0, strongest), ylim=(LOWEST, HIGHEST), yscale="log")
    axes.set_xlabel("$2(1-a) = K_oT$, filtered in contact $\\beta K_oT$")
    axes.set_ylabel(r"$c/b$, drift outward over approach, $\approx (v_t T/2\rho)\,/\,(v_n/v_t)$")
    axes.grid(visible=False)
    entries: list[Artist] = [Patch(facecolor=colour, alpha=0.3, label=regime) for regime, colour in COLOURS.items()]
    entries.append(Patch(facecolor="none", edgecolor=QUIET, hatch="///", label="two stable cycles: the entry decides"))
    entries += _marker_entries(comparisons, "measured: ")
    figure.legend(handles=entries, loc="outside lower center", ncols=3)
    figure.suptitle("Regimes of the normal map: predicted areas, measured marks")
    wrong = sum(each.measured.regime != each.prediction.regime for each in comparisons)
    caption = (
        f"How one point in contact chatters, by two numbers: {len(comparisons)} compiled rollouts, of which "
        f"{wrong} fell into another regime than predicted. Below c = 0 nothing cycles up to K_oT = 2."
    )
    return Plate("chatter_regimes", caption, figure, {"2(1 - a)": gain, "c/b": ratio})


def _regions(axes: Axes, strongest: float) -> None:
    """The areas of the table at the head of `chatter`, in closed form."""
    below, above = np.linspace(0.0, 2.0, 201), np.linspace(2.0, 4.0, 201)
    edge = np.maximum(1 - below / 2, LOWEST)  # c/b = a
    shallow = np.maximum(2 - above / 2, LOWEST)  # c/b = 1 − |a|
    areas: list[tuple[Regime, ArrayLike, ArrayLike, ArrayLike]] = [
        ("sawtooth", below, LOWEST, edge),
        ("Nyquist two-cycle", below, edge, 1.0),
        ("Nyquist two-cycle", above, LOWEST, 1.0),
        ("long runs outside", [0.0, 4.0], 1.0, HIGHEST),
        ("aperiodic", [4.0, strongest], LOWEST, HIGHEST),
    ]
    for regime, x, low, high in areas:
        axes.fill_between(x, low, high, color=COLOURS[regime], alpha=0.3, linewidth=0)
    axes.fill_between(above, shallow, 1.0, facecolor="none", edgecolor=QUIET, hatch="///", linewidth=0)


def _agreement(comparisons: Sequence[Comparison]) -> Plate:
    """Mean period and mean amplitude, measured over predicted, each on logarithmic axes."""
    figure = Figure(figsize=(10.0, 4.9), layout="constrained")
    axes = figure.subplots(1, 2)
    period = [(_mean(each.prediction.period), _mean(each.measured.period)) for each in comparisons]
    rise = [(_mean(each.prediction.amplitude), _mean(each.measured.amplitude)) for each in comparisons]
    columns: dict[str, Array] = {}
    for panel, values, name, unit in zip(axes, (period, rise), ("period", "amplitude"), ("samples", "m"), strict=True):
        both = np.array(values)
        ends = np.array([0.7 * np.nanmin(both), 1.4 * np.nanmax(both)])
        panel.plot(ends, ends, color=COMMANDED, linewidth=0.8)
        panel.fill_between(ends, (1 - LIMIT) * ends, (1 + LIMIT) * ends, color=QUIET, alpha=0.25, linewidth=0)
        for each, (x, y) in zip(comparisons, values, strict=True):
            _mark(panel, each, x, y)
        panel.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
        panel.set_aspect("equal", adjustable="box")
        if unit == "samples":
            ticks = [n for n in (2, 3, 5, 10, 20, 50, 100, 200, 500) if ends[0] < n < ends[1]]
            for axis in (panel.xaxis, panel.yaxis):
                axis.set_ticks(ticks, [str(n) for n in ticks])
                axis.set_ticks([], minor=True)
        panel.set(xlabel=f"predicted {name} [{unit}]", ylabel=f"measured {name} [{unit}]")
        columns |= {f"predicted {name} [{unit}]": both[:, 0], f"measured {name} [{unit}]": both[:, 1]}
    entries = [*_marker_entries(comparisons), Patch(facecolor=QUIET, alpha=0.25, label=f"within {LIMIT:.0%}")]
    figure.legend(handles=entries, loc="outside lower center", ncols=5)
    figure.suptitle("Chatter of one point in contact: measured against predicted")
    worst = max(abs(y / x - 1) for x, y in (*period, *rise) if np.isfinite(x))
    caption = (
        f"Mean period and mean rise of {len(comparisons)} compiled rollouts against the normal map that the "
        f"compiled functions give: at most {worst:.1%} apart."
    )
    return Plate("chatter_agreement", caption, figure, columns)


def _examples(comparisons: Sequence[Comparison]) -> Plate:
    """Depth over samples, one contact per regime: what the rollout did, and the map from the same entry."""
    chosen = {regime: _clearest(comparisons, regime) for regime in COLOURS}
    shown = [each for each in chosen.values() if each is not None]
    figure = Figure(figsize=(10.0, 1.0 + 1.7 * len(shown)), layout="constrained")
    panels = np.atleast_1d(figure.subplots(len(shown), 1, sharex=True))
    columns: dict[str, Array] = {}
    for axes, each in zip(panels, shown, strict=True):
        regime, start = each.measured.regime, _entry(each)
        measured = each.measured.depth[start : start + SHOWN]
        predicted = iterate(each.map, float(measured[0]), len(measured))
        axes.axhspan(0.0, 1e3, color=COLOURS[regime], alpha=0.12, linewidth=0)
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.plot(1e3 * predicted, color=COMMANDED, linestyle="--", linewidth=1.0)
        axes.plot(1e3 * measured, color=COLOURS[regime], marker=MARKERS[regime], markersize=4, linewidth=0.8)
        low, high = 1e3 * min(measured.min(), predicted.min()), 1e3 * max(measured.max(), predicted.max())
        axes.set(ylim=(low - 0.15 * (high - low), high + 0.15 * (high - low)), ylabel="$x$ [mm]")
        axes.set_title(
            f"{regime}: $2(1-a)$ = {2 * (1 - each.map.a):.2f}, $c/b$ = {each.map.c / each.map.b:.3g}", loc="left"
        )
        columns |= {f"{regime} measured [m]": measured, f"{regime} map [m]": predicted}
    panels[-1].set_xlabel("samples after an entry")
    entries = [
        Line2D([], [], color=QUIET, marker="o", markersize=4, linewidth=0.8, label="compiled rollout"),
        Line2D([], [], color=COMMANDED, linestyle="--", linewidth=1.0, label="normal map from the same entry"),
        Patch(facecolor=QUIET, alpha=0.2, label="inside the influence region"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=3)
    figure.suptitle("Depth x = s − d of the point in contact")
    caption = "One contact of every regime: the compiled rollout, and the scalar map from the same entry."
    return Plate("chatter_examples", caption, figure, columns)


def _clearest(comparisons: Sequence[Comparison], regime: Regime) -> Comparison | None:
    """The contact of a regime to show: measured as predicted, with the middle one of the periods."""
    alike = [each for each in comparisons if each.measured.regime == each.prediction.regime == regime]
    return sorted(alike, key=lambda each: _mean(each.measured.period))[len(alike) // 2] if alike else None


def _entry(each: Comparison) -> int:
    """The first entry into the region after the first third of what was measured."""
    inside = each.measured.depth >= 0
    entries = np.flatnonzero(inside[1:] & ~inside[:-1]) + 1
    return int(entries[len(entries) // 3])


def _mean(span: Span | None) -> float:
    return float("nan") if span is None else span.mean


def _mark(axes: Axes, each: Comparison, x: float, y: float) -> None:
    """A mark in the colour and shape of the measured regime."""
    regime = each.measured.regime
    axes.plot(x, y, MARKERS[regime], color=COLOURS[regime], markeredgecolor="black", markeredgewidth=0.6, markersize=6)


def _marker_entries(comparisons: Sequence[Comparison], prefix: str = "") -> list[Line2D]:
    """A legend entry for every regime that was measured."""
    measured = {each.measured.regime for each in comparisons}
    style: dict[str, Any] = {"markeredgecolor": "black", "markeredgewidth": 0.6, "linestyle": "none"}
    return [
        Line2D([], [], marker=MARKERS[regime], color=colour, label=f"{prefix}{regime}", **style)
        for regime, colour in COLOURS.items()
        if regime in measured
    ]
