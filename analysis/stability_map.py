"""What the compiled loop really does over gain and sampling time: where it is stable, how well it tracks.

Measured with rollouts of the compiled step, beside what the linear loop and the nonlinear certificate say.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from clikgen.analysis.certificate import (
    Bounds,
    Motion,
    bounds_within_limits,
    jacobians,
    largest_gain,
    recursion,
    reference_motion,
    regular_configuration,
    tuning_of,
)
from clikgen.analysis.clik_loop import Loop, gain_bound
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.tracking import alone, damping_at, without_limits
from clikgen.runtime.batch import simulate_batch
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import FunctionInfo
from clikgen.runtime.scenario import CASES, Case, Scenario
from clikgen.runtime.simulation import Run, prepare

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called with how many of how many rows are done."""

PERTURBATION = 1e-6  # [m] linear to 1e-6 of itself, and 1e9 rounding units
STEPS = 400  # 0.05 % beyond the boundary the error grows by half over these
DIVERGED = 1e6  # [m]
HALVINGS = 14  # of a bracket of a factor 2: the boundary to 0.01 %


@dataclass(frozen=True, slots=True)
class BoundaryPoint:
    """Where a small error stops to decay, at a sampling time."""

    period: float
    """T [s]."""
    share: float
    """μ, the largest eigenvalue of J A_β J^#, what filter and damping leave of a step: β without damping [1]."""
    gain: float
    """The largest gain with which it decays, measured to 0.01 % [1/s]."""
    linear: float
    """The same of the linear loop, 2/(μT) [1/s]."""

    @property
    def deviation(self) -> float:
        """Measured over linear, minus one."""
        return self.gain / self.linear - 1


def boundary(
    controller: CompiledController,
    periods: Iterable[float],
    filtered: bool = False,
    q: ArrayLike | None = None,
    parameters: Mapping[str, Any] = MappingProxyType({}),
) -> list[BoundaryPoint]:
    """The measured stability boundary of the compiled loop at a set point, from an error of 1e-6 m.

    The filter is always on or off, no limit is met, and no other task moves the robot. At `q`, default a regular
    configuration; `parameters` of the step are at their defaults where not given. Raises BadInput for a name or a
    value that the controller does not take.
    """
    step, name = controller.manifest.function("step"), controller.manifest.controller
    values = {
        key: step.input(key).value(value, f"{name}: {key}") for key, value in {**_defaults(step), **parameters}.items()
    }
    place = regular_configuration(controller) if q is None else step.input("q").value(q, f"{name}: q")
    values |= alone(controller.manifest) | {"q": place, "lam_free": np.array(1.0 if filtered else 0.0)}
    every = [step.input("period").value(period, f"{name}: period") for period in periods]
    starts = [_start(controller, values | {"period": T}, filtered) for T in every]
    each = {"period": np.array(every), f"{_task(controller)}_reference": np.array([one.reference for one in starts])}
    shared = {key: value for key, value in values.items() if key not in (*each, f"{_task(controller)}_gain")}
    gains = _boundary_gains(controller, shared, each) if starts else np.zeros(0)
    return [
        BoundaryPoint(float(T), one.share, float(gain), gain_bound(Loop("A", float(T))) / one.share)
        for T, one, gain in zip(every, starts, gains, strict=True)
    ]


def _task(controller: CompiledController) -> str:
    """The name of the task that is watched: the first that tracks, if it is a position; raises BadInput."""
    first, position = controller.manifest.tracking_task(), controller.manifest.position_task()
    if first != position:
        raise BadInput(
            f"{controller.manifest.controller}: wanted the position task '{position.name}' above the other tracking "
            f"tasks, got '{first.name}'"
        )
    return position.name


def _defaults(step: FunctionInfo) -> dict[str, Array]:
    return {
        signal.name: np.reshape(signal.default, signal.shape) for signal in step.inputs if signal.role == "parameter"
    }


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """The largest eigenvalue of J A_β J^#, and the reference (m,) [m] that is PERTURBATION away along its vector."""

    share: float
    reference: Array


