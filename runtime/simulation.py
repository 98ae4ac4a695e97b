"""A scenario run on a compiled controller: the whole rollout in C, step by step, or in real time."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.runtime.clearance import distances
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.realtime import Clock, Timing, run_at_fixed_rate
from clikgen.runtime.scenario import Case, Scenario, check_against

Array = NDArray[np.float64]
LONGEST = 10_000_000  # steps; longer is taken for a slip of the pen
LOST = 1e6  # [m, rad] a joint beyond this, the limit of the state q, has diverged


@dataclass(frozen=True, slots=True, eq=False)
class Rollout:
    """What happened, over N steps of period T [s].

    `signals` holds every output of the step over time, (N, ...), and the state q, (N + 1, n); `parameters` what
    the step was given for each of its parameters. The reference of the first tracking task is (N, m) [m] and
    [m/s], (N, 0) without one; obstacle centres are (N, obstacles, m) and radii (obstacles,) [m].

    Distances, clearances and obstacle centres are the true ones. Where the scenario's sensing is not perfect, the
    signals `sensed_distance` and `sensed_clearance` are what the step took them for; `active` is always its belief.
    """

    scenario: Scenario
    case: Case
    manifest: Manifest
    period: float
    t: Array  # (N,) [s]
    signals: Mapping[str, Array]
    tracked: str | None
    parameters: Mapping[str, Array]
    reference: Array
    reference_velocity: Array
    obstacle_center: Array
    obstacle_radius: Array

    @property
    def title(self) -> str:
        """What the case does with the law, as in "NSB + filter"."""
        law = self.manifest.law
        return self.case.title.format(law="NSB" if law == "nsb" else law)

    @property
    def q(self) -> Array:
        """Joint positions, (N + 1, n)."""
        return self.signals["q"]

    @property
    def dq(self) -> Array:
        """Joint velocities as they were run, (N, n)."""
        return self.signals["dq"]

    @property
    def position(self) -> Array:
        """Where the tracked frame was, (N, m) [m]; (N, 0) without one."""
        return self.signals.get(f"{self.tracked}_position", self.reference)

    @property
    def error(self) -> Array:
        """Reference minus position, (N, m) [m]; (N, 0) without a tracking task."""
        return self.signals.get(f"{self.tracked}_error", self.reference)

    @property
    def diverged(self) -> float | None:
        """When the joints left the limits of the state, or were not finite any more [s]; None if they never did."""
        with np.errstate(invalid="ignore"):
            lost = ~np.all(np.abs(self.q[:-1]) <= LOST, axis=1)
        return float(self.t[np.argmax(lost)]) if lost.any() else None

    def before_divergence(self) -> "Rollout":
        """The rollout up to where it diverged, or all of it; two steps at least."""
        if self.diverged is None:
            return self
        steps = max(2, int(np.searchsorted(self.t, self.diverged)))
        return replace(
            self,
            t=self.t[:steps],
            signals={name: values[: steps + (name == "q")] for name, values in self.signals.items()},
            reference=self.reference[:steps],
            reference_velocity=self.reference_velocity[:steps],
            obstacle_center=self.obstacle_center[:steps],
        )

    @property
    def active(self) -> NDArray[np.bool_]:
        """Whether some influence region met an obstacle, or a one-sided task acted, (N,).

        A barrier engages before its boundary and keeps it, so that no region need ever be met; a contact under
        hysteresis still counts where it is left.
        """
        acted = np.zeros(len(self.t), dtype=bool)
        for name in ("active", "barrier_steps", *(f"{task.name}_share" for task in self.manifest.tasks)):
            if name in self.signals:
                acted |= (self.signals[name] > 0).reshape(len(self.t), -1).any(axis=1)
        return acted


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A scenario and a case, sampled and ready: what the step is fed over `steps` periods."""

    controller: CompiledController
    scenario: Scenario
    case: Case
    steps: int
    period: float
    values: Mapping[str, Array]

    def in_c(self) -> Rollout:
        """The whole rollout inside compiled C."""
        return self._rollout(self.controller.rollout(self.steps, self.values))

    def stepwise(self) -> Rollout:
        """The same, one call from Python per step; equal bit for bit."""
        return self._rollout(self.controller.rollout_stepwise(self.steps, self.values))

    def in_real_time(self, clock: Clock) -> tuple[Rollout, Timing]:
        """The same, one step per period of the clock, with how punctual it was."""
        signals, step = self.controller.stepper(self.steps, self.values)
        timing = run_at_fixed_rate(step, self.period, self.steps, clock)
        return self._rollout(signals), timing

    def _rollout(self, signals: Mapping[str, Array]) -> Rollout:
        tracked = next((task.name for task in self.controller.manifest.tracking_tasks), None)
        untracked = np.zeros((self.steps, 0))
        centers = self._true_centers()
        return Rollout(
            scenario=self.scenario,
            case=self.case,
            manifest=self.controller.manifest,
            period=self.period,
            t=_times(self.steps, self.period),
            signals=signals if self.scenario.sensing.perfect else self._with_truth(signals, centers),
            tracked=tracked,
            parameters={
                signal.name: self.values[signal.name]
                for signal in self.controller.step.info.inputs
                if signal.role == "parameter"
            },
            reference=self.values.get(f"{tracked}_reference", untracked),
            reference_velocity=self.values.get(f"{tracked}_reference_velocity", untracked),
            obstacle_center=centers,
            obstacle_radius=np.array([obstacle.radius for obstacle in self.scenario.obstacles]),
        )

    def _true_centers(self) -> Array:
        """Where the balls really are, (steps, obstacles, m) [m]."""
        manifest, present = self.controller.manifest, len(self.scenario.obstacles)
        if not present:
            return np.zeros((self.steps, 0, manifest.dimension))
        if self.scenario.sensing.perfect:
            return self.values["obstacle_center"][:, :present]
        return _balls(self.scenario, manifest, _times(self.steps, self.period))[0][:, :present]

    def _with_truth(self, signals: Mapping[str, Array], centers: Array) -> Mapping[str, Array]:
        """The signals with the true `distance` and `clearance`, and the step's own as the `sensed_` ones."""
        if "distance" not in signals:
            return signals
        points = self.controller.kinematics.map(self.steps, {"q": signals["q"][:-1]})["point_position"]
        distance = distances(points, centers, self.scenario)
        return {
            **signals,
            "distance": distance,
            "clearance": np.min(distance - self.values["influence_radius"], axis=1),
            "sensed_distance": signals["distance"],
            "sensed_clearance": signals["clearance"],
        }


