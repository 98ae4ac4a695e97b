"""Limits on the joint velocity, kept after the law; the ways to keep them are the files in `velocity_limits/`."""

from abc import ABC, abstractmethod

import casadi as ca

from clikgen.runtime.documents import BadInput, Document, Positive
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, symbol


class VelocityLimitSpec(Document, ABC):
    """What a spec file says of velocity limits.

    `limit` [m/s, rad/s] is one number for all joints or a list, one per joint (for a differential drive one per
    input); by default each joint's own.
    """

    kind: str
    limit: Positive | tuple[Positive, ...] | None = None

    @abstractmethod
    def limited(self, u: ca.SX, limit: ca.SX) -> ca.SX:
        """The velocity u (n, 1) brought within ±limit (n, 1)."""

    def build(self, robot: Robot, u: ca.SX) -> tuple[ca.SX, Signal]:
        """The limited velocity and the parameter it needs; raises BadInput for a joint without a limit."""
        limit = symbol(
            "velocity_limit",
            (u.numel(),),
            ", ".join(f"{moved.unit}/s" for moved in robot.inputs),
            "velocity limits: " + ", ".join(moved.name for moved in robot.inputs),
            "parameter",
            (1e-6, 1e6),
            self._default(robot),
        )
        return self.limited(u, limit.expression), limit

    def _default(self, robot: Robot) -> float | tuple[float, ...]:
        if self.limit is not None:
            return self.limit
        for moved in robot.inputs:
            if not moved.velocity:
                raise BadInput(
                    f"velocity_limits: joint '{moved.name}' has no velocity limit; give it one, "
                    "or velocity_limits.limit"
                )
        return tuple(moved.velocity or 0.0 for moved in robot.inputs)
