"""The margin of a sampled barrier along a rollout, and whether every clearance kept it: theory in `barrier_margin`."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.barrier_margin import Balls, Margin, greatest, guarding, margin_terms, share_run, velocity_limits
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import TaskInfo
from clikgen.runtime.scenario import Capsule
from clikgen.runtime.simulation import Rollout, Run

Array = NDArray[np.float64]

ROUNDING = 1e-10  # [m, rad] what rounding may make of a clearance
KEPT = 1e-7  # [m/s, rad/s] to which rows computed anew agree with the program's own
CENTRED = 1e-12  # [m] nearer to a centre or axis than this, the direction to it is +x, as in the step
COVERED = ("obstacle_avoidance", "workspace_walls", "joint_limits")  # kinds of tasks that the margin speaks of


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """What a barrier kept of one point, or of one joint, over the N steps of a rollout."""

    task: str
    name: str
    """Of the point or joint."""
    is_point: bool
    """Whether it is a point of interest, not a joint."""
    unit: str
    """Of every length here: m, or that of the joint."""
    clearance: Array
    """h, the least of its pairs, at every sample and after the last step, (N + 1,)."""
    bound: Array
    """m_k of the pair that is nearest: h_k >= −m_k, (N + 1,)."""
    slack: Array
    """The least h_k + m_k of its pairs, (N + 1,)."""
    margin: Margin
    """m, each term by what is greatest in the rollout."""
    unreported: float
    """By how much a row was violated at most, beyond what the barrier itself reports [unit/s]."""

    @property
    def label(self) -> str:
        """What to call it."""
        return f"{self.task}: {self.name}"

    @property
    def least(self) -> float:
        """The least clearance."""
        return float(np.min(self.clearance))

    @property
    def used(self) -> float:
        """How much of the margin was used at most, h_k/(−m_k): 0 where h stayed above zero, more than 1 violates it."""
        below = self.clearance < -ROUNDING
        return float(np.max(-self.clearance[below] / np.maximum(self.bound[below], ROUNDING), initial=0.0))

    @property
    def bound_there(self) -> float:
        """m_k where the clearance is least."""
        return float(self.bound[np.argmin(self.clearance)])

    @property
    def holds(self) -> bool:
        """Whether the rows were kept as the barrier says, and the clearances as follows from them."""
        return bool(np.min(self.slack) >= -ROUNDING and self.unreported <= KEPT)


def kept(run: Run, rollout: Rollout) -> tuple[Kept, ...]:
    """What was kept of every point and joint that a barrier guards, in a rollout of the run.

    κ_r is (2/T²) û·(r⁺ − r − T J_r w), the mean along each step, from compiled kinematics and Jacobians. Obstacles
    are where the scenario says and sensed as the run was fed. Empty where no barrier acts that the margin speaks of.
    Raises BadInput for a rollout that diverged, or for a filter that the margin does not know.
    """
    if rollout.diverged is not None:
        raise BadInput(f"{rollout.scenario.name}: diverged at t = {rollout.diverged:g} s: no margin to look at")
    if "barrier_excess" not in rollout.signals:
        return ()
    loop, manifest = _Loop.of(run, rollout), rollout.manifest
    found: list[Kept] = []
    for task in guarding(manifest, "obstacle_avoidance"):
        influence = run.values["influence_radius"]
        found += _of_points(loop, task, [_row(loop, one, influence) for one in _obstacles(run, loop.places)])
    for task in guarding(manifest, "workspace_walls"):
        found += _of_points(loop, task, [_row(loop, wall, s) for wall, s in _walls(loop, task)])
    for task in guarding(manifest, "joint_limits"):
        found += _of_joints(loop, task)
    return tuple(found)


def uncovered(run: Run, rollout: Rollout) -> list[str]:
    """The tasks that act by the barrier and that the margin says nothing of."""
    guarded = guarding(rollout.manifest, "workspace_walls")
    walls = [task.name for task in guarded if not _of_interest(run, rollout, task)]
    others = [task.name for task in rollout.manifest.tasks if task.activation == "barrier" and task.kind not in COVERED]
    return [*walls, *others]


# ---- What ran ----


@dataclass(frozen=True, slots=True, eq=False)
class _Loop:
    """A rollout and what its steps ran, N of them."""

    run: Run
    rollout: Rollout
    places: Array  # r of every point (N + 1, points, dimension) [m]
    velocities: Array  # J_r w (N, points, dimension) [m/s]
    bends: Array  # the mean of D²r[w, w] along each step (N, points, dimension) [m/s²]
    share: Array  # μ (N, 1)

    @classmethod
    def of(cls, run: Run, rollout: Rollout) -> Self:
        steps, dimension = run.steps, rollout.manifest.dimension
        places, velocities = np.zeros((steps + 1, 0, dimension)), np.zeros((steps, 0, dimension))
        if rollout.manifest.points:
            places = run.controller.kinematics.map(steps + 1, {"q": rollout.q})["point_position"]
            jacobians = run.controller.jacobians.map(steps, {"q": rollout.q[:-1]})["point_jacobian"]
            velocities = np.einsum("kpdn,kn->kpd", jacobians, rollout.dq)
        bends = 2 / run.period**2 * (np.diff(places, axis=0) - run.period * velocities)
        return cls(run, rollout, places, velocities, bends, share_run(run, rollout.signals["lam"])[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class _Obstacle:
    """An obstacle to every point, over time: what is true of it, and what is sensed."""

    distance: Array  # d (N + 1, points) [m]
    toward: Array  # û (N, points, dimension)
    sensed_distance: Array  # d' (N, points) [m]
    sensed_toward: Array  # û' (N, points, dimension)
    velocity: Array  # ȯ (N, 1, dimension) [m/s]
    fed: Array  # v̂ (N, 1, dimension) [m/s]
    acceleration: Array  # the mean of ö over each period (N, 1, dimension) [m/s²]


def _obstacles(run: Run, places: Array) -> Iterator[_Obstacle]:
    """Every obstacle of the scenario."""
    balls = Balls.of(run)
    for i, radius in enumerate(balls.radius):
        length, toward = _directed(balls.center[:, None, i] - places)
        sensed, sensed_toward = _directed(balls.sensed[:, None, i] - places[:-1])
        yield _Obstacle(
            length - radius,
            toward[:-1],
            sensed - radius,
            sensed_toward,
            balls.velocity[:-1, None, i],
            balls.fed[:, None, i],
            balls.acceleration(run.period)[:, None, i],
        )
    for capsule in run.scenario.capsules:
        length, toward = _directed(_nearest_on_axis(capsule, places) - places)
        yield _at_rest(length - capsule.radius, toward)
    for wall in run.scenario.half_spaces:
        yield _half_space(np.asarray(wall.normal), wall.offset, places)


def _half_space(normal: Array, offset: float, places: Array) -> _Obstacle:
    """All points p with nᵀp <= offset."""
    return _at_rest(places @ normal - offset, np.broadcast_to(-normal, places.shape))


def _at_rest(distance: Array, toward: Array) -> _Obstacle:
    """An obstacle that does not move, and is sensed as it is."""
    rest = np.zeros((len(distance) - 1, 1, toward.shape[2]))
    return _Obstacle(distance, toward[:-1], distance[:-1], toward[:-1], rest, rest, rest)


def _directed(way: Array) -> tuple[Array, Array]:
    """Length [m] and unit vector of ways (..., dimension), +x where a way is zero."""
    length = np.linalg.norm(way, axis=-1)
    first_axis = np.eye(way.shape[-1])[0]
    far = length[..., None] > CENTRED
    return length, np.where(far, way / np.where(far, length[..., None], 1.0), first_axis)


def _nearest_on_axis(capsule: Capsule, places: Array) -> Array:
    """The point of the capsule's axis that is nearest to each place (..., dimension) [m]."""
    start = np.asarray(capsule.start)
    along = np.asarray(capsule.end) - start
    share = np.clip((places - start) @ along / max(along @ along, CENTRED**2), 0, 1)
    return np.asarray(start + share[..., None] * along)


