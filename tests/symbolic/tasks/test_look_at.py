"""A frame's axis toward a target, against the angle between the two that numpy finds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Line

START = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0, 0, 0, 0])


@pytest.fixture(scope="module", params=["x", "y", "z", "planar x", "planar y"])
def case(request, one_task, two_arms, planar_robot):
    """The robot, the task, its frame and the number of the axis."""
    axis = request.param[-1]
    robot, frame = (planar_robot, "camera") if "planar" in request.param else (two_arms, "left")
    return robot, one_task(robot, kind="look_at", frame=frame, axis=axis), frame, "xyz".index(axis)


@pytest.fixture
def seen(case, pose_by_scipy):
    """The target in the frame's axes, from SciPy's pose."""
    robot, _, frame, _ = case

    def position(q, target):
        R, p = pose_by_scipy(robot, frame, q)
        return (R.T @ (np.append(target, [0.0])[:3] - p))[: robot.dimension]

    return position


@pytest.fixture
def off_axis(case, seen):
    """X (m,) = 2 tan(φ/2) toward where the target is, from the angle φ."""
    axis = case[3]

    def value(q, target):
        s = seen(q, target)
        across = np.delete(s, axis)
        angle = np.arctan2(np.linalg.norm(across), s[axis])
        return 2 * np.tan(angle / 2) * across / np.linalg.norm(across)

    return value


def _targets(robot, count, seed):
    return np.random.default_rng(seed).uniform(-2, 2, (count, robot.dimension))


def _is_tame(x, s):
    """Φ < 143° and no target at arm's length: third derivatives grow as tan⁴(φ/2) and as 1/|s|³."""
    return np.linalg.norm(x) < 6 and np.linalg.norm(s) > 0.5


def test_its_value_is_twice_the_tangent_of_half_the_angle(case, off_axis, joint_positions):
    robot, task, *_ = case
    for q, target in zip(joint_positions(robot, 30, 0), _targets(robot, 30, 0), strict=True):
        values = task("kinematics", q=q, aim_reference=target)["aim_value"]
        expected = off_axis(q, target)
        # 2 tan(φ/2) magnifies the rounding of φ, 1e-14, by 1 + x²/4
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-13 * (1 + expected @ expected))


def test_its_jacobian_is_the_derivative(case, seen, off_axis, joint_positions, differences):
    robot, task, *_ = case
    checked = 0
    for q, target in zip(joint_positions(robot, 40, 1), _targets(robot, 40, 1), strict=True):
        x = off_axis(q, target)
        J = task("jacobians", q=q, aim_reference=target)["aim_jacobian"].reshape(len(x), -1)
        if _is_tame(x, seen(q, target)):

            def moved(q, target=target):
                return off_axis(q, target)

            np.testing.assert_allclose(J, differences(moved, q), rtol=0, atol=1e-6)
            checked += 1
    assert checked > 20


def test_the_feedforward_makes_up_for_what_the_target_does_to_x(case, seen, off_axis, joint_positions):
    """With the joints held, a moving target changes x; J q̇ is to take just that away."""
    robot, task, *_ = case
    draw, h, checked = np.random.default_rng(5), 1e-5, 0
    for q, target in zip(joint_positions(robot, 30, 2), _targets(robot, 30, 2), strict=True):
        x, velocity = off_axis(q, target), draw.normal(size=robot.dimension)
        J = task("jacobians", q=q, aim_reference=target)["aim_jacobian"].reshape(len(x), -1)
        if _is_tame(x, seen(q, target)) and np.linalg.svd(J, compute_uv=False)[-1] > 0.1:  # where nothing is damped
            rate = (off_axis(q, target + h * velocity) - off_axis(q, target - h * velocity)) / (2 * h)
            still, moving = (
                task("step", q=q, aim_reference=target, aim_reference_velocity=v)["dq_law"] for v in (0, velocity)
            )
            np.testing.assert_allclose(J @ (moving - still), -rate, rtol=0, atol=1e-6)
            checked += 1
    assert checked > 10


