"""The linear CLIK loop in pictures: gain bounds against sampling time, root loci, commanded to actual."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.polynomial.polynomial as poly
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clikgen.analysis.clik_loop import READINGS, Loop, Reading, closed_loop, gain_bound, ramp_lag
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.drawing import ERROR, QUIET, STYLE
from clikgen.analysis.measured_loop import MeasuredLoop
from clikgen.analysis.plates import Plate

Array = NDArray[np.float64]

READING_COLOURS = {"A": "#0072B2", "B": "#009E73", "C": "#CC79A7"}
READING_NAMES = {
    "A": "A: the filtered position is the state (generated code)",
    "B": "B: filter on the output",
    "C": "C: the filtered position is measured back",
}


def clik_plates(loop: Loop, gain: float, cutoff: float, measured: MeasuredLoop | None = None) -> list[Plate]:
    """Bounds over T, root loci over K, and frequency responses, around `loop` at `gain` [1/s], f_c [Hz].

    `measured` is the response of the compiled step in reading A, with feedforward.
    """
    with mpl.rc_context(STYLE):
        return [_bounds(loop, gain, cutoff), _loci(loop, gain), _responses(loop, gain, measured)]


def bound_curves(loop: Loop, cutoff: float, periods: Array) -> Mapping[str, Array]:
    """Largest stable gain [1/s] over the sampling times (k,) [s]: unfiltered, the readings, and delays.

    The filter keeps its f_c [Hz], so that β changes with T as eq. 15 says; the servo keeps its τ.
    """

    def curve(reading: Reading, delay: int = 0, filtered: bool = False) -> Array:
        loops = [
            replace(loop, reading=reading, period=T, delay=delay, beta=beta_of(cutoff, T) if filtered else 1.0)
            for T in periods
        ]
        return np.array([gain_bound(one) for one in loops])

    curves = {"no filter": curve("A", loop.delay)}
    for reading in READINGS:
        curves[reading] = curve(reading, loop.delay, filtered=True)
    for delay in (1, 2, 5):
        curves[f"{delay} more sample{'s' * (delay > 1)}"] = curve("A", loop.delay + delay)
    return curves


def _bounds(loop: Loop, gain: float, cutoff: float) -> Plate:
    """Gain bound against sampling time, log-log, with the stable region of the generated code shaded."""
    periods = np.geomspace(5e-4, 0.1, 60)
    curves = bound_curves(loop, cutoff, periods)
    figure = Figure(figsize=(8.5, 5.6), layout="constrained")
    axes = figure.subplots()
    ours = curves["A"]
    axes.fill_between(1e3 * periods, 0.05, ours, color=READING_COLOURS["A"], alpha=0.08, lw=0)
    axes.plot(1e3 * periods, curves["no filter"], color="#111111", lw=2.0, label="no filter")
    for reading in READINGS:
        # reading B has the bound of the unfiltered loop: dashes let the line below show
        style = (0, (4, 3)) if reading == "B" else "-"
        axes.plot(
            1e3 * periods,
            curves[reading],
            color=READING_COLOURS[reading],
            ls=style,
            label=READING_NAMES[reading],
        )
    for name, values in curves.items():
        if "more" in name:
            axes.plot(1e3 * periods, values, color=QUIET, lw=0.9, ls=":")
            place = (1e3 * periods[-1], values[-1])
            axes.annotate(f"+{name.split()[0]}", place, (4, 0), textcoords="offset points", color=QUIET, va="center")
    axes.plot([], [], color=QUIET, lw=0.9, ls=":", label="no filter, +1, +2, +5 samples of delay")
    axes.plot(1e3 * loop.period, gain, "o", color=ERROR, zorder=5)
    axes.annotate(
        f"this controller: K = {gain:g}/s, T = {1e3 * loop.period:g} ms",
        (1e3 * loop.period, gain),
        (8, -3),
        textcoords="offset points",
        color=ERROR,
    )
    axes.set(xscale="log", yscale="log", xlabel="sampling time T [ms]", ylabel="gain K [1/s]")
    axes.set(xlim=(1e3 * periods[0], 1e3 * periods[-1]), ylim=(min(1.0, gain / 2), 2 * np.max(ours)))
    servo = f", servo lag {1e3 * loop.servo:g} ms" if loop.servo else ""
    axes.set_title(f"Largest stable gain against sampling time, f_c = {cutoff:.4g} Hz{servo}", loc="left")
    figure.legend(loc="outside lower center", ncols=2)
    caption = (
        "The linear gain bound against the sampling time, from the closed-loop poles. Shaded: stable with the "
        "filter as generated (reading A). A filter at fixed f_c raises the bound only because it slows the loop."
    )
    data = {"T [s]": periods, **{f"{name} [1/s]": values for name, values in curves.items()}}
    return Plate("clik_gain_bound", caption, figure, data)


def _loci(loop: Loop, gain: float) -> Plate:
    """Closed-loop poles in the z plane as K grows, for the three readings."""
    figure = Figure(figsize=(9.5, 3.5), layout="constrained")
    data: dict[str, Array] = {}
    for axes, reading in zip(figure.subplots(1, 3, sharex=True, sharey=True), READINGS, strict=True):
        one = replace(loop, reading=reading)
        bound = gain_bound(one)
        gains = np.concatenate([np.geomspace(1e-3, 1.0, 150), np.linspace(1.0, 1.4, 30)]) * bound
        poles = np.array([_poles(one, k) for k in gains])  # (gains, poles)
        _draw_locus(axes, poles, gains / bound, READING_COLOURS[reading])
        here = _poles(one, gain)
        axes.plot(here.real, here.imag, "o", color=ERROR, ms=6, zorder=6)
        radius = np.max(np.abs(here))
        axes.set_title(f"{reading}: K < {bound:.4g}/s, |z| = {radius:.3f} at K = {gain:g}/s", loc="left", fontsize=9)
        axes.set_xlabel("Re z")
        data[f"{reading}: K [1/s]"] = gains
        for i in range(poles.shape[1]):
            data |= {f"{reading}: Re z{i}": poles[:, i].real, f"{reading}: Im z{i}": poles[:, i].imag}
        if reading == "A":
            axes.set_ylabel("Im z")
    caption = (
        "Root loci over the gain: dots, the poles of this controller; crosses, the open-loop poles; the last "
        "stretch of each line lies beyond the bound."
    )
    return Plate("clik_root_locus", caption, figure, data)


def _poles(loop: Loop, gain: float) -> NDArray[np.complex128]:
    numerator, denominator = loop.open_loop()
    return np.asarray(poly.polyroots(poly.polyadd(denominator, gain * numerator)), dtype=np.complex128)


def _draw_locus(axes: Axes, poles: NDArray[np.complex128], share: Array, colour: str) -> None:
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
    axes.plot(circle.real, circle.imag, color=QUIET, lw=0.9)
    stable = share <= 1
    axes.plot(poles[stable].real, poles[stable].imag, ".", ms=3, color=colour)
    axes.plot(poles[~stable].real, poles[~stable].imag, ".", ms=3, color=ERROR, alpha=0.5)
    axes.plot(poles[0].real, poles[0].imag, "x", color="#111111", ms=7)
    axes.set_aspect("equal")
    axes.set(xlim=(-1.6, 1.3), ylim=(-1.25, 1.25))


def _responses(loop: Loop, gain: float, measured: MeasuredLoop | None) -> Plate:
    """Commanded to actual position: gain and phase with and without feedforward, and the ramp lag in words."""
    f = np.geomspace(0.01, 0.5 / loop.period, 400)
    z = np.exp(2j * np.pi * f * loop.period)
    figure = Figure(figsize=(8.5, 5.6), layout="constrained")
    size, lag = figure.subplots(2, 1, sharex=True)
    data: dict[str, Array] = {"frequency [Hz]": f}
    for reading in READINGS:
        one = replace(loop, reading=reading)
        for feedforward, style in ((True, "-"), (False, "--")):
            response = closed_loop(one, gain, feedforward=feedforward)(z)
            seconds = ramp_lag(one, gain, feedforward=feedforward)
            with_or_no = "with" if feedforward else "no"
            name = f"{reading}, {with_or_no} feedforward: ramp lag {abs(round(1e3 * seconds, 6)):.4g} ms"
            size.plot(f, 20 * np.log10(np.abs(response)), color=READING_COLOURS[reading], ls=style, label=name)
            lag.plot(f, np.degrees(np.unwrap(np.angle(response))), color=READING_COLOURS[reading], ls=style)
            data |= {f"{name}, gain": np.abs(response), f"{name}, phase [rad]": np.angle(response)}
    if measured is not None:
        at = np.unique(np.searchsorted(measured.frequency, np.geomspace(measured.frequency[0], 0.5 / loop.period, 40)))
        at = at[at < len(measured.frequency)]
        dots: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.5, "color": ERROR, "mfc": "none", "zorder": 5}
        at_f, there = measured.frequency[at], measured.response[at]
        size.plot(at_f, 20 * np.log10(np.abs(there)), **dots, label="compiled step, measured")
        lag.plot(at_f, np.degrees(np.angle(there)), **dots)
        data |= {"measured frequency [Hz]": measured.frequency, "measured gain": np.abs(measured.response)}
        data |= {"measured phase [rad]": np.angle(measured.response)}
    size.set(ylabel="gain [dB]", xscale="log", xlim=(f[0], f[-1]), ylim=(-60, 6))
    lag.set(ylabel="phase [deg]", xlabel="frequency [Hz]", ylim=(-200, 60))
    size.set_title(f"Commanded to actual position at K = {gain:g}/s, β = {loop.beta:.4g}", loc="left")
    figure.legend(loc="outside lower center", ncols=2)
    caption = (
        "Frequency response from the commanded to the actual position for the three readings of eq. 16; dots: of the "
        "compiled step, whose filtered position is the state (A), excited by a noisy reference."
    )
    return Plate("clik_response", caption, figure, data)
