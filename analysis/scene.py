"""What there is to see of a rollout, in space and over time, whatever draws it: all places in the world, in metres.

K moments of the rollout's N steps; a planar robot lies in the plane z = 0.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import FAR, FrameInfo, Manifest
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SHORTEST = 1e-6  # [m] a piece of the robot that never gets longer than this is none
RIGID = 1e-6  # [m, 1] what moves less than this against a link is fixed to it
THICKNESS = 0.025  # half the thickness of a link, as a share of the robot's reach


@dataclass(frozen=True, slots=True, eq=False)
class Segment:
    """A straight piece of the robot: from the origin of the link that carries `link` to its own."""

    link: str
    start: Array  # (K, 3)
    end: Array  # (K, 3)

    @property
    def length(self) -> Array:
        """How long it is, (K,) [m]."""
        norm: Array = np.linalg.norm(self.end - self.start, axis=1)
        return norm


@dataclass(frozen=True, slots=True, eq=False)
class Outline:
    """The polygon that a link is drawn as, where its spec has one."""

    link: str
    corners: Array  # (K, vertices, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Capsule:
    """All points within `radius` [m] of the line from start to end; a ball where both are one point."""

    name: str
    start: Array  # (K, 3)
    end: Array  # (K, 3)
    radius: float

    @property
    def is_ball(self) -> bool:
        """Whether start and end are one point."""
        return bool(np.all(self.start == self.end))


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The influence region of a point of interest, and whether it met an obstacle at a moment or since the last."""

    name: str
    center: Array  # (K, 3)
    radius: float
    touched: Flags  # (K,)


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """The half-space of all points p with normalᵀp <= offset [m]."""

    name: str
    normal: Array  # (3,)
    offset: float

    def patch(self, center: Array, half: float) -> Array:
        """A square of the wall's surface below `center` (3,), with sides of 2·`half` [m]: its corners (4, 3)."""
        foot = center - (self.normal @ center - self.offset) * self.normal
        first = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        first /= np.linalg.norm(first)
        second = np.cross(self.normal, first)
        sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        corners: Array = foot + half * sides @ np.stack([first, second])
        return corners


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Where a frame should be and where it was, at every step."""

    task: str
    commanded: Array  # (N, 3)
    traced: Array  # (N, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Triad:
    """How a frame should be turned and how it was: world_R_frame, at the place where it was."""

    task: str
    origin: Array  # (K, 3)
    commanded: Array  # (K, 3, 3)
    actual: Array  # (K, 3, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """A place that a frame looks at."""

    task: str
    place: Array  # (K, 3)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorTrace:
    """The norm of the error of a task that has to follow a reference, over time."""

    name: str
    unit: str  # m or rad
    norm: Array  # (N,)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All there is to see of one case."""

    title: str
    t: Array  # (N,) [s]
    steps: NDArray[np.intp]  # (K,), the steps of the moments
    thickness: float  # half that of a link [m]
    segments: tuple[Segment, ...]
    outlines: tuple[Outline, ...]
    joints: Array  # the axes of the turning joints, (K, joints, 3)
    bodies: tuple[Capsule, ...]
    regions: tuple[Region, ...]
    obstacles: tuple[Capsule, ...]
    walls: tuple[Wall, ...]
    paths: tuple[Path, ...]
    triads: tuple[Triad, ...]
    targets: tuple[Target, ...]
    lam: Array  # (N,)
    errors: tuple[ErrorTrace, ...]
    clearance: Array | None  # (N,) [m]; None without obstacles
    active: Flags  # (N,), whether some influence region met an obstacle

    @property
    def moments(self) -> Array:
        """When the K moments are, (K,) [s]."""
        return self.t[self.steps]

    def places(self) -> Array:
        """Points whose box holds the robot, its bodies, the obstacles and the paths, (any, 3)."""
        every = [self.joints.reshape(-1, 3)]
        every += [end for segment in self.segments for end in (segment.start, segment.end)]
        every += [outline.corners.reshape(-1, 3) for outline in self.outlines]
        every += [path for each in self.paths for path in (each.commanded, each.traced)]
        every += [target.place for target in self.targets]
        for capsule in (*self.bodies, *self.obstacles):
            every += [end + side * capsule.radius for end in (capsule.start, capsule.end) for side in (-1.0, 1.0)]
        return np.concatenate(every)


def even_steps(rollout: Rollout, count: int) -> NDArray[np.intp]:
    """`count` steps from the first to the last one, evenly spaced; fewer in a shorter rollout."""
    return np.unique(np.linspace(0, len(rollout.t) - 1, max(count, 2)).astype(np.intp))


