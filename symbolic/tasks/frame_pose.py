"""A frame's position and orientation follow two references, as one task of six rows."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.rotations import OrientationError, orientation_error, quaternion_of
from clikgen.symbolic.task import Task, gain_signal, rotation_reference, vector_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree


class Spec(TrackingSpec):
    """q̇ = [J_p; J_ω]⁺ ([ṙ_d; ω_d] + K [r_d − f(q); e]), with e = log(R_d Rᵀ) in the world [rad].

    The position r_d [m] is the reference `<name>`, the orientation R_d the reference `<name>_orientation`. `gain` is
    K [1/s]: a number, a list of six or a full 6x6 symmetric positive definite matrix, position first; `error` is as for
    frame_orientation, which also says how e decays. `damping` weighs metres and radians alike: where no q̇ meets
    both, a metre of the one counts as a radian of the other.
    """

    kind: Literal["frame_pose"]
    frame: str
    error: OrientationError = "axis_angle"

    def tracked_axes(self, robot: Robot) -> tuple[int, ...]:
        """All of them."""
        return (0, 1, 2)

    def dimension(self, robot: Robot) -> int:
        """Six: a velocity, then an angular velocity."""
        return 6

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """Both errors [m; rad], both Jacobians (6, n), ṙ_d and ω_d as feedforward; BadInput in the plane."""
        name = self.name
        if tree.robot.space == "planar":
            raise BadInput("a planar robot has no pose; use the kinds frame_position and base_heading")
        frame = tree.robot.frame(self.frame)
        position = tree.position(frame.link, frame.xyz)
        quaternion = quaternion_of(tree.rotation(frame.link, frame.rpy))
        place = vector_reference(name, 3, "m", f"r_d, where frame {frame.name} should be")
        turn = rotation_reference(f"{name}_orientation", f"R_d, how frame {frame.name} should be turned")
        error = orientation_error(turn.value.expression, quaternion, self.error)
        return self.task(
            jacobian=ca.vertcat(tree.position_jacobian(frame.link, frame.xyz), tree.angular_jacobian(frame.link)),
            unit="m, rad",
            text=f"J = [J_p; J_ω] of frame {frame.name}",
            gain=gain_signal(name, 6, self.gain, "K, position first"),
            values=(
                self.output("position", position, "m", f"f(q), where frame {frame.name} is"),
                self.output("orientation", quaternion, "1", "R, quaternion (w, x, y, z), w >= 0"),
            ),
            errors=(
                self.output("error", place.value.expression - position, "m", "r_d − f(q)"),
                self.output("orientation_error", error, "rad", "e, the turn from R to R_d"),
            ),
            feedforward=ca.vertcat(place.velocity.expression, turn.velocity.expression),
            references=(place, turn),
        )