def prepare(controller: CompiledController, scenario: Scenario, case: Case, source: str = "scenario") -> Run:
    """Sample references and obstacles at t_k = k·T and check everything; raises BadInput."""
    manifest = controller.manifest
    check_against(scenario, manifest, source)
    step = manifest.function("step")
    values: dict[str, Array] = {"q": step.input("q").value(scenario.q0, f"{source}: q0")}
    for signal in step.inputs:
        if signal.role == "parameter":
            given = scenario.parameters.get(signal.name)
            values[signal.name] = (
                np.reshape(signal.default, signal.shape)
                if given is None
                else signal.value(given, f"{source}: parameters.{signal.name}")
            )
    for name, share in (("lam_free", case.lam_free), ("lam_event", case.lam_event)):
        if name in values:  # without obstacles there is no event
            values[name] = np.array(share)
    period = float(values["period"])
    steps = math.floor(scenario.duration / period + 1e-9)
    if not 1 <= steps <= LONGEST:
        raise BadInput(f"{source}: duration: wanted 1 to {LONGEST} periods of {period:g} s, got {steps}")
    t = _times(steps, period)
    for name, reference in scenario.references.items():
        values[f"{name}_reference"], values[f"{name}_reference_velocity"] = reference.sample(t)
    values |= _obstacles(scenario, manifest, t)
    return Run(controller, scenario, case, steps, period, values)


def _times(steps: int, period: float) -> Array:
    """When the periods begin, t_k = k·T, (steps,) [s]."""
    return period * np.arange(steps, dtype=np.float64)


def _obstacles(scenario: Scenario, manifest: Manifest, t: Array) -> dict[str, Array]:
    """Where the obstacles are sensed over time, as the step wants them: unused places stay zero."""
    values: dict[str, Array] = {}
    if scenario.obstacles:
        center, velocity = _sensed_balls(scenario, manifest, t)
        values["obstacle_center"] = center
        if any(signal.name == "obstacle_velocity" for signal in manifest.function("step").inputs):
            values["obstacle_velocity"] = velocity
        values["obstacle_radius"] = _filled([one.radius for one in scenario.obstacles], (manifest.obstacles,))
        values["obstacle_count"] = np.array(float(len(scenario.obstacles)))
    if scenario.capsules:
        values |= {
            "capsule_start": _filled([one.start for one in scenario.capsules], (manifest.capsules, manifest.dimension)),
            "capsule_end": _filled([one.end for one in scenario.capsules], (manifest.capsules, manifest.dimension)),
            "capsule_radius": _filled([one.radius for one in scenario.capsules], (manifest.capsules,)),
            "capsule_count": np.array(float(len(scenario.capsules))),
        }
    if scenario.half_spaces:
        shape = (manifest.half_spaces, manifest.dimension)
        values |= {
            "half_space_normal": _filled([one.normal for one in scenario.half_spaces], shape),
            "half_space_offset": _filled([one.offset for one in scenario.half_spaces], shape[:1]),
            "half_space_count": np.array(float(len(scenario.half_spaces))),
        }
    return values


def _sensed_balls(scenario: Scenario, manifest: Manifest, t: Array) -> tuple[Array, Array]:
    """The centres and velocities of the balls as they are sensed at the times t, both (k, places, m) [m, m/s].

    Both are as old as the sensing's delay, but never from before t = 0; the centres alone are noisy.
    """
    sensing, present = scenario.sensing, len(scenario.obstacles)
    center, velocity = _balls(scenario, manifest, np.maximum(t - sensing.delay, 0.0))
    if sensing.noise:
        draw = np.random.default_rng(sensing.seed)
        center[:, :present] += sensing.noise * draw.standard_normal((t.size, present, manifest.dimension))
    return center, velocity


def _balls(scenario: Scenario, manifest: Manifest, t: Array) -> tuple[Array, Array]:
    """The true centres and velocities of the balls at the times t (k,), both (k, places, m) [m, m/s]."""
    center, velocity = np.zeros((2, t.size, manifest.obstacles, manifest.dimension))
    for i, obstacle in enumerate(scenario.obstacles):
        center[:, i], velocity[:, i] = obstacle.motion.sample(t)
    return center, velocity


def _filled(rows: ArrayLike, shape: tuple[int, ...]) -> Array:
    """The rows at the start of zeros of `shape`."""
    array = np.zeros(shape)
    given = np.asarray(rows, dtype=np.float64)
    array[: len(given)] = given
    return array