def _start(controller: CompiledController, values: dict[str, Array], filtered: bool) -> _Start:
    """One sampling time: the error starts along the eigenvector of J A_β J^# that loses stability first."""
    task, T = _task(controller), float(values["period"])
    J = jacobians(controller, values["q"][None])[0]
    cutoffs = values["filter_cutoff"]
    beta = [beta_of(float(cutoff), T) if filtered else 1.0 for cutoff in cutoffs]
    gram = J @ J.T + damping_at(values, task, J) ** 2 * np.eye(len(J))
    # J A Jᵀ against J Jᵀ + λ²I: a symmetric pencil, whose eigenvalues are those of J A_β J^#
    shares, vectors = eigh((J * beta) @ J.T, gram)
    first = gram @ vectors[:, -1]
    position = controller.kinematics(q=values["q"])[f"{task}_position"]
    return _Start(float(shares[-1]), position + PERTURBATION * first / np.linalg.norm(first))


def _boundary_gains(controller: CompiledController, shared: Mapping[str, Array], each: Mapping[str, Array]) -> Array:
    """Where decay turns into growth at each of the sampling times, by doubling from 1/T and bisection, all at once."""
    task, count = _task(controller), len(each["period"])

    def largest(gains: Array, steps: int) -> Array:
        """Of the errors within so many steps, (count,) [m]."""
        K = gains[:, None, None] * np.eye(each[f"{task}_reference"].shape[1])
        tried = {**each, f"{task}_gain": K}
        return simulate_batch(controller, steps, count, shared, tried, ["tracking_max"])["tracking_max"]

    high = 1 / each["period"]
    start = largest(high, 1)

    def decays(gains: Array) -> NDArray[np.bool_]:
        """Whether the error never again is as large as at the start.

        Its end alone would not tell: what has grown may carry the arm to another configuration, where it dies.
        """
        return largest(gains, STEPS) <= start

    while (decaying := decays(high)).any():
        high = np.where(decaying, 2 * high, high)
    low = high / 2
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        decaying = decays(middle)
        low, high = np.where(decaying, middle, low), np.where(decaying, high, middle)
    return (low + high) / 2


@dataclass(frozen=True, slots=True, eq=False)
class TrackingMap:
    """How well a reference is tracked over sampling time and gain, measured and certified.

    `periods` (P,) [s], `gains` (G,) [1/s]; the errors are (P, G) [m], after the transient: `largest` and `rms`,
    infinite where the loop diverged; `ultimate` is the certificate's e−, infinite where there is none. `certified`
    (P,) is the gain below which there is one [1/s]. `motions` are the reference's v and a, `beta` (P,) the step's.
    """

    scenario: Scenario
    case: Case
    bounds: Bounds
    periods: Array
    gains: Array
    beta: Array
    motions: tuple[Motion, ...]
    largest: Array
    rms: Array
    ultimate: Array
    certified: Array


def tracking_map(
    controller: CompiledController,
    scenario: Scenario,
    periods: Sequence[float],
    gains: Sequence[float],
    case: Case = CASES[1],
    bounds: Bounds | None = None,
    transient: float = 0.25,
    progress: Progress | None = None,
) -> TrackingMap:
    """Track a scenario's references, its obstacles left out, with every gain at every sampling time.

    `transient` is the share of the run that is not counted. `bounds` default to those within the joint limits.
    Raises BadInput where the scenario does not fit, or J is singular within the limits.
    """
    if not 0 <= transient < 1:
        raise BadInput(f"transient: wanted a share of the run, 0 or more and below 1, got {transient:g}")
    bounds = bounds_within_limits(controller) if bounds is None else bounds
    rows = []
    for done, period in enumerate(periods):
        rows.append(_row(_at_period(controller, scenario, case, period), bounds, gains, transient))
        if progress:
            progress(done + 1, len(periods))
    return TrackingMap(
        scenario=scenario,
        case=case,
        bounds=bounds,
        periods=np.array(periods, dtype=float),
        gains=np.array(gains, dtype=float),
        beta=np.array([row.beta for row in rows]),
        motions=tuple(row.motion for row in rows),
        largest=np.array([row.largest for row in rows]),
        rms=np.array([row.rms for row in rows]),
        ultimate=np.array([row.ultimate for row in rows]),
        certified=np.array([row.certified for row in rows]),
    )


