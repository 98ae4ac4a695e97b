"""The filter as the compiled step applies it: its β, and its frequency response estimated from a rollout."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import chirp, csd, welch

from clikgen.analysis.certificate import regular_configuration
from clikgen.analysis.tracking import alone, references_at
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput

Array = NDArray[np.float64]

SEGMENT = 16_384
"""Samples of a Welch segment: long against the filter's memory, or leakage would bias the estimate."""
LOWEST_BIN = 8
"""Bins below this one are left out: the segment's detrending shows in them."""


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
    one_step = controller.rollout(1, values | {"q": regular_configuration(controller)})
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
    T, moved = float(values["period"]), f"{controller.manifest.tracking_task().name}_reference_velocity"
    velocity = _excitation(excitation, steps, values[moved].size, seed)
    values |= {"q": regular_configuration(controller), moved: velocity}
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
    moved = f"{controller.manifest.tracking_task().name}_reference_velocity"
    return (
        alone(controller.manifest)
        | references_at(controller, regular_configuration(controller))
        | values
        | {"lam_free": np.array(1.0), moved: np.full(step.input(moved).shape, 0.1)}
    )


def _excitation(kind: Excitation, steps: int, dimension: int, seed: int) -> Array:
    """Reference velocity (steps, dimension) [m/s] with all frequencies up to Nyquist in it."""
    if kind == "noise":
        return 0.1 * np.random.default_rng(seed).standard_normal((steps, dimension))
    half = np.arange(steps - steps // 2)
    up = chirp(half, f0=1e-4, t1=half[-1], f1=0.5, method="logarithmic")  # cycles per sample
    sweep = np.concatenate([up, up[::-1]])[:steps]
    return 0.1 * np.tile(sweep[:, None], (1, dimension))
