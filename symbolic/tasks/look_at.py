"""An axis of a frame points at a target in the world, by its stereographic projection: no singularity ahead."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Task, gain_signal, vector_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree

NEAREST = 1e-6  # [m] a target closer than this to the frame has no direction: it is taken to be this far
AWAY = 1e-12  # 1 + cos φ is held above this, where the axis points away from the target to within 1.4e-6 rad


class Spec(TrackingSpec):
    """x = 2 s_⊥ / (|s| + s_a) → 0, s = Rᵀ (target − p) the target in the frame's axes: |x| = 2 tan(φ/2), about φ.

    φ [rad] is the angle between the frame's `axis` a and the way to the target, the reference `<name>` [m] in the
    world; x has a row for each other axis of the frame, in their order (in the plane one). q̇ = J⁺ (−∂x/∂s Rᵀ ṫ − K x),
    J = ∂x/∂s ∂s/∂q, so that φ obeys φ̇ = −k sin φ. Smooth but where the axis points exactly away from the target:
    there x is taken to be 0, an equilibrium that the least disturbance leaves. `damping` [rad].
    """

    kind: Literal["look_at"]
    frame: str
    axis: Literal["x", "y", "z"] = "z"

    def dimension(self, robot: Robot) -> int:
        """A direction's: 2, in the plane 1."""
        return robot.dimension - 1

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error −x, J = ∂x/∂q, and what the target's motion does to x as feedforward; BadInput for z in a plane."""
        name, d, m = self.name, tree.robot.dimension, self.dimension(tree.robot)
        along = "xyz".index(self.axis)
        if along >= d:
            raise BadInput("a planar robot looks along x or y, got axis z")
        frame = tree.robot.frame(self.frame)
        target = vector_reference(name, d, "m", f"target that frame {frame.name} looks at")
        rotation = tree.rotation(frame.link, frame.rpy)[:d, :d]
        s, s_jacobian = tree.seen_from(frame, target.value.expression, ca.SX.zeros(d, tree.q.numel()))
        x, slope = _projected(s, along)
        return self.task(
            jacobian=slope @ s_jacobian,
            unit="rad",
            text=f"J = ∂x/∂q of frame {frame.name}",
            gain=gain_signal(name, m, self.gain, "K"),
            values=(self.output("value", x, "rad", f"x, the target off the {self.axis} axis of {frame.name}"),),
            errors=(self.output("error", -x, "rad", "−x"),),
            feedforward=-slope @ (rotation.T @ target.velocity.expression),
            references=(target,),
        )


def _projected(s: ca.SX, along: int) -> tuple[ca.SX, ca.SX]:
    """x = 2 s_⊥/D (m, 1), D = |s| + s_a, and ∂x/∂s = 2/D (E_⊥ − s_⊥/|s| (E_⊥ᵀ x/2 + e_a)ᵀ), shape (m, d)."""
    identity = ca.SX.eye(s.numel())
    across = identity[[i for i in range(s.numel()) if i != along], :]  # E_⊥, (m, d)
    length = ca.sqrt(ca.fmax(ca.sumsqr(s), NEAREST**2))
    D = ca.fmax(length + s[along], AWAY * length)
    x = 2 * (across @ s) / D
    return x, 2 / D * (across - (across @ s) / length @ (across.T @ x / 2 + identity[:, along]).T)
