"""The barrier, sampled: how far below zero the clearance h = d − s of a pair may fall at the sampling time T.

For every pair of a point r(q) and an obstacle the barrier keeps, at each sample, the row of `symbolic/barrier.py`,

    û'·(J_r u − v̂) <= γ h' + ε,                                                                                   (1)

where û' (toward the obstacle), h' and v̂ are what is sensed of the obstacle, and ε is `barrier_excess`: rows that
contradict each other cannot all be kept. The joints then go straight on, q⁺ = q + T w with w = μ u: μ = 1 without the
filter, and μ = 1 − λ(1 − β) where it acts on all joints alike.

A step. A ball, a capsule and a half-space are convex, so d is a convex function of y = r − o with the subgradient −û:
d⁺ >= d − û·(y⁺ − y), however far the step. With Taylor's remainder of r along the straight step of the joints,

    h⁺ >= h − T û·(J_r w − ȯ) − (T²/2) κ,     κ = κ_r + κ_o,   κ_r <= sup û·D²r[w, w],   κ_o <= sup |ö|.           (2)

That an obstacle is round only helps. What costs is that the path of the point is, and a flat wall is the worst case.

What (1) says of the truth. Let |o' − o| <= e, so that |h' − h| <= e. The directions û' and û are at most asin(e/ρ)
apart, ρ = |y|, so |û' − û| <= θ = 2 sin(½ asin(e/ρ)), or 2 for e >= ρ. Let ν >= |μ v̂ − ȯ|: |ȯ| where no velocity is
fed, sup |ö| times the delay where one is, and (1 − μ)|ȯ| with the filter. With g = μγ,

    û·(J_r w − ȯ) <= g h + c,     c = g e + θ |J_r w − ȯ| + ν + με.                                                (3)

gT <= 1. From (2) and (3), h⁺ >= (1 − gT) h − T c − (T²/2) κ, whose right side does not fall as h grows. So

    {h >= −m} is invariant for   m = T κ/(2g) + e + θ |ṙ − ȯ|/g + ν/g + ε/γ,                                       (4)

and h_k + m >= (1 − gT)^k (h_0 + m) from a start below. With κ and c of every step the same recursion is sharper:
h_k >= −m_k for m_0 = max(0, −h_0), m⁺ = (1 − gT) m + T c + (T²/2) κ.

gT > 1. Now (3) allows more than the way to the boundary, and only the speed keeps that from being run. With
V >= û·(J_r w − ȯ), h⁺ >= h − T min(g h + c, V) − (T²/2) κ. That is least over all h where g h + c = V, and there −m:

    m = T² κ/2 + c/g + (gT − 1) V/g.                                                                               (5)

The last term is an overshoot of first order in T. (5) holds from the first sample on, whatever the start, and for
gT >= 2 too, where h alternates at rest. At gT = 1 it agrees with (4).

The third term of (4) is never more than 2e(1 − gT)/(gT), and nothing in (5): by convexity at the sensed position
d⁺ >= d' − û'·(y⁺ − y) − e, so h⁺ >= (1 − gT) h' − e − T(ν + με) − (T²/2) κ without a direction in it, and h' >= h − e.

Other rows. A wall of `workspace_walls` is a half-space at rest. Joint limits are linear in q: κ = e = ν = 0.
Not covered: `self_collision`. Its row holds for the two points that are nearest at the sample, and the ends of two
axes, up to ℓ away, close faster by ωℓ, ω their relative turning. So m gains ωℓ/γ, which does not vanish with T.
Not covered either: a filter with different β of the joints, or with a memory (the planner `smooth`), while λ > 0.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi

from clikgen.analysis.discrete_filter import beta_of
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest, TaskInfo
from clikgen.runtime.simulation import Run

Array = NDArray[np.float64]

CONFIDENCE = 0.999  # that no noise of a run exceeds the position error taken for it
CONSTANT = 1e-9  # [m] what rounding may make of a length that does not change
SAMPLES = 32  # configurations at which the lengths of a chain are read


# ---- The margin ----


@dataclass(frozen=True, slots=True)
class Disturbance:
    """Bounds on what the row of a pair does not know."""

    curvature: float
    """κ_r, of the point's own path [m/s²]."""
    speed: float
    """V, of the point relative to the obstacle [m/s]."""
    acceleration: float = 0.0
    """κ_o, of the obstacle [m/s²]."""
    velocity_error: float = 0.0
    """ν, of the obstacle's velocity as it is fed [m/s]."""
    position_error: float = 0.0
    """e, of the obstacle's position as it is sensed [m]."""
    direction_error: float = 0.0
    """θ, of the unit vector toward it [1]."""
    excess: float = 0.0
    """ε, by how much the row is violated [m/s]."""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not value >= 0:
                raise BadInput(f"{name}: wanted 0 or more, got {value:g}")


