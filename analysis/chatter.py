"""Chatter at a contact: predicted from the compiled controller, and measured in a rollout.

Near the boundary of an influence region the depth x = s − d [m] of the point of interest goes from sample to
sample by a scalar map, the normal map:

    inside, x ≥ 0:  x⁺ = a x − c        outside, x < 0:  x⁺ = x + b

a = 1 − K_oT/2 is the avoidance gain, b = v_nT the approach of the tracking task alone, c the drift outward, mostly
the curvature that a straight step along the boundary meets. b jumps to 0 at the boundary, as the projector of
eq. 11 switches from I to I − jjᵀ/ν² at any depth: that jump is the chatter. What the map does, for b > 0:

    0 ≤ a ≤ 1   c ≤ 0 none | 0 < c < ab sawtooth | ab ≤ c < b Nyquist two-cycle | c ≥ b long runs outside
    −1 < a < 0  m samples outside for one inside, m = ⌈c/b⌉, or m + 1 where m − c/b < |a| and the entry is deep;
                m ≤ 0 none, m = 1 Nyquist two-cycle, m ≥ 2 long runs outside
    a ≤ −1      aperiodic, and bounded

The rise from a trough to the next peak is b for every sample spent outside, so exactly b in a sawtooth and in a
Nyquist two-cycle. For b ≤ 0 the point leaves, or stays for good. The damping of J_o⁺ lets part of the task through
at small depths, leak/x², which ends a sawtooth whose drift is small: then the point stays at a small depth.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.analysis.metrics import encounters
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, choices
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.scenario import Case
from clikgen.runtime.simulation import Rollout, Run, prepare

Array = NDArray[np.float64]
Regime = Literal["none", "sawtooth", "Nyquist two-cycle", "long runs outside", "aperiodic"]

PROBE = 1.0
"""[m] depth at which the law is probed: it is affine in the depth, and J_o⁺ is damped the less the deeper."""
CURVATURE_STEP = 1e-4
"""Joint step [m, rad] of the central difference of the Jacobian: error about 1e-8, rounding about 1e-12."""
SAME = 1e-9  # [m] distances nearer to each other are the same, but for rounding
SHORTEST = 16  # samples; fewer tell nothing of a regime
FEWEST_CYCLES = 3  # complete cycles in an encounter; with fewer there is no regime to speak of
PAIRED = 400  # samples at most whose pairs tell how depths fan out
SAMPLED_MAPS = 25  # states of an encounter whose normal maps are averaged
SETTLING_STEPS = 5_000  # of the normal map; it has settled if it stays inside in the second half of them
ALTERNATING = 0.97  # share of the periods that are 2 samples from which on a cycle counts as Nyquist's
REST = 0.5  # [s] standing still for so long is resting
REST_SHARE = 0.02  # of the speed that the tracking task asks for; less counts as standing still
REST_ERROR = 1e-3  # [m] tracking error below which the robot has arrived, and may rest


@dataclass(frozen=True, slots=True)
class Span:
    """The least, the mean and the largest value of something that varies from cycle to cycle."""

    low: float
    mean: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float] | Array) -> "Span":
        """The span of one value or more."""
        return cls(float(np.min(values)), float(np.mean(values)), float(np.max(values)))


# ---- The normal map ----


@dataclass(frozen=True, slots=True)
class NormalMap:
    """How the depth x [m] of one point in contact goes on: inside x⁺ = a x − c, outside x⁺ = x + b."""

    a: float
    """Factor per sample inside, 1 − βK_oT/2 [1]."""
    b: float
    """Approach per sample outside, v_nT with its second-order term [m]."""
    c: float
    """Drift outward per sample inside [m]."""
    period: float
    """Sampling time T [s]."""
    leak: float = 0.0
    """What the damping ε of J_o⁺ lets through inside is leak/x²: ℓ²βv_nT, ℓ = ε/ν [m³]."""

    def __call__(self, x: float) -> float:
        """The depth one sample after x [m]."""
        if x < 0:
            return x + self.b
        return self.a * x - self.c + (self.leak / (x * x + self.leak / self.b) if self.leak > 0 < self.b else 0.0)

    @property
    def x_f(self) -> float:
        """c/(1 − a), in the paper's loop 2c/(K_oT) [m]: inside, x + x_f shrinks by a per sample; inf for a = 1."""
        return self.c / (1 - self.a) if self.a != 1 else math.inf

    def filtered(self, beta: float, *, outside: bool) -> "NormalMap":
        """The map with the filter of eq. 16 on in contact and, if `outside`, there too (Cases 3 and 2).

        a → 1 − β(1 − a), c → β²c, and in Case 2 b → βb; of b's second-order term this holds to O(T²).
        """
        b = self.b * beta if outside else self.b
        return NormalMap(1 - beta * (1 - self.a), b, beta**2 * self.c, self.period, beta * self.leak)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """One point of interest on the boundary of its influence region, as the compiled functions see it.

    Velocities of the law (eq. 11), without filter, are relative to the obstacle.
    """

    point: str
    obstacle: int
    distance: float
    """To the obstacle, d [m]."""
    rho: float
    """To its centre, ρ = d + R [m]: radius of the boundary."""
    toward: Array
    """Unit vector u to the obstacle, (dimension,)."""
    approach: Array
    """j = J_rᵀu, the gradient of the depth, (n,)."""
    dq_free: Array
    """q̇ of the law outside, q̇_g, (n,)."""
    dq_held: Array
    """q̇ of the law inside as x → 0⁺, (n,)."""
    v_n: float
    """Normal speed that the tracking task wants, toward the obstacle, j·q̇_g − u·ȯ [m/s]."""
    v_t: float
    """Tangential speed in contact [m/s]."""
    beta: float
    """Share of the law's step that the filter lets through at λ = 1 [1]."""
    map: NormalMap

    @property
    def nu(self) -> float:
        """ν = |j| [m per joint unit]."""
        return float(np.linalg.norm(self.approach))

    @property
    def jump(self) -> float:
        """How far the command jumps at the boundary however small the depth, |j·q̇_g|/ν [rad/s, m/s]."""
        return abs(float(self.approach @ self.dq_free)) / self.nu


