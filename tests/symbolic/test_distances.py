"""Nearest points of segments, against exact rational arithmetic and a bounded least-squares solver."""

from fractions import Fraction
from itertools import product
from math import isqrt

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from clikgen.symbolic.distances import COINCIDENT, direction, nearest_on_segment, nearest_on_segments


def _function(dimension):
    ends = [ca.SX.sym(name, dimension) for name in ("start_1", "end_1", "start_2", "end_2")]
    function = ca.Function("nearest", ends, list(nearest_on_segments(*ends)))

    def nearest(segments):
        """The nearest points (N, 2, dimension) of pairs of segments (N, 4, dimension)."""
        columns = [np.ascontiguousarray(segments[:, i].T) for i in range(4)]
        return np.stack([np.array(points).T for points in function.call(columns)], axis=1)

    return nearest


@pytest.fixture(scope="module", params=[2, 3])
def dimension(request):
    return request.param


@pytest.fixture(scope="module")
def nearest(dimension):
    return _function(dimension)


def _distance(points):
    return np.linalg.norm(points[:, 1] - points[:, 0], axis=-1)


def _exact_distance(segment):
    """The distance of two segments (4, dimension) of floats, by rational arithmetic, rounded once at the end."""
    p1, e1, p2, e2 = [[Fraction(float(x)) for x in point] for point in segment]
    u, v, w = ([b - a for a, b in zip(*ends, strict=True)] for ends in ((p1, e1), (p2, e2), (p1, p2)))

    def dot(a, b):
        return sum(x * y for x, y in zip(a, b, strict=True))

    def squared(s, t):
        gap = [c + t * b - s * a for a, b, c in zip(u, v, w, strict=True)]
        return dot(gap, gap)

    def clamped(above, below):
        return min(max(above / below, Fraction(0)), Fraction(1)) if below else Fraction(0)

    # the convex quadratic of (s, t) has its least value on an edge of the unit square or, inside it, at its centre
    seen = [squared(s, clamped(s * dot(u, v) - dot(w, v), dot(v, v))) for s in (Fraction(0), Fraction(1))]
    seen += [squared(clamped(dot(w, u) + t * dot(u, v), dot(u, u)), t) for t in (Fraction(0), Fraction(1))]
    det = dot(u, u) * dot(v, v) - dot(u, v) ** 2
    if det:
        s = (dot(w, u) * dot(v, v) - dot(w, v) * dot(u, v)) / det
        t = (dot(w, u) * dot(u, v) - dot(w, v) * dot(u, u)) / det
        if 0 <= s <= 1 and 0 <= t <= 1:
            seen.append(squared(s, t))
    least = min(seen)
    return isqrt(int(least * 2**200)) / 2**100


# Of coordinates below 2 m each difference is rounded at 2e-16 m, and ten of them meet in a distance.
ROUNDING = 4e-15


def test_distance_equals_a_bounded_least_squares_solver_s(nearest, dimension):
    segments = np.random.default_rng(1).uniform(-1, 1, (300, 4, dimension))
    found = _distance(nearest(segments))
    for (p1, e1, p2, e2), mine in zip(segments, found, strict=True):
        solved = lsq_linear(np.column_stack([e1 - p1, p2 - e2]), p2 - p1, bounds=(0, 1), method="bvls", tol=1e-14)
        # the solver stops at a relative change of 1e-14 of a squared distance: where that is small, 1e-7 of it
        assert mine == pytest.approx(np.sqrt(2 * solved.cost), abs=1e-8)


def test_distance_is_exact_for_random_segments(nearest, dimension):
    segments = np.random.default_rng(2).uniform(-1, 1, (500, 4, dimension))
    exact = [_exact_distance(segment) for segment in segments]
    np.testing.assert_allclose(_distance(nearest(segments)), exact, rtol=0, atol=ROUNDING)