def _walls(loop: _Loop, task: TaskInfo) -> list[tuple[_Obstacle, Array]]:
    """The walls of a task, and the distance s that each wants [m]; none where they are not for points of interest."""
    if not _of_interest(loop.run, loop.rollout, task):
        return []
    walls = zip(*(loop.run.values[f"{task.name}_{key}"] for key in ("normal", "offset", "margin")), strict=True)
    return [(_half_space(n, float(o), loop.places), s) for n, o, s in walls]


def _of_interest(run: Run, rollout: Rollout, task: TaskInfo) -> bool:
    """Whether a task's walls are for the points of interest, as they are unless it names frames."""
    if not rollout.manifest.points:
        return False
    places = run.controller.kinematics(q=rollout.q[0])["point_position"]
    normals, offsets = run.values[f"{task.name}_normal"], run.values[f"{task.name}_offset"]
    there = rollout.signals[f"{task.name}_distance"][0]  # (walls, points)
    expected = normals @ places.T - offsets[:, None]
    return there.shape == expected.shape and np.allclose(there, expected, rtol=0, atol=ROUNDING)


# ---- Rows, and what follows from them ----


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """A row of the barrier for every point or joint over time; (N, points) where nothing else is said.

    The closing speed is what the row allows and what it does not know: closing = allowed + velocity + direction.
    """

    clearance: Array  # h (N + 1, points) [m]
    known: Array  # h', what the row knows of h [m]
    closing: Array  # û·(J_r w − ȯ) [m/s]
    allowed: Array  # û'·(J_r w − μ v̂), by the row at most g h' + με [m/s]
    velocity: Array  # û'·(μ v̂ − ȯ) [m/s]
    direction: Array  # (û − û')·(J_r w − ȯ) [m/s]
    curvature: Array  # κ_r [m/s²]
    acceleration: Array  # κ_o [m/s²]


