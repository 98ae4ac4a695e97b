"""Obstacles, balls, capsules and half-spaces that may move, and what every point of interest senses of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Self

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import Document
from clikgen.runtime.manifest import FAR
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.distances import COINCIDENT, nearest_on_segment
from clikgen.symbolic.signals import Signal, symbol
from clikgen.symbolic.tree import KinematicTree, Push

UNROLLED = 64  # pairs of points and obstacles; more of them are looped over, as the code would outgrow the cache
Capacity = Annotated[int, Field(strict=True, ge=0, le=100)]


class ObstacleCapacity(Document):
    """How many obstacles the controller can hold at once: balls (`maximum`; discs in the plane), capsules, walls."""

    maximum: Capacity = 0
    capsules: Capacity = 0
    half_spaces: Capacity = 0

    @property
    def any(self) -> bool:
        """Whether there can be an obstacle at all."""
        return bool(self.maximum or self.capsules or self.half_spaces)


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """The signals that say where the obstacles are and how many of each kind there are."""

    dimension: int
    capacity: ObstacleCapacity
    signals: dict[str, Signal]

    @classmethod
    def up_to(cls, capacity: ObstacleCapacity, dimension: int) -> Self:
        """New symbols for as many obstacles as the controller can hold."""
        inputs: list[Signal] = []
        if capacity.maximum:
            inputs += [
                _points("obstacle_center", capacity.maximum, dimension, "obstacle centres o"),
                _radii("obstacle_radius", capacity.maximum, "obstacle radii; 0 is a point"),
                _count("obstacle_count", capacity.maximum),
            ]
        if capacity.capsules:
            inputs += [
                _points("capsule_start", capacity.capsules, dimension, "where the capsules' axes start"),
                _points("capsule_end", capacity.capsules, dimension, "where the capsules' axes end"),
                _radii("capsule_radius", capacity.capsules, "capsule radii; 0 is a segment"),
                _count("capsule_count", capacity.capsules),
            ]
        if capacity.half_spaces:
            shape, text = (capacity.half_spaces, dimension), "outward unit normals n of the half-spaces"
            inputs += [
                symbol("half_space_normal", shape, "1", text, "signal", (-1.0, 1.0)),
                symbol("half_space_offset", shape[:1], "m", "o: nᵀp <= o is inside", "signal", (-1e6, 1e6)),
                _count("half_space_count", capacity.half_spaces),
            ]
        return cls(dimension, capacity, {signal.info.name: signal for signal in inputs})

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The signals the controller has to be given."""
        return tuple(self.signals.values())

    @property
    def places(self) -> int:
        """How many obstacles there can be, of all kinds."""
        return self.capacity.maximum + self.capacity.capsules + self.capacity.half_spaces

    def closest(self, point: ca.SX) -> tuple[ca.SX, ca.SX]:
        """D and u of eqs. 8-9 for the closest obstacle to `point` (dimension, 1).

        d [m] is the distance to its surface, negative inside it and FAR without an obstacle; u (dimension, 1) is
        the unit vector toward its nearest point or axis, +x where the point sits on a centre or axis.
        """
        first_axis = ca.SX.eye(self.dimension)[:, 0]
        distance, toward, norm = ca.SX(FAR), first_axis, ca.SX(1)
        for there, distance_k, toward_k, norm_k in self._each(point):
            seen = ca.if_else(there, distance_k, FAR)
            closer = seen < distance
            distance = ca.if_else(closer, seen, distance)
            toward = ca.if_else(closer, toward_k, toward)
            norm = ca.if_else(closer, norm_k, norm)
        return distance, ca.if_else(norm > COINCIDENT, toward / norm, first_axis)

    def _each(self, point: ca.SX) -> Iterator[tuple[ca.SX, ca.SX, ca.SX, ca.SX]]:
        """Of every obstacle: whether it is there, its distance [m], a vector toward it and that vector's norm."""
        at = {name: signal.expression for name, signal in self.signals.items()}
        for k in range(self.capacity.maximum):
            toward = at["obstacle_center"][k, :].T - point
            norm = ca.sqrt(ca.sumsqr(toward))
            yield k < at["obstacle_count"], norm - at["obstacle_radius"][k], toward, norm
        for k in range(self.capacity.capsules):
            start, end = at["capsule_start"][k, :].T, at["capsule_end"][k, :].T
            toward = nearest_on_segment(start, end, point) - point
            norm = ca.sqrt(ca.sumsqr(toward))
            yield k < at["capsule_count"], norm - at["capsule_radius"][k], toward, norm
        for k in range(self.capacity.half_spaces):
            normal = at["half_space_normal"][k, :].T
            distance = ca.dot(normal, point) - at["half_space_offset"][k]
            yield k < at["half_space_count"], distance, -normal, ca.SX(1)


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The search for the closest obstacle as one small function called for each point, not unrolled for all.

    The contacts are then expressions of `distance` and `toward`, which that function fills in.
    """

    places: ca.SX  # (dimension, points) [m], of q
    closest: ca.Function  # a place and the obstacles -> d and u
    obstacles: tuple[Signal, ...]
    distance: ca.SX  # (1, points) symbols
    toward: ca.SX  # (dimension, points) symbols

    @classmethod
    def over(cls, obstacles: Obstacles, places: ca.SX) -> Self:
        """The loop over all `places` (dimension, points)."""
        dimension, points = places.shape
        place = ca.SX.sym("place", dimension)
        inputs = [place, *(signal.column for signal in obstacles.inputs)]
        closest = ca.Function("closest", inputs, ca.cse(list(obstacles.closest(place))))
        symbols = ca.SX.sym("distance", 1, points), ca.SX.sym("toward", dimension, points)
        return cls(places, closest, obstacles.inputs, *symbols)

    def run(self, places: ca.MX, obstacles: Sequence[ca.MX]) -> list[ca.MX]:
        """D (1, points) and u (dimension, points) for the values of places and obstacles."""
        shared = list(range(1, 1 + len(obstacles)))  # the same for every point
        return list(self.closest.map("sensing", "serial", places.shape[1], shared, [])(places, *obstacles))


@dataclass(frozen=True, slots=True, eq=False)
class Sensing:
    """All points of interest against all obstacles."""

    obstacles: Obstacles
    influence_radius: Signal  # (points,)
    contacts: tuple[Contact, ...]
    pushes: tuple[Push, ...]  # of each point, the unit vector toward its obstacle
    loop: Loop | None

    @classmethod
    def of(cls, tree: KinematicTree, obstacles: Obstacles) -> Self:
        """Every point of interest of the robot, each with its own influence radius s as a parameter."""
        points = tree.robot.points_of_interest
        radius = symbol(
            "influence_radius",
            (len(points),),
            "m",
            "influence radius s of each point of interest (eq. 8)",
            "parameter",
            (1e-6, 1e3),
            [point.influence_radius for point in points],
        )
        places = ca.horzcat(*(tree.position(point.link, point.offset) for point in points))
        loop = Loop.over(obstacles, places) if len(points) * obstacles.places > UNROLLED else None
        contacts, pushes = [], []
        for i, point in enumerate(points):
            place = places[:, i]
            distance, toward = (loop.distance[i], loop.toward[:, i]) if loop else obstacles.closest(place)
            approach = toward.T @ tree.position_jacobian(point.link, point.offset)
            contacts.append(Contact.of(distance, radius.expression[i], approach))
            pushes.append(Push(point.link, place, toward))
        return cls(obstacles, radius, tuple(contacts), tuple(pushes), loop)

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The signals the controller has to be given."""
        return (*self.obstacles.inputs, self.influence_radius)

    @property
    def distance(self) -> ca.SX:
        """D of every point of interest, shape (points, 1) [m]."""
        return ca.vertcat(*(contact.distance for contact in self.contacts))

    @property
    def clearance(self) -> ca.SX:
        """The least d − s over the points of interest [m]: negative is intrusion."""
        return ca.mmin(self.distance - self.influence_radius.expression)

    @property
    def event(self) -> ca.SX:
        """1 where some influence region meets an obstacle, 𝓘 ∩ 𝓞 ≠ ∅ (eq. 18), else 0."""
        event = ca.SX(0)
        for contact in self.contacts:
            event = ca.logic_or(event, contact.inside)
        return event


def _points(name: str, maximum: int, dimension: int, description: str) -> Signal:
    return symbol(name, (maximum, dimension), "m", description, "signal", (-1e6, 1e6))


def _radii(name: str, maximum: int, description: str) -> Signal:
    return symbol(name, (maximum,), "m", description, "signal", (0.0, 1e3))


def _count(name: str, maximum: int) -> Signal:
    return symbol(name, (), "1", "how many are there; the rest is ignored", "signal", (0.0, maximum))
