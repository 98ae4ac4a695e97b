"""Posture: joints go where a reference says, closed loop."""

from typing import Annotated, Literal

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, Number
from clikgen.symbolic.damping import DampingSpec, damping_signals
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import (
    NEAR_SINGULARITY,
    GainSpec,
    Task,
    TaskSpec,
    gain_signal,
    jacobian_result,
    joint_units,
    selected_joints,
    vector_reference,
)
from clikgen.symbolic.tree import KinematicTree


class Spec(TaskSpec):
    """q̇_s = ṙ + K (r − q_s) for the selected joints q_s = S q, so J = S, the rows of the identity.

    `joints` are their names, in order; all by default. `posture` [m, rad] is where they go while no reference is
    given. `gain` is K [1/s]: a number or a list, which becomes a parameter (k,) and costs O(k) operations, or a
    full symmetric positive definite matrix (k, k), which costs O(k²). `damping` [1] matters below tasks that
    leave no room for all k rows: alone, J Jᵀ = I, the default one is exactly zero.
    """

    kind: Literal["posture"]
    joints: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    posture: tuple[Number, ...]
    gain: GainSpec
    damping: DampingSpec = NEAR_SINGULARITY

    @property
    def equality(self) -> bool:
        """It holds always."""
        return True

    def dimension(self, robot: Robot) -> int:
        """k, one row a joint."""
        return len(selected_joints(robot, self.joints))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """The error r − q_s [m, rad], J = S and ṙ as feedforward; raises BadInput for joints that do not fit."""
        name, joints = self.name, selected_joints(tree.robot, self.joints)
        k, unit = len(joints), joint_units(tree.robot, joints)
        names = ", ".join(tree.robot.coordinates[i].name for i in joints)
        if len(self.posture) != k:
            raise BadInput(
                f"task '{name}': posture, the default of {name}_reference: wanted shape ({k},), "
                f"got ({len(self.posture)},); the joints are {names}"
            )
        value, jacobian = tree.q[joints], ca.SX.eye(tree.q.numel())[joints, :]
        reference = vector_reference(name, k, unit, f"r, where these joints should be: {names}", self.posture)
        gain, gain_matrix = self._gain(k)
        damping, damping_parameters = damping_signals(name, "1", self.damping)
        error = reference.value.expression - value
        measured = result(f"{name}_value", value, (k,), unit, f"q_s: {names}")
        return Task(
            name=name,
            jacobian=jacobian,
            error=error,
            feedforward=reference.velocity.expression,
            gain=gain_matrix,
            damping=damping,
            parameters=(gain, *damping_parameters),
            diagnostics=(measured, result(f"{name}_error", error, (k,), unit, "r − q_s")),
            values=(measured,),
            jacobians=(jacobian_result(name, jacobian, "1", "S = ∂q_s/∂q"),),
            references=(reference,),
        )

    def _gain(self, size: int) -> tuple[Signal, ca.SX]:
        """The parameter, and K as a matrix: diagonal, with structural zeros, unless `gain` is a full matrix."""
        if isinstance(self.gain, tuple) and isinstance(self.gain[0], tuple):
            full = gain_signal(self.name, size, self.gain)
            return full, full.expression
        diagonal = symbol(f"{self.name}_gain", (size,), "1/s", "diagonal of K", "parameter", (0.0, 1e4), self.gain)
        return diagonal, ca.diag(diagonal.expression)
