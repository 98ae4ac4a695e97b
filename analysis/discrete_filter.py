"""The filter of eqs. 15-16 as a discrete system: closed forms, designs to compare with, and its inverse design.

H(z) = β z/(z − (1 − β)) with β = X/(1 + X), X = 2πTf_c: the backward-Euler image of the RC low-pass. Ω = 2πfT is
the frequency in rad per sample, 0 to π.
"""

from dataclasses import dataclass
from typing import Literal

import control
import numpy as np
from numpy.typing import NDArray
from scipy.signal import chirp, csd, welch

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput

Array = NDArray[np.float64]
Method = Literal["backward Euler", "pole-matched", "Tustin"]

SEGMENT = 16_384
"""Samples of a Welch segment: long against the filter's memory, or leakage would bias the estimate."""
LOWEST_BIN = 8
"""Bins below this one are left out: the segment's detrending shows in them."""
EXISTENCE_EDGE = 2 * (np.sqrt(2) - 1)
"""β above which |H| stays above −3 dB up to the Nyquist frequency: 0.8284."""


def beta_of(cutoff: float, period: float) -> float:
    """β = X/(1 + X), X = 2πTf_c (eq. 15), from f_c [Hz] and T [s]; raises BadInput unless both are positive."""
    if not (cutoff > 0 and period > 0):
        raise BadInput(f"wanted f_c > 0 Hz and T > 0 s, got f_c = {cutoff:g} and T = {period:g}")
    x = 2 * np.pi * period * cutoff
    return float(x / (1 + x))


def cutoff_of(beta: float, period: float) -> float:
    """f_c [Hz] that makes eq. 15 give β at T [s]: the inverse of beta_of; raises BadInput unless 0 < β < 1."""
    _check(beta)
    return beta / (1 - beta) / (2 * np.pi * period)


def _check(beta: float) -> None:
    if not 0 < beta < 1:
        raise BadInput(f"wanted β in (0, 1), got {beta:g}")


def system(beta: float, period: float) -> control.TransferFunction:
    """H(z) = β z/(z − (1 − β)) at sampling time T [s]."""
    return control.TransferFunction([beta, 0.0], [1.0, beta - 1.0], period)


def magnitude(beta: float, omega: Array) -> Array:
    """|H(e^{jΩ})| = β/√(1 − 2(1−β)cos Ω + (1−β)²), at Ω [rad/sample]."""
    a = 1 - beta
    # the sum of squares (1 − a)² + 4a sin²(Ω/2) is the same without cancellation at small β and Ω
    return np.asarray(beta / np.sqrt(beta**2 + 4 * a * np.sin(omega / 2) ** 2))


def phase(beta: float, omega: Array) -> Array:
    """arg H(e^{jΩ}) = −atan2((1−β)sin Ω, 1 − (1−β)cos Ω) [rad]; the largest lag is asin(1 − β)."""
    a = 1 - beta
    return np.asarray(-np.arctan2(a * np.sin(omega), 1 - a * np.cos(omega)))


def group_delay(beta: float, omega: Array) -> Array:
    """−d arg H/dΩ = a(cos Ω − a)/(1 − 2a cos Ω + a²), a = 1 − β, in samples; at DC a/β = 1/(2πTf_c)."""
    a = 1 - beta
    return np.asarray(a * (np.cos(omega) - a) / (beta**2 + 4 * a * np.sin(omega / 2) ** 2))


def noise_gain(beta: float) -> float:
    """Variance of the output over that of white noise at the input: β/(2 − β), which also is |H| at Nyquist."""
    return beta / (2 - beta)


def minus_3_db(beta: float) -> float | None:
    """Ω_c = 2 asin(X/(2√(1+X))) [rad/sample] where |H|² = 1/2; None beyond the existence edge.

    In β: X/√(1+X) = β/√(1−β).
    """
    if beta > EXISTENCE_EDGE:
        return None
    return float(2 * np.arcsin(min(1.0, beta / (2 * np.sqrt(1 - beta)))))


def beta_for(cutoff: float, period: float) -> float:
    """β whose true −3 dB frequency is `cutoff` [Hz] at T [s]: −y + √(y² + 2y), y = 1 − cos Ω_d.

    Raises BadInput unless 0 < cutoff <= 1/(2T).
    """
    omega = 2 * np.pi * cutoff * period
    if not 0 < omega <= np.pi:
        raise BadInput(f"wanted a cut-off above 0 and up to the Nyquist frequency {0.5 / period:g} Hz, got {cutoff:g}")
    y = 2 * np.sin(omega / 2) ** 2
    return float(-y + np.sqrt(y * y + 2 * y))


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """A way to make the RC low-pass of f_c discrete: its system and its −3 dB frequency [Hz], None without."""

    method: Method
    system: control.TransferFunction
    cutoff: float | None


def designs(cutoff: float, period: float) -> list[Design]:
    """The shipped design and the two usual others, for f_c [Hz] at T [s], X = 2πTf_c.

    backward Euler: eq. 15; pole-matched: the same form with β = 1 − e^{−X}, Ω_c = 2 asin(sinh(X/2)); Tustin: a
    zero at Nyquist, Ω_c = 2 atan(X/2).
    """
    x = 2 * np.pi * period * cutoff
    matched = -np.expm1(-x)
    backward = beta_of(cutoff, period)
    tustin = control.TransferFunction([x, x], [2 + x, x - 2], period)
    hertz = 1 / (2 * np.pi * period)
    ends = {
        "backward Euler": minus_3_db(backward),
        "pole-matched": minus_3_db(matched),
        "Tustin": 2 * np.arctan(x / 2),
    }
    systems = {
        "backward Euler": system(backward, period),
        "pole-matched": system(matched, period),
        "Tustin": tustin,
    }
    return [
        Design(method, systems[method], None if ends[method] is None else float(ends[method]) * hertz)
        for method in ("backward Euler", "pole-matched", "Tustin")
    ]


