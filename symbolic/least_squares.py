"""Damped least squares: the one inverse this project uses."""

import casadi as ca

ROUNDING = 2.0**-46  # of the trace: what rounding (64 times 2^-52) can leave of a pivot that is zero


def damped_pseudo_inverse_times(J: ca.SX, v: ca.SX, damping: ca.SX) -> ca.SX:
    """J⁺ v with J⁺ = Jᵀ(J Jᵀ + damping² I)⁻¹: the damped least-squares joint velocity, shape (n, 1).

    J (m, n), v (m, 1), damping a scalar > 0 in the unit of J. Finite for every finite J, J = 0 included.
    """
    m = J.shape[0]
    gram = J @ J.T + damping**2 * ca.SX.eye(m)  # (m, m)
    return J.T @ _ldl_solve(gram, v, smallest_pivot=damping**2 + ROUNDING * ca.trace(gram))


def _ldl_solve(A: ca.SX, b: ca.SX, smallest_pivot: ca.SX) -> ca.SX:
    """Solve A x = b for symmetric A (m, m) and b (m, 1) by one LDLᵀ factorisation, unrolled.

    A pivot below smallest_pivot is held there: at a singular J it is rounding noise, zero or below, and dividing
    by it would send the solution anywhere.
    """
    m = A.shape[0]
    L = ca.SX.eye(m)
    d: list[ca.SX] = []
    x: list[ca.SX] = []
    for i in range(m):
        for j in range(i):
            L[i, j] = (A[i, j] - sum(L[i, k] * d[k] * L[j, k] for k in range(j))) / d[j]
        pivot = A[i, i] - sum(L[i, k] ** 2 * d[k] for k in range(i))
        d.append(pivot if i == 0 else ca.fmax(pivot, smallest_pivot))
        x.append(b[i] - sum(L[i, k] * x[k] for k in range(i)))
    for i in reversed(range(m)):
        x[i] = x[i] / d[i] - sum(L[k, i] * x[k] for k in range(i + 1, m))
    return ca.vertcat(*x)
