"""Where a frame is, all of it or along some axes, against SciPy's poses, in space and in the plane."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Line

START = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0.3, -0.4, 0.2, 0.5])
WHOLE, SOME = {}, {"axes": ["z", "x"]}


@pytest.fixture(scope="module", params=["space", "plane", "two axes"])
def case(request, one_task, two_arms, planar_robot):
    """The robot, the task, its frame and its axes."""
    if request.param == "plane":
        return planar_robot, one_task(planar_robot, kind="frame_position", frame="tool"), "tool", [0, 1]
    more = SOME if request.param == "two axes" else WHOLE
    axes = [2, 0] if request.param == "two axes" else [0, 1, 2]
    return two_arms, one_task(two_arms, kind="frame_position", frame="left", **more), "left", axes


@pytest.fixture
def place(case, pose_by_scipy):
    """Where the frame is along the task's axes, from SciPy's poses."""
    robot, _, frame, axes = case
    return lambda q: pose_by_scipy(robot, frame, q)[1][axes]


def test_its_value_is_the_position_along_its_axes_in_their_order(case, place, joint_positions):
    robot, task, *_ = case
    for q in joint_positions(robot, 30, 0):
        # some fifteen transforms, of entries of about 1
        np.testing.assert_allclose(task("kinematics", q=q)["aim_position"], place(q), rtol=0, atol=1e-14)


def test_its_jacobian_is_the_derivative(case, place, joint_positions, differences):
    robot, task, *_ = case
    for q in joint_positions(robot, 30, 1):
        J = task("jacobians", q=q)["aim_jacobian"]
        np.testing.assert_allclose(J, differences(place, q), rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_any_position(case, place, joint_positions, seed):
    robot, task, *_ = case
    start, goal = joint_positions(robot, 2, seed)
    outputs = task.run(start, 1000, aim_reference=place(goal))
    np.testing.assert_allclose(place(outputs["q_next"][-1]), place(goal), rtol=0, atol=1e-6)


def test_a_ramp_is_followed_to_first_order_in_t(case, place, ramp, expect_first_order):
    robot, task, _, axes = case
    start = START if robot.space == "spatial" else np.array([0.0, 0.0, 0.3, 0.4, 1.2])
    r = place(start)
    line = Line(kind="line", start=tuple(r), end=tuple(r + np.array([0.2, -0.25, 0.1])[axes]), duration=4.0)

    def motion(t):
        value, rate = line.sample(t)
        return {"aim_reference": value, "aim_reference_velocity": rate}

    expect_first_order(ramp(task, start, motion))


def test_a_speed_bounds_the_feedback_and_keeps_its_direction(one_task, two_arms):
    free, bounded = (
        one_task(two_arms, kind="frame_position", frame="left", damping=1e-6, **more) for more in ({}, {"speed": 0.3})
    )
    position = free("kinematics", q=START)["aim_position"]
    J = free("jacobians", q=START)["aim_jacobian"]
    for size in (0.01, 0.059, 0.061, 3.0):  # gain 5/s: the bound of 0.3 m/s is met at 0.06 m
        error = size * np.array([0.6, 0.0, 0.8])
        wanted = 5 * error * min(1.0, 0.3 / (5 * size))
        moved = J @ bounded("step", q=START, aim_reference=position + error)["dq_law"]
        np.testing.assert_allclose(moved, wanted, rtol=1e-9, atol=1e-10)
        unbounded = J @ free("step", q=START, aim_reference=position + error)["dq_law"]
        np.testing.assert_allclose(unbounded, 5 * error, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"axes": ["x", "x"]}, "wanted each axis once"),
        ({"axes": []}, "axes"),
        ({"axes": ["w"]}, "'x', 'y' or 'z'"),
        ({"frame": "lft"}, "no frame 'lft'; did you mean 'left'"),
        ({"speed": -1.0}, "speed"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(one_task, two_arms, more, message):
    with pytest.raises(BadInput, match=message) as error:
        one_task(two_arms, **({"kind": "frame_position", "frame": "left"} | more))
    assert "\n" not in str(error.value)


def test_a_planar_robot_has_no_z(one_task, planar_robot):
    with pytest.raises(BadInput, match="a planar robot has the axes x and y, got z"):
        one_task(planar_robot, kind="frame_position", frame="tool", axes=["z"])
