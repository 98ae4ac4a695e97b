"""The heading of a frame's x axis, against the angle that numpy finds, in space and in the plane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from clikgen.runtime.references import Line
from clikgen.symbolic.robot import Robot

START = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0, 0, 0, 0])


@pytest.fixture(scope="module", params=["two_arms", "planar"])
def case(request, one_task, two_arms, planar_robot):
    """The robot, the task and its frame."""
    robot, frame = (planar_robot, "camera") if request.param == "planar" else (two_arms, "left")
    return robot, one_task(robot, kind="base_heading", frame=frame), frame


@pytest.fixture(scope="module")
def turntable(one_task):
    """A frame on one joint about z, so that its heading is q."""
    joint = {"name": "yaw", "type": "continuous", "link": "base"}
    return one_task(Robot.parse({"joints": [joint]}, "a turntable"), kind="base_heading", frame="base")


@pytest.fixture
def x_axis(case, pose_by_scipy):
    robot, _, frame = case
    return lambda q: pose_by_scipy(robot, frame, q)[0][:, 0]


def _heading(axis):
    return np.arctan2(axis[1], axis[0])


def _apart(angle, other):
    return abs(np.angle(np.exp(1j * (angle - other))))


def test_its_value_is_the_x_axis_seen_from_above(case, x_axis, joint_positions):
    robot, task, _ = case
    for q in joint_positions(robot, 50, 0):
        axis = x_axis(q)
        # the angle of a short shadow magnifies the rounding of 1e-14
        value = task("kinematics", q=q)["aim_value"][0]
        assert _apart(value, _heading(axis)) < 1e-14 / np.hypot(*axis[:2])


def test_its_jacobian_is_the_derivative(case, x_axis, joint_positions, differences):
    robot, task, _ = case
    checked = 0
    for q in joint_positions(robot, 40, 1):
        shadow = np.hypot(*x_axis(q)[:2])
        if shadow < 0.1:  # third derivatives grow as its third power
            continue
        here = _heading(x_axis(q))

        def turned(q, here=here):
            c, s = np.cos(here), np.sin(here)
            x, y, _ = x_axis(q)
            return np.atleast_1d(np.arctan2(c * y - s * x, c * x + s * y))  # about zero, where nothing wraps

        J = task("jacobians", q=q)["aim_jacobian"]
        np.testing.assert_allclose(J[None], differences(turned, q), rtol=0, atol=1e-6)
        checked += 1
    assert checked > 20


@given(st.floats(-50, 50), st.floats(-50, 50))
def test_the_error_is_the_shorter_way_round(turntable, q, reference):
    error = turntable("step", q=[q], aim_reference=[reference])["aim_error"][0]
    # angles up to 50 are rounded at 7e-15, and once more when turns are taken off
    assert -np.pi - 3e-14 < error <= np.pi + 3e-14
    assert _apart(q + error, reference) < 3e-14


@pytest.mark.parametrize(
    ("reference", "expected"),
    [(np.pi, np.pi), (-np.pi, np.pi), (0.5, 0.5), (-3.0, -3.0), (3.5, 3.5 - 2 * np.pi), (0.0, 0.0)],
)
def test_the_error_is_wrapped_into_the_half_open_turn(turntable, reference, expected):
    assert turntable("step", q=[0.0], aim_reference=[reference])["aim_error"][0] == expected


@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_any_heading_from_anywhere(case, x_axis, joint_positions, seed):
    robot, task, _ = case
    start = joint_positions(robot, 1, seed)[0]
    for heading in (-3.0, 0.4, 3.1):
        outputs = task.run(start, 1000, aim_reference=heading)
        assert abs(outputs["aim_error"][-1][0]) < 1e-6
        assert _apart(_heading(x_axis(outputs["q_next"][-1])), heading) < 1e-6


def _ramp_of_heading(start, rate):
    line = Line(kind="line", start=(start,), end=(start + 10 * rate,), duration=10.0)

    def motion(t):
        value, velocity = line.sample(t)
        return {"aim_reference": value, "aim_reference_velocity": velocity}

    return motion


def test_in_space_a_ramp_is_followed_to_first_order_in_t(one_task, two_arms, pose_by_scipy, ramp, expect_first_order):
    task = one_task(two_arms, kind="base_heading", frame="left")
    heading = _heading(pose_by_scipy(two_arms, "left", START)[0][:, 0])
    expect_first_order(ramp(task, START, _ramp_of_heading(heading, 0.5)))


def test_in_the_plane_a_ramp_past_many_turns_is_followed_exactly(one_task, planar_robot, ramp):
    """ψ is linear in q there, so Euler's step is exact: e⁺ = (1 − kT) e, and without feedforward v/k stays."""
    task = one_task(planar_robot, kind="base_heading", frame="camera", damping=1e-9)
    motion = ramp(task, np.array([0.0, 0.0, 1.0, 0.0, 0.0]), _ramp_of_heading(0.2, 6.0))
    # 36 rad are rounded at 7e-15, over and over, and each step takes kT of what has come together away
    np.testing.assert_allclose(motion.errors(feedforward=True, end=6.0), 0, rtol=0, atol=1e-11)
    np.testing.assert_allclose(motion.errors(feedforward=False, end=3.0), 6.0 / 5.0, rtol=1e-5)


@pytest.mark.parametrize("rpy", [[0.0, -np.pi / 2, 0.0], [0.0, np.pi / 2, 0.0], [0.0, 1e-9 - np.pi / 2, 0.0]])
def test_an_axis_that_points_straight_up_or_down_leaves_every_output_finite(one_task, rpy):
    joints = [
        {"name": "yaw", "type": "continuous", "link": "base"},
        {"name": "roll", "type": "continuous", "link": "head", "axis": [1, 0, 0]},
    ]
    frames = [{"name": "up", "link": "head", "rpy": rpy}]  # at a right angle its x axis is (0, 0, ±1) to the last bit
    task = one_task(Robot.parse({"joints": joints, "frames": frames}, "a head"), kind="base_heading", frame="up")
    for function in ("kinematics", "jacobians", "step"):
        outputs = task(function, q=[0.3, 0.0], aim_reference=[1.0])
        assert all(np.all(np.isfinite(value)) for value in outputs.values())


def test_a_frame_turned_against_its_link_heads_where_its_own_x_axis_does(one_task):
    joint = {"name": "yaw", "type": "continuous", "link": "base"}
    frames = [{"name": "side", "link": "base", "rpy": [0.4, 0.3, 1.1]}]
    task = one_task(Robot.parse({"joints": [joint], "frames": frames}, "r"), kind="base_heading", frame="side")
    axis = Rotation.from_euler("z", 0.7).apply(Rotation.from_euler("xyz", [0.4, 0.3, 1.1]).apply([1.0, 0, 0]))
    assert task("kinematics", q=[0.7])["aim_value"][0] == pytest.approx(_heading(axis), abs=1e-15)