def scene(controller: CompiledController, rollout: Rollout, steps: Sequence[int] | NDArray[np.intp]) -> Scene:
    """What there is to see of a rollout on `controller` at the given steps, which increase."""
    chosen = np.asarray(steps, dtype=np.intp)
    manifest = controller.manifest
    # Link poses and points depend on q alone, so that further inputs (a target to look at) keep their defaults.
    seen = controller.kinematics.map(len(chosen), {"q": rollout.q[chosen]})
    pose = seen["link_pose"]  # (K, links, 3, 4), [R | p] of world_T_link
    paths = tuple(_paths(controller, rollout))
    pieces = tuple(_segments(manifest, pose))
    turning = [link for joint, link in zip(manifest.joints, manifest.joint_links, strict=True) if joint.unit == "rad"]
    clearance = rollout.signals.get("clearance")
    return Scene(
        title=f"Case {rollout.case.number}: {rollout.title}",
        t=rollout.t,
        steps=chosen,
        thickness=THICKNESS * _reach(manifest, pieces),
        segments=pieces,
        outlines=tuple(
            Outline(link.name, _fixed_to(pose[:, i], np.array(link.outline)))
            for i, link in enumerate(manifest.links)
            if link.outline
        ),
        joints=pose[..., 3][:, turning],
        bodies=tuple(_bodies(manifest, pose)),
        regions=tuple(_regions(manifest, rollout, seen, chosen)),
        obstacles=tuple(_obstacles(rollout, chosen)),
        walls=tuple(
            Wall(f"half_space_{i}", _in_space(np.array(wall.normal)), wall.offset)
            for i, wall in enumerate(rollout.scenario.half_spaces)
        ),
        paths=paths,
        triads=tuple(_triads(controller, rollout, chosen)),
        targets=tuple(
            Target(one.task, _in_space(rollout.scenario.references[one.name].sample(rollout.t[chosen])[0]))
            for one in manifest.references
            if _task_kind(manifest, one.task) == "look_at" and one.name in rollout.scenario.references
        ),
        lam=rollout.signals["lam"],
        errors=tuple(_errors(controller, rollout)),
        clearance=clearance if clearance is not None and np.min(clearance) < FAR / 2 else None,
        active=rollout.active,
    )


def _in_space(places: Array) -> Array:
    """Places (..., 2 or 3) with their third coordinate, zero in the plane, (..., 3)."""
    missing = 3 - places.shape[-1]
    return np.concatenate([places, np.zeros((*places.shape[:-1], missing))], axis=-1)


def _fixed_to(pose: Array, offsets: Array) -> Array:
    """Where points at `offsets` (n, 3) of a link with pose (K, 3, 4) are, (K, n, 3)."""
    places: Array = offsets @ pose[:, :, :3].swapaxes(1, 2) + pose[:, None, :, 3]
    return places


# The robot.


def _segments(manifest: Manifest, pose: Array) -> Iterator[Segment]:
    """From every link's parent to the link, and from the links to the tracked frames that they carry."""
    names = [link.name for link in manifest.links]
    on_wheels = _gliding(manifest)
    for i, link in enumerate(manifest.links):
        root = np.zeros_like(pose[:, i, :, 3])
        start = pose[:, names.index(link.parent), :, 3] if link.parent in names else root
        segment = Segment(link.name, start, pose[:, i, :, 3])
        if link.name not in on_wheels and np.max(segment.length) > SHORTEST:
            yield segment
    for task in manifest.tracking_tasks:
        if task.frame and task.frame.link in names:
            link_pose = pose[:, names.index(task.frame.link)]
            segment = Segment(task.frame.link, link_pose[:, :, 3], _place(task.frame, manifest, pose))
            if np.max(segment.length) > SHORTEST:
                yield segment


def _place(frame: FrameInfo, manifest: Manifest, pose: Array) -> Array:
    """Where a frame is, (K, 3) [m], for link poses (K, links, 3, 4)."""
    names = [link.name for link in manifest.links]
    root = np.tile(np.eye(3, 4), (len(pose), 1, 1))
    link = pose[:, names.index(frame.link)] if frame.link in names else root
    return _fixed_to(link, np.array([frame.xyz]))[:, 0]


def _gliding(manifest: Manifest) -> set[str]:
    """The links of a base that slides in two directions or more before anything turns: no pole leads to them."""
    types = {joint.link: joint.type for joint in manifest.joints}
    names = {link.name for link in manifest.links}
    ways: dict[str, tuple[str, ...]] = {}  # link -> the links from the root to it, where nothing turns on the way
    for link in manifest.links:
        if types.get(link.name, "prismatic") == "prismatic" and (link.parent in ways or link.parent not in names):
            ways[link.name] = (*ways.get(link.parent, ()), link.name)
    return {link for way in ways.values() if sum(link in types for link in way) >= 2 for link in way}


