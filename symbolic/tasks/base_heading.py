"""The direction a frame's x axis has, seen from above, follows a reference: a base's heading."""

import math
from typing import Literal

import casadi as ca

from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Task, gain_signal, vector_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree

UPRIGHT = 1e-12  # a_x² + a_y² is held above this: an axis within 1e-6 rad of the vertical has no heading


class Spec(TrackingSpec):
    """ψ = atan2(a_y, a_x) of the x axis a of `frame`, q̇ = J⁺ (ψ̇_d + K e), e = ψ_d − ψ wrapped into (−π, π].

    J = (a_x ȧ_y − a_y ȧ_x)/(a_x² + a_y²) with ȧ = ω × a, so ψ̇ = ω_z − a_z (a_x ω_x + a_y ω_y)/(a_x² + a_y²). The
    reference ψ_d [rad] is the vector of one number `<name>`. `gain` K [1/s], `damping` [rad].
    """

    kind: Literal["base_heading"]
    frame: str

    def dimension(self, robot: Robot) -> int:
        """One: an angle."""
        return 1

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error e [rad], J = ∂ψ/∂q (1, n), and ψ̇_d as feedforward."""
        name = self.name
        frame = tree.robot.frame(self.frame)
        x, y, z = ca.vertsplit(tree.rotation(frame.link, frame.rpy)[:, 0])
        heading = ca.atan2(y, x)
        tilt = z / ca.fmax(x**2 + y**2, UPRIGHT)
        reference = vector_reference(name, 1, "rad", f"ψ_d, the heading that frame {frame.name} should have")
        error = _wrapped(reference.value.expression - heading)
        return self.task(
            jacobian=ca.horzcat(-tilt * x, -tilt * y, 1) @ tree.angular_jacobian(frame.link),
            unit="rad",
            text=f"J = ∂ψ/∂q of frame {frame.name}",
            gain=gain_signal(name, 1, self.gain, "K"),
            values=(self.output("value", heading, "rad", f"ψ, the heading of frame {frame.name}, −π to π"),),
            errors=(self.output("error", error, "rad", "ψ_d − ψ, in (−π, π]"),),
            feedforward=reference.velocity.expression,
            references=(reference,),
        )


def _wrapped(angle: ca.SX) -> ca.SX:
    """The angle less as many turns as bring it into (−π, π], which leaves one that is there as it is."""
    return angle - 2 * math.pi * ca.ceil((angle - math.pi) / (2 * math.pi))