def contact(
    controller: CompiledController,
    values: Mapping[str, ArrayLike],
    point: str,
    case: Case | None = None,
    obstacle_velocity: ArrayLike = 0.0,
) -> Contact:
    """The contact of `point` with its closest obstacle, its influence region taken to end there.

    `values` are inputs of the step (those not named at their defaults) with q on the boundary; λ is that of
    `case` if given; `obstacle_velocity` is ȯ [m/s]. The normal map comes from compiled functions alone: with w
    the joint velocity that is run and v = J_r w − ȯ,

        Δx = T u·v − (T²/2)(|v_t|²/ρ − u·D²r[w, w])

    is b for the w outside (no obstacle), and −c for the w inside at K_o = 0; K_o makes a. So it also holds for a
    filter with a cut-off of its own in every joint. Raises BadInput for an unknown point, a controller without
    obstacle avoidance, or no obstacle.
    """
    inputs = _inputs(controller, values, case)
    index, obstacle, center = point_index(controller.manifest, point), *_closest(controller, inputs, point)
    rho = float(np.linalg.norm(center))
    if rho == 0:
        raise BadInput(f"point '{point}' sits on the centre of obstacle {obstacle}: there is no normal")
    toward, distance, T = center / rho, rho - float(inputs["obstacle_radius"][obstacle]), float(inputs["period"])
    free, held, pushed, law_free, law_held, beta = _probe(controller, inputs, index, obstacle, distance)
    still = np.broadcast_to(np.asarray(obstacle_velocity, dtype=np.float64), toward.shape)

    def velocity(dq: Array) -> Array:
        return _jacobians(controller, inputs["q"], index) @ dq - still

    def change(dq: Array) -> float:
        bend = _second_derivative(controller, inputs["q"], index, dq)
        curvature = _tangential(velocity(dq), toward) ** 2 / rho - toward @ bend
        return float(T * toward @ velocity(dq) - T**2 / 2 * curvature)

    approach = _jacobians(controller, inputs["q"], index).T @ toward
    v_n = float(toward @ velocity(law_free))
    damping = float(inputs[f"{avoidance_task(controller.manifest)}_damping"])
    share = 1 - float(inputs["lam_event"]) * (1 - beta)
    return Contact(
        point=point,
        obstacle=obstacle,
        distance=distance,
        rho=rho,
        toward=toward,
        approach=approach,
        dq_free=law_free,
        dq_held=law_held,
        v_n=v_n,
        v_t=_tangential(velocity(law_held), toward),
        beta=beta,
        map=NormalMap(
            a=1 + T * float(approach @ (pushed - held)) / PROBE,
            b=change(free),
            c=-change(held),
            period=T,
            leak=damping**2 / float(approach @ approach) * share * max(v_n, 0.0) * T,
        ),
    )


def contact_in(controller: CompiledController, rollout: Rollout, step: int, point: str) -> Contact:
    """The contact of `point` in a rollout near `step`: its joint position, moved along j onto the boundary."""
    return _contact_in(controller, _prepared(controller, rollout), rollout, step, point)


def _prepared(controller: CompiledController, rollout: Rollout) -> Run:
    """The inputs that the rollout was given."""
    avoidance_task(controller.manifest)
    return prepare(controller, rollout.scenario, rollout.case, rollout.scenario.name)