def _at_period(controller: CompiledController, scenario: Scenario, case: Case, period: float) -> Run:
    """The scenario at a sampling time, without obstacles."""
    parameters = {**scenario.parameters, "period": float(period)}
    alone = scenario.model_copy(update={"obstacles": (), "parameters": parameters})
    return prepare(controller, alone, case, scenario.name)


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One sampling time of a tracking map."""

    beta: float
    motion: Motion
    largest: Array
    rms: Array
    ultimate: list[float]
    certified: float


def _row(run: Run, bounds: Bounds, gains: Sequence[float], transient: float) -> _Row:
    """Every gain at the run's sampling time, measured and certified."""
    task = bounds.task
    reference, velocity = run.values[f"{task}_reference"], run.values[f"{task}_reference_velocity"]
    motion = reference_motion(reference, velocity, run.period)
    tuning = replace(tuning_of(run.controller.manifest, run.values, bounds), gains=tuple(gains[:1]))
    largest, tracked_rms = _tracked(run, np.asarray(gains, dtype=float), int(transient * run.steps))
    ultimate = []
    for gain in gains:
        certified = recursion(bounds, motion, replace(tuning, gains=(gain,)))
        ultimate.append(certified.fixed_points[0] if certified.contracts else float(np.inf))
    return _Row(tuning.beta, motion, largest, tracked_rms, ultimate, largest_gain(bounds, motion, tuning))


def _tracked(run: Run, gains: Array, transient: int) -> tuple[Array, Array]:
    """The largest error and its RMS after so many steps, with every gain, both (G,) [m]; infinite where it diverged."""
    controller, step = run.controller, run.controller.step.info
    task, states = _task(controller), {signal.feeds for signal in step.outputs if signal.feeds}
    values = {**run.values, **without_limits(step)}
    shapes = {signal.name: signal.shape for signal in step.inputs}

    def part(steps: slice) -> dict[str, Array]:
        """The values that are shared in a part of the run."""
        kept = {name: np.asarray(value) for name, value in values.items() if name != f"{task}_gain"}
        return {name: value if value.shape == shapes[name] else value[steps] for name, value in kept.items()}

    each = {f"{task}_gain": gains[:, None, None] * np.eye(values[f"{task}_reference"].shape[1])}
    diverged = np.zeros(len(gains), dtype=bool)
    if transient:
        wanted = ["diverged_at", *(f"final_{state}" for state in sorted(states))]
        before = simulate_batch(controller, transient, len(gains), part(slice(transient)), each, wanted)
        diverged |= np.isfinite(before["diverged_at"]) | ~_finite(before["final_q"])
        safe = {state: before[f"final_{state}"] for state in states}
        safe = {name: np.where(_over(diverged, value), 0.0, value) for name, value in safe.items()}
        each |= safe
    shared = {name: value for name, value in part(slice(transient, None)).items() if name not in each}
    metrics = ["tracking_max", "tracking_rms", "diverged_at"]
    after = simulate_batch(controller, run.steps - transient, len(gains), shared, each, metrics)
    diverged |= np.isfinite(after["diverged_at"]) | ~(after["tracking_max"] < DIVERGED)
    return np.where(diverged, np.inf, after["tracking_max"]), np.where(diverged, np.inf, after["tracking_rms"])


def _finite(values: Array) -> NDArray[np.bool_]:
    """Whether all of a row is finite, (N,)."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))


def _over(rows: NDArray[np.bool_], values: Array) -> NDArray[np.bool_]:
    """A flag for each row, in the shape of the values."""
    return np.broadcast_to(rows.reshape(-1, *[1] * (values.ndim - 1)), values.shape)


@dataclass(frozen=True, slots=True, eq=False)
class StabilityMap:
    """Where the loop is stable and how well it tracks over sampling time and gain, without and with filter."""

    boundary: tuple[BoundaryPoint, ...]
    filtered_boundary: tuple[BoundaryPoint, ...]
    tracking: TrackingMap
    filtered_tracking: TrackingMap


def stability_map(
    controller: CompiledController,
    scenario: Scenario,
    periods: Sequence[float],
    gains: Sequence[float],
    bounds: Bounds | None = None,
    progress: Progress | None = None,
) -> StabilityMap:
    """Boundaries and tracking maps of a scenario without the filter (Case 1) and with it always on (Case 2).

    Raises BadInput where the scenario does not fit, or J is singular within the limits and no `bounds` are given.
    """
    bounds = bounds_within_limits(controller) if bounds is None else bounds
    parameters = scenario.parameters
    of = 2 * len(periods)

    def second(done: int, _: int) -> None:
        if progress:
            progress(len(periods) + done, of)

    def first(done: int, _: int) -> None:
        if progress:
            progress(done, of)

    return StabilityMap(
        boundary=tuple(boundary(controller, periods, parameters=parameters)),
        filtered_boundary=tuple(boundary(controller, periods, filtered=True, parameters=parameters)),
        tracking=tracking_map(controller, scenario, periods, gains, CASES[1], bounds, progress=first),
        filtered_tracking=tracking_map(controller, scenario, periods, gains, CASES[2], bounds, progress=second),
    )
