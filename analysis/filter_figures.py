"""The filter in pictures: Bode with the measured response, true cut-off against f_c, step response and noise."""

from collections.abc import Sequence
from typing import Any

import control
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from clikgen.analysis.discrete_filter import (
    Design,
    beta_of,
    cutoff_of,
    designs,
    group_delay,
    magnitude,
    minus_3_db,
    noise_gain,
    phase,
    prototype,
)
from clikgen.analysis.drawing import ERROR, QUIET, STYLE
from clikgen.analysis.measured_filter import MeasuredResponse
from clikgen.analysis.plates import Plate

Array = NDArray[np.float64]

COLOURS = {"backward Euler": "#0072B2", "pole-matched": "#009E73", "Tustin": "#CC79A7"}
NAMES = {"backward Euler": "eq. 15 (backward Euler)", "pole-matched": "pole-matched", "Tustin": "Tustin"}


def filter_plates(measured: Sequence[MeasuredResponse]) -> list[Plate]:
    """Bode, cut-off and time response of the filter that the compiled step was measured with."""
    beta, period = measured[0].beta, measured[0].period
    with mpl.rc_context(STYLE):
        return [_bode(beta, period, measured), _cutoffs(beta, period), _in_time(beta, period)]


def _bode(beta: float, period: float, measured: Sequence[MeasuredResponse]) -> Plate:
    """Magnitude, phase and group delay over frequency; the compiled step's estimate as dots."""
    cutoff, nyquist = cutoff_of(beta, period), 0.5 / period
    f = np.geomspace(cutoff / 30, nyquist, 600)
    omega = 2 * np.pi * f * period
    figure = Figure(figsize=(8.5, 8.2), layout="constrained")
    gain, lag, delay = figure.subplots(3, 1, sharex=True)
    continuous = prototype(cutoff)(2j * np.pi * f)
    gain.plot(f, _db(np.abs(continuous)), color=QUIET, ls=":", label="continuous RC")
    lag.plot(f, np.degrees(np.angle(continuous)), color=QUIET, ls=":")
    delay.plot(f, 1e3 / (2 * np.pi * cutoff) / (1 + (f / cutoff) ** 2), color=QUIET, ls=":")
    for design in designs(cutoff, period)[1:]:
        response = design.system(np.exp(1j * omega[:-1]))
        gain.plot(f[:-1], _db(np.abs(response)), color=COLOURS[design.method], label=NAMES[design.method])
        lag.plot(f[:-1], np.degrees(np.unwrap(np.angle(response))), color=COLOURS[design.method])
        slope = -np.gradient(np.unwrap(np.angle(response)), omega[:-1])
        delay.plot(f[:-1], 1e3 * period * slope, color=COLOURS[design.method])
    ours = {"color": COLOURS["backward Euler"], "lw": 2.2}
    gain.plot(f, _db(magnitude(beta, omega)), **ours, label=NAMES["backward Euler"])
    lag.plot(f, np.degrees(phase(beta, omega)), **ours)
    delay.plot(f, 1e3 * period * group_delay(beta, omega), **ours)
    for one, marker, name in zip(measured, "ox", ("noise", "swept sine"), strict=False):
        _dots(gain, lag, one, marker, f"compiled step, {name}")
    _mark_cutoff(gain, beta, period)
    gain.set(ylabel="gain [dB]", ylim=(_db(noise_gain(beta)) - 12, 3), xscale="log", xlim=(f[0], nyquist))
    lag.set(ylabel="phase [deg]", ylim=(-95, 5), yticks=range(-90, 1, 30))
    delay.set(ylabel="group delay [ms]", xlabel="frequency [Hz]")
    figure.suptitle(f"Filter: β = {beta:.4g} (f_c = {cutoff:.4g} Hz at T = {1e3 * period:g} ms)", x=0.01, ha="left")
    figure.legend(loc="outside lower center", ncols=3)
    data = {
        "frequency [Hz]": f,
        "gain": magnitude(beta, omega),
        "phase [rad]": phase(beta, omega),
        "group delay [s]": period * group_delay(beta, omega),
        "measured frequency [Hz]": measured[0].frequency,
        "measured gain": np.abs(measured[0].response),
        "measured phase [rad]": np.angle(measured[0].response),
    }
    caption = (
        "Gain, phase and group delay of the filter that ships, against the continuous RC low-pass and the two "
        "usual discrete designs. Dots: estimated from the compiled step, excited by noise and by a swept sine."
    )
    return Plate("filter_bode", caption, figure, data)


def _dots(gain: Axes, lag: Axes, measured: MeasuredResponse, marker: str, label: str) -> None:
    """The measured response at about 40 frequencies, evenly spread over the logarithm."""
    wanted = np.geomspace(measured.frequency[0], measured.frequency[-2], 40 if marker == "o" else 23)
    at = np.unique(np.searchsorted(measured.frequency, wanted))
    style: dict[str, Any] = {"ls": "none", "marker": marker, "ms": 4.5, "color": ERROR, "mfc": "none", "zorder": 5}
    gain.plot(measured.frequency[at], _db(np.abs(measured.response[at])), **style, label=label)
    lag.plot(measured.frequency[at], np.degrees(np.angle(measured.response[at])), **style)


