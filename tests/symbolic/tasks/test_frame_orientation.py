"""A frame's orientation against SciPy's rotations: error, Jacobian, and how the error decays."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Spin


@pytest.fixture(scope="module")
def orientation(one_task, two_arms):
    return one_task(two_arms, kind="frame_orientation", frame="left")


@pytest.fixture
def rotation_of(pose_by_scipy, two_arms):
    return lambda q: Rotation.from_matrix(pose_by_scipy(two_arms, "left", q)[0])


def _quaternion(rotation):
    return rotation.as_quat(scalar_first=True)


def test_the_orientation_is_scipys_with_positive_w(orientation, rotation_of, two_arms, joint_positions):
    for q in joint_positions(two_arms, 50, 0):
        value = orientation("kinematics", q=q)["aim_orientation"]
        expected = rotation_of(q).as_quat(scalar_first=True, canonical=True)  # canonical: w > 0
        # nine rotations in a row, each rounded at some 1e-16
        np.testing.assert_allclose(value, expected, rtol=0, atol=1e-14)


def test_the_jacobian_is_the_angular_velocity_in_the_world(orientation, rotation_of, two_arms, joint_positions):
    h = 1e-5
    for q in joint_positions(two_arms, 30, 1):
        J = orientation("jacobians", q=q)["aim_jacobian"]
        columns = [
            (rotation_of(q + h * e) * rotation_of(q - h * e).inv()).as_rotvec() / (2 * h) for e in np.eye(len(q))
        ]
        # the turn is about h·a to third order in h; rounding of 1e-15 over 2h is 5e-11
        np.testing.assert_allclose(J, np.transpose(columns), rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, np.pi / 2, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_error_is_the_missing_turn_as_a_vector_in_the_world(
    orientation, rotation_of, two_arms, joint_positions, angle, sign
):
    axes = np.random.default_rng(2).normal(size=(20, 3))
    for q, axis in zip(joint_positions(two_arms, 20, 2), axes, strict=True):
        missing = angle * axis / np.linalg.norm(axis)
        reference = sign * _quaternion(Rotation.from_rotvec(missing) * rotation_of(q))
        error = orientation("step", q=q, aim_reference=reference)["aim_error"]
        if angle == np.pi:  # rounding chooses between the two ways round
            error *= np.sign(error @ missing)
        np.testing.assert_allclose(error, missing, rtol=0, atol=1e-14)


def test_every_output_is_finite_at_zero_half_a_turn_and_for_a_zero_quaternion(
    orientation, rotation_of, two_arms, joint_positions
):
    q = joint_positions(two_arms, 1, 3)[0]
    own = orientation("kinematics", q=q)["aim_orientation"]
    half = _quaternion(Rotation.from_rotvec([np.pi, 0, 0]) * rotation_of(q))
    for reference in (own, -own, half, -half, np.zeros(4), 1e3 * own, 1e-160 * own):
        outputs = orientation("step", q=q, aim_reference=reference)
        assert all(np.all(np.isfinite(value)) for value in outputs.values())


def test_the_quaternion_error_is_the_chord_of_the_axis_angle_error(one_task, two_arms, joint_positions):
    tasks = [
        one_task(two_arms, kind="frame_orientation", frame="left", error=error)
        for error in ("axis_angle", "quaternion")
    ]
    for q in joint_positions(two_arms, 20, 4):
        log, chord = (task("step", q=q, aim_reference=[0.5, -0.1, 0.7, 0.2])["aim_error"] for task in tasks)
        angle = np.linalg.norm(log)
        np.testing.assert_allclose(chord, 2 * np.sin(angle / 2) / angle * log, rtol=0, atol=1e-14)


@pytest.mark.parametrize("error", ["axis_angle", "quaternion"])
@pytest.mark.parametrize("seed", range(4))
def test_it_reaches_any_orientation_from_anywhere(one_task, two_arms, rotation_of, joint_positions, error, seed):
    task = one_task(two_arms, kind="frame_orientation", frame="left", error=error)
    start, goal = joint_positions(two_arms, 2, seed)
    outputs = task.run(start, 1000, aim_reference=_quaternion(rotation_of(goal)))
    assert np.linalg.norm(outputs["aim_error"][-1]) < 1e-6
    reached = rotation_of(outputs["q_next"][-1])
    assert (reached * rotation_of(goal).inv()).magnitude() < 1e-6


def _flow(e, omega, gain):
    """ė of a frame that turns at ω = ω_d + K e, from rotations alone: both turn for a short time h."""
    h = 1e-6
    ends = []
    for sign in (1, -1):
        reference = Rotation.from_rotvec(sign * h * omega)
        frame = Rotation.from_rotvec(sign * h * (omega + gain @ e))
        ends.append((reference * Rotation.from_rotvec(e) * frame.inv()).as_rotvec())
    return np.subtract(*ends) / (2 * h)


@pytest.mark.parametrize("seed", range(20))
def test_with_this_feedforward_the_angle_decays_under_any_gain_and_any_reference(seed):
    """d|e|²/dt = −2 eᵀK e whatever ω_d; and for K = k·I, ė = ω_d × e − k e: exact, seen from the reference."""
    draw = np.random.default_rng(seed)
    e = draw.normal(size=3)
    e *= draw.uniform(0.1, 3.0) / np.linalg.norm(e)
    omega, root = draw.normal(size=3), draw.normal(size=(3, 3))
    gain = root @ root.T + 0.1 * np.eye(3)
    rate = _flow(e, omega, gain)
    # rounding of 1e-15 over 2h is 5e-10, times |e| <= 3; h² of third derivatives is far below
    assert 2 * e @ rate == pytest.approx(-2 * e @ gain @ e, abs=2e-8)
    np.testing.assert_allclose(_flow(e, omega, 4 * np.eye(3)), np.cross(omega, e) - 4 * e, rtol=0, atol=1e-8)


def test_the_loop_decays_as_exp_minus_kt_in_the_axes_of_a_turning_reference(orientation, rotation_of, two_arms):
    """The claim of the docstring on the robot: e_d = R_dᵀ e is exp(−kt) times what it was, as T goes to zero."""
    q = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0, 0, 0, 0])
    start = Rotation.from_rotvec([0.4, -0.5, 0.3]) * rotation_of(q)
    spin = Spin(kind="spin", start=tuple(start.as_euler("xyz")), axis=(0.2, 1.0, -0.4), rate=0.8, duration=10.0)
    worst = []
    for period in (0.004, 0.002):
        steps = round(0.5 / period) + 1
        value, velocity = spin.sample(period * np.arange(steps))
        outputs = orientation.run(q, steps, period=period, aim_reference=value, aim_reference_velocity=velocity)
        seen = Rotation.from_quat(value, scalar_first=True).inv().apply(outputs["aim_error"])
        expected = np.exp(-5 * period * np.arange(steps))[:, None] * seen[0]
        worst.append(np.max(np.abs(seen - expected)))
    assert worst[1] < 0.01 * np.linalg.norm(seen[0])
    assert worst[0] / worst[1] == pytest.approx(2, rel=0.1)  # what is left is Euler's O(T)


def test_a_full_gain_matrix_is_applied_to_the_error_in_the_world(one_task, two_arms, joint_positions):
    K = np.array([[3.0, 0.5, -0.2], [0.5, 2.0, 0.3], [-0.2, 0.3, 4.0]])
    task = one_task(two_arms, kind="frame_orientation", frame="left", gain=K.tolist(), damping=1e-6)
    q = joint_positions(two_arms, 1, 5)[0]
    omega = np.array([0.1, -0.2, 0.3])
    outputs = task("step", q=q, aim_reference=[0.9, 0.1, -0.2, 0.3], aim_reference_velocity=omega)
    J = task("jacobians", q=q)["aim_jacobian"]
    # a damping of 1e-6 against singular values of about 1 changes the velocity by 1e-12 of itself
    np.testing.assert_allclose(J @ outputs["dq_law"], omega + K @ outputs["aim_error"], rtol=0, atol=1e-10)


def test_a_spin_is_followed_to_first_order_in_t(orientation, ramp, expect_first_order, rotation_of):
    q = np.array([0.2, -0.3, 0.5, 0.4, -0.6, 0.3, 0.2, 0, 0, 0, 0])
    rpy = tuple(rotation_of(q).as_euler("xyz"))
    spin = Spin(kind="spin", start=rpy, axis=(0.3, -0.2, 1.0), rate=0.4, duration=10.0)

    def motion(t):
        value, velocity = spin.sample(t)
        return {"aim_reference": value, "aim_reference_velocity": velocity}

    expect_first_order(ramp(orientation, q, motion))


def test_a_planar_robot_is_told_of_base_heading(one_task, planar_robot):
    with pytest.raises(BadInput, match=r"aim.*base_heading"):
        one_task(planar_robot, kind="frame_orientation", frame="tool")


def test_an_unknown_frame_is_told_the_valid_ones(one_task, two_arms):
    with pytest.raises(BadInput, match=r"no frame 'lift'.*left.*right"):
        one_task(two_arms, kind="frame_orientation", frame="lift")
