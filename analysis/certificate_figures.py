"""Theory and measurement in one picture: where the loop is stable, how well it tracks, what is certified."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from clikgen.analysis.drawing import COMMANDED, ERROR, LAM, QUIET, STYLE, TRACED
from clikgen.analysis.stability_map import BoundaryPoint, StabilityMap, TrackingMap

Array = NDArray[np.float64]

GAIN_COLOURS = (TRACED, ERROR, LAM)  # of the gains in the figure of the tracking error
LOST = 1.0  # [m] a larger tracking error is not drawn: the reference is lost


def certificate_figures(found: StabilityMap) -> dict[str, Figure]:
    """Gain against sampling time, "stability_map", and error against sampling time, "tracking_error"."""
    with mpl.rc_context(STYLE):
        return {"stability_map": _stability_map(found), "tracking_error": _tracking_error(found)}


# ---- Gain against sampling time ----


def _stability_map(found: StabilityMap) -> Figure:
    """A panel without and a panel with the filter, in the same axes and colours."""
    figure = Figure(figsize=(11.0, 5.4), layout="constrained")
    panels = [figure.add_subplot(1, 2, 1)]
    panels.append(figure.add_subplot(1, 2, 2, sharex=panels[0], sharey=panels[0]))
    maps = (found.tracking, found.filtered_tracking)
    errors = np.concatenate([_followed(tracking).compressed() for tracking in maps])
    norm = LogNorm(float(errors.min()), float(errors.max())) if errors.size else LogNorm(1e-6, LOST)
    boundaries = (found.boundary, found.filtered_boundary)
    for axes, tracking, points in zip(panels, maps, boundaries, strict=True):
        mesh = axes.pcolormesh(
            tracking.periods, tracking.gains, _followed(tracking).T, norm=norm, cmap="viridis_r", shading="nearest"
        )
        _draw_bounds(axes, tracking, points)
    bar = figure.colorbar(mesh, ax=panels, pad=0.01)
    bar.set_label(f"measured: largest tracking error [m]; blank above {LOST:g} m")
    panels[0].set_title("without filter")
    panels[1].set_title("with filter, always on")
    panels[0].set_ylabel("gain $K$ [1/s]")
    _title(figure, f"Stability and tracking of {_names(found)}")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def _followed(tracking: TrackingMap) -> "np.ma.MaskedArray[tuple[int, ...], np.dtype[np.float64]]":
    """The largest errors, masked where the reference is lost."""
    return np.ma.masked_greater(np.ma.masked_invalid(tracking.largest), LOST)


def _draw_bounds(axes: Axes, tracking: TrackingMap, points: Sequence[BoundaryPoint]) -> None:
    """The certified region, the linear bound and the measured boundary over what was measured of tracking."""
    T = np.array([point.period for point in points])
    certified = np.where(tracking.certified > 0, tracking.certified, np.nan)
    low, high = _span(tracking.gains)
    axes.fill_between(
        tracking.periods, low, certified, facecolor="none", edgecolor="white", hatch="//", linewidth=0, alpha=0.5
    )
    axes.plot(tracking.periods, certified, color=LAM, label="certified below (nonlinear)", linewidth=2.0)
    axes.plot(
        T, [point.linear for point in points], color=COMMANDED, linestyle="--", label=r"linear bound 2/($\beta T$)"
    )
    axes.plot(
        T,
        [point.gain for point in points],
        "o",
        color=ERROR,
        markersize=5.5,
        markeredgecolor="white",
        label="measured boundary",
    )
    limit = tracking.periods[tracking.certified > 0]
    if limit.size < len(tracking.periods) and limit.size:
        axes.axvline(float(limit[-1]), color=LAM, linestyle=":", linewidth=1.0)
    axes.set(xscale="log", yscale="log", xlim=_span(tracking.periods), ylim=(low, high), xlabel="sampling time $T$ [s]")


def _span(values: Array) -> tuple[float, float]:
    """The first and last cell of a logarithmic axis with half a cell around."""
    half = float(np.sqrt(values[1] / values[0])) if len(values) > 1 else 2.0
    return float(values[0] / half), float(values[-1] * half)


# ---- Tracking error against sampling time ----


def _tracking_error(found: StabilityMap) -> Figure:
    """Measured error over sampling time, the certified ball and the ramp lag, for some gains."""
    figure = Figure(figsize=(11.0, 5.0), layout="constrained")
    left = figure.add_subplot(1, 2, 1)
    right = figure.add_subplot(1, 2, 2, sharex=left, sharey=left)
    _draw_errors(left, found.tracking)
    _draw_errors(right, found.filtered_tracking)
    left.set(title="without filter", ylabel="tracking error [m]")
    right.set(title="with filter, always on")
    _title(figure, f"Largest tracking error of {_names(found)}: measured and predicted")
    colours = [Line2D([], [], color=colour, label=f"$K$ = {gain:.3g}/s") for gain, colour in _gains(found.tracking)]
    kinds = [
        Line2D([], [], color=QUIET, marker="o", markersize=4, linestyle="none", label="measured"),
        Line2D([], [], color=QUIET, linestyle="--", label="certified: $e_-$"),
        Line2D([], [], color=QUIET, linestyle=":", label=r"ramp lag $(1 - \beta)v/(\beta K)$"),
    ]
    figure.legend(handles=[*colours, *kinds], loc="outside lower center", ncols=6)
    return figure


def _gains(tracking: TrackingMap) -> list[tuple[float, str]]:
    """Some gains of the map, from its lowest on, with their colours."""
    which = np.unique(np.linspace(0, 0.75 * (len(tracking.gains) - 1), len(GAIN_COLOURS)).round().astype(int))
    return [(float(tracking.gains[i]), colour) for i, colour in zip(which, GAIN_COLOURS, strict=False)]


def _draw_errors(axes: Axes, tracking: TrackingMap) -> None:
    """Measured, certified and predicted errors over T for some gains."""
    speed = np.array([motion.speed for motion in tracking.motions])
    for gain, colour in _gains(tracking):
        i = int(np.argmin(np.abs(tracking.gains - gain)))
        axes.plot(tracking.periods, _shown(tracking.largest[:, i]), "o", color=colour, markersize=4)
        axes.plot(tracking.periods, _shown(tracking.ultimate[:, i]), color=colour, linestyle="--")
        lag = _shown((1 - tracking.beta) * speed / (tracking.beta * gain))
        if np.any(lag > 0):
            axes.plot(tracking.periods, lag, color=colour, linestyle=":")
    axes.set(xscale="log", yscale="log", xlim=_span(tracking.periods), xlabel="sampling time $T$ [s]")


def _shown(error: Array) -> Array:
    """Errors that are drawn; the rest is not a number."""
    return np.where(error < LOST, error, np.nan)


def _names(found: StabilityMap) -> str:
    scenario = found.tracking.scenario
    return f"{scenario.controller} on scenario {scenario.name}"


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(text, x=0.01, ha="left", fontweight="bold")