def _row(loop: _Loop, obstacle: _Obstacle, wanted: Array) -> _Row:
    """The row of every point and an obstacle, from which they keep the distances `wanted` s [m]."""
    relative, told = loop.velocities - obstacle.velocity, loop.share[:, :, None] * obstacle.fed
    return _Row(
        clearance=obstacle.distance - wanted,
        known=obstacle.sensed_distance - wanted,
        closing=_dot(obstacle.toward, relative),
        allowed=_dot(obstacle.sensed_toward, loop.velocities - told),
        velocity=_dot(obstacle.sensed_toward, told - obstacle.velocity),
        direction=_dot(obstacle.toward - obstacle.sensed_toward, relative),
        curvature=_dot(obstacle.toward, loop.bends),
        acceleration=-_dot(obstacle.toward, obstacle.acceleration),
    )


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """What follows from a row."""

    clearance: Array  # h (N + 1, points)
    bound: Array  # m_k (N + 1, points)
    terms: dict[str, Array]  # of m, the greatest of each, (points,)
    unreported: Array  # (points,)


def _pair(loop: _Loop, task: TaskInfo, row: _Row) -> _Pair:
    """The recursion of the theory for every point: what is not known counts where it harms."""
    g = loop.share * float(loop.run.values[f"{task.name}_rate"])
    reported = loop.share * loop.rollout.signals["barrier_excess"][:, None]
    violated = row.allowed - g * row.known
    worst = {
        "curvature": np.maximum(row.curvature, 0.0),
        "acceleration": np.maximum(row.acceleration, 0.0),
        "velocity": np.maximum(row.velocity, 0.0),
        "position": np.maximum(row.known - row.clearance[:-1], 0.0),
        "direction": np.maximum(row.direction, 0.0),
        "excess": np.clip(violated, 0.0, reported + KEPT),
        "speed": np.maximum(row.closing.max(axis=0), 0.0),
    }
    terms = margin_terms(g, loop.run.period, **worst)
    bound = _recursion(row.clearance[0], g * loop.run.period, sum(terms.values(), np.zeros(())))
    most = {name: np.max(values, axis=0) for name, values in terms.items()}
    return _Pair(row.clearance, bound, most, np.maximum(violated - reported, 0.0).max(axis=0))


def _recursion(start: Array, decay: Array, settled: Array) -> Array:
    """m_k (N + 1, points) from h_0 (points,), gT (N, 1) and what m would be with the κ and c of each step (N, points).

    m⁺ = (1 − gT) m + gT m(κ, c), which is T c + T²κ/2, and m(κ, c) alone for gT > 1.
    """
    bound = np.empty((len(settled) + 1, len(start)))
    bound[0] = np.maximum(-start, 0.0)
    for k, (share, m) in enumerate(zip(np.minimum(decay, 1.0), settled, strict=True)):
        bound[k + 1] = (1 - share) * bound[k] + share * m
    return bound


def _of_points(loop: _Loop, task: TaskInfo, rows: Sequence[_Row]) -> list[Kept]:
    names = [(point.name, "m") for point in loop.rollout.manifest.points]
    return _merged(task, names, [_pair(loop, task, row) for row in rows], are_points=True)


def _of_joints(loop: _Loop, task: TaskInfo) -> list[Kept]:
    """Joint limits, linear in q: no curvature; a joint comes back from beyond no faster than its velocity limit."""
    joints = loop.rollout.manifest.joints
    limited = [i for i, joint in enumerate(joints) if joint.lower is not None]
    lower, upper, wanted = (loop.run.values[f"{task.name}_{key}"] for key in ("lower", "upper", "margin"))
    q, w = loop.rollout.q[:, limited], loop.rollout.dq[:, limited]
    slowest = -velocity_limits(loop.run)[limited] / float(loop.run.values[f"{task.name}_rate"])
    none = np.zeros_like(w)
    rows = [
        _Row(h, np.maximum(h[:-1], slowest), closing, closing, none, none, none, none)
        for h, closing in ((q - lower - wanted, -w), (upper - q - wanted, w))
    ]
    names = [(joints[i].name, joints[i].unit) for i in limited]
    return _merged(task, names, [_pair(loop, task, row) for row in rows], are_points=False)


def _merged(
    task: TaskInfo, names: Sequence[tuple[str, str]], pairs: Sequence[_Pair], *, are_points: bool
) -> list[Kept]:
    """Of each point or joint, by its name and unit, the worst over all its pairs."""
    if not pairs:
        return []
    clearance, bound = (np.array([getattr(pair, name) for pair in pairs]) for name in ("clearance", "bound"))
    nearest = np.argmin(clearance, axis=0)[None]  # (1, N + 1, points)
    h, m = (np.take_along_axis(values, nearest, axis=0)[0] for values in (clearance, bound))
    return [
        Kept(
            task=task.name,
            name=name,
            is_point=are_points,
            unit=unit,
            clearance=h[:, i],
            bound=m[:, i],
            slack=np.min(clearance[:, :, i] + bound[:, :, i], axis=0),
            margin=greatest(
                [Margin(**{term: float(values[i]) for term, values in pair.terms.items()}) for pair in pairs]
            ),
            unreported=max(float(pair.unreported[i]) for pair in pairs),
        )
        for i, (name, unit) in enumerate(names)
    ]
