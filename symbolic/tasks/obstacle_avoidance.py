"""Obstacle avoidance at the points of interest: one scalar task that sums their potentials (eqs. 6-10)."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import BadInput, NonNegative, Positive
from clikgen.symbolic.chain import SerialChain
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.task import Task, TaskSpec


class Spec(TaskSpec):
    """q̇_o = J_o⁺ (ṙ_o + K_o (r_o − f_o(q))), eq. 10, toward the potential r_o = 0 with ṙ_o = 0.

    `gain` is K_o [1/s]; `damping` [m²] that of the pseudo-inverse: J_o goes to zero with the depth, so below
    a depth of damping/|uᵀJ_r| the task fades instead of switching (a tiny value keeps the paper's switch).
    """

    kind: Literal["obstacle_avoidance"]
    gain: NonNegative
    damping: Positive

    @property
    def equality(self) -> bool:
        """It acts only inside an influence region."""
        return False

    def dimension(self, robot: Robot) -> int:
        """One row, however many points."""
        return 1

    def build(self, chain: SerialChain, sensing: Sensing | None) -> Task:
        """V = Σ ½ x² (eq. 8) and J_o = Σ x uᵀ J_r (eq. 9), x = s − d where d ≤ s, else 0."""
        name = self.name
        if sensing is None:
            raise BadInput(f"task '{name}' wants points of interest and [obstacles] maximum >= 1")
        potential = ca.SX(0)
        jacobian = ca.SX.zeros(1, chain.q.numel())
        for contact in sensing.contacts:
            potential += contact.depth**2 / 2
            jacobian += contact.depth * contact.approach
        gain = symbol(f"{name}_gain", (), "1/s", "K_o (eq. 10)", "parameter", (0.0, 1e6), self.gain)
        damping = symbol(f"{name}_damping", (), "m^2", "damping of J_o⁺", "parameter", (1e-9, 1e3), self.damping)
        return Task(
            name=name,
            jacobian=jacobian,
            error=-potential,
            feedforward=ca.SX(0),
            gain=gain.expression,
            damping=damping.expression,
            inputs=(gain, damping),
            diagnostics=(result(f"{name}_potential", potential, (), "m^2", "V, sum of eq. 8"),),
            positions=(),
            jacobians=(
                result(
                    f"{name}_jacobian",
                    jacobian,
                    (chain.q.numel(),),
                    "m^2 per joint unit",
                    "J_o = ∂V/∂q, sum of eq. 9",
                ),
            ),
        )
