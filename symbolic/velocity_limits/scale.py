"""Velocity limits by uniform scaling: the whole joint velocity shrinks, so every task keeps its direction."""

from typing import Literal

import casadi as ca

from clikgen.symbolic.velocity_limit import VelocityLimitSpec


class Spec(VelocityLimitSpec):
    """u ← u / max(1, max_i |u_i| / v_i): continuous, and all tasks slow down alike."""

    kind: Literal["scale"]

    def limited(self, u: ca.SX, limit: ca.SX) -> ca.SX:
        """The largest multiple of u (n, 1), up to u itself, within ±limit (n, 1)."""
        return u / ca.fmax(1, ca.mmax(ca.fabs(u) / limit))
