"""Augmented projection: each task within the null space of all those above it together (Siciliano & Slotine 1991)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Self

import casadi as ca

from clikgen.symbolic.damping import TINY, near_singular
from clikgen.symbolic.least_squares import ROUNDING, LdlFactor
from clikgen.symbolic.task import Task

GUARD = 2.0**-30  # of |J|²: the least λ² of a task of which nothing is left in some direction, (3e-5 |J|)²
CONFLICT = 2.0**-28  # of |J|²: the s² from which a task has all its directions, (6e-5 |J|)²; no guard there
SPENT = 2.0**-86  # of a row's square: below it (1e-13 of its length) what is left of a row is rounding noise


def combine(tasks: Sequence[Task]) -> ca.SX:
    """q̇ ← q̇ + P J_kᵀ(J_k P J_kᵀ + λ_k² I)⁻¹(ẋ_k + K_k e_k − J_k q̇) from the highest task down, shape (n, 1).

    P, from P = I, is the projector on the null space of J_1 … J_{k−1} stacked, J_k (m_k, n); its (n, n) is never
    formed. With λ = 0 this is
    q̇_k = q̇_{k−1} + (J_k P)⁺(v_k − J_k q̇_{k−1}) (Siciliano & Slotine, ICAR 1991). Two levels read
    q̇ = q̇_1 + (J_2P_1)⁺(v_2 − J_2q̇_1): no secondary tracking is lost where the tasks are compatible, which
    successive projection (`nsb`) loses unless the row spaces are orthogonal.

    P = S Sᵀ is kept as Potter's square root of recursive least squares (Bierman 1977, ch. II), S = E_1 E_2 …
    with one projector E per row of the tasks. The square F Fᵀ of F = J S cannot come out indefinite, and S Sᵀ
    projects twice, so that no lower task changes J_k q̇ by more than rounding, whatever the damping and the
    condition of the stack.

    Where a task is singular, the direction it is losing is anybody's guess, and what that direction is to the tasks
    below would turn at once. So what lies below a selectively damped task moves by the share
    1 − (1 − s²/ε²)² of its velocity that `Damping.regularity` gives: all of it but near the singularity, none at
    it. That makes q̇ continuous. A task below one that is singular everywhere therefore never moves: give that one
    fewer rows, or constant damping.

    A task that moves every joint, J = I, takes all that is left: (P)⁺ = P, so it needs no inverse, and ends the list.
    """
    dq = ca.SX.zeros(tasks[0].jacobian.shape[1])
    root: list[_Deflation] = []  # S, its factors from left to right
    share = ca.SX(1)
    for task in tasks:
        J = task.jacobian
        residual = share * (task.velocity - J @ dq)
        if _is_identity(J):
            return dq + reduce(_deflated, reversed(root), reduce(_deflated, root, residual))
        F = reduce(_deflated, root, J.T)  # Sᵀ Jᵀ, (n, m)
        gram = F.T @ F  # J P Jᵀ, (m, m)
        row_squares = ca.sum2(J**2)  # (m, 1)
        squared = _guarded(task.damping.squared(gram), gram, ca.sum1(row_squares))
        factor = LdlFactor.of(gram + squared * ca.SX.eye(J.shape[0]), squared + ROUNDING * row_squares)
        dq += reduce(_deflated, reversed(root), F @ factor.solve(residual))
        root += _deflations(F, row_squares, task.damping.projector_squared())  # the last ones remain unused
        share *= task.damping.regularity(gram)
    return dq


def _is_identity(J: ca.SX) -> bool:
    """Whether J is the identity, whatever q."""
    rows, n = J.shape
    return bool(rows == n and (J - ca.SX.eye(n)).is_zero())


def _guarded(squared: ca.SX, gram: ca.SX, jacobian_squared: ca.SX) -> ca.SX:
    """λ², or more where a direction of the task is gone and λ alone would divide rounding noise by next to nothing.

    Rounding leaves eps |J|² of an eigenvalue of `gram` that is zero, so eps/GUARD = 2e-7 is what it can change of
    the least-squares velocity there. A task that has all its directions is left exactly as it is.
    """
    guard = near_singular(gram, GUARD * jacobian_squared, CONFLICT * jacobian_squared + TINY)
    return ca.fmax(squared, guard)


@dataclass(frozen=True, slots=True, eq=False)
class _Deflation:
    """E = I − γ f fᵀ, (n, n): the square root of the projector I − f fᵀ/(|f|² + μ²) that takes f out."""

    f: ca.SX  # (n, 1)
    gamma: ca.SX  # scalar

    @classmethod
    def of(cls, f: ca.SX, row_square: ca.SX, squared: ca.SX) -> Self:
        """E² = I − f fᵀ/g for g = |f|² + μ² wants γ = 1/(g + μ√g); `squared` is μ², `row_square` what |f|² was."""
        g = ca.fmax(ca.sumsqr(f), SPENT * row_square + TINY) + squared
        return cls(f, 1 / (g + ca.sqrt(squared * g)))


def _deflated(X: ca.SX, by: _Deflation) -> ca.SX:
    """E X, shape of X (n, k)."""
    return X - by.f @ (by.gamma * (by.f.T @ X))


def _deflations(F: ca.SX, row_squares: ca.SX, squared: ca.SX) -> list[_Deflation]:
    """The factors that take one column of F (n, m) after the other out, each by what those before left of it."""
    factors: list[_Deflation] = []
    for i in range(F.shape[1]):
        f = reduce(_deflated, factors, F[:, i])
        factors.append(_Deflation.of(f, row_squares[i], squared))
    return factors