def prototype(cutoff: float) -> control.TransferFunction:
    """The continuous RC low-pass 1/(1 + s/(2πf_c))."""
    return control.TransferFunction([1.0], [1 / (2 * np.pi * cutoff), 1.0])


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredResponse:
    """H(e^{jΩ}) estimated from the compiled step: frequencies (k,) [Hz], response (k,), coherence (k,)."""

    joint: int
    beta: float
    period: float
    frequency: Array
    response: NDArray[np.complex128]
    coherence: Array


Excitation = Literal["noise", "swept sine"]


def shipped_beta(controller: CompiledController, cutoff: float | None = None, period: float | None = None) -> Array:
    """β of every joint as the compiled step applies it, (n,): its q̇ with the filter over its q̇ without.

    With λ = 1, q_next − q = β T q̇_law in each joint. `cutoff` [Hz] and `period` [s] are the manifest's defaults
    where not given.
    """
    values = _filter_inputs(controller, cutoff, period)
    one_step = controller.rollout(1, values | {"q": _regular(controller)})
    return np.asarray(one_step["dq"][0] / one_step["dq_law"][0])


def estimate(put_in: Array, came_out: Array, period: float) -> tuple[Array, NDArray[np.complex128], Array]:
    """Frequencies (k,) [Hz], transfer function (k,) and coherence (k,) from a record (N,) of in and out.

    Cross-spectral over power-spectral density, Welch with a Hann window (scipy), the lowest bins left out. Raises
    BadInput when the record is too short for eight segments.
    """
    if len(put_in) < 8 * SEGMENT:
        raise BadInput(
            f"too short to estimate a frequency response from: wanted {8 * SEGMENT} steps, got {len(put_in)}"
        )
    frequency, power = welch(put_in, fs=1 / period, window="hann", nperseg=SEGMENT)
    _, cross = csd(put_in, came_out, fs=1 / period, window="hann", nperseg=SEGMENT)
    _, out_power = welch(came_out, fs=1 / period, window="hann", nperseg=SEGMENT)
    seen = slice(LOWEST_BIN, None)
    return frequency[seen], (cross / power)[seen], (np.abs(cross) ** 2 / (power * out_power))[seen]


def measure_response(
    controller: CompiledController,
    joint: int = 0,
    cutoff: float | None = None,
    period: float | None = None,
    steps: int = 16 * 16_384,
    excitation: Excitation = "noise",
    seed: int = 0,
) -> MeasuredResponse:
    """The compiled step excited by its reference velocity; in and out of the filter compared at one joint.

    In: q + T q̇_law, out: q_next, both as increments, since those have a flat spectrum. Raises BadInput when `steps`
    is too short to estimate from.
    """
    values = _filter_inputs(controller, cutoff, period)
    tracking = next(task for task in controller.manifest.tasks if task.equality)
    T = float(values["period"])
    velocity = _excitation(excitation, steps, tracking.dimension, seed)
    values |= {"q": _regular(controller), f"{tracking.name}_reference_velocity": velocity}
    run = controller.rollout(steps, values)
    raw = run["q"][:-1, joint] + T * run["dq_law"][:, joint]
    put_in, came_out = np.diff(raw, prepend=raw[0]), np.diff(run["q"][:, joint])
    frequency, response, coherence = estimate(put_in, came_out, T)
    return MeasuredResponse(
        joint=joint,
        beta=float(shipped_beta(controller, cutoff, period)[joint]),
        period=T,
        frequency=frequency,
        response=response,
        coherence=coherence,
    )


def _filter_inputs(controller: CompiledController, cutoff: float | None, period: float | None) -> dict[str, Array]:
    """Inputs of the step with the filter always on, no obstacle, and a reference that moves the robot a little."""
    step = controller.manifest.function("step")
    given = {"filter_cutoff": cutoff, "period": period}
    values = {
        name: step.input(name).value(value, f"{controller.manifest.controller}: {name}")
        for name, value in given.items()
        if value is not None
    }
    for name in given.keys() - values.keys():
        info = step.input(name)
        values[name] = np.reshape(info.default, info.shape)
    tracking = next(task for task in controller.manifest.tasks if task.equality)
    position = controller.kinematics(q=_regular(controller))[f"{tracking.name}_position"].copy()
    return values | {
        "lam_free": np.array(1.0),
        f"{tracking.name}_reference": position,
        f"{tracking.name}_reference_velocity": np.full(tracking.dimension, 0.1),
    }


def _regular(controller: CompiledController) -> Array:
    """A configuration away from stretched-out arms: every revolute joint bent by 0.7 rad, within its limits."""
    joints = controller.manifest.joints
    return np.array([np.clip(0.7 if joint.unit == "rad" else 0.0, joint.lower, joint.upper) for joint in joints])


def _excitation(kind: Excitation, steps: int, dimension: int, seed: int) -> Array:
    """Reference velocity (steps, dimension) [m/s] with all frequencies up to Nyquist in it."""
    if kind == "noise":
        return 0.1 * np.random.default_rng(seed).standard_normal((steps, dimension))
    half = np.arange(steps - steps // 2)
    up = chirp(half, f0=1e-4, t1=half[-1], f1=0.5, method="logarithmic")  # cycles per sample
    sweep = np.concatenate([up, up[::-1]])[:steps]
    return 0.1 * np.tile(sweep[:, None], (1, dimension))
