"""A frame's orientation follows a reference: the rotation that is missing is turned about its axis."""

from typing import Literal

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.rotations import OrientationError, orientation_error, quaternion_of
from clikgen.symbolic.task import Task, gain_signal, rotation_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree


class Spec(TrackingSpec):
    """q̇ = J_ω⁺ (ω_d + K e), e = log(R_d Rᵀ) in the world [rad], without a singularity up to half a turn.

    With ω = ω_d + K e the error obeys ė = ω_d × e − J_r⁻¹(e) K e, J_r the right Jacobian of SO(3), and as
    eᵀ J_r⁻¹(e) = eᵀ, d|e|²/dt = −2 eᵀK e: for any symmetric positive definite `gain` K [1/s], and whatever ω_d, the
    angle decays at least as exp(−λ_min(K) t); for K = k·I, e seen in the reference's axes decays as exp(−kt) exactly.

    `error` = "quaternion" takes e = 2 sin(θ/2) a in place of the `axis_angle` θ a: at most 2 long instead of π, and
    slower to leave half a turn. `damping` [rad] is that of the pseudo-inverse.
    """

    kind: Literal["frame_orientation"]
    frame: str
    error: OrientationError = "axis_angle"

    def dimension(self, robot: Robot) -> int:
        """Three: an angular velocity."""
        return 3

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error log(R_d Rᵀ) [rad], J_ω (3, n) of the frame, and ω_d as feedforward; BadInput in the plane."""
        name = self.name
        if tree.robot.space == "planar":
            raise BadInput("in the plane an orientation is one angle; use the kind base_heading")
        frame = tree.robot.frame(self.frame)
        quaternion = quaternion_of(tree.rotation(frame.link, frame.rpy))
        reference = rotation_reference(name, f"R_d, how frame {frame.name} should be turned")
        error = orientation_error(reference.value.expression, quaternion, self.error)
        text = f"R of frame {frame.name}, quaternion (w, x, y, z), w >= 0"
        return self.task(
            jacobian=tree.angular_jacobian(frame.link),
            unit="rad",
            text=f"J_ω, ω = J_ω q̇ of frame {frame.name}",
            gain=gain_signal(name, 3, self.gain, "K"),
            values=(self.output("orientation", quaternion, "1", text),),
            errors=(self.output("error", error, "rad", "e, the turn from R to R_d as a vector in the world"),),
            feedforward=reference.velocity.expression,
            references=(reference,),
        )
