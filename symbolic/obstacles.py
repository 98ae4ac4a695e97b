"""Obstacles, balls, capsules and half-spaces that may move, and what every point of interest senses of them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Self

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import Document
from clikgen.runtime.manifest import FAR
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.distances import apart, direction, is_nearer, nearest_on_segment
from clikgen.symbolic.points import by_link, places
from clikgen.symbolic.robot import PointOfInterest
from clikgen.symbolic.signals import Signal, symbol
from clikgen.symbolic.stage import Stage, Symbols, looped
from clikgen.symbolic.tree import KinematicTree, Wrench

WAYS, MANY = 4, 24  # strands of a loop over so many points or more
WATCHED = 5  # obstacles that a barrier keeps off a point at once; of more, the nearest ones
ABSENT = {
    "obstacle": {"center": 0.0, "radius": -FAR},
    "capsule": {"start": 0.0, "end": 0.0, "radius": -FAR},
    "half_space": {"normal": 0.0, "offset": -4 * FAR},
}
"""What stands for an obstacle that is not there, whatever its place holds: it is never the nearest one."""

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

    def shapes(self, stages: list[Stage] | None = None) -> "Shapes":
        """What they are in space, those that are not there out of the way; in loops, where there are `stages` to add.

        These are balls and capsules of radius −FAR about the origin, and half-spaces that end 4 FAR away.
        """
        at, found = {name: signal.expression for name, signal in self.signals.items()}, dict[str, ca.SX]()
        for kind, absent in ABSENT.items():
            if f"{kind}_count" in at:
                values = [at[f"{kind}_{name}"] for name in absent]
                there = _where_there(values, at[f"{kind}_count"], list(absent.values()), stages)
                found |= {f"{kind}_{name}": value for name, value in zip(absent, there, strict=True)}
        nothing, none = ca.SX(0, self.dimension), ca.SX(0, 1)
        return Shapes(
            found.get("obstacle_center", nothing),
            at.get("obstacle_velocity", nothing),
            found.get("obstacle_radius", none),
            found.get("capsule_start", nothing),
            found.get("capsule_end", nothing),
            found.get("capsule_radius", none),
            found.get("half_space_normal", nothing),
            found.get("half_space_offset", none),
        )


def _where_there(
    values: Sequence[ca.SX], count: ca.SX, absent: Sequence[float], stages: list[Stage] | None
) -> list[ca.SX]:
    """The first `count` rows of each of the values (k, any), and `absent` instead of the rest."""
    numbers = ca.SX(ca.DM(range(values[0].shape[0])))

    def chosen(number: ca.SX, count: ca.SX, row: ca.SX, instead: float) -> ca.SX:
        return ca.if_else(number < count, row, instead)

    if stages is None:
        return [
            ca.vertcat(*(chosen(numbers[k], count, value[k, :], instead) for k in range(value.shape[0])))
            for value, instead in zip(values, absent, strict=True)
        ]

    def body(_: Symbols, columns: Symbols, shared: Symbols, __: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        number, *rows = columns
        return [], [chosen(number, shared[0], row, instead) for row, instead in zip(rows, absent, strict=True)]

    over = [numbers.T, *(value.T for value in values)]
    return [found.T for found in looped("there", body, [], over, [count], stages)[1]]


Merge = Callable[[Sequence[ca.SX], Sequence[ca.SX]], Sequence[ca.SX]]


def _reduced(
    name: str, step: Merge, merge: Merge, start: Sequence[ca.SX], over: Sequence[ca.SX], stages: list[Stage]
) -> Sequence[ca.SX]:
    """What `step` makes of `start` and all columns, in a loop; of many columns in WAYS strands, merged in the end.

    An iteration waits for the one before: strands do not wait for each other.
    """
    ways, count = (WAYS if over[0].shape[1] >= MANY else 1), len(start)
    together = over[0].shape[1] // ways * ways

    def body(mine: Symbols, columns: Symbols, _: Symbols, __: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        return [one for k in range(ways) for one in step(mine[k * count : (k + 1) * count], columns[k::ways])], []

    strands = [one[:, k:together:ways] for one in over for k in range(ways)]
    found, _ = looped(name, body, [*start] * ways, strands, [], stages)
    total: Sequence[ca.SX] = found[:count]
    for k in range(1, ways):
        total = merge(total, found[k * count : (k + 1) * count])
    for i in range(together, over[0].shape[1]):
        total = step(total, [one[:, i] for one in over])
    return total


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
        """All of them, in order, an obstacle a column."""
        return tuple(getattr(self, one.name).T for one in fields(self))

    @classmethod
    def from_arrays(cls, arrays: Sequence[ca.SX]) -> Self:
        """The shapes whose arrays these are."""
        return cls(*(array.T for array in arrays))

    def closest(self, point: ca.SX, stages: list[Stage]) -> tuple[ca.SX, ca.SX, ca.SX]:
        """D of eq. 8, a vector t and its length |t| > 0, with u = t/|t| of eq. 9, of the closest obstacle to `point`.

        d [m] is the distance to its surface, negative inside it and at most FAR; t (dimension, 1) points toward its
        nearest point or axis, along +x where the `point` (dimension, 1) sits on a centre or axis. Squares are
        compared, so that balls and capsules together cost one root, in loops that are added to the stages.
        """
        best = _closest_of(_Ball.at, (self.center.T, self.radius.T), None, point, stages)
        capsules = self.start.T, self.end.T, self.thickness.T
        best = _closest_of(_Ball.of_capsule, capsules, best, point, stages)
        if best is None:
            distance, toward, length = ca.SX(FAR), ca.SX.eye(point.numel())[:, 0], ca.SX(1)
        else:
            root = ca.sqrt(best.squared)
            distance = ca.fmin(root - best.radius, FAR)
            toward, length = apart(best.toward, root)
        for k in range(self.offset.numel()):
            normal = self.normal[k, :].T
            away = ca.dot(normal, point) - self.offset[k]
            nearer = away < distance
            distance = ca.if_else(nearer, away, distance)
            inward, size = apart(-normal, ca.sqrt(ca.sumsqr(normal)))
            toward, length = ca.if_else(nearer, inward, toward), ca.if_else(nearer, size, length)
        return distance, toward, length

    def each(self, point: ca.SX) -> Iterator[tuple[ca.SX, ca.SX, ca.SX]]:
        """D, u and uᵀȯ, how fast it moves away [m/s], for every obstacle to `point` (dimension, 1)."""
        for k in range(self.radius.numel()):
            yield _Ball.at(point, self.center[k, :].T, self.radius[k]).contact(self.velocity[k, :].T)
        for k in range(self.thickness.numel()):
            ball = _Ball.of_capsule(point, self.start[k, :].T, self.end[k, :].T, self.thickness[k])
            yield ball.contact(ca.SX.zeros(point.numel()))
        for k in range(self.offset.numel()):
            normal = self.normal[k, :].T
            yield ca.dot(normal, point) - self.offset[k], -direction(normal)[0], ca.SX(0)

    def nearest(self, point: ca.SX, count: int, stages: list[Stage]) -> tuple[ca.SX, ca.SX, ca.SX]:
        """D (1, count), u (dimension, count) and uᵀȯ (1, count) of the `count` nearest obstacles, the nearest first.

        The balls are searched in a loop, which is added to the stages.
        """
        best = ca.repmat(ca.vertcat(2 * FAR, ca.SX.eye(point.numel())[:, 0], 0), 1, count)

        def body(mine: Symbols, columns: Symbols, shared: Symbols, _: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
            center, radius, velocity = columns
            contact = _Ball.at(shared[0], center, radius).contact(velocity)
            return [_inserted(ca.vertcat(*contact), mine[0])], []

        if self.radius.numel():
            over = [self.center.T, self.radius.T, self.velocity.T]
            (best,), _ = looped("nearest", body, [best], over, [point], stages)
        rest = Shapes.from_arrays([array[:, : 0 if k < 3 else None] for k, array in enumerate(self.arrays)])
        for contact in rest.each(point):
            best = _inserted(ca.vertcat(*contact), best)
        return best[0, :], best[1:-1, :], best[-1, :]


def _inserted(contact: ca.SX, best: ca.SX) -> ca.SX:
    """The nearest of contacts d, u, uᵀȯ in a column, the nearest first: what is nearer takes the place of another."""
    kept = []
    for j in range(best.shape[1]):
        nearer = contact[0] < best[0, j]
        kept.append(ca.if_else(nearer, contact, best[:, j]))
        contact = ca.if_else(nearer, best[:, j], contact)
    return ca.horzcat(*kept)


@dataclass(frozen=True, slots=True, eq=False)
class _Ball:
    """A ball as a point sees it."""

    toward: ca.SX  # (dimension, 1) [m], from the point to the centre
    squared: ca.SX  # its squared length
    radius: ca.SX

    @classmethod
    def at(cls, point: ca.SX, center: ca.SX, radius: ca.SX) -> Self:
        """Of this centre (dimension, 1) and radius."""
        toward = center - point
        return cls(toward, ca.sumsqr(toward), radius)

    @classmethod
    def of_capsule(cls, point: ca.SX, start: ca.SX, end: ca.SX, radius: ca.SX) -> Self:
        """The one in a capsule that is nearest to the point."""
        return cls.at(point, nearest_on_segment(start, end, point), radius)

    def or_nearer(self, other: Self) -> Self:
        """The nearer of the two, this one where they are as near as each other."""
        nearer = is_nearer(other.squared, other.radius, self.squared, self.radius)
        mine = ca.vertcat(self.toward, self.squared, self.radius)
        chosen = ca.if_else(nearer, ca.vertcat(other.toward, other.squared, other.radius), mine)
        return type(self)(chosen[:-2], chosen[-2], chosen[-1])

    def contact(self, velocity: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """D, u, and uᵀȯ of its `velocity` ȯ (dimension, 1)."""
        u, length = direction(self.toward, self.squared)
        return length - self.radius, u, ca.dot(u, velocity)


def _closest_of(
    ball: Callable[..., _Ball],
    columns: Sequence[ca.SX],
    best: _Ball | None,
    point: ca.SX,
    stages: list[Stage],
) -> _Ball | None:
    """The closest to the point (dimension, 1) of `best` and the balls that the columns stand for."""
    count = columns[0].shape[1]
    if count <= 2:
        for k in range(count):
            one = ball(point, *(column[:, k] for column in columns))
            best = one if best is None else best.or_nearer(one)
        return best
    if best is None:
        best, columns = ball(point, *(column[:, 0] for column in columns)), [column[:, 1:] for column in columns]

    def body(mine: Symbols, columns: Symbols, shared: Symbols, _: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        found = _Ball(*mine).or_nearer(ball(shared[0], *columns))
        return [found.toward, found.squared, found.radius], []

    carried, _ = looped("closest", body, [best.toward, best.squared, best.radius], columns, [point], stages)
    return _Ball(*carried)


@dataclass(frozen=True, slots=True, eq=False)
class ClosestContacts:
    """Of every point of interest its contact with its closest obstacle, and what they come to together."""

    places: ca.SX  # (dimension, points) [m]
    contacts: tuple[Contact, ...]
    potential: ca.SX  # Σ ½ x² [m²]
    wrenches: tuple[Wrench, ...]  # of the forces x u at the points
    clearance: ca.SX  # the least d − s [m]: negative is intrusion
    searches: tuple[Stage, ...]  # the loops for them


@dataclass(frozen=True, slots=True, eq=False)
class Sensing:
    """All points of interest against all obstacles."""

    obstacles: Obstacles
    influence_radius: Signal  # (points,)
    tree: KinematicTree
    closest: ClosestContacts
    watch: tuple[Stage, ...]  # where there are many obstacles, the search for those that a barrier watches

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
        closest = _closest_contacts(tree, obstacles, radius.expression)
        watch = _watched(tree, obstacles) if obstacles.places > WATCHED else ()
        return cls(obstacles, radius, tree, closest, watch)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """The searches that are loops."""
        return (*self.closest.searches, *self.watch)

    def pairs(self) -> list[Contact]:
        """The contact of every point of interest with every obstacle, or with the WATCHED nearest ones of more."""
        return [
            Contact(distance, self.influence_radius.expression[i], toward.T @ _jacobian(self.tree, point), opening)
            for i, point in enumerate(self.tree.robot.points_of_interest)
            for distance, toward, opening in self._near(i)
        ]

    def _near(self, i: int) -> Iterator[tuple[ca.SX, ca.SX, ca.SX]]:
        """D, u and uᵀȯ of the obstacles that a barrier keeps off point i."""
        if not self.watch:
            yield from self.obstacles.shapes().each(_place(self.tree, self.tree.robot.points_of_interest[i]))
            return
        distance, towards, opening = (symbols[:, i] for symbols in self.watch[-1].symbols)
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
        return ca.vertcat(*(contact.distance for contact in self.closest.contacts))

    @property
    def event(self) -> ca.SX:
        """1 where some influence region meets an obstacle, 𝓘 ∩ 𝓞 ≠ ∅ (eq. 18), else 0."""
        return self.closest.clearance <= 0


def _place(tree: KinematicTree, point: PointOfInterest) -> ca.SX:
    return tree.position(point.link, point.offset)


def _jacobian(tree: KinematicTree, point: PointOfInterest) -> ca.SX:
    return tree.position_jacobian(point.link, point.offset)


def _closest_contacts(tree: KinematicTree, obstacles: Obstacles, radius: ca.SX) -> ClosestContacts:
    """Each point against the obstacles, in loops over points and obstacles; radius (points, 1) [m]."""
    points, stages = tree.robot.points_of_interest, list[Stage]()
    where, arrays = places(tree, stages), obstacles.shapes(stages).arrays

    def sensed(_: Symbols, columns: Symbols, shared: Symbols, inner: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        place, s = columns
        distance, toward, length = Shapes.from_arrays(_restored(shared, arrays)).closest(place, inner)
        wrench, x = Wrench.at("", place, toward), ca.fmax(s - distance, 0)
        force, moment = x / length * wrench.force, x / length * wrench.moment
        return [], [distance, toward / length, x**2, force, moment]

    _, (distance, u, x_squared, force, moment) = looped(
        "sense", sensed, [], [where, radius.T], [array for array in arrays if array.numel()], stages
    )

    def added(mine: Sequence[ca.SX], columns: Sequence[ca.SX]) -> list[ca.SX]:
        return [total + one for total, one in zip(mine, columns, strict=True)]

    wrenches = []
    for link, here in by_link(tree).items():
        forces, moments = force[:, here], moment[:, here]
        nothing = [ca.SX.zeros(forces.shape[0]), ca.SX.zeros(moments.shape[0])]
        wrenches.append(Wrench(link, *_reduced("add", added, added, nothing, [forces, moments], stages)))

    def least(mine: Sequence[ca.SX], columns: Sequence[ca.SX]) -> list[ca.SX]:
        x_squared, distance, s = columns
        return [mine[0] + x_squared, ca.fmin(distance - s, mine[1])]

    def both(mine: Sequence[ca.SX], other: Sequence[ca.SX]) -> list[ca.SX]:
        return [mine[0] + other[0], ca.fmin(mine[1], other[1])]

    over = [x_squared, distance, radius.T]
    potential, lowest = _reduced("least", least, both, [ca.SX(0), ca.SX(2 * FAR)], over, stages)
    contacts = tuple(
        Contact(distance[i], radius[i], u[:, i].T @ _jacobian(tree, point)) for i, point in enumerate(points)
    )
    return ClosestContacts(where, contacts, potential / 2, tuple(wrenches), lowest, tuple(stages))


def _restored(given: Sequence[ca.SX], arrays: Sequence[ca.SX]) -> list[ca.SX]:
    """What is given for those of the arrays that are not empty, among the empty ones."""
    left = iter(given)
    return [next(left) if array.numel() else array for array in arrays]


def _watched(tree: KinematicTree, obstacles: Obstacles) -> tuple[Stage, ...]:
    """The WATCHED nearest obstacles to each point, in a loop over the points; its stage is the last.

    Its symbols are d (WATCHED, points), the u one below the other (WATCHED · dimension, points), uᵀȯ (WATCHED, points).
    """
    places = ca.horzcat(*(_place(tree, point) for point in tree.robot.points_of_interest))
    stages = list[Stage]()
    arrays = obstacles.shapes(stages).arrays
    shapes = [array for array in arrays if array.numel()]

    def body(_: Symbols, columns: Symbols, shared: Symbols, inner: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        there = Shapes.from_arrays(_restored(shared, arrays))
        distance, towards, opening = there.nearest(columns[0], WATCHED, inner)
        return [], [distance.T, ca.vec(towards), opening.T]

    looped("watched", body, [], [places], shapes, stages)
    return tuple(stages)


def _points(name: str, maximum: int, dimension: int, description: str) -> Signal:
    return symbol(name, (maximum, dimension), "m", description, "signal", (-1e6, 1e6))


def _radii(name: str, maximum: int, description: str) -> Signal:
    return symbol(name, (maximum,), "m", description, "signal", (0.0, 1e3))


def _count(name: str, maximum: int) -> Signal:
    return symbol(name, (), "1", "how many are there; the rest is ignored", "signal", (0.0, maximum))