def _contact_in(controller: CompiledController, run: Run, rollout: Rollout, step: int, point: str) -> Contact:
    values = _values_at(controller, run, step) | {"q": rollout.q[step]}
    index = point_index(controller.manifest, point)
    obstacle, _ = _closest(controller, values, point)
    for _ in range(3):  # Newton on x(q) = 0: the depth is of the order of a step, the error of its eighth power
        _, center = _closest(controller, values, point)
        rho = float(np.linalg.norm(center))
        j = _jacobians(controller, values["q"], index).T @ (center / rho)
        depth = values["influence_radius"][index] + values["obstacle_radius"][obstacle] - rho
        values["q"] = values["q"] - j * depth / (j @ j)
    centers = run.values["obstacle_center"][:, obstacle]
    k = min(step, len(centers) - 2)
    return contact(controller, values, point, None, (centers[k + 1] - centers[k]) / run.period)


def point_index(manifest: Manifest, point: str) -> int:
    """Where a point of interest stands among them; raises BadInput with their names."""
    avoidance_task(manifest)
    names = [info.name for info in manifest.points]
    if point not in names:
        raise BadInput(f"{manifest.controller}: no point of interest '{point}'; {choices(point, names)}")
    return names.index(point)


def avoidance_task(manifest: Manifest) -> str:
    """The name of the obstacle avoidance task; raises BadInput without one, or where it is not the paper's switched."""
    for task in manifest.tasks:
        if task.kind == "obstacle_avoidance":
            if task.activation != "switched":
                raise BadInput(
                    f"{manifest.controller}: task '{task.name}': wanted the activation 'switched', of which the normal "
                    f"map speaks, got '{task.activation}'"
                )
            return task.name
    kinds = ", ".join(task.kind for task in manifest.tasks)
    raise BadInput(f"{manifest.controller}: wanted a task of kind 'obstacle_avoidance', got {kinds}")


def _inputs(controller: CompiledController, values: Mapping[str, ArrayLike], case: Case | None) -> dict[str, Array]:
    """Every input of the step at a state, checked for its shape."""
    step, source = controller.manifest.function("step"), controller.manifest.controller
    avoidance_task(controller.manifest)
    share = {} if case is None else {"lam_free": case.lam_free, "lam_event": case.lam_event}
    given = {signal.name: np.reshape(signal.default or np.zeros(signal.shape), signal.shape) for signal in step.inputs}
    for name, value in (dict(values) | share).items():
        given[name] = step.input(name).value(value, f"{source}: {name}")
    return given


def _values_at(controller: CompiledController, run: Run, step: int) -> dict[str, Array]:
    """What a run feeds the step at one moment."""
    shapes = {signal.name: signal.shape for signal in controller.step.info.inputs}
    return {name: value if value.shape == shapes[name] else value[step] for name, value in run.values.items()}


def _closest(controller: CompiledController, inputs: Mapping[str, Array], point: str) -> tuple[int, Array]:
    """The obstacle closest to a point of interest, and the way from the point to its centre (dimension,) [m]."""
    count = int(inputs.get("obstacle_count", np.zeros(())))
    if count < 1:
        raise BadInput(f"{controller.manifest.controller}: wanted an obstacle for a contact, got none")
    place = controller.kinematics(q=inputs["q"])["point_position"][point_index(controller.manifest, point)]
    way = inputs["obstacle_center"][:count] - place
    nearest = int(np.argmin(np.linalg.norm(way, axis=1) - inputs["obstacle_radius"][:count]))
    return nearest, way[nearest]


def _probe(
    controller: CompiledController, inputs: Mapping[str, Array], index: int, obstacle: int, distance: float
) -> tuple[Array, Array, Array, Array, Array, float]:
    """q̇ as run outside, inside at K_o = 0, inside at PROBE depth; q̇ of the law for the first two; β at λ = 1.

    The influence radius of every other point is its smallest, and every obstacle the one in contact.
    """
    gain, smallest = (
        f"{avoidance_task(controller.manifest)}_gain",
        controller.step.info.input("influence_radius").minimum,
    )
    radii = np.full(inputs["influence_radius"].shape, smallest)
    radii[index] = distance + PROBE
    here = {
        "obstacle_center": inputs["obstacle_center"][obstacle],
        "obstacle_radius": inputs["obstacle_radius"][obstacle],
    }
    probes = {name: np.broadcast_to(value, inputs[name].shape).copy() for name, value in here.items()}
    results = controller.step.map(
        4,
        {
            **inputs,
            **probes,
            "influence_radius": radii,
            "obstacle_count": np.array([0.0, 1.0, 1.0, 1.0]),
            gain: np.array([0.0, 0.0, 1.0, 1.0]) * inputs[gain],
            "lam_event": np.array([0.0, inputs["lam_event"], inputs["lam_event"], 1.0]),
        },
    )
    run, law = results["dq"], results["dq_law"]
    beta = float(run[3] @ law[3] / (law[3] @ law[3])) if np.any(law[3]) else 1.0
    return run[0], run[1], run[2], law[0], law[1], beta


