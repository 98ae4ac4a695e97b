"""Manipulability: joints climb the gradient of Yoshikawa's measure, away from singular configurations."""

from itertools import combinations
from typing import Annotated, Literal

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, NonNegative
from clikgen.symbolic.damping import DampingSpec, damping_signals
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Frame, Robot
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.task import NEAR_SINGULARITY, Task, TaskSpec, jacobian_result, joint_units, selected_joints
from clikgen.symbolic.tree import KinematicTree

SINGULAR = 1e-6  # below this w the ascent fades out: at w = 0 the gradient has no direction


class Spec(TaskSpec):
    """q̇_s = k ∂w/∂q_s with w = √det(J Jᵀ) (Yoshikawa 1985), J the Jacobian of a frame's motion.

    `of` says which: its position, its orientation or both. The task has a row for each of the selected `joints`
    (all by default), so it leaves nothing for tasks below it: it suits the lowest level, where the law takes the
    part of the gradient that the tasks above leave free. w mixes m and rad as J does. `gain` is k in joint unit
    squared per second and unit of w; `damping` [1] matters below tasks that leave no room for all its rows.
    """

    kind: Literal["manipulability"]
    frame: str
    of: Literal["position", "orientation", "pose"] = "position"
    joints: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    gain: NonNegative
    damping: DampingSpec = NEAR_SINGULARITY

    @property
    def equality(self) -> bool:
        """It acts always."""
        return True

    def dimension(self, robot: Robot) -> int:
        """One row a selected joint."""
        return len(selected_joints(robot, self.joints))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """∂w/∂q_s as the error, J = S; raises BadInput for a frame that can never move as `of` says."""
        name, joints = self.name, selected_joints(tree.robot, self.joints)
        k, unit = len(joints), joint_units(tree.robot, joints)
        w, gradient = self._measure(tree, tree.robot.frame(self.frame))
        value = result(f"{name}_value", w, (), "1", f"w of the {self.of} of frame {self.frame}")
        gain = symbol(f"{name}_gain", (), "1/s", "k, step along ∂w/∂q", "parameter", (0.0, 1e6), self.gain)
        damping, damping_parameters = damping_signals(name, "1", self.damping)
        error = gradient[joints]
        return Task(
            name=name,
            jacobian=ca.SX.eye(tree.q.numel())[joints, :],
            error=error,
            feedforward=ca.SX.zeros(k),
            gain=gain.expression,
            damping=damping,
            parameters=(gain, *damping_parameters),
            diagnostics=(value, result(f"{name}_error", error, (k,), f"1 per {unit}", "∂w/∂q of the selected joints")),
            values=(value,),
            jacobians=(jacobian_result(name, gradient.T, "1", "∂w/∂q"),),
        )

    def _measure(self, tree: KinematicTree, frame: Frame) -> tuple[ca.SX, ca.SX]:
        """w and ∂w/∂q (n, 1), which is ∂(w²)/∂q / 2w where w > SINGULAR and fades to zero below."""
        J = self._jacobian(tree, frame)
        squared = determinant(J @ J.T)
        w = ca.sqrt(ca.fmax(squared, 0))
        return w, ca.gradient(squared, tree.q) / (2 * ca.fmax(w, SINGULAR))

    def _jacobian(self, tree: KinematicTree, frame: Frame) -> ca.SX:
        """J(q) (m, n_u) of the frame's motion, by the inputs of the robot; in the plane it turns about z alone."""
        position = tree.position_jacobian(frame.link, frame.xyz)
        angular = tree.angular_jacobian(frame.link)[0 if tree.robot.space == "spatial" else 2 :, :]
        J = {"position": position, "orientation": angular, "pose": ca.vertcat(position, angular)}[self.of]
        J @= tree.velocity_map()
        rank = ca.sprank(ca.sparsify(J))
        if rank < J.shape[0]:
            raise BadInput(
                f"the robot's joints move the {self.of} of frame '{self.frame}' in {rank} of "
                f"{J.shape[0]} directions at most, so w is zero everywhere"
            )
        return J


def determinant(A: ca.SX) -> ca.SX:
    """Det A of a square matrix (m, m), by Laplace expansion with shared minors: m 2^(m−1) products, no division."""
    m = A.shape[0]
    minors: dict[tuple[int, ...], ca.SX] = {(): ca.SX(1)}
    for i in range(m):
        minors = {
            columns: sum(
                (-1) ** (i + j) * A[i, column] * minors[columns[:j] + columns[j + 1 :]]
                for j, column in enumerate(columns)
            )
            for columns in combinations(range(m), i + 1)
        }
    return minors[tuple(range(m))]
