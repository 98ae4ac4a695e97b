"""What every candidate is given: two robots, each along a path and in states at random."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledController

Array = NDArray[np.float64]
HERE = Path(__file__).parent
STEPS = 2000  # of a path
RANDOM = 2048  # states at random

CENTERS = np.array([[0.80, 0.93], [-1.22, 0.0], [0.20, -0.75]])  # [m] of planar5.urdf's obstacles
RADII = np.array([0.12, 0.15, 0.10])
INFLUENCE = np.array([0.25, 0.25, 0.15, 0.15, 0.15, 0.15])  # s of planar5's points of interest [m]
HOME = np.array([0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4])  # arm7's posture

PLANAR5 = ("tool_reference", "tool_reference_velocity", "obstacle_center")
ARM7 = (
    "hand_reference",
    "hand_reference_velocity",
    "hand_orientation_reference",
    "hand_orientation_reference_velocity",
)


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """Steps to take: q (count, n) and what else a step is given, input name -> (count, *shape), in C's order.

    Along a path q is where our own loop is, and only the first one is given to a candidate: it goes on by itself.
    """

    q: Array
    given: Mapping[str, Array]

    @property
    def rows(self) -> Array:
        """What is given, a row a step: (count, width)."""
        return np.hstack([value.reshape(len(value), -1) for value in self.given.values()])

    def items(self) -> list[tuple[Array, ...]]:
        """What is given, a tuple a step."""
        return list(zip(*self.given.values(), strict=True))


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """A robot with our controller for it, its tool frame, and what there is to do."""

    name: str
    urdf: Path
    tool: str
    controller: CompiledController
    path: Work
    random: Work

    def positions(self, q: Array) -> Array:
        """Where the tool is at each of q (count, n): (count, 3) [m], z = 0 in the plane."""
        found = self.controller.kinematics.map(len(q), {"q": q})[f"{self._task}_position"]
        return np.pad(found, ((0, 0), (0, 3 - found.shape[1])))

    def distances(self, q: Array) -> Array:
        """The least d − s of the points of interest to the obstacles of the path, at each of q: (count,) [m]."""
        points = self.controller.kinematics.map(len(q), {"q": q})["point_position"]
        away = np.linalg.norm(CENTERS - points[:, :, None], axis=-1) - RADII  # (count, points, obstacles)
        return (away.min(axis=2) - INFLUENCE).min(axis=1)

    def targets(self) -> list[tuple[Array, Array]]:
        """The path as positions (3,) and rotations (3, 3) of the tool."""
        given = self.path.given
        places = given[f"{self._task}_reference"]
        places = np.pad(places, ((0, 0), (0, 3 - places.shape[1])))
        if self.name == "planar5":
            return [(place, np.eye(3)) for place in places]
        return list(zip(places, map(rotation, given["hand_orientation_reference"]), strict=True))

    @property
    def _task(self) -> str:
        return "tool" if self.name == "planar5" else "hand"


def robots(folder: Path) -> Iterator[Robot]:
    """Both robots; planar5 as it ships, arm7 generated into the folder."""
    planar5 = CompiledController.load("planar5")
    planar5.step.inputs["obstacle_radius"][...] = RADII
    planar5.step.inputs["obstacle_count"][...] = len(RADII)
    fixed = {"obstacle_radius": RADII, "obstacle_count": float(len(RADII))}
    path = followed(planar5, planar5_start(), planar5_path(), fixed)
    yield Robot("planar5", HERE / "planar5.urdf", "point_6", planar5, path, planar5_random(planar5))
    arm7 = CompiledController.load(folder / "arm7")
    urdf = HERE.parents[1] / "symbolic" / "specs" / "robots" / "panda7.urdf"
    path = followed(arm7, HOME, arm7_path(arm7), {})
    yield Robot("arm7", urdf, "hand_tcp", arm7, path, arm7_random(arm7))


def followed(controller: CompiledController, start: Array, given: dict[str, Array], fixed: dict[str, object]) -> Work:
    """The path as our own loop goes along it."""
    rollout = controller.rollout(STEPS, {"q": start, **given, **fixed})
    return Work(rollout["q"][:-1], given)


def planar5_start() -> Array:
    """The tool at (1, 0), where its path begins."""
    q = np.array([0.0, 0.0, 0.0, 0.6, -0.9])
    q[0] = 1 - (0.2 + 0.5 * np.cos(0.6) + 0.4 * np.cos(-0.3))
    q[1] = -(0.5 * np.sin(0.6) + 0.4 * np.sin(-0.3))
    return q


def planar5_path() -> dict[str, Array]:
    """A circle of 1 m in 20 s, past three obstacles."""
    rate = 2 * np.pi / (STEPS * 0.01)
    angle = rate * 0.01 * np.arange(STEPS)
    place = np.column_stack([np.cos(angle), np.sin(angle)])
    velocity = rate * np.column_stack([-np.sin(angle), np.cos(angle)])
    return dict(zip(PLANAR5, (place, velocity, np.broadcast_to(CENTERS, (STEPS, 3, 2)).copy()), strict=True))


def planar5_random(controller: CompiledController) -> Work:
    """Joint positions and references at random, each obstacle at 0.5 to 4 s from one of the points."""
    rng = np.random.default_rng(5)
    q = rng.uniform([-1, -1, -np.pi, -2.8, -2.8], [1, 1, np.pi, 2.8, 2.8], (RANDOM, 5))
    points = controller.kinematics.map(RANDOM, {"q": q})["point_position"]
    which = rng.integers(6, size=(RANDOM, 3))
    angle = rng.uniform(0, 2 * np.pi, (RANDOM, 3))
    reach = INFLUENCE[which] * rng.uniform(0.5, 4.0, (RANDOM, 3)) + RADII
    away = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * reach[..., None]
    centers = np.take_along_axis(points, which[..., None], axis=1) + away
    reference, velocity = rng.uniform(-2, 2, (RANDOM, 2)), rng.uniform(-1, 1, (RANDOM, 2))
    return Work(q, dict(zip(PLANAR5, (reference, velocity, centers), strict=True)))


def arm7_path(controller: CompiledController) -> dict[str, Array]:
    """A circle of 0.1 m in 4 s, the hand swinging by 0.3 rad about a fixed axis, from HOME on."""
    rate = 2 * np.pi / (STEPS * 0.002)
    angle = rate * 0.002 * np.arange(STEPS)
    home = controller.kinematics(q=HOME)
    center = home["hand_position"] - [0.0, 0.0, 0.1]
    place = center + 0.1 * np.column_stack([0 * angle, np.sin(angle), np.cos(angle)])
    velocity = 0.1 * rate * np.column_stack([0 * angle, np.cos(angle), -np.sin(angle)])
    axis = np.array([2.0, 1.0, 2.0]) / 3
    swing, turning = 0.3 * np.sin(angle), 0.3 * rate * np.cos(angle)[:, None] * axis
    turned = np.column_stack([np.cos(swing / 2), np.sin(swing / 2)[:, None] * axis])
    orientation = np.array([product(one, home["hand_orientation"]) for one in turned])
    return dict(zip(ARM7, (place, velocity, orientation, turning), strict=True))


def arm7_random(controller: CompiledController) -> Work:
    """Joint positions within the limits, references at random around where the hand is."""
    rng = np.random.default_rng(7)
    low, high = np.transpose(controller.manifest.limits)
    q = rng.uniform(low, high, (RANDOM, 7))
    place = controller.kinematics.map(RANDOM, {"q": q})["hand_position"] + rng.uniform(-0.3, 0.3, (RANDOM, 3))
    orientation = rng.normal(size=(RANDOM, 4))
    orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
    velocity, turning = rng.uniform(-0.5, 0.5, (RANDOM, 3)), rng.uniform(-1, 1, (RANDOM, 3))
    return Work(q, dict(zip(ARM7, (place, velocity, orientation, turning), strict=True)))


def product(p: Array, q: Array) -> Array:
    """Of two quaternions (w, x, y, z)."""
    vector = p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])
    return np.array([p[0] * q[0] - p[1:] @ q[1:], *vector])


def rotation(quaternion: Array) -> Array:
    """Its matrix (3, 3)."""
    w, v = quaternion[0], quaternion[1:]
    cross = np.cross(np.eye(3), -v)
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross
