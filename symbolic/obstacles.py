"""Obstacles, balls, capsules and half-spaces that may move, and what every point of interest senses of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
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

    @property
    def shapes(self) -> "Shapes":
        """What they are in space, those that are not there out of the way."""
        at = {name: signal.expression for name, signal in self.signals.items()}
        nothing, none = ca.SX(0, self.dimension), ca.SX(0, 1)
        return Shapes(
            at.get("obstacle_center", nothing),
            _where_there(at["obstacle_radius"], at["obstacle_count"], -FAR) if "obstacle_radius" in at else none,
            at.get("capsule_start", nothing),
            at.get("capsule_end", nothing),
            _where_there(at["capsule_radius"], at["capsule_count"], -FAR) if "capsule_radius" in at else none,
            _where_there(at["half_space_normal"], at["half_space_count"], 0) if "half_space_normal" in at else nothing,
            _where_there(at["half_space_offset"], at["half_space_count"], -4 * FAR)
            if "half_space_offset" in at
            else none,
        )


def _where_there(values: ca.SX, count: ca.SX, absent: float) -> ca.SX:
    """The first `count` rows of the values (k, any), and `absent` instead of the rest."""
    return ca.vertcat(*(ca.if_else(k < count, values[k, :], absent) for k in range(values.shape[0])))


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Balls, capsules and half-spaces in space: a row each, radii and offsets far negative where there is none."""

    center: ca.SX  # (balls, dimension) [m]
    radius: ca.SX  # (balls, 1) [m]
    start: ca.SX  # (capsules, dimension) [m]
    end: ca.SX  # (capsules, dimension) [m]
    thickness: ca.SX  # (capsules, 1) [m]
    normal: ca.SX  # (half-spaces, dimension)
    offset: ca.SX  # (half-spaces, 1) [m]

    @property
    def arrays(self) -> tuple[ca.SX, ...]:
        """All of them, in order."""
        return tuple(getattr(self, field.name) for field in fields(self))

    def symbols(self) -> "Shapes":
        """As many shapes, of new symbols."""
        return Shapes(*(ca.SX.sym("shape", *array.shape) for array in self.arrays))

    def closest(self, point: ca.SX) -> tuple[ca.SX, ca.SX]:
        """D and u of eqs. 8-9 for the closest obstacle to `point` (dimension, 1).

        d [m] is the distance to its surface, negative inside it and FAR without an obstacle; u (dimension, 1) is
        the unit vector toward its nearest point or axis, +x where the point sits on a centre or axis.
        """
        first_axis = ca.SX.eye(point.numel())[:, 0]
        distance, toward = ca.SX(FAR), first_axis
        for distance_k, toward_k in self._each(point):
            closer = distance_k < distance
            distance = ca.if_else(closer, distance_k, distance)
            toward = ca.if_else(closer, toward_k, toward)
        norm = ca.sqrt(ca.sumsqr(toward))
        return distance, ca.if_else(norm > COINCIDENT, toward / norm, first_axis)

    def _each(self, point: ca.SX) -> Iterator[tuple[ca.SX, ca.SX]]:
        """Of every obstacle its distance [m] and a vector toward it."""
        for k in range(self.radius.numel()):
            toward = self.center[k, :].T - point
            yield ca.sqrt(ca.sumsqr(toward)) - self.radius[k], toward
        for k in range(self.thickness.numel()):
            toward = nearest_on_segment(self.start[k, :].T, self.end[k, :].T, point) - point
            yield ca.sqrt(ca.sumsqr(toward)) - self.thickness[k], toward
        for k in range(self.offset.numel()):
            normal = self.normal[k, :].T
            yield ca.dot(normal, point) - self.offset[k], -normal


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """The search for the closest obstacle as one small function called for each point, not unrolled for all.

    The contacts are then expressions of `distance` and `toward`, which that function fills in.
    """

    places: ca.SX  # (dimension, points) [m], of q
    shapes: Shapes
    closest: ca.Function  # a place and the shapes -> d and u
    distance: ca.SX  # (1, points) symbols
    toward: ca.SX  # (dimension, points) symbols

    @classmethod
    def over(cls, shapes: Shapes, places: ca.SX) -> Self:
        """The loop over all `places` (dimension, points)."""
        dimension, points = places.shape
        place, others = ca.SX.sym("place", dimension), shapes.symbols()
        closest = ca.Function("closest", [place, *others.arrays], ca.cse(list(others.closest(place))))
        symbols = ca.SX.sym("distance", 1, points), ca.SX.sym("toward", dimension, points)
        return cls(places, shapes, closest, *symbols)

    def run(self, places: ca.MX, shapes: Sequence[ca.MX]) -> list[ca.MX]:
        """D (1, points) and u (dimension, points) for the values of places and shapes."""
        shared = list(range(1, 1 + len(shapes)))  # the same for every point
        return list(self.closest.map("sensing", "serial", places.shape[1], shared, [])(places, *shapes))


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
        shapes = obstacles.shapes
        loop = Loop.over(shapes, places) if len(points) * obstacles.places > UNROLLED else None
        contacts, pushes = [], []
        for i, point in enumerate(points):
            place = places[:, i]
            distance, toward = (loop.distance[i], loop.toward[:, i]) if loop else shapes.closest(place)
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