def _reach(manifest: Manifest, segments: Sequence[Segment]) -> float:
    """The longest way along the robot from its base to an end [m]."""
    lengths = {segment.link: float(np.max(segment.length)) for segment in reversed(segments)}
    along: dict[str, float] = {}
    for link in manifest.links:
        along[link.name] = along.get(link.parent, 0.0) + lengths.get(link.name, 0.0)
    return max([*along.values(), *lengths.values(), SHORTEST])


def _bodies(manifest: Manifest, pose: Array) -> Iterator[Capsule]:
    names = [link.name for link in manifest.links]
    root = np.tile(np.eye(3, 4), (len(pose), 1, 1))
    for body in manifest.bodies:
        link = pose[:, names.index(body.link)] if body.link in names else root
        ends = _fixed_to(link, np.array([body.start, body.end]))
        yield Capsule(body.name, ends[:, 0], ends[:, 1], body.radius)


def _regions(manifest: Manifest, rollout: Rollout, seen: dict[str, Array], steps: NDArray[np.intp]) -> Iterator[Region]:
    """Contact may switch from step to step: to look at the moments alone would draw lots."""
    if "influence_radius" not in rollout.parameters:
        return
    radius = rollout.parameters["influence_radius"]
    touching = rollout.signals["distance"] <= radius  # (N, points)
    before = [-1, *steps[:-1]]
    touched = np.array([touching[b + 1 : k + 1].any(axis=0) for b, k in zip(before, steps, strict=True)])
    center = _in_space(seen["point_position"])
    for i, point in enumerate(manifest.points):
        yield Region(point.name, center[:, i], float(radius[i]), touched[:, i])


# What is around it, and what it should do.


def _obstacles(rollout: Rollout, steps: NDArray[np.intp]) -> Iterator[Capsule]:
    for i, radius in enumerate(rollout.obstacle_radius):
        center = _in_space(rollout.obstacle_center[steps, i])
        yield Capsule(f"obstacle_{i}", center, center, float(radius))
    for i, capsule in enumerate(rollout.scenario.capsules):
        start, end = (np.tile(_in_space(np.array(one)), (len(steps), 1)) for one in (capsule.start, capsule.end))
        yield Capsule(f"capsule_{i}", start, end, capsule.radius)


def _paths(controller: CompiledController, rollout: Rollout) -> Iterator[Path]:
    """Of every tracked frame; where a task holds some axes only, what is commanded follows the frame along the rest."""
    manifest = controller.manifest
    pose = controller.kinematics.map(len(rollout.t), {"q": rollout.q[:-1]})["link_pose"]
    for task in manifest.tracking_tasks:
        if task.frame:
            traced = _place(task.frame, manifest, pose)
            commanded = traced.copy()
            commanded[:, list(task.axes)] = rollout.scenario.references[task.name].sample(rollout.t)[0]
            yield Path(task.name, commanded, traced)


def _triads(controller: CompiledController, rollout: Rollout, steps: NDArray[np.intp]) -> Iterator[Triad]:
    """At the frame whose orientation follows a reference."""
    manifest = controller.manifest
    pose = controller.kinematics.map(len(steps), {"q": rollout.q[steps]})["link_pose"]
    frames = {task.name: task.frame for task in manifest.tasks}
    for reference in manifest.references:
        frame = frames[reference.task]
        if reference.space != "rotation" or frame is None or reference.name not in rollout.scenario.references:
            continue
        commanded = _matrices(rollout.scenario.references[reference.name].sample(rollout.t[steps])[0])
        actual = _matrices(rollout.signals[f"{reference.task}_orientation"][steps])
        yield Triad(reference.task, _place(frame, manifest, pose), commanded, actual)


def _matrices(quaternions: Array) -> Array:
    """Rotation matrices (K, 3, 3) of quaternions (w, x, y, z), (K, 4)."""
    return np.asarray(Rotation.from_quat(quaternions, scalar_first=True).as_matrix())


def _errors(controller: CompiledController, rollout: Rollout) -> Iterator[ErrorTrace]:
    """Of every reference that had to be given: what is wrong in metres or radians."""
    manifest = controller.manifest
    units = {signal.name: signal.unit for signal in manifest.function("step").outputs}
    for reference in manifest.references:
        name = f"{reference.name}_error"
        if reference.required and units.get(name) in ("m", "rad"):
            error = rollout.signals[name].reshape(len(rollout.t), -1)
            yield ErrorTrace(reference.name, units[name], np.linalg.norm(error, axis=1))


def _task_kind(manifest: Manifest, name: str) -> str:
    return next(task.kind for task in manifest.tasks if task.name == name)