def _jacobians(controller: CompiledController, q: Array, index: int) -> Array:
    """J_r of one point of interest, (dimension, n)."""
    rows: Array = controller.jacobians(q=q)["point_jacobian"][index].copy()
    return rows


def _second_derivative(controller: CompiledController, q: Array, index: int, dq: Array) -> Array:
    """D²r[q̇, q̇] of one point of interest, (dimension,) [m/s²]: the change of J_r along q̇, times q̇."""
    fastest = float(np.max(np.abs(dq)))
    if fastest == 0:
        return np.zeros(controller.manifest.dimension)
    h = CURVATURE_STEP / fastest
    ahead, behind = (_jacobians(controller, q + side * h * dq, index) for side in (1, -1))
    bend: Array = (ahead - behind) @ dq / (2 * h)
    return bend


def _tangential(velocity: Array, toward: Array) -> float:
    """Length of the part of a velocity across the normal [m/s]."""
    return float(np.linalg.norm(velocity - toward * (toward @ velocity)))


# ---- Prediction ----


@dataclass(frozen=True, slots=True)
class Prediction:
    """What the normal map does in the end: its regime and, where it cycles, the cycle."""

    regime: Regime
    period: Span | None
    """Samples from one entry to the next; None without a cycle."""
    amplitude: Span | None
    """Rise of the depth from a trough to the next peak [m]; None without a cycle."""
    frequency: float | None
    """1/(T · mean period) [Hz]; None without a cycle."""
    settles_at: float | None
    """Depth at which a point that stays inside ends up, on average [m]; None where it does not stay."""
    rival: Regime | None
    """Regime of the map's other stable cycle; None without one."""
    divide: float | None
    """Entry depth [m] that parts the two: shallower entries end up with fewer samples outside."""


def predict(normal_map: NormalMap, entry: float | None = None) -> Prediction:
    """The regime of a normal map and its cycle, by the table at the head of this module.

    In closed form: every regime, all of the Nyquist two-cycle and of −1 < a < 0, the amplitude of the sawtooth,
    and the least and largest period for 0 ≤ a ≤ 1: N(b − c) to N(b), N(y) = 2 + ⌊ln(1 + y/x_f)/(−ln a)⌋, or
    1 + ⌈(c − ab)/b⌉ to 1 + ⌈c/b⌉ for c ≥ b. Mean periods there, everything aperiodic, and whether the damping of
    J_o⁺ catches the point about a depth x with leak/x² = c + (1 − a)x, come from iterating the map past its
    transient. `entry` [m] is the depth of the first sample inside; where two cycles are stable it decides, and
    without it the one that most entries lead to is given.
    """
    a, b, c = normal_map.a, normal_map.b, normal_map.c
    start = b / 2 if entry is None else entry
    settled = _settled_by_damping(normal_map, start)
    if settled is not None:
        return Prediction("none", None, None, None, settled, None, None)
    if a <= -1 and b > 0:
        return _iterated(normal_map, "aperiodic", start)
    if a < 0 and b > 0:
        return _alternating(normal_map, entry)
    if b <= 0 or c <= 0:
        return _no_cycle(normal_map)
    if a * b <= c < b:
        return _cycle(normal_map, "Nyquist two-cycle", 1)
    if c < b:
        return _iterated(normal_map, "sawtooth", start, Span(sojourn(normal_map, b - c), 0.0, sojourn(normal_map, b)))
    fewest, most = math.floor(c / b - a) + 1, math.ceil(c / b)
    return _iterated(normal_map, "long runs outside", start, Span(1 + fewest, 0.0, 1 + most))


def sojourn(normal_map: NormalMap, entry: float) -> int:
    """N(y) = 2 + ⌊ln(1 + y/x_f)/(−ln a)⌋: samples inside after an entry at depth y [m], and the one outside.

    For 0 < a ≤ 1 and 0 < c < b; a = 1 is the limit 2 + ⌊y/c⌋.
    """
    if normal_map.a == 1:
        return 2 + math.floor(entry / normal_map.c)
    return 2 + math.floor(math.log1p(entry / normal_map.x_f) / -math.log(normal_map.a))


