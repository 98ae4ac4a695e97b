"""Velocity limits joint by joint: each velocity stops at its own limit, and the tasks bend."""

from typing import Literal

import casadi as ca

from clikgen.symbolic.velocity_limit import VelocityLimitSpec


class Spec(VelocityLimitSpec):
    """u_i ← min(max(u_i, −v_i), v_i): continuous; the other joints go on, so a task's direction changes."""

    kind: Literal["clamp"]

    def limited(self, u: ca.SX, limit: ca.SX) -> ca.SX:
        """The vector within ±limit (n, 1) that is nearest to u (n, 1)."""
        return ca.fmin(ca.fmax(u, -limit), limit)
