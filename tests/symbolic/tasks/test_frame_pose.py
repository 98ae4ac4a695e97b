"""Position and orientation as one task: its rows are those of the two, and both errors vanish together."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Line, Spin

START = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0, 0, 0, 0])


@pytest.fixture(scope="module")
def pose(one_task, two_arms):
    return one_task(two_arms, kind="frame_pose", frame="left")


@pytest.fixture
def pose_of(pose_by_scipy, two_arms):
    return lambda q: pose_by_scipy(two_arms, "left", q)


def _quaternion(matrix):
    return Rotation.from_matrix(matrix).as_quat(scalar_first=True, canonical=True)


def test_its_values_are_scipys_position_and_orientation(pose, pose_of, two_arms, joint_positions):
    for q in joint_positions(two_arms, 30, 0):
        values = pose("kinematics", q=q)
        rotation, position = pose_of(q)
        # nine transforms in a row, of entries of about 1
        np.testing.assert_allclose(values["aim_position"], position, rtol=0, atol=1e-14)
        np.testing.assert_allclose(values["aim_orientation"], _quaternion(rotation), rtol=0, atol=1e-14)


def test_its_jacobian_is_velocity_over_angular_velocity(pose, pose_of, two_arms, joint_positions, differences):
    for q in joint_positions(two_arms, 20, 1):
        here = Rotation.from_matrix(pose_of(q)[0])

        def moved(q, here=here):
            rotation, position = pose_of(q)
            return np.concatenate([position, (Rotation.from_matrix(rotation) * here.inv()).as_rotvec()])

        J = pose("jacobians", q=q)["aim_jacobian"]
        np.testing.assert_allclose(J, differences(moved, q), rtol=0, atol=1e-8)


def test_its_errors_are_the_missing_way_and_the_missing_turn(pose, pose_of, two_arms, joint_positions):
    for q, goal in joint_positions(two_arms, 40, 2).reshape(20, 2, -1):
        (R, p), (R_d, p_d) = pose_of(q), pose_of(goal)
        outputs = pose("step", q=q, aim_reference=p_d, aim_orientation_reference=-_quaternion(R_d))
        np.testing.assert_allclose(outputs["aim_error"], p_d - p, rtol=0, atol=1e-14)
        missing = Rotation.from_matrix(R_d @ R.T).as_rotvec()
        # SciPy's logarithm of a matrix magnifies its rounding near half a turn
        np.testing.assert_allclose(outputs["aim_orientation_error"], missing, rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_a_pose_from_another(pose, pose_of, two_arms, joint_positions, seed):
    start, goal = joint_positions(two_arms, 2, seed)
    rotation, position = pose_of(goal)
    outputs = pose.run(start, 2000, aim_reference=position, aim_orientation_reference=_quaternion(rotation))
    assert np.linalg.norm(outputs["aim_error"][-1]) < 1e-6
    assert np.linalg.norm(outputs["aim_orientation_error"][-1]) < 1e-6
    reached = pose_of(outputs["q_next"][-1])
    np.testing.assert_allclose(reached[1], position, rtol=0, atol=1e-6)
    np.testing.assert_allclose(reached[0], rotation, rtol=0, atol=1e-6)


@pytest.mark.parametrize("error", ["aim_error", "aim_orientation_error"])
def test_a_line_and_a_spin_are_followed_to_first_order_in_t(pose, pose_of, ramp, expect_first_order, error):
    rotation, position = pose_of(START)
    rpy = tuple(Rotation.from_matrix(rotation).as_euler("xyz"))
    spin = Spin(kind="spin", start=rpy, axis=(0.3, -0.2, 1.0), rate=0.1, duration=10.0)
    line = Line(kind="line", start=tuple(position), end=tuple(np.add(position, [0.3, -0.4, 0.5])), duration=10.0)

    def motion(t):
        (place, velocity), (turn, omega) = line.sample(t), spin.sample(t)
        return {
            "aim_reference": place,
            "aim_reference_velocity": velocity,
            "aim_orientation_reference": turn,
            "aim_orientation_reference_velocity": omega,
        }

    expect_first_order(ramp(pose, START, motion, error))


def test_a_full_gain_couples_position_and_orientation(one_task, two_arms, pose_of):
    root = np.random.default_rng(3).normal(size=(6, 6))
    K = root @ root.T + np.eye(6)
    K = (K + K.T) / 2
    task = one_task(two_arms, kind="frame_pose", frame="left", gain=K.tolist(), damping=1e-6)
    outputs = task("step", q=START, aim_reference=pose_of(START)[1] + 0.1, aim_orientation_reference=[1, 0.1, 0, 0.2])
    e = np.concatenate([outputs["aim_error"], outputs["aim_orientation_error"]])
    J = task("jacobians", q=START)["aim_jacobian"]
    # a damping of 1e-6 against singular values above 0.05 changes the velocity by 4e-10 of itself
    np.testing.assert_allclose(J @ outputs["dq_law"], K @ e, rtol=1e-8, atol=1e-8)


def test_it_tracks_and_has_two_references(pose):
    (task,) = pose.controller.tasks
    assert pose.controller.spec.tasks[0].tracked_axes(None) == (0, 1, 2)
    assert [(one.name, one.space) for one in task.references] == [("aim", "vector"), ("aim_orientation", "rotation")]


def test_a_planar_robot_is_told_of_the_kinds_it_has(one_task, planar_robot):
    with pytest.raises(BadInput, match=r"aim.*frame_position and base_heading"):
        one_task(planar_robot, kind="frame_pose", frame="tool")
