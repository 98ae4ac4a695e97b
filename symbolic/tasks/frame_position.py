"""Trajectory tracking: a frame's position follows a reference, closed loop (eqs. 3-5)."""

from dataclasses import replace
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Task, gain_signal, vector_reference
from clikgen.symbolic.tracking import TrackingSpec
from clikgen.symbolic.tree import KinematicTree


class Spec(TrackingSpec):
    """q̇_g = J_g⁺ (ṙ_g + K_g (r_g − f_g(q))), eq. 4.

    `axes` are the world axes along which the position is held, all of them by default. `gain` is K_g [1/s]: a
    number k for k·I, a list for a diagonal, or a full symmetric positive definite matrix. `damping` [m] is that
    of the pseudo-inverse.
    """

    kind: Literal["frame_position"]
    frame: str
    axes: Annotated[tuple[Literal["x", "y", "z"], ...], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _axes_differ(self) -> Self:
        if self.axes and len(set(self.axes)) < len(self.axes):
            raise ValueError(f"wanted each axis once, got {list(self.axes)}")
        return self

    def tracked_axes(self, robot: Robot) -> tuple[int, ...]:
        """Those of `axes`; raises BadInput for z in the plane."""
        axes = tuple("xyz".index(axis) for axis in self.axes or "xyz"[: robot.dimension])
        if max(axes) >= robot.dimension:
            raise BadInput("a planar robot has the axes x and y, got z")
        return axes

    def dimension(self, robot: Robot) -> int:
        """One row an axis: 2 in the plane, 3 in space, unless `axes` says less."""
        return len(self.axes) if self.axes else robot.dimension

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error r_g − f_g(q) [m], the geometric Jacobian of the frame, and ṙ_g as feedforward."""
        name, m = self.name, self.dimension(tree.robot)
        frame = tree.robot.frame(self.frame)
        rows = list(self.tracked_axes(tree.robot))
        position = tree.position(frame.link, frame.xyz)[rows]
        reference = vector_reference(name, m, "m", f"r_g, where frame {frame.name} should be")
        task = self.task(
            jacobian=tree.position_jacobian(frame.link, frame.xyz)[rows, :],
            unit="m",
            text=f"J_g = ∂f_g/∂q of frame {frame.name}",
            gain=gain_signal(name, m, self.gain, "K_g (eq. 4)"),
            values=(self.output("position", position, "m", f"f_g(q), where frame {frame.name} is"),),
            errors=(self.output("error", reference.value.expression - position, "m", "r_g − f_g(q)"),),
            feedforward=reference.velocity.expression,
            references=(reference,),
        )
        return replace(task, values=(self.output("position", position, "m", f"position of frame {frame.name}"),))
