"""Obstacle avoidance at the points of interest: one scalar task that sums their potentials (eqs. 6-10)."""

from dataclasses import replace
from typing import Literal

from clikgen.runtime.documents import BadInput, NonNegative, Positive
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.potential import Combine, potential_task
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Task, TaskSpec
from clikgen.symbolic.tree import KinematicTree


class Spec(TaskSpec):
    """q̇_o = J_o⁺ (ṙ_o + K_o (r_o − f_o(q))), eq. 10, toward the potential r_o = 0 with ṙ_o = 0.

    `gain` is K_o [1/s]; `damping` [m²] that of the pseudo-inverse: J_o goes to zero with the depth, so below
    a depth of damping/|uᵀJ_r| the task fades instead of switching (a tiny value keeps the paper's switch).
    `combine` is "sum" for the paper's one row, or "rows" for one a point, which holds several contacts at once.
    """

    kind: Literal["obstacle_avoidance"]
    gain: NonNegative
    damping: Positive
    combine: Combine = "sum"

    @property
    def equality(self) -> bool:
        """It acts only inside an influence region."""
        return False

    def dimension(self, robot: Robot) -> int:
        """One row, however many points; or one a point."""
        return 1 if self.combine == "sum" else len(robot.points_of_interest)

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """V = Σ ½ x² (eq. 8) and J_o = Σ x uᵀ J_r (eq. 9), x = s − d where d ≤ s, else 0."""
        if sensing is None:
            raise BadInput(f"task '{self.name}' wants points of interest and [obstacles] maximum >= 1")
        pushes = (
            replace(push, force=c.depth * push.force) for push, c in zip(sensing.pushes, sensing.contacts, strict=True)
        )
        return potential_task(
            self.name, sensing.contacts, self.gain, self.damping, self.combine, gradient=tree.pullback(list(pushes))
        )
