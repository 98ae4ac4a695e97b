"""Manipulability: the measure, its gradient, and where the ascent ends."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.tasks.manipulability import SINGULAR, determinant


def _ascent(**more):
    return {"name": "climb", "kind": "manipulability", "frame": "tool", "gain": 2.0} | more


def _twist_jacobian(controller, q, of, h=1e-6):
    """The Jacobian of the tool's motion at q, (m, n), from differences of its pose: no code of the measure."""
    frame = controller.controller.spec.robot.frames[0]
    joints = [joint.link for joint in controller.controller.spec.robot.joints]

    def pose(q):
        row = controller("kinematics", q=q)["link_pose"][joints.index(frame.link)]
        return row[:, :3], row[:, 3] + row[:, :3] @ frame.xyz

    columns = []
    for e in h * np.eye(len(q)):
        (R1, p1), (R2, p2) = pose(q + e), pose(q - e)
        columns.append(np.concatenate([p1 - p2, Rotation.from_matrix(R1 @ R2.T).as_rotvec()]) / (2 * h))
    J = np.array(columns).T
    return {"position": J[:3], "orientation": J[3:], "pose": J}[of]


@pytest.mark.parametrize("m", range(1, 7))
def test_determinant_equals_numpy_s(m):
    A = ca.SX.sym("A", m, m)
    function = ca.Function("det", [A], [determinant(A)])
    for matrix in np.random.default_rng(m).uniform(-1, 1, (50, m, m)):
        # 720 products of six numbers below 1 at most
        assert float(function(matrix)) == pytest.approx(np.linalg.det(matrix), abs=1e-14)


def test_two_links_have_the_measure_of_the_textbook(evaluated, plane_arm):
    """W = l1 l2 |sin q2| (Yoshikawa 1985)."""
    q = np.random.default_rng(0).uniform(-3, 3, (500, 2))
    outputs = evaluated(plane_arm([0.5, 0.3]), _ascent())(q=q)
    expected = 0.15 * np.abs(np.sin(q[:, 1]))
    # w² is known to 1e-17, so w = 1e-4 to 1e-13
    np.testing.assert_allclose(outputs["climb_value"], expected, rtol=0, atol=1e-12)
    gradient = np.column_stack([np.zeros(500), 0.15 * np.sign(np.sin(q[:, 1])) * np.cos(q[:, 1])])
    np.testing.assert_allclose(outputs["climb_error"], gradient, rtol=0, atol=1e-12)


@pytest.mark.parametrize("of", ["position", "orientation", "pose"])
def test_measure_is_the_product_of_the_singular_values(evaluated, space_arm, of):
    controller = evaluated(space_arm(), _ascent(of=of))
    for q in np.random.default_rng(1).uniform(-2, 2, (40, 7)):
        expected = np.prod(np.linalg.svd(_twist_jacobian(controller, q, of), compute_uv=False))
        # the differences are good to 1e-9, of entries of about 1
        assert controller(q=q)["climb_value"] == pytest.approx(expected, abs=3e-8)
        assert controller("kinematics", q=q)["climb_value"] == controller(q=q)["climb_value"]


@pytest.mark.parametrize("of", ["position", "orientation", "pose"])
@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_the_measure_s_derivative(evaluated, space_arm, of, seed):
    controller = evaluated(space_arm(seed), _ascent(of=of))
    q = np.random.default_rng(seed).uniform(-2, 2, (300, 7))
    regular = controller(q=q)["climb_value"] > 1e-3  # at w = 0 the measure has a kink
    assert np.sum(regular) > 100
    gradient = controller("jacobians", q=q[regular])["climb_jacobian"]
    # h²/6 of a third derivative below 1/w² = 1e6 is 2e-7; rounding of 1e-13/w over 2h is 1e-4 w⁻¹ of 1e-6
    np.testing.assert_allclose(gradient, controller.derivative("climb_value", q[regular]), rtol=0, atol=1e-6)


def test_on_a_cart_the_measure_is_that_of_what_the_drive_can_do(evaluated):
    """q̇ = S u: the base moves along its own axis and turns, so the wrist of the arm cannot slide sideways."""
    limits = {"lower": -10.0, "upper": 10.0, "velocity": 1.0}
    cart = {
        "space": "planar",
        "joints": [
            {"name": "x", "type": "prismatic", "link": "lx", "axis": [1, 0, 0], **limits},
            {"name": "y", "type": "prismatic", "link": "ly", "axis": [0, 1, 0], **limits},
            {"name": "yaw", "type": "continuous", "link": "base"},
        ],
        "drive": {"x": "x", "y": "y", "yaw": "yaw", "velocity": 1.0},
        "frames": [{"name": "tool", "link": "base", "xyz": [0.3, 0.2, 0.0]}],
    }
    controller = evaluated(cart, _ascent())
    for q in np.random.default_rng(2).uniform(-3, 3, (20, 3)):
        # ahead (1, 0) and turning (−0.2, 0.3) in the frame of the base: the determinant is 0.3
        assert controller(q=q)["climb_value"] == pytest.approx(0.3, abs=1e-14)


