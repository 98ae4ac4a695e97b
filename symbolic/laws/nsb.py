"""Null-space-based behavioural control: each task within the null space of those above it (eqs. 11-12)."""

from collections.abc import Sequence

import casadi as ca

from clikgen.symbolic.least_squares import damped_pseudo_inverse_times
from clikgen.symbolic.task import Task


def combine(tasks: Sequence[Task]) -> ca.SX:
    """q̇ = q̇_1 + (I − J_1⁺J_1)(q̇_2 + (I − J_2⁺J_2)(…)), eq. 11 for any number of levels, shape (n, 1).

    `tasks` in priority order, the highest first, q̇_i = J_i⁺(ẋ_i + K_i e_i). From the lowest upward each level
    is q̇ ← q̇ + J_i⁺(ẋ_i + K_i e_i − J_i q̇): the same value, with one factorisation and one right-hand side.

    What a lower task may change, z being all that lies below level k, undamped: nothing of J_1 q̇. Of J_k q̇ it
    changes J_k N_1⋯N_k z, which is zero for every z if the projectors on the row spaces of J_k and of each J_i
    above it commute (spaces orthogonal or nested are the usual case); for k = 2 only then. `augmented` has no
    such condition. With damping λ, J_1 q̇ changes by J_1(I − J_1⁺J_1) z = Σ σ_i λ²/(σ_i² + λ²) u_i v_iᵀ z, so
    |J_1(I − J_1⁺J_1) z| <= max_i σ_i λ²/(σ_i² + λ²) |z| <= λ|z|/2, the latter reached at σ_i = λ.
    """
    dq = ca.SX.zeros(tasks[0].jacobian.shape[1])
    for task in reversed(tasks):
        dq += damped_pseudo_inverse_times(task.jacobian, task.velocity - task.jacobian @ dq, task.damping)
    return dq
