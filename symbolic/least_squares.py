"""Damped least squares: one factorisation, used as often as it is wanted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import casadi as ca

if TYPE_CHECKING:  # damping.py needs the factorisation below
    from clikgen.symbolic.damping import Damping

ROUNDING = 2.0**-46  # of a sum of squares: what rounding (64 times 2^-52) can leave of a pivot that is zero


@dataclass(frozen=True, slots=True, eq=False)
class LdlFactor:
    """A = L D Lᵀ (Golub & Van Loan, Matrix Computations, 4th ed., section 4.1.2), unrolled.

    A structural zero of A costs nothing: with a diagonal A everything below is O(m).
    """

    rows: tuple[Mapping[int, ca.SX], ...]  # of L below its diagonal of ones, what is not structurally zero
    pivots: tuple[ca.SX, ...]  # the diagonal of D

    @classmethod
    def of(cls, A: ca.SX, least: ca.SX) -> Self:
        """Factor symmetric A (m, m), of which the lower triangle is read, holding pivot i at least[i] or above.

        A smaller pivot is rounding noise, zero or below, and dividing by it would send the solution anywhere.
        `least` is (m, 1), in the unit of A. The held factors are those of A + E with |E| of the order of `least`.
        """
        rows, d = list[dict[int, ca.SX]](), list[ca.SX]()
        for i in range(A.shape[0]):
            row, scaled = dict[int, ca.SX](), dict[int, ca.SX]()  # of L and, before the division, of L D
            for j in range(i):
                entry = A[i, j] - sum(scaled[k] * rows[j][k] for k in row if k in rows[j])
                if not entry.is_zero():
                    row[j], scaled[j] = entry / d[j], entry
            d.append(ca.fmax(A[i, i] - sum(scaled[k] * row[k] for k in row), least[i]))
            rows.append(row)
        return cls(tuple(rows), tuple(d))

    def solve(self, b: ca.SX) -> ca.SX:
        """A⁻¹ b for b (m, k), shape (m, k)."""
        x = self._forward(b)
        columns: list[list[int]] = [[] for _ in x]  # where L has an entry below its diagonal
        for k, row in enumerate(self.rows):
            for i in row:
                columns[i].append(k)
        for i in reversed(range(len(x))):
            x[i] = x[i] / self.pivots[i] - sum(self.rows[k][i] * x[k] for k in columns[i])
        return ca.vertcat(*x)

    def trace_of_inverse(self) -> ca.SX:
        """Trace(A⁻¹) = Σ_k |row k of L⁻¹|² / d_k, a sum of positive terms: nothing cancels."""
        rows = self._forward(ca.SX.eye(len(self.pivots)))
        return sum((ca.sumsqr(row) / pivot for row, pivot in zip(rows, self.pivots, strict=True)), ca.SX(0))

    def _forward(self, b: ca.SX) -> list[ca.SX]:
        """The rows of L⁻¹ b."""
        x: list[ca.SX] = []
        for i, row in enumerate(self.rows):
            x.append(b[i, :] - sum(row[k] * x[k] for k in row))
        return x


def damped_pseudo_inverse_times(J: ca.SX, v: ca.SX, damping: "Damping") -> ca.SX:
    """J⁺ v with J⁺ = Jᵀ(J Jᵀ + λ² I)⁻¹: the damped least-squares joint velocity, shape (n, 1).

    J (m, n), v (m, 1), λ from `damping`, in the unit of J. Finite for every finite J, J = 0 included.
    """
    gram = J @ J.T  # (m, m)
    squared = damping.squared(gram)
    damped = gram + squared * ca.SX.eye(J.shape[0])
    least = ca.repmat(squared + ROUNDING * ca.trace(damped), J.shape[0], 1)
    least[0] = damped[0, 0]  # the first pivot is a plain sum of squares: nothing cancels in it
    return J.T @ LdlFactor.of(damped, least).solve(v)
