"""Self-collision avoidance: pairs of the robot's own bodies keep a distance from each other."""

from itertools import combinations
from typing import Annotated, Literal

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, Positive, choices
from clikgen.symbolic.activation import Boundary
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.distances import direction, nearest_on_segments
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.robot import Body, Robot
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.tree import KinematicTree

Pair = tuple[Body, Body]


class Spec(OneSidedSpec):
    """Each pair of bodies keeps a distance s.

    d = |c_2 − c_1| − r_1 − r_2 with c_1, c_2 the nearest points of the two axes, and by the envelope theorem
    ∂d/∂q = uᵀ(J(c_2) − J(c_1)) with the points held fixed to their links, u = (c_2 − c_1)/|c_2 − c_1|. Once two
    axes meet, d = −r_1 − r_2 and u has no meaning (it is +x): a margin cannot recover from there.

    `pairs` names bodies of the robot, two by two; by default all pairs that two joints or more keep apart.
    `margin` is s [m], a number or a list with one per pair.
    """

    kind: Literal["self_collision"]
    pairs: Annotated[tuple[tuple[str, str], ...], Field(min_length=1)] | None = None
    margin: Positive | tuple[Positive, ...]

    def contacts(self, robot: Robot) -> int:
        """One a pair."""
        return len(self._pairs(KinematicTree.of(robot)))

    def boundary(self, tree: KinematicTree, sensing: Sensing | None) -> Boundary:
        """A contact a pair; raises BadInput for an unknown body or two that are fixed to each other."""
        pairs = self._pairs(tree)
        shape, names = (len(pairs),), ", ".join(f"{a.name}-{b.name}" for a, b in pairs)
        text = f"s of each pair: {names}"
        margin = symbol(f"{self.name}_margin", shape, "m", text, "parameter", (1e-6, 1e3), self.margin)
        contacts = tuple(_contact(tree, pair, margin.expression[i]) for i, pair in enumerate(pairs))
        distance = ca.vertcat(*(contact.distance for contact in contacts))
        diagnostic = result(f"{self.name}_distance", distance, shape, "m", f"d of each pair: {names}")
        return Boundary(self.name, "m", contacts, (margin,), (diagnostic,))

    def _pairs(self, tree: KinematicTree) -> list[Pair]:
        bodies = {body.name: body for body in tree.robot.bodies}
        if self.pairs is None:
            pairs = [pair for pair in combinations(bodies.values(), 2) if _joints_between(tree, pair) > 1]
            if not pairs:
                raise BadInput("wanted bodies with two joints or more between them, got none")
            return pairs
        for name in (name for pair in self.pairs for name in pair):
            if name not in bodies:
                raise BadInput(f"no body '{name}'; {choices(name, bodies)}")
        pairs = [(bodies[a], bodies[b]) for a, b in self.pairs]
        for a, b in pairs:
            if _joints_between(tree, (a, b)) == 0:
                raise BadInput(
                    f"the bodies '{a.name}' and '{b.name}' are fixed to each other, "
                    "wanted a joint at least between them"
                )
        return pairs


def _joints_between(tree: KinematicTree, pair: Pair) -> int:
    """How many moving joints are on the way from one body to the other."""
    first, second = (set(tree.carriers[body.link]) for body in pair)
    return len(first ^ second)


def _contact(tree: KinematicTree, pair: Pair, margin: ca.SX) -> Contact:
    (start_1, end_1), (start_2, end_2) = (_axis(tree, body) for body in pair)
    point_1, point_2 = nearest_on_segments(start_1, end_1, start_2, end_2)
    away, apart = direction(point_2 - point_1)
    # a joint that carries both bodies moves the two points alike along u: its column is zero and left out
    first, second = (tree.carriers[body.link] for body in pair)
    relative = tree.jacobian_at(point_2, [axis for axis in second if axis not in first]) - tree.jacobian_at(
        point_1, [axis for axis in first if axis not in second]
    )
    return Contact(apart - pair[0].radius - pair[1].radius, margin, -away.T @ relative)


def _axis(tree: KinematicTree, body: Body) -> tuple[ca.SX, ca.SX]:
    """Where the body's axis starts and ends in the world, the same for a ball."""
    start = tree.position(body.link, body.start)
    return start, start if body.end is None else tree.position(body.link, body.end)