def test_two_links_end_with_a_right_angle_at_the_elbow(evaluated, plane_arm):
    controller = evaluated(plane_arm([0.5, 0.3]), _ascent(gain=20.0))
    for elbow, end in ((0.01, np.pi / 2), (-0.01, -np.pi / 2), (3.0, np.pi / 2), (1.0, np.pi / 2)):
        path, outputs = controller.run(1500, [0.2, elbow])
        # the slowest rate is gain · w = 3/s: e^-45 is left
        assert path[-1, 1] == pytest.approx(end, abs=1e-9)
        # ∂w/∂q0 is zero up to the rounding of a sum that cancels, 1500 times
        assert path[-1, 0] == pytest.approx(0.2, abs=1e-13)
        # it climbs all the way, up to the rounding of w at the top
        assert np.all(np.diff(outputs["climb_value"]) > -1e-15)


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_below_a_tracking_task_it_ends_at_a_maximum_of_the_self_motion(evaluated, plane_arm, law):
    tracking = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 5.0, "damping": 1e-6}
    controller = evaluated(plane_arm([0.5, 0.4, 0.3]), tracking, _ascent(gain=20.0), law=law)
    start = np.array([0.3, 0.2, 0.1])
    goal = np.array([0.7, 0.2])
    path, outputs = controller.run(3000, start, tool_reference=goal)
    assert np.max(np.abs(outputs["tool_error"][-1])) < 1e-9
    null = np.linalg.svd(controller("jacobians", q=path[-1])["tool_jacobian"])[2][2]
    gradient = outputs["climb_error"][-1]
    assert abs(null @ gradient) < 1e-9
    assert np.linalg.norm(gradient) > 1e-2  # the gradient itself is not zero: tracking stands against it
    # a maximum and no saddle: 1e-2 rad along the self-motion either way, back on the goal, w is less
    for way in (1e-2, -1e-2):
        beside, _ = controller.run(2000, path[-1] + way * null, tool_reference=goal, climb_gain=0.0)
        assert controller(q=beside[-1])["climb_value"] < outputs["climb_value"][-1] - 1e-7


def test_only_the_selected_joints_climb(evaluated, space_arm):
    controller = evaluated(space_arm(), _ascent(joints=["j5", "j2"]))
    q = np.random.default_rng(3).uniform(-2, 2, 7)
    outputs, gradient = controller(q=q), controller("jacobians", q=q)["climb_jacobian"]
    np.testing.assert_array_equal(outputs["climb_error"], gradient[[5, 2]])
    # a division by 1 and a product
    np.testing.assert_allclose(outputs["dq_law"], 2.0 * gradient * [0, 0, 1, 0, 0, 1, 0], rtol=1e-15, atol=0)
    assert np.all(gradient[[5, 2]] != 0)


def test_at_a_singular_configuration_it_asks_for_nothing_and_leaves_one_beside_it(evaluated, plane_arm):
    controller = evaluated(plane_arm([0.5, 0.3]), _ascent())
    outputs = controller(q=np.zeros(2))
    assert outputs["climb_value"] == 0
    np.testing.assert_array_equal(outputs["dq_law"], 0)
    beside = controller(q=np.array([0.0, 2 * SINGULAR / 0.15]))
    # ∂w/∂q2 = l1 l2 cos q2, w² with the rounding of 1e-17 against 4e-12
    np.testing.assert_allclose(beside["climb_error"], [0, 0.15], rtol=0, atol=1e-5)


@pytest.mark.parametrize("of", ["position", "orientation", "pose"])
def test_random_and_degenerate_states_step_to_finite_ones(evaluated, space_arm, of):
    controller = evaluated(space_arm(), _ascent(of=of))
    rng = np.random.default_rng(4)
    q = rng.normal(size=(10_000, 7)) * 10.0 ** rng.uniform(-12, 4, (10_000, 1))
    q[:10] = 0
    outputs = controller(q=q)
    assert all(np.all(np.isfinite(values)) for values in outputs.values())


def test_stretched_and_folded_arms_step_to_finite_states(evaluated, plane_arm):
    controller = evaluated(plane_arm([0.5, 0.4, 0.3]), _ascent())
    rng = np.random.default_rng(5)
    q = np.pi * rng.integers(-1, 2, (10_000, 3)) + 10.0 ** rng.uniform(-20, -3, (10_000, 3))
    outputs = controller(q=q)
    assert all(np.all(np.isfinite(values)) for values in outputs.values())
    # |∂w/∂q| is bounded: by the derivative of the determinant of entries below 1.2 m
    assert np.max(np.abs(outputs["climb_error"])) < 3


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"frame": "tol"}, "no frame 'tol'; did you mean 'tool'"),
        ({"of": "pose"}, "move the pose of frame 'tool' in 2 of 3 directions at most, so w is zero everywhere"),
        ({"of": "shape"}, "of"),
        ({"joints": ["j9"]}, "no joint 'j9'"),
        ({"gain": -1.0}, "gain"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(evaluated, plane_arm, wrong, message):
    with pytest.raises(BadInput, match=message) as error:
        evaluated(plane_arm([0.5, 0.3]), _ascent(**wrong))
    assert "\n" not in str(error.value)


def test_a_planar_pose_has_three_rows(evaluated, plane_arm):
    controller = evaluated(plane_arm([0.5, 0.4, 0.3]), _ascent(of="pose"))
    for q in np.random.default_rng(6).uniform(-3, 3, (50, 3)):
        J = _twist_jacobian(controller, q, "pose")[[0, 1, 5]]
        # the differences are good to 1e-9, of entries of about 1
        assert controller(q=q)["climb_value"] == pytest.approx(abs(np.linalg.det(J)), abs=3e-8)
