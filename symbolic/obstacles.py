"""Obstacles, balls, capsules and half-spaces that may move, and what every point of interest senses of them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Self

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import Document
from clikgen.runtime.manifest import FAR
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.distances import direction, nearest_on_segment
from clikgen.symbolic.signals import Signal, symbol
from clikgen.symbolic.stage import Stage
from clikgen.symbolic.tree import KinematicTree, Push

UNROLLED = 64  # pairs of points and obstacles; more of them are looped over, as the code would outgrow the cache
WATCHED = 5  # obstacles that a barrier keeps off a point at once; of more, the nearest ones
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
                symbol(
                    "obstacle_velocity",
                    (capacity.maximum, dimension),
                    "m/s",
                    "ȯ, how fast the centres move",
                    "signal",
                    (-1e3, 1e3),
                ),
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
            at.get("obstacle_velocity", nothing),
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
    velocity: ca.SX  # (balls, dimension) [m/s]
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
        for distance_k, toward_k, _ in self._each(point):
            closer = distance_k < distance
            distance = ca.if_else(closer, distance_k, distance)
            toward = ca.if_else(closer, toward_k, toward)
        return distance, direction(toward)[0]

    def each(self, point: ca.SX) -> Iterator[tuple[ca.SX, ca.SX, ca.SX]]:
        """D, u and uᵀȯ, how fast it moves away [m/s], for every obstacle to `point` (dimension, 1)."""
        for distance, toward, velocity in self._each(point):
            u, _ = direction(toward)
            yield distance, u, ca.dot(u, velocity)

    def nearest(self, point: ca.SX, count: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """D (count, 1), u (dimension, count) and uᵀȯ (count, 1) of the `count` nearest obstacles, the nearest first."""
        found = list(self.each(point))
        distances, numbers = [ca.SX(2 * FAR)] * count, [ca.SX(-1)] * count
        for number, (distance, _, _) in enumerate(found):
            carried, carried_number = distance, ca.SX(number)
            for j in range(count):  # insertion: what is nearer takes the place, the other one is carried on
                nearer = carried < distances[j]
                distances[j], carried = ca.fmin(distances[j], carried), ca.fmax(distances[j], carried)
                numbers[j], carried_number = (
                    ca.if_else(nearer, carried_number, numbers[j]),
                    ca.if_else(nearer, numbers[j], carried_number),
                )
        towards, openings = [], []
        for number_j in numbers:
            toward, opening = ca.SX.zeros(point.numel()), ca.SX(0)
            for number, (_, u, rate) in enumerate(found):
                toward += ca.if_else(number_j == number, u, 0)
                opening += ca.if_else(number_j == number, rate, 0)
            towards.append(toward)
            openings.append(opening)
        return ca.vertcat(*distances), ca.horzcat(*towards), ca.vertcat(*openings)

    def _each(self, point: ca.SX) -> Iterator[tuple[ca.SX, ca.SX, ca.SX]]:
        """Of every obstacle its distance [m], a vector toward it, and its velocity [m/s]."""
        rest = ca.SX.zeros(point.numel())
        for k in range(self.radius.numel()):
            toward = self.center[k, :].T - point
            yield ca.sqrt(ca.sumsqr(toward)) - self.radius[k], toward, self.velocity[k, :].T
        for k in range(self.thickness.numel()):
            toward = nearest_on_segment(self.start[k, :].T, self.end[k, :].T, point) - point
            yield ca.sqrt(ca.sumsqr(toward)) - self.thickness[k], toward, rest
        for k in range(self.offset.numel()):
            normal = self.normal[k, :].T
            yield ca.dot(normal, point) - self.offset[k], -normal, rest


def looped(shapes: Shapes, places: ca.SX) -> Stage:
    """The closest obstacle to each of the `places` (dimension, points) by one small function called for each point.

    The contacts are then expressions of its symbols: d (1, points) and u (dimension, points).
    """
    return _for_each_place("closest", lambda others, place: list(others.closest(place)), shapes, places)


def watched(shapes: Shapes, places: ca.SX) -> Stage:
    """The WATCHED nearest obstacles to each of the `places` (dimension, points), by a function called for each point.

    Its symbols are d (WATCHED, points), the u one below the other (WATCHED · dimension, points), uᵀȯ (WATCHED, points).
    """

    def nearest(others: Shapes, place: ca.SX) -> list[ca.SX]:
        distance, toward, opening = others.nearest(place, WATCHED)
        return [distance, ca.vec(toward), opening]

    return _for_each_place("nearest", nearest, shapes, places)


def _for_each_place(name: str, what: Callable[[Shapes, ca.SX], list[ca.SX]], shapes: Shapes, places: ca.SX) -> Stage:
    """A function of shapes and place, called in a loop over the `places` (dimension, points)."""
    dimension, points = places.shape
    place, others = ca.SX.sym("place", dimension), shapes.symbols()
    outputs = ca.cse(what(others, place))
    both = zip(shapes.arrays, others.arrays, strict=True)
    used = [(given, own) for given, own in both if ca.depends_on(ca.veccat(*outputs), ca.vec(own))]
    function = ca.Function(name, [place, *(own for _, own in used)], outputs)
    shared = list(range(1, 1 + len(used)))  # the same for every point
    return Stage(
        symbols=tuple(ca.SX.sym(name, function.size1_out(i), points) for i in range(function.n_out())),
        arguments=(places, *(given for given, _ in used)),
        run=lambda values: list(function.map(f"{name}_to_each", "serial", points, shared, [])(*values)),
        instructions=points * function.n_instructions(),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Sensing:
    """All points of interest against all obstacles."""

    obstacles: Obstacles
    influence_radius: Signal  # (points,)
    places: ca.SX  # (dimension, points) [m]
    jacobians: tuple[ca.SX, ...]  # J_r of each point (dimension, n)
    shapes: Shapes
    contacts: tuple[Contact, ...]
    pushes: tuple[Push, ...]  # of each point, the unit vector toward its obstacle
    loop: Stage | None  # where there are many pairs, the search for the closest obstacle
    watch: Stage | None  # where there are many obstacles, the search for those that a barrier watches

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
        loop = looped(shapes, places) if len(points) * obstacles.places > UNROLLED else None
        jacobians = tuple(tree.position_jacobian(point.link, point.offset) for point in points)
        contacts, pushes = [], []
        for i, point in enumerate(points):
            place = places[:, i]
            distance, toward = (loop.symbols[0][i], loop.symbols[1][:, i]) if loop else shapes.closest(place)
            contacts.append(Contact(distance, radius.expression[i], toward.T @ jacobians[i]))
            pushes.append(Push(point.link, place, toward))
        watch = watched(shapes, places) if obstacles.places > WATCHED else None
        return cls(obstacles, radius, places, jacobians, shapes, tuple(contacts), tuple(pushes), loop, watch)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The searches that are loops."""
        return tuple(stage for stage in (self.loop, self.watch) if stage)

    def pairs(self) -> list[Contact]:
        """The contact of every point of interest with every obstacle, or with the WATCHED nearest ones of more."""
        return [
            Contact(distance, self.influence_radius.expression[i], toward.T @ J, opening)
            for i, J in enumerate(self.jacobians)
            for distance, toward, opening in self._near(i)
        ]

    def _near(self, i: int) -> Iterator[tuple[ca.SX, ca.SX, ca.SX]]:
        """D, u and uᵀȯ of the obstacles that a barrier keeps off point i."""
        if self.watch is None:
            yield from self.shapes.each(self.places[:, i])
            return
        distance, towards, opening = (symbols[:, i] for symbols in self.watch.symbols)
        dimension = self.obstacles.dimension
        for k in range(WATCHED):
            yield distance[k], towards[k * dimension : (k + 1) * dimension], opening[k]

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
