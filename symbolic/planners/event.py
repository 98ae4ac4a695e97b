"""The paper's planner: λ jumps when an influence region meets an obstacle (eqs. 16-18)."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import casadi as ca

from clikgen.symbolic.planner import Motion, Plan, PlannerSpec

if TYPE_CHECKING:
    from clikgen.symbolic.filters.first_order import Spec as AnyFilter


class Spec(PlannerSpec):
    """λ = lam_event while 𝓘 ∩ 𝓞 ≠ ∅ and lam_free otherwise, eq. 18; q_{i−1} of eq. 16 is where the period begins.

    That scales every velocity by 1 − λ(1 − β): where λ jumps so does the velocity, and at λ = 1 a ramp at v is
    followed with the lag v/(2π f_c K T).
    """

    kind: Literal["event"] = "event"

    def build(self, motion: Motion, chosen: "AnyFilter") -> Plan:
        """Eqs. 16, 18 and 17, in this order."""
        free, at_event = self.shares()
        lam = ca.if_else(motion.event, at_event.expression, free.expression)  # eq. 18
        share, filter_inputs = motion.share(lam, chosen)  # eqs. 16 and 17
        return Plan(share * motion.dq_law, lam, (*filter_inputs, free, at_event))


def by_default(table: Any) -> Any:
    """A table that names no kind, read as the paper's; anything else as it is."""
    return Spec.model_validate(table) if isinstance(table, Mapping) and "kind" not in table else table
