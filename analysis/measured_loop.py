"""The closed loop as the compiled step runs it: commanded to actual position, and the lag behind a ramp."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.analysis.certificate import regular_configuration
from clikgen.analysis.clik_loop import Loop, pole_radius
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.measured_filter import estimate
from clikgen.analysis.tracking import alone
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput

Array = NDArray[np.float64]

AMPLITUDE = 1e-3  # [m] of the reference's motion: the robot stays near its regular configuration
STEPS = 16 * 16_384
LONGEST = 2_000_000  # steps until a ramp is followed steadily; slower loops are not measured


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredLoop:
    """Commanded to actual position along the first axis: frequencies (k,) [Hz], response (k,)."""

    frequency: Array
    response: NDArray[np.complex128]


def measure_loop(
    controller: CompiledController, gain: float, period: float, cutoff: float | None, seed: int = 0
) -> MeasuredLoop:
    """The loop with K = gain·I [1/s] at T [s], the filter always on with f_c = cutoff [Hz], or off (None).

    The reference is white noise about a regular configuration, its velocity (r⁺ − r)/T. Raises BadInput for values
    that the controller does not take.
    """
    values = _values(controller, gain, period, cutoff)
    task = controller.manifest.position_task().name
    place = values.pop("place")
    reference = place + AMPLITUDE * np.random.default_rng(seed).standard_normal((STEPS + 1, place.size))
    moving = {f"{task}_reference": reference[:-1], f"{task}_reference_velocity": np.diff(reference, axis=0) / period}
    actual = controller.rollout(STEPS, values | moving)[f"{task}_position"]
    frequency, response, _ = estimate(reference[:-1, 0] - place[0], actual[:, 0] - place[0], period)
    return MeasuredLoop(frequency, response)


def measure_ramp_lag(controller: CompiledController, gain: float, period: float, cutoff: float | None) -> float | None:
    """How late a slow ramp along the first axis is followed [s], after twelve time constants; None if that is too long.

    Raises BadInput for values that the controller does not take.
    """
    values = _values(controller, gain, period, cutoff)
    task = controller.manifest.position_task().name
    place = values.pop("place")
    pole = pole_radius(Loop("A", period, 1.0 if cutoff is None else beta_of(cutoff, period)), gain)
    steps = int(np.ceil(12 / -np.log(min(max(pole, 0.5), 1 - 1e-12))))
    if not pole < 1 or steps > LONGEST:
        return None
    velocity = np.zeros((steps, place.size))
    velocity[:, 0] = AMPLITUDE / (steps * period)
    reference = place + velocity * period * np.arange(steps)[:, None]
    moving = {f"{task}_reference": reference, f"{task}_reference_velocity": velocity}
    error = controller.rollout(steps, values | moving)[f"{task}_error"]
    return float(error[-1, 0] / velocity[-1, 0])


def _values(controller: CompiledController, gain: float, period: float, cutoff: float | None) -> dict[str, Any]:
    """Inputs of the step without obstacles; under "place" where the tracked frame is at the start."""
    if not gain > 0:
        raise BadInput(f"gain: wanted more than 0, got {gain:g}")
    step, task = controller.manifest.function("step"), controller.manifest.position_task().name
    given: dict[str, ArrayLike] = {f"{task}_gain": gain, "period": period, "lam_free": 0.0 if cutoff is None else 1.0}
    if cutoff is not None:
        given["filter_cutoff"] = cutoff
    q = regular_configuration(controller)
    place = controller.kinematics(q=q)[f"{task}_position"].copy()
    values = {name: step.input(name).value(value, name) for name, value in given.items()}
    return alone(controller.manifest) | values | {"q": q, "place": place}