@dataclass(frozen=True, slots=True)
class Margin:
    """How far below zero a clearance may fall, term by term [m; of a joint in its unit]."""

    curvature: float
    """Tκ_r/(2g), or T²κ_r/2 for gT > 1."""
    acceleration: float
    """The same of κ_o."""
    velocity: float
    """ν/g."""
    position: float
    """e."""
    direction: float
    """θV/g, at most 2e(1 − gT)/(gT), and 0 for gT >= 1."""
    excess: float
    """ε/γ."""
    overshoot: float
    """(gT − 1)V/g for gT > 1, else 0."""

    @property
    def total(self) -> float:
        """m [m]."""
        return float(sum(asdict(self).values()))


def margin(disturbance: Disturbance, rate: float, period: float, share: float = 1.0) -> Margin:
    """Eqs. (4) and (5): the margin m of a barrier of `rate` γ [1/s] at the sampling time `period` T [s].

    `share` is μ, the share of the barrier's velocity that is run. Raises BadInput for numbers out of range.
    """
    if not (rate > 0 and period > 0 and 0 < share <= 1):
        raise BadInput(f"wanted rate and period above 0 and a share in (0, 1], got {rate:g}, {period:g}, {share:g}")
    g, e = share * rate, disturbance.position_error
    direction = min(max(0.0, 2 * e * (1 / period - g)), disturbance.direction_error * disturbance.speed)
    terms = margin_terms(
        g,
        period,
        curvature=disturbance.curvature,
        acceleration=disturbance.acceleration,
        velocity=disturbance.velocity_error,
        position=e,
        direction=direction,
        excess=share * disturbance.excess,
        speed=disturbance.speed,
    )
    return Margin(**{name: float(value) for name, value in terms.items()})


def margin_terms(
    g: float | Array,
    period: float,
    *,
    curvature: float | Array,
    acceleration: float | Array,
    velocity: float | Array,
    position: float | Array,
    direction: float | Array,
    excess: float | Array,
    speed: float | Array,
) -> dict[str, Array]:
    """The terms of eqs. (4) and (5) by their names in `Margin`, of κ_r, κ_o, ν, e, θ|ṙ − ȯ|, με and V [m]."""
    fast = np.asarray(g * period) > 1
    bent = np.where(fast, period**2 / 2, period / (2 * np.asarray(g)))
    return {
        "curvature": bent * curvature,
        "acceleration": bent * acceleration,
        "velocity": np.asarray(velocity / g),
        "position": np.asarray(position),
        "direction": np.asarray(direction / g),
        "excess": np.asarray(excess / g),
        "overshoot": np.maximum(0.0, period - 1 / np.asarray(g)) * np.where(fast, speed, 0.0),
    }


def direction_error(position_error: float, distance: float) -> float:
    """θ = 2 sin(½ asin(e/ρ)), how far unit vectors to two places e apart may be from each other, one of them ρ away."""
    if position_error == 0:
        return 0.0
    return 2.0 if position_error >= distance else 2 * float(np.sin(np.arcsin(position_error / distance) / 2))


