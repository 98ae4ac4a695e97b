"""A frame's orientation follows a reference: the rotation that is missing is turned about its axis."""

from typing import Literal

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.damping import DampingSpec, damping_signals
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.rotations import OrientationError, orientation_error, quaternion_of
from clikgen.symbolic.signals import result
from clikgen.symbolic.task import (
    NEAR_SINGULARITY,
    GainSpec,
    Task,
    TaskSpec,
    gain_signal,
    jacobian_result,
    rotation_reference,
)
from clikgen.symbolic.tree import KinematicTree


class Spec(TaskSpec):
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
    gain: GainSpec
    damping: DampingSpec = NEAR_SINGULARITY

    @property
    def equality(self) -> bool:
        """Tracking holds always."""
        return True

    def dimension(self, robot: Robot) -> int:
        """Three: an angular velocity."""
        return 3

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error log(R_d Rᵀ) [rad], J_ω (3, n) of the frame, and ω_d as feedforward; BadInput in the plane."""
        name = self.name
        if tree.robot.space == "planar":
            raise BadInput(f"task '{name}': in the plane an orientation is one angle; use the kind base_heading")
        frame = tree.robot.frame(self.frame)
        quaternion = quaternion_of(tree.rotation(frame.link, frame.rpy))
        jacobian = tree.angular_jacobian(frame.link)
        reference = rotation_reference(name, f"R_d, how frame {frame.name} should be turned")
        gain = gain_signal(name, 3, self.gain, "K")
        damping, damping_parameters = damping_signals(name, "rad", self.damping)
        error = orientation_error(reference.value.expression, quaternion, self.error)
        orientation = result(
            f"{name}_orientation", quaternion, (4,), "1", f"R of frame {frame.name}, quaternion (w, x, y, z), w >= 0"
        )
        return Task(
            name=name,
            jacobian=jacobian,
            error=error,
            feedforward=reference.velocity.expression,
            gain=gain.expression,
            damping=damping,
            parameters=(gain, *damping_parameters),
            diagnostics=(
                orientation,
                result(f"{name}_error", error, (3,), "rad", "e, the turn from R to R_d as a vector in the world"),
            ),
            values=(orientation,),
            jacobians=(jacobian_result(name, jacobian, "rad", f"J_ω, ω = J_ω q̇ of frame {frame.name}"),),
            references=(reference,),
        )
