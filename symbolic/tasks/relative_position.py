"""Where one frame is, as another one sees it, follows a reference: two arms that work together."""

from typing import Literal

from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Task, gain_signal, vector_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree


class Spec(TrackingSpec):
    """r = R_Aᵀ (p_B − p_A), q̇ = J⁺ (ṙ_d + K (r_d − r)) with J = R_Aᵀ (J_B − J_A + [p_B − p_A]× J_ωA).

    B is `frame` and A is `relative_to`, in whose axes r [m] and its reference are expressed. What moves both alike
    cancels. `gain` K [1/s] and `damping` [m] are as for frame_position.
    """

    kind: Literal["relative_position"]
    frame: str
    relative_to: str

    def dimension(self, robot: Robot) -> int:
        """As many as a position has: 2 in the plane, 3 in space."""
        return robot.dimension

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error r_d − r [m], J = ∂r/∂q, and ṙ_d as feedforward."""
        name, m = self.name, self.dimension(tree.robot)
        frame, observer = tree.robot.frame(self.frame), tree.robot.frame(self.relative_to)
        position, jacobian = tree.seen_from(
            observer, tree.position(frame.link, frame.xyz), tree.position_jacobian(frame.link, frame.xyz)
        )
        reference = vector_reference(name, m, "m", f"r_d, where {observer.name} should see {frame.name}")
        return self.task(
            jacobian=jacobian,
            unit="m",
            text=f"J = ∂r/∂q of {frame.name} from {observer.name}",
            gain=gain_signal(name, m, self.gain, "K"),
            values=(self.output("position", position, "m", f"r, {frame.name} in the axes of {observer.name}"),),
            errors=(self.output("error", reference.value.expression - position, "m", "r_d − r"),),
            feedforward=reference.velocity.expression,
            references=(reference,),
        )