# ---- How far a point can move and bend ----


def greatest_motion(controller: CompiledController, velocity: Array) -> tuple[Array, Array]:
    """Bounds on |ṙ| [m/s] and |D²r[q̇, q̇]| [m/s²] of every point of interest for |q̇_i| <= velocity_i, (points,) each.

    With a_i the axis of joint i, ∂²r/∂q_i∂q_k = a_i × J_k for a turning joint i no further out than k, else 0, and
    |J_k| <= ρ_k, the sum of the lengths from joint k to the point, or 1 for a sliding joint. So at every configuration

        |ṙ| <= Σ v_k ρ_k,   |D²r[q̇, q̇]| <= Σ_i v_i (v_i ρ_i + 2 Σ_{k>i} v_k ρ_k),   i over the turning joints.

    In the plane both are attained, where all lengths are aligned. Infinite where a joint of the chain has no
    velocity limit, or the point is no end of such a chain (a joint mimics another one).
    """
    speed, curvature = np.zeros((2, len(controller.manifest.points)))
    turning = np.array([joint.unit == "rad" for joint in controller.manifest.joints])
    for i, (chain, lever) in enumerate(_levers(controller)):
        rates, turns = velocity[list(chain)] * lever, turning[list(chain)]
        further = np.append(np.cumsum(rates[:0:-1])[::-1], 0.0)  # of the joints further out
        bends = velocity[list(chain)] * (rates + 2 * further)
        speed[i], curvature[i] = np.sum(rates), np.sum(bends[turns])
    return speed, curvature


def _levers(controller: CompiledController) -> Iterator[tuple[tuple[int, ...], Array]]:
    """For every point of interest the joints that carry it, the first one first, and a bound on each |J_k| [m, 1]."""
    manifest = controller.manifest
    if not manifest.points:
        return
    turning = np.array([joint.unit == "rad" for joint in manifest.joints])
    q = _spread(manifest)
    where = controller.kinematics.map(len(q), {"q": q})
    origins = where["link_pose"][:, list(manifest.joint_links)][..., : manifest.dimension, 3]
    J = controller.jacobians.map(len(q), {"q": q})["point_jacobian"]
    for i, point in enumerate(manifest.points):
        chain = _chain(manifest, point.link)
        corners = np.concatenate([origins[:, list(chain)], where["point_position"][:, i, None]], axis=1)
        lengths = np.linalg.norm(np.diff(corners, axis=1), axis=2)  # (samples, chain)
        ends_turning = np.append(turning[list(chain)][1:], True)
        reach = np.cumsum(lengths.max(axis=0)[::-1])[::-1]
        lever = np.where(turning[list(chain)], reach, 1.0)
        others = [k for k in range(len(turning)) if k not in chain]
        columns = np.linalg.norm(J[:, i], axis=1)  # (samples, n)
        plain = (
            np.all(np.ptp(lengths, axis=0)[ends_turning] < CONSTANT)
            and np.all(columns[:, list(chain)] <= lever + CONSTANT)
            and np.all(columns[:, others] < CONSTANT)
        )
        yield chain, lever if plain else np.full(len(chain), np.inf)


def _spread(manifest: Manifest) -> Array:
    """Configurations within the limits, (SAMPLES, n); sliding joints at either end, where lengths are greatest."""
    limits = np.where(np.isinf(manifest.limits), [-np.pi, np.pi], manifest.limits)
    q = np.random.default_rng(0).uniform(limits[:, 0], limits[:, 1], (SAMPLES, len(limits)))
    for i, joint in enumerate(manifest.joints):
        if joint.unit == "m":
            q[::2, i], q[1::2, i] = limits[i]
    return q


