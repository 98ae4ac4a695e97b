"""Obstacle avoidance at the points of interest (eqs. 6-10)."""

from typing import Literal

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.activation import Boundary
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.tree import KinematicTree


class Spec(OneSidedSpec):
    """Every point of interest keeps its influence radius s from the obstacles: x = s − d where d <= s, else 0.

    The contact of a point is with its closest obstacle, so inside two regions at once all activations but the barrier
    jump where the closest one changes; the barrier watches all obstacles, or the five closest ones of more.
    """

    kind: Literal["obstacle_avoidance"]

    def contacts(self, robot: Robot) -> int:
        """One a point."""
        return len(robot.points_of_interest)

    def boundary(self, tree: KinematicTree, sensing: Sensing | None) -> Boundary:
        """The contacts; the sum J_o = Σ x uᵀ J_r of eq. 9 by the wrenches that the points exert on the tree."""
        if sensing is None:
            raise BadInput("wanted points of interest and [obstacles] maximum >= 1")
        closest = sensing.closest
        summed = closest.potential, tree.pullback(closest.wrenches)
        return Boundary(self.name, "m", closest.contacts, pairs=sensing.pairs, summed=summed)
