"""Where one frame sees another, against SciPy's poses, in space and in the plane."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Line

START = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0.3, -0.4, 0.2, 0.5])


@pytest.fixture(scope="module", params=["two_arms", "planar"])
def case(request, one_task, two_arms, planar_robot):
    """The robot, the task, the frame and who sees it."""
    if request.param == "planar":
        names = {"frame": "tool", "relative_to": "camera"}
        return planar_robot, one_task(planar_robot, kind="relative_position", **names), *names.values()
    names = {"frame": "left", "relative_to": "right"}
    return two_arms, one_task(two_arms, kind="relative_position", **names), *names.values()


@pytest.fixture
def seen(case, pose_by_scipy):
    """Where the one frame is in the other's axes, from SciPy's poses."""
    robot, _, frame, observer = case

    def position(q):
        (_, p_B), (R_A, p_A) = pose_by_scipy(robot, frame, q), pose_by_scipy(robot, observer, q)
        return (R_A.T @ (p_B - p_A))[: robot.dimension]

    return position


def test_its_value_is_the_position_in_the_other_s_axes(case, seen, joint_positions):
    robot, task, *_ = case
    for q in joint_positions(robot, 30, 0):
        # some fifteen transforms, of entries of about 1
        np.testing.assert_allclose(task("kinematics", q=q)["aim_position"], seen(q), rtol=0, atol=2e-14)


def test_its_jacobian_is_the_derivative(case, seen, joint_positions, differences):
    robot, task, *_ = case
    for q in joint_positions(robot, 30, 1):
        J = task("jacobians", q=q)["aim_jacobian"]
        np.testing.assert_allclose(J, differences(seen, q), rtol=0, atol=1e-8)


def test_what_carries_both_does_not_move_the_one_against_the_other(one_task, two_arms, joint_positions):
    task = one_task(two_arms, kind="relative_position", frame="left", relative_to="right")
    for q in joint_positions(two_arms, 10, 2):
        J = task("jacobians", q=q)["aim_jacobian"]
        np.testing.assert_allclose(J[:, :2], 0, rtol=0, atol=1e-15)  # lift and waist; rounding of J_B − J_A + [.]× J_ωA
        assert np.all(np.linalg.norm(J[:, [2, 7, 8]], axis=0) > 1e-3)  # both arms do


@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_any_relative_position(case, seen, joint_positions, seed):
    robot, task, *_ = case
    start, goal = joint_positions(robot, 2, seed)
    outputs = task.run(start, 1000, aim_reference=seen(goal))
    assert np.linalg.norm(outputs["aim_error"][-1]) < 1e-6
    np.testing.assert_allclose(seen(outputs["q_next"][-1]), seen(goal), rtol=0, atol=1e-6)


def test_a_ramp_is_followed_to_first_order_in_t(case, seen, ramp, expect_first_order):
    robot, task, *_ = case
    start = START if robot.space == "spatial" else np.array([0.0, 0.0, 0.3, 0.4, 1.2])
    r = seen(start)
    way = np.array([0.2, -0.25, 0.1])[: robot.dimension]  # stays within reach
    line = Line(kind="line", start=tuple(r), end=tuple(r + way), duration=4.0)

    def motion(t):
        value, velocity = line.sample(t)
        return {"aim_reference": value, "aim_reference_velocity": velocity}

    expect_first_order(ramp(task, start, motion))


def test_a_frame_that_tilts_out_of_the_plane_is_refused(one_task, planar_robot):
    with pytest.raises(BadInput, match="frame 'tilted' of a planar robot: wanted no roll or pitch"):
        one_task(planar_robot, kind="relative_position", frame="tool", relative_to="tilted")