def iterate(normal_map: NormalMap, entry: float, steps: int) -> Array:
    """The depths that the map makes of an entry depth, (steps,) [m]."""
    depths = np.empty(steps)
    x = entry
    for k in range(steps):
        depths[k] = x
        x = normal_map(x)
    return depths


def _settled_by_damping(normal_map: NormalMap, entry: float) -> float | None:
    """The mean depth at which the damping of J_o⁺ keeps the point inside [m]; None where it gets out again.

    It rests where leak/x² = c + (1 − a)x if the slope there is above −1, at c = 0 for K_oT < 4/3 and otherwise
    about for c√c < ℓ√b(1 + a)/2; a little beyond it moves irregularly about that depth, still inside. Whether an
    entry leads there the map itself is asked.
    """
    a, b, c = normal_map.a, normal_map.b, normal_map.c
    if normal_map.leak <= 0 or not (-1 < a < 1 and 0 <= c < b):
        return None
    late = iterate(normal_map, entry, SETTLING_STEPS)[SETTLING_STEPS // 2 :]
    return float(np.mean(late)) if np.all(late >= 0) else None


def _no_cycle(normal_map: NormalMap) -> Prediction:
    stays = normal_map.c <= 0 and abs(normal_map.a) < 1
    return Prediction("none", None, None, None, normal_map.x_f * -1 if stays else None, None, None)


def _cycle(normal_map: NormalMap, regime: Regime, outside: int) -> Prediction:
    """One sample inside and `outside` samples outside, again and again."""
    rise, length = outside * normal_map.b, 1 + outside
    frequency = 1 / (normal_map.period * length)
    return Prediction(regime, Span.of([length]), Span.of([rise]), frequency, None, None, None)


def _alternating(normal_map: NormalMap, entry: float | None) -> Prediction:
    """−1 < a < 0: from one sample inside to x = ax − c < 0, so the entries go by x → mb − c − |a|x.

    Entries below (⌈c/b⌉b − c)/|a| go on with m = ⌈c/b⌉ for ever, deeper ones with one more: either is a
    contraction of the entries that belong to it.
    """
    a, b, c = normal_map.a, normal_map.b, normal_map.c
    fewest = math.ceil(c / b)
    if fewest < 0:
        return _no_cycle(normal_map)
    divide = (fewest * b - c) / -a
    branches = [
        _no_cycle(normal_map) if m == 0 else _cycle(normal_map, _with_outside(m), m) for m in (fewest, fewest + 1)
    ]
    if divide >= b:
        return branches[0]
    deep = divide < b / 2 if entry is None else _first_entry(normal_map, entry) > divide
    chosen, other = reversed(branches) if deep else branches
    return replace(chosen, rival=other.regime, divide=divide)


def _with_outside(samples: int) -> Regime:
    return "Nyquist two-cycle" if samples == 1 else "long runs outside"


def _first_entry(normal_map: NormalMap, x: float) -> float:
    """The first depth within [0, b) on the way from x [m]."""
    while not 0 <= x < normal_map.b:
        x = normal_map(x)
    return x


def _iterated(normal_map: NormalMap, regime: Regime, start: float, period: Span | None = None) -> Prediction:
    """The cycle from iterating the map past its transient; `period` has the closed form of its ends."""
    steps = 20_000 if period is None else int(min(max(200 * period.high, 4_000), 400_000))
    late = iterate(normal_map, start, steps)[steps // 4 :]
    lengths, rises = cycles(late)
    if not lengths.size:  # it took more than SETTLING_STEPS until the damping had caught it
        return Prediction("none", None, None, None, float(np.mean(late)), None, None)
    seen = Span.of(lengths)
    ends = seen if period is None else Span(period.low, seen.mean, period.high)
    frequency = 1 / (normal_map.period * seen.mean)
    return Prediction(regime, ends, Span.of(rises), frequency, None, None, None)


def cycles(depth: Array) -> tuple[Array, Array]:
    """Complete cycles in depths x (N,) [m], inside where x ≥ 0: their lengths in samples, and their rises [m].

    A cycle lasts from one entry to the next; its rise is from the trough outside, just before the entry, to the
    peak inside. Both are empty where there is none.
    """
    inside = depth >= 0
    entries = np.flatnonzero(inside[1:] & ~inside[:-1]) + 1
    if len(entries) < 2:
        return np.zeros(0), np.zeros(0)
    troughs, peaks = np.minimum.reduceat(depth, entries), np.maximum.reduceat(depth, entries)  # of every cycle
    return np.diff(entries).astype(np.float64), peaks[1:] - troughs[:-1]


# ---- Measurement ----


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """What a point of interest did in one encounter, or in the part of it that was looked at."""

    points: tuple[str, ...]
    """The points of interest that met an obstacle in it."""
    begin: int
    """First step."""
    end: int
    """Step after the last."""
    depth: Array
    """x = s − d of the deepest of these points over time, (end − begin,) [m]."""
    regime: Regime
    period: Span | None
    """Samples from one entry to the next; None without a cycle."""
    amplitude: Span | None
    """Rise of the depth from a trough to the next peak [m], or, where several points alternate without getting
    out, the step of their depths (x_1, x_2, ...); None without a cycle."""
    frequency: float | None
    """1/(T · mean period) [Hz]; None without a cycle."""

    @property
    def single(self) -> bool:
        """Whether one point alone was in contact, as the normal map supposes."""
        return len(self.points) == 1


def sensed_depths(rollout: Rollout) -> Array:
    """The depths x = s − d of every point by which the step acted, (N, points) [m]: noisy and late if it senses so."""
    signals = rollout.signals
    depths: Array = rollout.parameters["influence_radius"] - signals.get("sensed_distance", signals["distance"])
    return depths


def sensed_as_it_is(rollout: Rollout) -> bool:
    """Whether the step knew the true distances all along, as the normal map supposes."""
    true = rollout.signals["distance"]
    return np.allclose(rollout.signals.get("sensed_distance", true), true, rtol=0, atol=SAME)


def measure(rollout: Rollout, during: tuple[float, float] | None = None) -> tuple[Measured, ...]:
    """Every encounter of a rollout, or what of it lies within `during` [s, s].

    The regime is told from the sensed depths alone: no cycle; (nearly) every period 2; inside the depths fan out; more
    samples outside than inside; or else a sawtooth. Raises BadInput for a rollout or a stretch that is too short, or
    without contact.
    """
    avoidance_task(rollout.manifest)
    first, last = (0, len(rollout.t)) if during is None else (round(t / rollout.period) for t in during)
    first, last = max(first, 0), min(last, len(rollout.t))
    if last - first < SHORTEST:
        raise BadInput(f"too short to measure chatter in: wanted {SHORTEST} samples, got {max(last - first, 0)}")
    spans = [(max(begin, first), min(end, last)) for begin, end in encounters(rollout)]
    depths = sensed_depths(rollout)
    found = tuple(
        _measured(rollout, depths, begin, end) for begin, end in spans if np.any(depths[begin : max(begin, end)] >= 0)
    )
    if not found:
        raise BadInput(f"{rollout.scenario.name}: no point of interest met an obstacle: no chatter to measure")
    return found


def _measured(rollout: Rollout, everything: Array, begin: int, end: int) -> Measured:
    depths = everything[begin:end]  # (samples, points)
    met = np.flatnonzero(np.any(depths >= 0, axis=0))
    depth = depths[:, met].max(axis=1)
    regime, (lengths, rises) = _regime(depth), cycles(depth)
    if regime == "none" and _alternates(depths[:, met]):  # two points can chatter without ever getting out
        regime, lengths = "Nyquist two-cycle", np.array([2.0])
        rises = np.linalg.norm(np.diff(depths[:, met], axis=0), axis=1)
    cycling = regime != "none"
    return Measured(
        points=tuple(rollout.manifest.points[i].name for i in met),
        begin=begin,
        end=end,
        depth=depth,
        regime=regime,
        period=Span.of(lengths) if cycling else None,
        amplitude=Span.of(rises) if cycling else None,
        frequency=1 / (rollout.period * float(np.mean(lengths))) if cycling else None,
    )


def _alternates(depths: Array) -> bool:
    """Whether the depths of several points (N, points) return after two samples, but not after one."""
    if depths.shape[1] < 2 or len(depths) < SHORTEST:
        return False
    once, twice = (float(np.median(np.linalg.norm(depths[n:] - depths[:-n], axis=1))) for n in (1, 2))
    return twice < 0.05 * once  # a decaying alternation loses more than that, or is over soon


def _regime(depth: Array) -> Regime:
    lengths, _ = cycles(depth)
    if len(lengths) < FEWEST_CYCLES:
        return "none"
    if np.mean(lengths == 2) >= ALTERNATING:
        return "Nyquist two-cycle"
    inside = depth >= 0
    if _slope_inside(depth) < -1:
        return "aperiodic"
    return "long runs outside" if np.mean(inside) < 0.5 else "sawtooth"


def _slope_inside(depth: Array) -> float:
    """Slope of x⁺ over x inside, the factor a of the normal map as measured: the median over pairs of samples.

    A median, as samples within the damping's reach of the boundary go by another law.
    """
    inside = np.flatnonzero(depth[:-1] >= 0)
    chosen = inside[:: 1 + len(inside) // PAIRED]
    here, there = (values - values[:, None] for values in (depth[chosen], depth[chosen + 1]))
    apart = np.abs(here) > 0.1 * np.ptp(depth[chosen])  # nearer pairs tell of the noise only
    return float(np.median(there[apart] / here[apart])) if np.any(apart) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """An encounter of one point: what was measured, the normal map there, and what it predicts."""

    measured: Measured
    map: NormalMap
    prediction: Prediction


def compare(
    controller: CompiledController, rollout: Rollout, during: tuple[float, float] | None = None
) -> tuple[Comparison, ...]:
    """Prediction and measurement for every encounter of a single point, or what of it lies within `during` [s, s].

    The map is a mean over states spread over the stretch, a and c over samples inside and b over those outside, as
    v_n may differ between them; so it speaks for stretches along which v_n and v_t vary little. Encounters of
    several points are left out: the normal map knows one. Raises BadInput as `measure` does, and for a rollout that
    sensed other distances than the true ones.
    """
    run = _prepared(controller, rollout)
    if not sensed_as_it_is(rollout):
        raise BadInput(f"{rollout.scenario.name}: wanted perfect sensing: the normal map knows no noise and no delay")
    found = []
    for measured in measure(rollout, during):
        if measured.single:
            mean = _mean_map(controller, run, rollout, measured)
            entries = measured.depth[measured.depth >= 0]
            found.append(Comparison(measured, mean, predict(mean, float(entries[0]) if entries.size else None)))
    return tuple(found)


def _mean_map(controller: CompiledController, run: Run, rollout: Rollout, measured: Measured) -> NormalMap:
    def maps(steps: NDArray[np.intp]) -> list[NormalMap]:
        chosen = steps[np.unique(np.linspace(0, len(steps) - 1, SAMPLED_MAPS).astype(int))] + measured.begin
        return [_contact_in(controller, run, rollout, int(k), measured.points[0]).map for k in chosen]

    inside, outside = np.flatnonzero(measured.depth >= 0), np.flatnonzero(measured.depth < 0)
    held, free = maps(inside if inside.size else outside), maps(outside if outside.size else inside)
    a, c, leak = (float(np.mean([getattr(each, name) for each in held])) for name in ("a", "c", "leak"))
    return NormalMap(a, float(np.mean([each.b for each in free])), c, rollout.period, leak)


# ---- Beyond one point that cycles ----


@dataclass(frozen=True, slots=True)
class Sticking:
    """A rest at an influence region's boundary while the tracking error remains."""

    begin: float
    """Since when [s]."""
    end: float
    """Until when [s]: the end of the rollout, or when it was let go."""
    point: str
    obstacle: int
    error: float
    """Tracking error that remains, at the end [m]."""
    v_n: float
    """Normal speed that the tracking task wants [m/s]: negative is away from the obstacle."""
    hold: float | None
    """How long the rest lasts from its begin [s], where the task pulls away; None: for ever."""
    explanation: str


def sticking(controller: CompiledController, rollout: Rollout) -> Sticking | None:
    """The first rest of REST [s] or longer in contact while the tracking error remains; None without one.

    Resting is to come forward at less than REST_SHARE of the speed that the tracking task asks for alone, on
    average over REST, so a chatter on the spot is a rest. Eq. 11 leaves nothing of q̇_g along the normal, in either
    direction: the boundary point nearest to the goal is an equilibrium, also where the goal lies away from the
    obstacle. There the depth decays by K_o alone until the damping ε of J_o⁺ lets go, with ℓ = ε/ν, after

        t = (2/(3βK_o)) ln(1 + x³K_o/(2ℓ²|v_n|)),   of ẋ = −β(K_o x/2 + ℓ²|v_n|/x²).

    Raises BadInput without obstacle avoidance or without a tracking task.
    """
    task = avoidance_task(rollout.manifest)
    if rollout.tracked is None:
        raise BadInput(f"{rollout.scenario.name}: wanted a tracking task, without which nothing is asked for")
    run, window = _prepared(controller, rollout), max(1, round(REST / rollout.period))
    resting = _resting(controller, run, rollout, window)
    if not resting.any():
        return None
    first = int(np.argmax(resting))
    ends = np.flatnonzero(~resting[first:])
    last = (first + int(ends[0]) if ends.size else len(resting)) + window - 1
    depths = sensed_depths(rollout)
    name = rollout.manifest.points[int(np.argmax(depths[first : first + window].max(axis=0)))].name
    at = _contact_in(controller, run, rollout, first + window // 2, name)
    gain, damping = (float(rollout.parameters[f"{task}_{of}"]) for of in ("gain", "damping"))
    depth, hold = float(depths[first].max()), None
    if at.v_n < 0 < gain:
        share = 1 - float(rollout.parameters["lam_event"]) * (1 - at.beta)
        hold = 2 / (3 * share * gain) * math.log1p(max(depth, 0.0) ** 3 * gain / (2 * (damping / at.nu) ** 2 * -at.v_n))
    error = float(np.linalg.norm(rollout.error[min(last, len(rollout.t)) - 1]))
    return Sticking(
        begin=first * rollout.period,
        end=last * rollout.period,
        point=name,
        obstacle=at.obstacle,
        error=error,
        v_n=at.v_n,
        hold=hold,
        explanation=_why(at, error, hold),
    )


def _resting(controller: CompiledController, run: Run, rollout: Rollout, window: int) -> NDArray[np.bool_]:
    """Whether the robot rests in contact, short of its goal, over the `window` steps from each step on."""
    steps = len(rollout.t)
    if steps < window:
        raise BadInput(f"too short to see a rest in: wanted {window} samples, got {steps}")
    alone = controller.step.map(steps, {**run.values, "q": rollout.q[:-1], "obstacle_count": np.zeros(())})["dq_law"]
    asked = np.linalg.norm(_moving_mean(alone, window), axis=1)
    made = np.linalg.norm(rollout.q[window:] - rollout.q[:-window], axis=1) / (window * rollout.period)
    touching = _moving_mean(np.any(sensed_depths(rollout) >= 0, axis=1)[:, None].astype(np.float64), window)[:, 0] > 0
    short = _moving_mean(np.linalg.norm(rollout.error, axis=1)[:, None], window)[:, 0] > REST_ERROR
    resting: NDArray[np.bool_] = touching & short & (made < REST_SHARE * asked)
    return resting


def _moving_mean(values: Array, window: int) -> Array:
    """Mean of `window` rows from each row on, (N − window + 1, n)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    mean: Array = (total[window:] - total[:-window]) / window
    return mean


def _why(at: Contact, error: float, hold: float | None) -> str:
    start = f"{at.point} rests at the boundary around obstacle {at.obstacle}, {error:.3g} m short of its goal: "
    if hold is not None:
        return start + (
            f"the tracking task pulls away from the obstacle at {-at.v_n:.3g} m/s, but eq. 11 takes out all "
            "motion along the normal, away from the obstacle as well as toward it; the hold lasts about "
            f"{hold:.3g} s, until the damping of the avoidance task lets go"
        )
    if at.v_n < 0:
        return start + "eq. 11 takes out all motion along the normal, and at K_o = 0 nothing brings the point out"
    return start + (
        f"the tracking task pulls toward the obstacle at {at.v_n:.3g} m/s, eq. 11 takes that out, and no motion "
        "along the boundary comes nearer to the goal"
    )


@dataclass(frozen=True, slots=True)
class TwoPointCycle:
    """The Nyquist cycle of two points in contact with orthonormal normals."""

    depth: float
    """√(x_1² + x_2²) at every sample [m]."""
    step: float
    """How far the depths (x_1, x_2) move from sample to sample [m]."""
    frequency: float
    """1/(2T) [Hz]."""


def two_point_cycle(
    speed: float, gain: float, period: float, beta: float = 1.0, bearing: float = math.pi / 4
) -> TwoPointCycle:
    """What the summed task of eqs. 8-9 does to two points whose normals j_1, j_2 are orthonormal.

    The depths x = (x_1, x_2) go by x⁺ = (1 − κ)x + βT(I − x̂x̂ᵀ)v, κ = βK_oT/2: one direction is projected out, and
    the other moves on. The cycle lies at angles ±θ to v, sin²θ = κ/2, at |x| = β|v|T/√(2(2 − κ)), and steps by
    2|x| sin θ. `speed` is |v| [m/s], `bearing` the angle of v from the first normal [rad]; both points have to
    stay in contact, θ < bearing < π/2 − θ: at 45° for every κ < 1. Raises BadInput beyond.
    """
    if not (speed > 0 and gain > 0 and period > 0 and 0 < beta <= 1):
        raise BadInput(
            f"wanted speed, gain and period above 0 and β in (0, 1], got {speed:g}, {gain:g}, {period:g} and {beta:g}"
        )
    kappa = beta * gain * period / 2
    theta = math.asin(math.sqrt(kappa / 2)) if kappa < 2 else math.pi / 2
    if not theta < bearing < math.pi / 2 - theta:
        raise BadInput(
            f"no cycle with both points in contact: wanted a bearing within {theta:.4g} and "
            f"{math.pi / 2 - theta:.4g} rad at βK_oT = {2 * kappa:g}, got {bearing:.4g}"
        )
    depth = beta * speed * period / math.sqrt(2 * (2 - kappa))
    return TwoPointCycle(depth, 2 * depth * math.sin(theta), 1 / (2 * period))
