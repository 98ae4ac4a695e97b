"""The robot, its influence regions and its obstacles, as shapes in the plane that figures and animation share."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from numpy.typing import NDArray

from clikgen.analysis.metrics import encounters
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]

# One meaning per colour in every picture: Okabe & Ito, and for the joints Tol's muted scheme, which stay apart
# for colour-blind readers. Commanded is always dashed, traced always solid.
COMMANDED = "#111111"
TRACED = "#0072B2"
ERROR = "#D55E00"
CONTACT = "#E69F00"
REGION = "#56B4E9"
OBSTACLE = "#8C8C8C"
ROBOT = "#DCE3EA"
ROBOT_EDGE = "#8794A1"
LAM = "#AA4499"
QUIET = "#666666"
JOINTS = ("#332288", "#CC6677", "#117733", "#999933", "#882255", "#44AA99", "#DDCC77", "#88CCEE")

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 10.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 10.0,
    "xtick.labelsize": 9.0,
    "ytick.labelsize": 9.0,
    "legend.fontsize": 9.0,
    "legend.frameon": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": QUIET,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}
"""The matplotlib settings that every picture is drawn with, whatever the user's own are."""

SHORTEST = 5  # steps; less is no motion to draw
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)
_CIRCLE_POINTS = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)  # (72, 2)
_BAR = 0.02  # half the width of a link without outline, as a share of the robot's length


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """A rectangle of the plane [m]."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def aspect(self) -> float:
        """Width over height."""
        return (self.right - self.left) / (self.top - self.bottom)

    def square(self) -> "Extent":
        """The smallest square around the same middle that holds it."""
        x, y = 0.5 * (self.left + self.right), 0.5 * (self.bottom + self.top)
        half = 0.5 * max(self.right - self.left, self.top - self.bottom)
        return Extent(x - half, x + half, y - half, y + half)

    def apply(self, axes: Axes) -> None:
        """Show this rectangle and nothing else, one metre as long across as up."""
        axes.set(xlim=(self.left, self.right), ylim=(self.bottom, self.top))
        axes.set_aspect("equal", adjustable="box")


@dataclass(frozen=True, slots=True, eq=False)
class Poses:
    """Where the robot was at K moments, seen along the third axis [m]."""

    links: tuple[Array, ...]  # a polygon per drawn link, each (K, vertices, 2)
    joints: Array  # the axes of the revolute joints, (K, revolute joints, 2)
    points: Array  # the points of interest, (K, points, 2)
    tip: Array  # the tracked frame, (K, 2)

    def polygons(self, k: int) -> list[Array]:
        """The link polygons at moment k, each (vertices, 2)."""
        return [link[k] for link in self.links]

    def places(self, radii: Array) -> Array:
        """All corners of links, and of squares around discs of `radii` (points,) at the points, (any, 2) [m]."""
        corners = [link.reshape(-1, 2) for link in self.links]
        if radii.size:
            corners += [(self.points + side * radii[:, None]).reshape(-1, 2) for side in (-1.0, 1.0)]
        return np.concatenate(corners)


def require_drawable(rollouts: Mapping[int, Rollout]) -> None:
    """Raises BadInput for rollouts of a few steps only, or that left every bound."""
    for number, rollout in rollouts.items():
        if len(rollout.t) < SHORTEST:
            raise BadInput(f"case {number}: wanted {SHORTEST} steps or more to draw, got {len(rollout.t)}")
        if rollout.diverged is not None:
            raise BadInput(f"case {number}: diverged at t = {rollout.diverged:g} s, nothing to draw")


def poses(controller: CompiledController, rollout: Rollout, steps: Sequence[int]) -> Poses:
    """The robot of a rollout at the given steps."""
    manifest = controller.manifest
    pose = np.empty((len(steps), len(manifest.links), 3, 4))  # [R | p] of world_T_link
    points, tip = np.empty((len(steps), len(manifest.points), 2)), np.empty((len(steps), 2))
    for i, k in enumerate(steps):
        outputs = controller.kinematics(q=rollout.q[k])
        pose[i], tip[i] = outputs["link_pose"], outputs[f"{rollout.tracked}_position"][:2]
        if manifest.points:
            points[i] = outputs["point_position"][:, :2]
    moved = zip(manifest.joints, manifest.joint_links, strict=True)
    turning = [link for joint, link in moved if joint.unit == "rad"]
    return Poses(_link_polygons(manifest, pose, tip), pose[..., :2, 3][:, turning], points, tip)


def _link_polygons(manifest: Manifest, pose: Array, tip: Array) -> tuple[Array, ...]:
    """The outlines of the links, (K, vertices, 2) each; bars from link to link where the spec has none."""
    drawn = [(i, np.array(link.outline)) for i, link in enumerate(manifest.links) if link.outline]
    if drawn:
        return tuple(outline @ pose[:, i, :2, :3].swapaxes(1, 2) + pose[:, i, None, :2, 3] for i, outline in drawn)
    names = [link.name for link in manifest.links]
    held = manifest.tracking_tasks[0].frame
    ends = [
        (names.index(link.parent), pose[:, i, :2, 3]) for i, link in enumerate(manifest.links) if link.parent in names
    ]
    ends += [(names.index(held.link), tip)] if held and held.link in names else []
    start = np.stack([pose[:, i, :2, 3] for i, _ in ends], axis=1)  # (K, bars, 2)
    end = np.stack([place for _, place in ends], axis=1)
    along = end - start
    length = np.linalg.norm(along, axis=2, keepdims=True)
    across = along[..., ::-1] * [-1, 1] * (_BAR * length.sum(axis=1, keepdims=True) / np.maximum(length, 1e-9))
    bars = np.stack([start + across, end + across, end - across, start - across], axis=2)  # (K, bars, 4, 2)
    return tuple(bars.swapaxes(0, 1))


def influence_radii(rollout: Rollout) -> Array:
    """Influence radius s of every point of interest, (points,) [m]; none where nothing is sensed."""
    for signal in rollout.manifest.function("step").inputs:
        if signal.name == "influence_radius":
            given = rollout.scenario.parameters.get(signal.name, signal.default)
            return signal.value(given, f"{rollout.scenario.name}: parameters.{signal.name}")
    return np.zeros(0)


def tracked_radius(rollout: Rollout, at: Poses) -> float | None:
    """Influence radius s of the point of interest that sits on the tracked frame [m], if one does."""
    radii = influence_radii(rollout)
    there = np.flatnonzero(np.all(np.linalg.norm(at.points - at.tip[:, None], axis=2) < 1e-9, axis=0))
    return float(radii[there[0]]) if there.size and radii.size else None


def circles(center: Array, radius: Array) -> Array:
    """Discs of `radius` (n,) around `center` (n, 2 or more) as polygons, (n, vertices, 2) [m]."""
    polygons: Array = center[:, None, :2] + radius[:, None, None] * _CIRCLE_POINTS
    return polygons


def add_robot(axes: Axes, alpha: float = 1.0) -> PolyCollection:
    """The links of a robot, still without a place: give it `Poses.polygons` with `set_verts`."""
    links = PolyCollection([], facecolors=ROBOT, edgecolors=ROBOT_EDGE, linewidths=0.8, alpha=alpha, zorder=2)
    axes.add_collection(links, autolim=False)
    return links


def add_obstacles(axes: Axes, center: Array, radius: Array, alpha: float = 1.0) -> PolyCollection:
    """Obstacles at `center` (n, 2 or more) as discs of `radius` (n,) [m]; a point is drawn as a dot."""
    obstacles = PolyCollection(
        list(discs(center, radius)), facecolors=OBSTACLE, edgecolors="black", linewidths=0.8, alpha=alpha, zorder=3
    )
    axes.add_collection(obstacles, autolim=False)
    return obstacles


def discs(center: Array, radius: Array) -> Array:
    """The polygons of obstacles, (n, vertices, 2) [m]; a point gets a few millimetres, or it would vanish."""
    return circles(center, np.maximum(radius, 6e-3))


def extent(rollouts: Iterable[Rollout], influence: float = 0.0, places: Iterable[Array] = ()) -> Extent:
    """The rectangle that holds every case: paths, obstacles with `influence` [m] around, and `places` (n, 2)."""
    every = list(places)
    for rollout in rollouts:
        every += [rollout.reference[:, :2], rollout.position[:, :2]]
        for i, radius in enumerate(rollout.obstacle_radius):
            every += [rollout.obstacle_center[:, i, :2] + side * (radius + influence) for side in (-1.0, 1.0)]
    return around(np.concatenate(every), 0.025)


def around(places: Array, margin: float) -> Extent:
    """The rectangle that holds `places` (n, 2), with a margin in shares of its longer side."""
    low, high = places.min(axis=0), places.max(axis=0)
    wider = margin * float(np.max(high - low)) + 1e-3
    return Extent(low[0] - wider, high[0] + wider, low[1] - wider, high[1] + wider)


def joint_colour(index: int) -> str:
    """The colour of joint `index`."""
    return JOINTS[index % len(JOINTS)]


def telling_joints(rollouts: Mapping[int, Rollout]) -> list[int]:
    """Two joints of one kind, or one: whose velocity varies most in the first case, and jumps most in the last."""
    every = list(rollouts.values())
    joints = every[0].manifest.joints
    liveliest = int(np.argmax(variation(every[0])))
    jump = np.abs(np.diff(every[-1].dq, axis=0)).max(axis=0)
    alike = [i for i, joint in enumerate(joints) if joint.unit == joints[liveliest].unit]
    return sorted({liveliest, max(alike, key=lambda i: float(jump[i]))})


def variation(rollout: Rollout) -> Array:
    """Total variation of the velocity of every joint, (n,): the larger, the more of a picture it covers."""
    total: Array = np.abs(np.diff(rollout.dq, axis=0)).sum(axis=0)
    return total


def covering_first(rollout: Rollout, joints: Iterable[int]) -> list[int]:
    """The joints in the order to draw their velocities in, so that the one hides nothing of the other."""
    total = variation(rollout)
    return sorted(joints, key=lambda i: -float(total[i]))


def value_range(values: Sequence[Array]) -> tuple[float, float]:
    """One range for all of the arrays, with a margin, so that the cases compare."""
    filled = [value for value in values if value.size]
    low = min((float(value.min()) for value in filled), default=-1.0)
    high = max((float(value.max()) for value in filled), default=1.0)
    margin = 0.06 * (high - low) + 1e-6
    return low - margin, high + margin


def shade(axes: Axes, spans: Sequence[tuple[float, float]]) -> None:
    """Mark the times of contact, each from and to [s], over the whole height of the axes."""
    bars = [(start, end - start) for start, end in spans]
    axes.broken_barh(
        bars,
        (0.0, 1.0),
        transform=axes.get_xaxis_transform(),
        facecolors=CONTACT,
        alpha=0.25,
        linewidth=0,
        zorder=0,
    )


def encounter_times(rollout: Rollout) -> list[tuple[float, float]]:
    """From and to [s] of every encounter."""
    return [(begin * rollout.period, end * rollout.period) for begin, end in encounters(rollout)]


def ignore(message: str) -> None:
    """Progress that nobody watches."""