def test_distance_is_exact_however_nearly_parallel_the_segments_are(nearest, dimension):
    rng = np.random.default_rng(3)
    segments = rng.uniform(-1, 1, (1000, 4, dimension))
    along = (segments[:, 1] - segments[:, 0]) * rng.uniform(-1.5, 1.5, (1000, 1))
    angle = 10 ** rng.uniform(-18, -1, (1000, 1))
    beside = segments[:, 0] + along * rng.uniform(-1, 1, (1000, 1)) + angle * rng.normal(size=(1000, dimension))
    segments[:, 2], segments[:, 3] = beside, beside + along + angle * rng.normal(size=(1000, dimension))
    exact = [_exact_distance(segment) for segment in segments]
    np.testing.assert_allclose(_distance(nearest(segments)), exact, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("segments", "distance"),
    [
        ([[0, 0], [1, 0], [0.2, 0.5], [0.8, 0.5]], 0.5),  # parallel, one beside the other
        ([[0, 0], [1, 0], [0.8, 0.5], [0.2, 0.5]], 0.5),  # the same, in opposite directions
        ([[0, 0], [1, 0], [2, 0], [3, 0]], 1.0),  # on one line
        ([[0, 0], [1, 0], [3, 0], [2, 0]], 1.0),
        ([[0, 0], [1, 0], [0.5, 0], [3, 0]], 0.0),  # on one line, overlapping
        ([[0, 0], [1, 0], [4, 4], [5, 4]], 5.0),  # parallel, none beside the other
        ([[0, 0], [1, 0], [0, 0], [1, 0]], 0.0),  # the same segment
        ([[0, 0], [1, 0], [1, 0], [0, 0]], 0.0),
        ([[0, -1], [0, 1], [-1, 0], [1, 0]], 0.0),  # crossing
        ([[0, 0], [1, 0], [1, 0], [1, 1]], 0.0),  # sharing an end
        ([[0, 0], [1, 0], [1.5, -1], [1.5, 1]], 0.5),  # an end against an interior point
        ([[0, 0], [0, 0], [3, 4], [3, 4]], 5.0),  # two points
        ([[0, 0], [0, 0], [0, 0], [0, 0]], 0.0),  # one point
        ([[0.3, 0], [0.3, 0], [-1, 2], [1, 2]], 2.0),  # a point and a segment, and the other way round
        ([[-1, 2], [1, 2], [0.3, 0], [0.3, 0]], 2.0),
    ],
)
def test_parallel_crossing_and_degenerate_segments(nearest, dimension, segments, distance):
    segments = np.pad(np.array(segments, dtype=float), ((0, 0), (0, dimension - 2)))
    for order in ([0, 1, 2, 3], [2, 3, 0, 1], [1, 0, 2, 3], [0, 1, 3, 2]):
        found = nearest(segments[None, order])
        # 0.3, 0.2 and 0.8 are rounded, each once
        assert _distance(found)[0] == pytest.approx(distance, abs=1e-15)


def test_every_arrangement_on_a_lattice_is_exact(nearest, dimension):
    """Segments between points of a lattice of three a side: many are parallel, crossing or points."""
    lattice = np.array(list(product((-1.0, 0.0, 1.0), repeat=dimension)))
    rng = np.random.default_rng(4)
    picks = rng.integers(0, len(lattice), (1500, 4))
    segments = lattice[picks]
    exact = [_exact_distance(segment) for segment in segments]
    np.testing.assert_allclose(_distance(nearest(segments)), exact, rtol=0, atol=ROUNDING)


def test_nearest_points_lie_on_their_segments(nearest, dimension):
    segments = np.random.default_rng(5).uniform(-1, 1, (2000, 4, dimension))
    for k, points in enumerate(np.moveaxis(nearest(segments), 1, 0)):
        start, end = segments[:, 2 * k], segments[:, 2 * k + 1]
        detour = np.linalg.norm(points - start, axis=1) + np.linalg.norm(end - points, axis=1)
        np.testing.assert_allclose(detour, np.linalg.norm(end - start, axis=1), rtol=0, atol=ROUNDING)


def test_all_is_finite_over_scales_and_coincidences(nearest, dimension):
    rng = np.random.default_rng(6)
    segments = rng.normal(size=(10_000, 4, dimension)) * 10.0 ** rng.uniform(-200, 6, (10_000, 4, 1))
    segments[::3, 1] = segments[::3, 0]
    segments[::5, 2:] = segments[::5, :2]
    segments[::7] = 0
    assert np.all(np.isfinite(nearest(segments)))


def test_the_nearest_point_of_a_segment_is_no_further_than_a_dense_sample(dimension):
    names = [ca.SX.sym(name, dimension) for name in ("start", "end", "point")]
    function = ca.Function("nearest", names, [nearest_on_segment(*names)])
    share = np.linspace(0, 1, 2001)[:, None]
    for start, end, point in np.random.default_rng(7).uniform(-1, 1, (200, 3, dimension)):
        sample = np.min(np.linalg.norm(start + share * (end - start) - point, axis=1))
        mine = np.linalg.norm(np.array(function(start, end, point))[:, 0] - point)
        # the nearest sample is within half a spacing, |end - start|/4000 < 9e-4 m, along the segment
        assert -ROUNDING < sample - mine < 9e-4


def test_direction_is_a_unit_vector_and_plus_x_where_there_is_none(dimension):
    toward = ca.SX.sym("toward", dimension)
    function = ca.Function("direction", [toward], list(direction(toward)))
    rng = np.random.default_rng(8)
    for vector in rng.normal(size=(200, dimension)) * 10.0 ** rng.uniform(-9, 6, (200, 1)):
        unit, length = (np.array(one) for one in function(vector))
        # a square root and a division
        assert length[0, 0] == pytest.approx(np.linalg.norm(vector), rel=1e-15)
        np.testing.assert_allclose(unit[:, 0], vector / np.linalg.norm(vector), rtol=0, atol=1e-15)
    for vector in (np.zeros(dimension), np.full(dimension, 1e-13), np.full(dimension, 1e-200)):
        unit, _ = (np.array(one) for one in function(vector))
        np.testing.assert_allclose(unit[:, 0], np.eye(dimension)[0], rtol=0, atol=COINCIDENT)
