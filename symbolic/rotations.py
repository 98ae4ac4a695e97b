"""Orientations as quaternions (w, x, y, z), and how far one is from another, without a singularity.

SX evaluates both branches of a choice, so every division here has a denominator that cannot vanish.
"""

from typing import Literal

import casadi as ca

OrientationError = Literal["axis_angle", "quaternion"]
"""How far two orientations are apart: the rotation vector θ a, up to π long, or 2 sin(θ/2) a, up to 2 long."""

TINY = 1e-300  # a square below this is taken for zero: its root, 1e-150, is far below any rounding


def quaternion_of(R: ca.SX) -> ca.SX:
    """The unit quaternion (4, 1) of a rotation matrix (3, 3), with w >= 0 (either sign at half a turn, w = 0).

    4 q qᵀ is linear in R; Shepperd (1978): its row with the largest diagonal entry, 4 q_i² >= 1, is 4 q_i q with q_i
    far from zero, whatever the rotation; the row is twice the root of that entry long.
    """
    w = ca.horzcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])  # 4 w (x, y, z)
    trace = ca.trace(R)
    rows = [(1 + trace, ca.horzcat(1 + trace, w))]  # each after its entry of the diagonal
    for i in range(3):
        vector = [R[i, j] + R[j, i] for j in range(3)]
        vector[i] = 1 + 2 * R[i, i] - trace
        rows.append((vector[i], ca.horzcat(w[i], *vector)))
    largest, best = _larger(_larger(*rows[:2]), _larger(*rows[2:]))
    return _with_positive_w(best.T) / (2 * ca.sqrt(largest))


def _larger(one: tuple[ca.SX, ca.SX], other: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
    """Of two numbers, each with a row, the greater one with its row."""
    return ca.fmax(one[0], other[0]), ca.if_else(other[0] > one[0], other[1], one[1])


def unit_quaternion(q: ca.SX) -> ca.SX:
    """q / |q|, and the identity for a quaternion (4, 1) of zero."""
    square = ca.sumsqr(q)
    zero = square <= TINY  # asked this way round, a NaN stays one
    return ca.if_else(zero, ca.SX([1, 0, 0, 0]), q) / ca.sqrt(ca.if_else(zero, 1, square))


def quaternion_product(p: ca.SX, q: ca.SX) -> ca.SX:
    """The quaternion (4, 1) of R(p) R(q): first the turn q, then the turn p."""
    v, u = p[1:], q[1:]
    return ca.vertcat(p[0] * q[0] - ca.dot(v, u), p[0] * u + q[0] * v + ca.cross(v, u))


def orientation_error(reference: ca.SX, quaternion: ca.SX, measure: OrientationError) -> ca.SX:
    """The rotation from `quaternion` to `reference`, both (4, 1), as a vector (3, 1) [rad] in the world.

    R_e = R_d Rᵀ turns by θ <= π about a: e = log(R_e) = θ a or, as `quaternion`, 2 sin(θ/2) a. The reference may have
    any length and either sign. Smooth for θ < π; at half a turn, where ±e say the same, it is either of the two.
    """
    conjugate = ca.vertcat(quaternion[0], -quaternion[1:])
    error = _with_positive_w(quaternion_product(unit_quaternion(reference), conjugate))
    w, v = error[0], error[1:]
    if measure == "quaternion":
        return 2 * v
    # asin and acos lose half the digits at θ = π and θ = 0; atan2(n, w)/n goes to 1/w as n does to zero.
    n = ca.sqrt(ca.fmax(ca.sumsqr(v), TINY))
    return 2 * ca.atan2(n, w) / n * v


def cross_matrix(v: ca.SX) -> ca.SX:
    """[v]× with [v]× ω = v × ω for ω (3, 1): shape (3, 3) or, for a vector (2, 1) of the plane, its two rows (2, 3)."""
    x, y = v[0], v[1]
    if v.numel() == 2:
        return ca.blockcat([[0, 0, y], [0, 0, -x]])
    z = v[2]
    return ca.blockcat([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def _with_positive_w(q: ca.SX) -> ca.SX:
    """The quaternion of the same rotation whose w >= 0."""
    return ca.vertcat(ca.fabs(q[0]), ca.copysign(1, q[0]) * q[1:])