@pytest.mark.parametrize("seed", range(4))
def test_it_comes_to_look_at_any_target(case, seen, joint_positions, seed):
    robot, task, _, axis = case
    start = joint_positions(robot, 1, seed)[0]
    target = 4 * _targets(robot, 1, seed)[0]
    outputs = task.run(start, 1500, aim_reference=target)
    assert np.linalg.norm(outputs["aim_error"][-1]) < 1e-6
    s = seen(outputs["q_next"][-1], target)
    assert s[axis] == pytest.approx(np.linalg.norm(s), rel=1e-12)


def test_a_target_that_moves_is_followed_to_first_order_in_t(case, pose_by_scipy, ramp, expect_first_order):
    robot, task, frame, axis = case
    start = START if robot.space == "spatial" else np.array([0.0, 0.0, 0.3, 0.4, 1.2])
    R, p = pose_by_scipy(robot, frame, start)
    ahead = (p + 1.5 * R[:, axis])[: robot.dimension]
    way = np.array([0.5, -0.6, 0.4])[: robot.dimension]
    line = Line(kind="line", start=tuple(ahead), end=tuple(ahead + way), duration=4.0)

    def motion(t):
        value, velocity = line.sample(t)
        return {"aim_reference": value, "aim_reference_velocity": velocity}

    expect_first_order(ramp(task, start, motion))


@pytest.mark.parametrize("off", [1e-3, 1e-5])
def test_it_turns_back_from_looking_almost_away_at_a_bounded_rate(one_task, planar_robot, off):
    """φ̇ = −k sin φ: however large x is there, the joints move no faster than k over the lever of J."""
    task = one_task(planar_robot, kind="look_at", frame="camera", axis="x", damping=1e-9)
    q = np.array([0.0, 0.0, 0.8 + np.pi - off, 0.0, 0.0])  # the camera is turned by −0.8
    from_camera = Rotation.from_euler("z", q[2]).apply([0.1, 0.2, 0.0])[:2]
    outputs = task.run(q, 1000, aim_reference=np.add(from_camera, [3.0, 0.0]))
    assert abs(outputs["aim_value"][0][0]) == pytest.approx(2 / np.tan(off / 2), rel=1e-3)
    assert np.max(np.abs(outputs["dq_law"])) < 5.0  # k = 5
    assert abs(outputs["aim_error"][-1][0]) < 1e-6


@pytest.mark.parametrize("target", [(0.0, 0.0), (1e-200, 0.0), (-1e-9, 0.0), (-2.0, 0.0), (-1e5, 0.0)])
def test_at_the_target_and_exactly_away_from_it_every_output_is_finite(one_task, planar_robot, target):
    task = one_task(planar_robot, kind="look_at", frame="base", axis="x")
    for function in ("kinematics", "jacobians", "step"):
        outputs = task(function, q=np.zeros(5), aim_reference=target, aim_reference_velocity=[1.0, 1.0])
        assert all(np.all(np.isfinite(value)) for value in outputs.values())


def test_in_space_too_no_output_is_lost_at_the_target_or_away_from_it(one_task, two_arms, pose_by_scipy):
    task = one_task(two_arms, kind="look_at", frame="left")
    R, p = pose_by_scipy(two_arms, "left", START)
    for target in (p, p - 2 * R[:, 2], p - 1e-9 * R[:, 2], p - 1e5 * R[:, 2]):
        outputs = task("step", q=START, aim_reference=target, aim_reference_velocity=[1, 1, 1])
        assert all(np.all(np.isfinite(value)) for value in outputs.values())


def test_looking_exactly_away_is_an_equilibrium(one_task, planar_robot):
    task = one_task(planar_robot, kind="look_at", frame="base", axis="x")
    outputs = task("step", q=np.zeros(5), aim_reference=[-2.0, 0.0])
    np.testing.assert_array_equal(outputs["aim_value"], 0)
    np.testing.assert_array_equal(outputs["dq"], 0)


def test_a_planar_robot_does_not_look_along_z(one_task, planar_robot):
    with pytest.raises(BadInput, match=r"aim.*looks along x or y, got axis z"):
        one_task(planar_robot, kind="look_at", frame="camera")
    with pytest.raises(BadInput, match="frame 'tilted'"):
        one_task(planar_robot, kind="look_at", frame="tilted", axis="x")
