"""The planner: how much of the filter is used, and when (eqs. 17-19)."""

from typing import Annotated

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import Document
from clikgen.symbolic.signals import Signal, symbol

Share = Annotated[float, Field(strict=True, ge=0, le=1)]


class Planner(Document):
    """λ while no influence region meets an obstacle (`lam_free`) and while one does (`lam_event`).

    (0, 0) is the paper's Case 1 (no filter), (1, 1) Case 2 (filter always), (0, 1) Case 3 (eq. 18).
    """

    lam_free: Share = 0.0
    lam_event: Share = 1.0

    def build(self, q_filtered: ca.SX, q_raw: ca.SX, event: ca.SX) -> tuple[ca.SX, ca.SX, tuple[Signal, ...]]:
        """q_i = A_λ q_filtered,i + (I − A_λ) q_i, eq. 17, shape (n, 1); then λ; then the inputs they need."""
        free = symbol("lam_free", (), "1", "λ while no region meets an obstacle", "parameter", (0, 1), self.lam_free)
        at_event = symbol("lam_event", (), "1", "λ while one does (eq. 18)", "parameter", (0, 1), self.lam_event)
        lam = ca.if_else(event, at_event.expression, free.expression)
        return lam * q_filtered + (1 - lam) * q_raw, lam, (free, at_event)