def _chain(manifest: Manifest, link: str) -> tuple[int, ...]:
    """The joints that carry a link, the first one first."""
    parents = {info.name: info.parent for info in manifest.links}
    moved = {joint.link: i for i, joint in enumerate(manifest.joints)}
    chain: list[int] = []
    while link in parents:
        chain = [moved[link], *chain] if link in moved else chain
        link = parents[link]
    return tuple(chain)


# ---- What a run brings along ----


def guarding(manifest: Manifest, kind: str) -> list[TaskInfo]:
    """The tasks of a kind that act by the barrier."""
    return [task for task in manifest.tasks if task.kind == kind and task.activation == "barrier"]


def share_run(run: Run, lam: Array) -> Array:
    """μ = 1 − λ(1 − β) for these λ; raises BadInput where the filter does not scale all velocities alike."""
    if not np.any(lam):
        return np.ones_like(lam)
    manifest = run.controller.manifest
    states = [signal.name for signal in manifest.function("step").inputs if signal.role == "state"]
    cutoffs = np.unique(run.values.get("filter_cutoff", np.zeros(0)))
    if manifest.filter != "first_order" or states != ["q"] or len(cutoffs) != 1:
        raise BadInput(
            f"{run.scenario.name}: at λ > 0 the margin speaks only of a first_order filter of one cut-off without a "
            f"memory, got {manifest.filter}, {len(cutoffs)} cut-off(s), states {', '.join(states)}"
        )
    return np.asarray(1 - lam * (1 - beta_of(float(cutoffs[0]), run.period)))


@dataclass(frozen=True, slots=True, eq=False)
class Balls:
    """The moving obstacles of a run at its N samples and the end of the last period: the truth, and what is fed."""

    radius: Array  # (balls,) [m]
    center: Array  # o (N + 1, balls, dimension) [m]
    velocity: Array  # ȯ (N + 1, balls, dimension) [m/s]
    sensed: Array  # o' (N, balls, dimension) [m]
    fed: Array  # v̂ (N, balls, dimension) [m/s]

    @classmethod
    def of(cls, run: Run) -> Self:
        """The balls of the run's scenario."""
        t = run.period * np.arange(run.steps + 1, dtype=np.float64)
        balls = run.scenario.obstacles
        shape = (2, run.steps + 1, len(balls), run.controller.manifest.dimension)
        center, velocity = np.zeros(shape)
        for i, ball in enumerate(balls):
            center[:, i], velocity[:, i] = ball.motion.sample(t)
        sensed = run.values.get("obstacle_center", center[:-1])[:, : len(balls)]
        fed = run.values.get("obstacle_velocity", np.zeros_like(sensed))[:, : len(balls)]
        return cls(np.array([ball.radius for ball in balls]), center, velocity, sensed, fed)

    def acceleration(self, period: float) -> Array:
        """2(o⁺ − o − Tȯ)/T², the mean acceleration over each period, (N, balls, dimension) [m/s²]."""
        return np.asarray(2 / period**2 * (np.diff(self.center, axis=0) - period * self.velocity[:-1]))


@dataclass(frozen=True, slots=True)
class Expected:
    """The margin of a point as far as it is known before the run; infinite where nothing bounds its motion."""

    task: str
    point: str
    margin: Margin


def expected(run: Run) -> tuple[Expected, ...]:
    """The margin of every point that a barrier guards, for all motion within the velocity limits.

    κ_r and V are those of `greatest_motion`; κ_o, ν and the delay's part of e are of the scenario's obstacles at the
    samples. e is exceeded by the noise of no sample of a run with the probability CONFIDENCE. ε = 0: every row can
    be kept. Where the filter is only on at times, each term is the greater one. Raises BadInput for a filter that
    the margin does not know.
    """
    manifest = run.controller.manifest
    motion = greatest_motion(run.controller, velocity_limits(run))
    lam = np.unique([float(run.values.get(name, np.zeros(()))) for name in ("lam_free", "lam_event")])
    tasks = [*guarding(manifest, "obstacle_avoidance"), *guarding(manifest, "workspace_walls")]
    of_shares = zip(*(_expected(run, tasks, share, *motion) for share in share_run(run, lam).tolist()), strict=True)
    names = [(task.name, point.name) for task in tasks for point in manifest.points]
    return tuple(Expected(*name, greatest(each)) for name, each in zip(names, of_shares, strict=True))


