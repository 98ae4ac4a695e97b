"""Self-collision avoidance: pairs of the robot's own bodies keep a distance from each other."""

from itertools import combinations
from typing import Annotated, Literal

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, NonNegative, Positive, choices
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.distances import direction, nearest_on_segments
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.potential import Combine, potential_task
from clikgen.symbolic.robot import Body, Robot
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.task import Task, TaskSpec
from clikgen.symbolic.tree import KinematicTree

Pair = tuple[Body, Body]


class Spec(TaskSpec):
    """q̇_c = J_c⁺ K_o (0 − V), eq. 10, with V = ½ x² (eq. 8), x = s − d where d < s, of each pair of bodies.

    d = |c_2 − c_1| − r_1 − r_2 with c_1, c_2 the nearest points of the two axes, and by the envelope theorem
    ∂d/∂q = uᵀ(J(c_2) − J(c_1)) with the points held fixed to their links, u = (c_2 − c_1)/|c_2 − c_1|. Once two
    axes meet, d = −r_1 − r_2 and u has no meaning (it is +x): a margin cannot recover from there.

    `pairs` names bodies of the robot, two by two; by default all pairs that two joints or more keep apart.
    `margin` is s [m], a number or a list with one per pair; `gain` is K_o [1/s]; `damping` [m²] that of the
    pseudo-inverse, as for obstacle_avoidance; `combine` is "rows" for a row a pair, or "sum" for one in all.
    """

    kind: Literal["self_collision"]
    pairs: Annotated[tuple[tuple[str, str], ...], Field(min_length=1)] | None = None
    margin: Positive | tuple[Positive, ...]
    gain: NonNegative
    damping: Positive
    combine: Combine = "rows"

    @property
    def equality(self) -> bool:
        """It acts only where two bodies are too near."""
        return False

    def dimension(self, robot: Robot) -> int:
        """One row a pair; or one, however many pairs."""
        return 1 if self.combine == "sum" else len(self._pairs(KinematicTree.of(robot)))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """V = ½ x² and J_c = ∂V/∂q; raises BadInput for an unknown body or two that are fixed to each other."""
        pairs = self._pairs(tree)
        shape, names = (len(pairs),), ", ".join(f"{a.name}-{b.name}" for a, b in pairs)
        text = f"s of each pair: {names}"
        margin = symbol(f"{self.name}_margin", shape, "m", text, "parameter", (1e-6, 1e3), self.margin)
        contacts = [_contact(tree, pair, margin.expression[i]) for i, pair in enumerate(pairs)]
        distance = ca.vertcat(*(contact.distance for contact in contacts))
        diagnostic = result(f"{self.name}_distance", distance, shape, "m", f"d of each pair: {names}")
        return potential_task(self.name, contacts, self.gain, self.damping, self.combine, (margin,), (diagnostic,))

    def _pairs(self, tree: KinematicTree) -> list[Pair]:
        bodies = {body.name: body for body in tree.robot.bodies}
        if self.pairs is None:
            pairs = [pair for pair in combinations(bodies.values(), 2) if _joints_between(tree, pair) > 1]
            if not pairs:
                raise BadInput(f"task '{self.name}': wanted bodies with two joints or more between them, got none")
            return pairs
        for name in (name for pair in self.pairs for name in pair):
            if name not in bodies:
                raise BadInput(f"task '{self.name}': no body '{name}'; {choices(name, bodies)}")
        pairs = [(bodies[a], bodies[b]) for a, b in self.pairs]
        for a, b in pairs:
            if _joints_between(tree, (a, b)) == 0:
                raise BadInput(
                    f"task '{self.name}': the bodies '{a.name}' and '{b.name}' are fixed to each other, "
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
    return Contact.of(apart - pair[0].radius - pair[1].radius, margin, -away.T @ relative)


def _axis(tree: KinematicTree, body: Body) -> tuple[ca.SX, ca.SX]:
    """Where the body's axis starts and ends in the world, the same for a ball."""
    start = tree.position(body.link, body.start)
    return start, start if body.end is None else tree.position(body.link, body.end)
