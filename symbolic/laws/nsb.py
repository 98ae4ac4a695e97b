"""Null-space-based behavioural control: each task within the null space of those above it (eqs. 11-12)."""

from collections.abc import Sequence

import casadi as ca

from clikgen.symbolic.least_squares import damped_pseudo_inverse_times
from clikgen.symbolic.task import Task


def combine(tasks: Sequence[Task]) -> ca.SX:
    """q̇ = q̇_1 + (I − J_1⁺J_1)(q̇_2 + (I − J_2⁺J_2)(…)), eq. 11 for any number of levels, shape (n, 1).

    `tasks` in priority order, the highest first, q̇_i = J_i⁺(ẋ_i + K_i e_i). From the lowest upward each level
    is q̇ ← q̇ + J_i⁺(ẋ_i + K_i e_i − J_i q̇): the same value, with one factorisation and one right-hand side.
    """
    dq = ca.SX.zeros(tasks[0].jacobian.shape[1])
    for task in reversed(tasks):
        dq += damped_pseudo_inverse_times(task.jacobian, task.velocity - task.jacobian @ dq, task.damping)
    return dq
