"""Trajectory tracking: a frame's position follows a reference, closed loop (eqs. 3-5)."""

from typing import Literal

from clikgen.runtime.documents import Number, Positive
from clikgen.symbolic.chain import SerialChain
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.task import Task, TaskSpec


class Spec(TaskSpec):
    """q̇_g = J_g⁺ (ṙ_g + K_g (r_g − f_g(q))), eq. 4.

    `gain` is K_g [1/s]: a number k for k·I, a list for a diagonal, or a full symmetric positive definite
    matrix. `damping` [m] is that of the pseudo-inverse.
    """

    kind: Literal["frame_position"]
    frame: str
    gain: Number | tuple[Number, ...] | tuple[tuple[Number, ...], ...]
    damping: Positive

    @property
    def equality(self) -> bool:
        """Tracking holds always."""
        return True

    def dimension(self, robot: Robot) -> int:
        """2 in the plane, 3 in space."""
        return robot.dimension

    def build(self, chain: SerialChain, sensing: Sensing | None) -> Task:
        """The error r_g − f_g(q) [m], the geometric Jacobian of the frame, and ṙ_g as feedforward."""
        m, name = chain.robot.dimension, self.name
        frame = chain.robot.frame(self.frame)
        position = chain.position(frame.link, frame.xyz)
        jacobian = chain.position_jacobian(frame.link, frame.xyz)
        reference = symbol(
            f"{name}_reference", (m,), "m", f"r_g, where frame {frame.name} should be", "signal", (-1e6, 1e6)
        )
        velocity = symbol(f"{name}_reference_velocity", (m,), "m/s", "its time derivative ṙ_g", "signal", (-1e6, 1e6))
        gain = symbol(
            f"{name}_gain",
            (m, m),
            "1/s",
            "K_g, symmetric positive definite (eq. 4)",
            "parameter",
            (-1e4, 1e4),
            self.gain,
            positive_definite=True,
        )
        damping = symbol(f"{name}_damping", (), "m", "damping of J_g⁺", "parameter", (1e-6, 1e3), self.damping)
        error = reference.expression - position
        return Task(
            name=name,
            jacobian=jacobian,
            error=error,
            feedforward=velocity.expression,
            gain=gain.expression,
            damping=damping.expression,
            inputs=(reference, velocity, gain, damping),
            diagnostics=(
                result(f"{name}_position", position, (m,), "m", f"f_g(q), where frame {frame.name} is"),
                result(f"{name}_error", error, (m,), "m", "r_g − f_g(q)"),
            ),
            positions=(result(f"{name}_position", position, (m,), "m", f"position of frame {frame.name}"),),
            jacobians=(
                result(
                    f"{name}_jacobian",
                    jacobian,
                    (m, chain.q.numel()),
                    "m per joint unit",
                    f"J_g = ∂f_g/∂q of frame {frame.name}",
                ),
            ),
        )
