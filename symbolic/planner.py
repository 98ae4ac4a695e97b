"""How much of the filter is used, and when (eqs. 16-19); the kinds of planner are the files in `planners/`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import Document
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, symbol

if TYPE_CHECKING:
    from clikgen.symbolic.filters.first_order import Spec as AnyFilter

Share = Annotated[float, Field(strict=True, ge=0, le=1)]


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A period of the loop as the law leaves it to filter and planner."""

    robot: Robot
    dq_law: ca.SX  # (n, 1) the law's velocity, (q_i − q_{i−1})/T of eq. 13
    period: ca.SX  # T [s]
    velocity_map: ca.SX  # S(q), q̇ = S u
    event: ca.SX  # 1 while some influence region meets an obstacle, else 0
    clearance: ca.SX | None  # the least d − s [m]; None where there is nothing to meet

    def share(self, lam: ca.SX, chosen: "AnyFilter") -> tuple[ca.SX, tuple[Signal, ...]]:
        """B = 1 − λ(1 − β), what eqs. 16 and 17 together leave of q_i − q_{i−1}: (n, 1), and the filter's inputs."""
        kept, inputs = chosen.build(self.period, self.robot.input_of)
        return 1 - lam * kept, inputs


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """How fast the robot goes, by which λ, and the signals that takes."""

    dq: ca.SX  # (n, 1), (q_i − q)/T of eq. 17
    lam: ca.SX  # λ
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...] = ()


class PlannerSpec(Document, ABC):
    """λ away from all obstacles (`lam_free`) and while some influence region meets one (`lam_event`).

    (0, 0) is the paper's Case 1 (no filter), (1, 1) Case 2 (filter always), (0, 1) Case 3 (eq. 18).
    """

    kind: str
    lam_free: Share = 0.0
    lam_event: Share = 1.0

    @abstractmethod
    def build(self, motion: Motion, chosen: "AnyFilter") -> Plan:
        """q_i = A_λ q_filtered,i + (I − A_λ) q_i, eq. 17."""

    def shares(self) -> tuple[Signal, Signal]:
        """The parameters `lam_free` and `lam_event`."""
        return (
            symbol("lam_free", (), "1", "λ while no region meets an obstacle", "parameter", (0, 1), self.lam_free),
            symbol("lam_event", (), "1", "λ while one does (eq. 18)", "parameter", (0, 1), self.lam_event),
        )
