"""Balls, capsules and half-spaces as the points of interest sense them, against samples and solvers."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from clikgen.runtime.manifest import FAR
from clikgen.symbolic.obstacles import ObstacleCapacity, Obstacles
from clikgen.symbolic.stage import Procedure

ROUNDING = 4e-15  # of coordinates below 3 m, some ten terms


class Field:
    """Obstacles as CasADi evaluates them: a point (dimension,) and obstacles by the names of their signals."""

    def __init__(self, dimension, **capacity):
        self.dimension = dimension
        obstacles = Obstacles.up_to(ObstacleCapacity(**capacity), dimension)
        self.infos = [signal.info for signal in obstacles.inputs]
        point = ca.SX.sym("point", dimension)
        columns = [signal.column for signal in obstacles.inputs]
        stages = []
        distance, toward, length = obstacles.shapes(stages).closest(point, stages)
        procedure = Procedure.of("closest", [point, *columns], [distance, toward / length], stages)
        self._function = procedure.casadi()

    def __call__(self, point, **given):
        """D [m] and u (dimension,); arrays (N, ...) give (N,) and (N, dimension)."""
        point = np.asarray(point, dtype=float)
        count, columns = len(np.atleast_2d(point)), [np.atleast_2d(point).T]
        for info in self.infos:
            value = np.asarray(given.get(info.name, 0.0), dtype=float)
            columns.append(np.broadcast_to(value, (count, *info.shape)).reshape(count, -1).T)
        distance, toward = (np.array(one).T for one in self._function.call([np.array(one) for one in columns]))
        return (distance[:, 0], toward) if point.ndim == 2 else (distance[0, 0], toward[0])


@pytest.fixture(scope="module", params=[2, 3])
def dimension(request):
    return request.param


@pytest.fixture(scope="module")
def capsule(dimension):
    return Field(dimension, capsules=1)


@pytest.fixture(scope="module")
def crowd(dimension):
    return Field(dimension, maximum=3, capsules=3, half_spaces=3)


def _unit(vector):
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def _crowds(dimension, count, seed):
    """Signals of `count` random crowds of up to three obstacles of each kind, and points."""
    rng = np.random.default_rng(seed)
    shape = (count, 3, dimension)
    return rng.uniform(-2, 2, (count, dimension)), {
        "obstacle_center": rng.uniform(-2, 2, shape),
        "obstacle_radius": rng.uniform(0, 0.3, (count, 3)),
        "obstacle_count": rng.integers(0, 4, count),
        "capsule_start": rng.uniform(-2, 2, shape),
        "capsule_end": rng.uniform(-2, 2, shape),
        "capsule_radius": rng.uniform(0, 0.3, (count, 3)),
        "capsule_count": rng.integers(0, 4, count),
        "half_space_normal": _unit(rng.normal(size=shape)),
        "half_space_offset": rng.uniform(-4, -1, (count, 3)),
        "half_space_count": rng.integers(0, 4, count),
    }


def _each_distance(point, given):
    """The signed distance to every obstacle that is there, by a scalar minimiser for the capsules."""
    centers, radii = (given[f"obstacle_{key}"][: given["obstacle_count"]] for key in ("center", "radius"))
    distances = [np.linalg.norm(center - point) - r for center, r in zip(centers, radii, strict=True)]
    for k in range(given["capsule_count"]):
        start, end = given["capsule_start"][k], given["capsule_end"][k]
        found = minimize_scalar(
            lambda s, start=start, end=end: np.sum((start + s * (end - start) - point) ** 2),
            bounds=(0, 1),
            method="bounded",
            options={"xatol": 1e-12},
        )
        squared = min(found.fun, np.sum((start - point) ** 2), np.sum((end - point) ** 2))
        distances.append(np.sqrt(squared) - given["capsule_radius"][k])
    for k in range(given["half_space_count"]):
        distances.append(given["half_space_normal"][k] @ point - given["half_space_offset"][k])
    return distances


def test_distance_is_that_to_the_closest_of_all_kinds(crowd, dimension):
    points, given = _crowds(dimension, 500, 0)
    found, _ = crowd(points, **given)
    for i, point in enumerate(points):
        expected = min(_each_distance(point, {name: value[i] for name, value in given.items()}), default=FAR)
        # the minimiser of a parabola knows its argument to 1e-8, its value to the square of that
        assert found[i] == pytest.approx(expected, abs=1e-13)
    assert np.sum(found == FAR) > 0
    assert np.sum(found < 0) > 20


def test_direction_is_the_steepest_descent_of_the_distance(crowd, dimension):
    points, given = _crowds(dimension, 2_000, 1)
    _, toward = crowd(points, **given)
    h = 1e-6
    gradient = np.empty_like(points)
    for i, e in enumerate(h * np.eye(dimension)):
        ends = [crowd(points + way * e, **given)[0] for way in (1, -1)]
        gradient[:, i] = (ends[0] - ends[1]) / (2 * h)
    present = sum(given[name] for name in given if name.endswith("_count")) > 0
    error = np.linalg.norm(gradient + toward, axis=1)[present]
    # where the closest one changes within h the difference means nothing; else rounding of 4e-16 m over 2h, and
    # h² over the square of the way to a centre
    assert np.mean(error < 1e-8) > 0.999
    np.testing.assert_allclose(np.linalg.norm(toward, axis=1), 1, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("radius", [0.0, 0.25])
def test_a_capsule_is_where_dense_samples_of_it_are(capsule, dimension, radius):
    rng = np.random.default_rng(2)
    share = np.linspace(0, 1, 2001)[:, None]
    for start, end, point in rng.uniform(-2, 2, (200, 3, dimension)):
        given = {"capsule_start": start[None], "capsule_end": end[None], "capsule_radius": [radius], "capsule_count": 1}
        distance, toward = capsule(point, **given)
        sample = start + share * (end - start)
        apart = np.linalg.norm(sample - point, axis=1)
        # half a spacing of samples along at most 7 m, and the parabola they lie on
        spacing = np.linalg.norm(end - start) / 4000
        assert -ROUNDING < np.min(apart) - radius - distance < spacing**2 / np.min(apart) + ROUNDING
        # the nearest point of the axis lies d + R along u
        nearest = point + (distance + radius) * toward
        assert np.min(np.linalg.norm(sample - nearest, axis=1)) <= spacing + ROUNDING


def test_a_capsule_of_no_length_is_a_ball(dimension):
    both = Field(dimension, maximum=1, capsules=1)
    rng = np.random.default_rng(3)
    for center, point in rng.uniform(-2, 2, (100, 2, dimension)):
        ball = both(point, obstacle_center=center[None], obstacle_radius=[0.2], obstacle_count=1)
        ends = {"capsule_start": center[None], "capsule_end": center[None]}
        capsule = both(point, **ends, capsule_radius=[0.2], capsule_count=1)
        np.testing.assert_array_equal(capsule[0], ball[0])
        np.testing.assert_array_equal(capsule[1], ball[1])


def test_the_ends_of_a_capsule_can_be_swapped(capsule, dimension):
    rng = np.random.default_rng(4)
    a, b, point = rng.uniform(-2, 2, (3, 500, dimension))
    rest = {"capsule_radius": [0.1], "capsule_count": 1}
    one = capsule(point, capsule_start=a[:, None], capsule_end=b[:, None], **rest)
    other = capsule(point, capsule_start=b[:, None], capsule_end=a[:, None], **rest)
    for mine, theirs in zip(one, other, strict=True):
        # the direction to a point 1e-3 m away magnifies rounding
        np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-11)


def test_inside_a_capsule_the_push_goes_away_from_its_axis(capsule, dimension):
    start, end = np.zeros(dimension), 2 * np.eye(dimension)[0]
    given = {"capsule_start": start[None], "capsule_end": end[None], "capsule_radius": [0.5], "capsule_count": 1}
    point = np.array([1.0, 0.1, 0.0])[:dimension]
    distance, toward = capsule(point, **given)
    # 0.1 is rounded once
    assert distance == pytest.approx(-0.4, abs=1e-15)
    np.testing.assert_allclose(toward, -np.eye(dimension)[1], rtol=0, atol=1e-15)
    distance, toward = capsule([1.0, 0.0, 0.0][:dimension], **given)  # on the axis: +x by convention
    assert distance == -0.5
    np.testing.assert_array_equal(toward, np.eye(dimension)[0])


def test_a_half_space_pushes_along_its_normal_from_either_side(dimension):
    field = Field(dimension, half_spaces=1)
    rng = np.random.default_rng(5)
    for point in rng.uniform(-3, 3, (100, dimension)):
        normal, offset = _unit(rng.normal(size=dimension)), rng.uniform(-2, 2)
        distance, toward = field(point, half_space_normal=normal[None], half_space_offset=[offset], half_space_count=1)
        # the foot of the point on the plane: it is in the plane, and the way to it is the distance
        foot = point + distance * toward
        assert normal @ foot == pytest.approx(offset, abs=ROUNDING)
        assert (distance < 0) == (normal @ point < offset)
        np.testing.assert_allclose(toward, -normal, rtol=0, atol=3e-16)  # made a unit vector once more


@pytest.mark.parametrize("garbage", [np.nan, np.inf, -np.inf, 0.0])
def test_what_is_not_there_is_ignored_whatever_it_holds(crowd, dimension, garbage):
    points, given = _crowds(dimension, 300, 6)
    spoiled = {name: np.array(value, dtype=float) for name, value in given.items()}
    for kind in ("obstacle", "capsule", "half_space"):
        absent = np.arange(3) >= given[f"{kind}_count"][:, None]
        for name in spoiled:
            if name.startswith(kind) and not name.endswith("_count"):
                spoiled[name][absent] = garbage
    for clean, other in zip(crowd(points, **given), crowd(points, **spoiled), strict=True):
        np.testing.assert_array_equal(clean, other)


def test_random_and_degenerate_crowds_are_finite(crowd, dimension):
    points, given = _crowds(dimension, 10_000, 7)
    rng = np.random.default_rng(7)
    points[::3] = given["capsule_start"][::3, 0]
    points[1::3] = given["obstacle_center"][1::3, 1]
    given["capsule_end"][::2] = given["capsule_start"][::2]
    near = given["capsule_start"][::5] + 10.0 ** rng.uniform(-200, -9, (2_000, 3, 1))
    given["capsule_end"][::5] = near
    distance, toward = crowd(points, **given)
    assert np.all(np.isfinite(distance))
    np.testing.assert_allclose(np.linalg.norm(toward, axis=1), 1, rtol=0, atol=1e-12)


def test_a_controller_has_the_signals_of_the_kinds_it_can_hold(dimension):
    def names(**capacity):
        return [info.name for info in Field(dimension, **capacity).infos]

    assert names(maximum=2) == ["obstacle_center", "obstacle_radius", "obstacle_count", "obstacle_velocity"]
    assert names(capsules=1) == ["capsule_start", "capsule_end", "capsule_radius", "capsule_count"]
    assert names(half_spaces=1) == ["half_space_normal", "half_space_offset", "half_space_count"]
    assert not ObstacleCapacity().any
    assert all(ObstacleCapacity(**{kind: 1}).any for kind in ("maximum", "capsules", "half_spaces"))


@pytest.fixture(scope="module")
def wary(plane_arm, evaluated):
    """A planar arm that avoids a capsule and a half-space with its elbow and its tool."""
    points = [
        {"name": "elbow", "link": "link0", "offset": [0.5, 0, 0], "influence_radius": 0.1},
        {"name": "hand", "link": "link2", "offset": [0.3, 0, 0], "influence_radius": 0.15},
    ]
    robot = plane_arm([0.5, 0.4, 0.3], points_of_interest=points)
    switched = {"kind": "switched", "gain": 100.0, "damping": 1e-6}
    avoid = {"name": "obstacles", "kind": "obstacle_avoidance", "activation": switched}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 3.0}
    capacity = {"maximum": 0, "capsules": 1, "half_spaces": 1}
    return evaluated(robot, avoid, goal, obstacles=capacity, period=0.002)


SCENE = {
    "capsule_start": np.array([[0.6, -0.2]]),
    "capsule_end": np.array([[1.1, 0.1]]),
    "capsule_radius": np.array([0.05]),
    "capsule_count": 1,
    "half_space_normal": np.array([[0.0, -1.0]]),
    "half_space_offset": np.array([-0.7]),  # y >= 0.7 is a ceiling
    "half_space_count": 1,
}


def test_the_potential_s_jacobian_is_its_derivative_for_every_kind(wary):
    q = np.random.default_rng(8).uniform(-2, 2, (2_000, 3))
    J = wary("jacobians", q=q, **SCENE)["obstacles_jacobian"]
    assert np.sum(np.any(J != 0, axis=1)) > 400
    error = np.abs(J - wary.derivative("obstacles_potential", q, **SCENE))
    # C¹ but where another obstacle becomes the closest: the curvature of up to 1 at d = s steps within h = 1e-6
    assert np.mean(error < 1e-8) > 0.995
    assert np.median(error) < 1e-10


@pytest.mark.parametrize(("goal", "kept"), [((0.85, -0.05), "capsule"), ((0.3, 0.85), "ceiling")])
def test_a_goal_inside_an_obstacle_is_not_reached(wary, goal, kept):
    """The hand enters its influence region, of 0.15 m, by one step's way at most, and rests at its edge."""
    start = [0.6, 0.0, -0.6]
    reference = {"tool_reference": np.array(goal)}
    _, free = wary.run(3_000, start, **reference)
    assert np.linalg.norm(free["tool_error"][-1]) < 1e-3  # with no obstacle it is
    _, outputs = wary.run(3_000, start, **reference, **SCENE)
    assert np.min(outputs["clearance"]) > -0.01
    assert outputs["clearance"][-1] == pytest.approx(0, abs=2e-3), kept
    assert np.linalg.norm(outputs["tool_error"][-1]) > 0.1
