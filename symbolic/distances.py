"""Nearest points and directions between points and segments, finite whatever coincides or is parallel."""

import casadi as ca

COINCIDENT = 1e-12  # [m] nearer than this, the direction from one point to another is +x


def apart(toward: ca.SX, length: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The vector (2 or 3, 1) and its length where that is above COINCIDENT, else both with 1 added along +x.

    One sum each, in place of a choice for every element: compilers make vectors of loops without branches.
    """
    coincident = length <= COINCIDENT
    return toward + coincident * ca.SX.eye(toward.numel())[:, 0], length + coincident


def direction(toward: ca.SX, squared: ca.SX | None = None) -> tuple[ca.SX, ca.SX]:
    """The unit vector along `toward` (2 or 3, 1), +x where that is zero, and its length [m].

    `squared` is its squared length, where that is known.
    """
    length = ca.sqrt(ca.sumsqr(toward) if squared is None else squared)
    along, divisor = apart(toward, length)
    return along / divisor, length


def is_nearer(squared: ca.SX, radius: ca.SX, other_squared: ca.SX, other_radius: ca.SX) -> ca.SX:
    """Whether √a − r < √b − ρ, the distances to two balls, from a, r and b, ρ: without a root.

    With δ = r − ρ and h = a − b − δ² that is h < 2δ√b, so h|h| < 4δ|δ|b, and √b + δ > 0.
    """
    delta = radius - other_radius
    square = delta**2
    h = squared - other_squared - square
    below = h * ca.fabs(h) < 4 * delta * ca.fabs(delta) * other_squared
    return ca.logic_and(below, ca.logic_or(delta > 0, other_squared > square))


def nearest_on_segment(start: ca.SX, end: ca.SX, point: ca.SX) -> ca.SX:
    """The point of the segment from `start` to `end` that is nearest to `point`; start when they coincide."""
    along = end - start
    squared = ca.sumsqr(along)
    share = ca.dot(point - start, along) / ca.fmax(squared, COINCIDENT**2)
    return start + _clamped(share) * along


def nearest_on_segments(start_1: ca.SX, end_1: ca.SX, start_2: ca.SX, end_2: ca.SX) -> tuple[ca.SX, ca.SX]:
    """The point of each of two segments that is nearest to the other one, each (2 or 3, 1); no branches.

    With u and v along the segments and w from start_1 to start_2, start_1 + s u with
    s = (w × v)·(u × v) / |u × v|² is nearest to the whole second line. From the point of segment 1 at that s,
    clamped, the nearest point of segment 2, and from there the nearest one of segment 1, are the solution
    (Ericson, Real-Time Collision Detection, 5.1.9). The products u × v keep s exact to rounding / sin(u, v), so
    the distance is exact to rounding at every angle. Of parallel segments, or ones that are points, each s will do.
    """
    u, v, w = in_space(end_1 - start_1), in_space(end_2 - start_2), in_space(start_2 - start_1)
    normal = ca.cross(u, v)
    share = ca.dot(ca.cross(w, v), normal) / ca.fmax(ca.sumsqr(normal), COINCIDENT**4)
    second = nearest_on_segment(start_2, end_2, start_1 + _clamped(share) * (end_1 - start_1))
    return nearest_on_segment(start_1, end_1, second), second


def _clamped(share: ca.SX) -> ca.SX:
    return ca.fmin(ca.fmax(share, 0), 1)


def in_space(vector: ca.SX) -> ca.SX:
    """The vector (3, 1) with z = 0 for one of the plane."""
    return ca.vertcat(vector, ca.SX.zeros(3 - vector.numel()))