def _mark_cutoff(axes: Axes, beta: float, period: float) -> None:
    end = minus_3_db(beta)
    axes.axhline(_db(np.sqrt(0.5)), color=QUIET, lw=0.8, ls="--")
    if end is None:
        axes.text(0.02, 0.1, "never falls to −3 dB", transform=axes.transAxes, color=QUIET)
        return
    hertz = end / (2 * np.pi * period)
    axes.axvline(hertz, color=QUIET, lw=0.8, ls="--")
    axes.annotate(
        f"−3 dB at {hertz:.3g} Hz", (hertz, _db(np.sqrt(0.5))), (6, 4), textcoords="offset points", color=QUIET
    )


def _cutoffs(beta: float, period: float) -> Plate:
    """True −3 dB frequency over f_c, against f_c T, for the three designs."""
    # the designs' ends are on the grid, a hair inside: X = 2√2 + 2 and X = 2 asinh 1
    ends = np.array([2 * np.sqrt(2) + 2, 2 * np.arcsinh(1)]) / (2 * np.pi) * (1 - 1e-12)
    shares = np.sort(np.concatenate([np.geomspace(1e-3, 1.0, 400), ends]))
    ratio = {method: np.full(shares.size, np.nan) for method in COLOURS}
    for i, share in enumerate(shares):
        for design in designs(share, 1.0):
            if design.cutoff is not None:
                ratio[design.method][i] = design.cutoff / share
    figure = Figure(figsize=(8.5, 4.4), layout="constrained")
    axes = figure.subplots()
    for method, values in ratio.items():
        last = np.flatnonzero(np.isfinite(values))[-1]
        ends = last < shares.size - 1
        label = f"{NAMES[method]}, ends at f_cT = {shares[last]:.3g}" if ends else NAMES[method]
        axes.plot(shares, values, color=COLOURS[method], label=label, lw=2.2 if "Euler" in method else 1.3)
        if ends:
            axes.plot(shares[last], values[last], "o", color=COLOURS[method])
    share = cutoff_of(beta, period) * period
    axes.axvline(share, color=ERROR, ls="--", lw=1.0, label=f"this controller, f_cT = {share:.3g}")
    axes.axhline(1.0, color=QUIET, lw=0.8)
    axes.set(xscale="log", xlabel="f_c T", ylabel="true −3 dB frequency / f_c", xlim=(1e-3, 1), ylim=(0, 1.9))
    axes.set_title("What f_c delivers: below the wanted cut-off, and from f_cT = 0.768 on none at all", loc="left")
    axes.legend(loc="lower left")
    caption = "The true −3 dB frequency of the three discrete designs over the f_c they were made for."
    data: dict[str, Array] = {"f_c T": shares, **{str(method): values for method, values in ratio.items()}}
    return Plate("filter_cutoff", caption, figure, data)


def _in_time(beta: float, period: float) -> Plate:
    """Step response of the designs, and the noise that is let through against f_c T."""
    cutoff = cutoff_of(beta, period)
    steps = int(np.ceil(6 / (2 * np.pi * cutoff * period))) + 2
    k = np.arange(steps)
    figure = Figure(figsize=(8.5, 3.8), layout="constrained")
    step, noise = figure.subplots(1, 2)
    t = np.linspace(0, steps * period, 400)
    step.plot(t, 1 - np.exp(-2 * np.pi * cutoff * t), color=QUIET, ls=":", label="continuous RC")
    responses = {design.method: _stepped(design, steps) for design in designs(cutoff, period)}
    for method, values in responses.items():
        step.plot(k * period, values, drawstyle="steps-post", color=COLOURS[method], label=NAMES[method])
    step.set(xlabel="t [s]", ylabel="step response", ylim=(0, 1.05), xlim=(0, steps * period))
    step.legend(loc="lower right")
    shares = np.geomspace(1e-3, 3.0, 300)
    variance = np.array([noise_gain(beta_of(share, 1.0)) for share in shares])
    noise.plot(shares, variance, color=COLOURS["backward Euler"], lw=2.2)
    noise.plot(cutoff * period, noise_gain(beta), "o", color=ERROR)
    noise.annotate(
        f"this controller: {noise_gain(beta):.3g}",
        (cutoff * period, noise_gain(beta)),
        (8, -12),
        textcoords="offset points",
        color=ERROR,
    )
    noise.set(xscale="log", yscale="log", xlabel="f_c T", ylabel="noise variance, out over in")
    caption = "Step response, and the share of white noise that the filter lets through: β/(2 − β)."
    data: dict[str, NDArray[np.floating]] = {"t [s]": k * period}
    data |= {str(method): values for method, values in responses.items()}
    data |= {"f_c T": shares, "noise variance ratio": variance}
    return Plate("filter_in_time", caption, figure, data)


def _stepped(design: Design, steps: int) -> Array:
    """The design's response to a unit step, (steps,)."""
    return np.asarray(control.step_response(design.system, design.system.dt * np.arange(steps)).outputs)


def _db(value: Any) -> Any:
    """20 log₁₀ of a number or an array."""
    return 20 * np.log10(value)