def _expected(run: Run, tasks: Sequence[TaskInfo], share: float, speed: Array, curvature: Array) -> Iterator[Margin]:
    """The margin of every point of every task, `share` μ of the velocity being run."""
    balls = Balls.of(run)
    nearest = run.values.get("influence_radius", np.zeros(0)) + np.min(balls.radius, initial=np.inf)
    for task in tasks:
        moving = _of_balls(run, balls, share) if task.kind == "obstacle_avoidance" else Disturbance(0.0, 0.0)
        for i in range(len(speed)):
            bounds = replace(moving, curvature=float(curvature[i]), speed=float(speed[i]) + moving.speed)
            rho = float(nearest[i]) if balls.radius.size else np.inf
            yield _with_direction(bounds, rho, float(run.values[f"{task.name}_rate"]), run.period, share)


def greatest(margins: Sequence[Margin]) -> Margin:
    """Each term at its greatest."""
    return Margin(*(max(getattr(each, one.name) for each in margins) for one in fields(Margin)))


def _of_balls(run: Run, balls: Balls, share: float) -> Disturbance:
    """What moving balls bring along, known before the run; `share` μ of the velocity that they ask for is run."""
    if not balls.radius.size:
        return Disturbance(0.0, 0.0)
    return Disturbance(
        curvature=0.0,
        speed=float(np.linalg.norm(balls.velocity, axis=2).max()),
        acceleration=float(np.linalg.norm(balls.acceleration(run.period), axis=2).max()),
        velocity_error=float(np.linalg.norm(share * balls.fed - balls.velocity[:-1], axis=2).max()),
        position_error=_delayed(run, balls) + _noise(run),
    )


def _delayed(run: Run, balls: Balls) -> float:
    """How far a ball gets within the sensing's delay, at the samples [m]."""
    late = np.maximum(run.period * np.arange(run.steps, dtype=np.float64) - run.scenario.sensing.delay, 0.0)
    then = [ball.motion.sample(late)[0] for ball in run.scenario.obstacles]
    return float(max(np.linalg.norm(o - balls.center[:-1, i], axis=1).max() for i, o in enumerate(then)))


def _noise(run: Run) -> float:
    """The length that no noise of the run exceeds, with the probability CONFIDENCE [m]: a quantile of χ."""
    draws = run.steps * len(run.scenario.obstacles)
    quantile = chi.ppf(CONFIDENCE ** (1 / draws), df=run.controller.manifest.dimension)
    return run.scenario.sensing.noise * float(quantile)


def _with_direction(bounds: Disturbance, nearest: float, rate: float, period: float, share: float) -> Margin:
    """θ and m together: the point comes as near to a centre as ρ = s + R − m, `nearest` being s + R [m]."""
    kept = margin(bounds, rate, period, share)
    for _ in range(100):  # m grows with θ and θ with m: from below to the least fixed point
        theta = direction_error(bounds.position_error, nearest - kept.total)
        before, kept = kept, margin(replace(bounds, direction_error=theta), rate, period, share)
        if kept.total <= before.total * (1 + 1e-12):
            break
    return kept


def velocity_limits(run: Run) -> Array:
    """The velocity limit of every joint that the step keeps, (n,) [m/s, rad/s]; infinite where it keeps none."""
    manifest = run.controller.manifest
    given = run.values.get("velocity_limit", np.full(len(manifest.inputs), np.inf))
    of = dict(zip((moved.name for moved in manifest.inputs), given, strict=True))
    driven = of.get("base_forward", np.inf)  # of a differential drive: along x and y no faster than forward
    return np.array([of.get(joint.name, driven) for joint in manifest.joints])
