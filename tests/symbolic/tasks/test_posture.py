"""Posture: a linear loop in joint space, so everything about it is known exactly."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput

ROUNDING = 2e-14  # of velocities of up to 100 rad/s times T, over the steps of a loop that contracts


@pytest.fixture(scope="module")
def arm(plane_arm):
    return plane_arm([0.4, 0.3, 0.3, 0.2])


def _posture(**more):
    return {"name": "rest", "kind": "posture", "posture": [0.4, -0.8, 1.2, 0.3], "gain": 5.0} | more


def test_jacobian_is_the_derivative_of_the_value(evaluated, arm):
    controller = evaluated(arm, _posture(joints=["j2", "j0"], posture=[1.0, 2.0]))
    q = np.random.default_rng(0).uniform(-3, 3, (50, 4))
    J = controller("jacobians", q=q)["rest_jacobian"]
    np.testing.assert_array_equal(J, np.broadcast_to([[0, 0, 1, 0], [1, 0, 0, 0]], (50, 2, 4)))
    # a linear value: rounding of 4e-16 over 2h = 2e-6
    np.testing.assert_allclose(J, controller.derivative("rest_value", q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_error_shrinks_by_one_minus_gain_times_period_each_step(evaluated, arm, law):
    controller = evaluated(arm, _posture(), law=law)
    path, outputs = controller.run(400, np.zeros(4))
    e0 = np.array([0.4, -0.8, 1.2, 0.3])
    expected = e0 * (1 - 5.0 * 0.01) ** np.arange(401)[:, None]
    # the augmented law withholds 2^-30 of every velocity
    np.testing.assert_allclose(e0 - path, expected, rtol=0, atol=ROUNDING if law == "nsb" else 1e-9)
    np.testing.assert_array_equal(outputs["rest_error"], e0 - path[:-1])
    np.testing.assert_array_equal(outputs["rest_value"], path[:-1])
    assert np.max(np.abs(e0 - path[-1])) < 1e-6


def test_each_joint_has_its_own_gain_with_a_list(evaluated, arm):
    gains = np.array([1.0, 2.0, 10.0, 100.0])
    path, _ = evaluated(arm, _posture(gain=gains.tolist())).run(200, np.zeros(4))
    e0 = np.array([0.4, -0.8, 1.2, 0.3])
    np.testing.assert_allclose(e0 - path, e0 * (1 - gains * 0.01) ** np.arange(201)[:, None], rtol=0, atol=ROUNDING)


def test_a_full_gain_matrix_couples_the_joints(evaluated, arm):
    A = np.random.default_rng(1).normal(size=(4, 4))
    K = (A @ A.T + np.eye(4)).round(3)
    path, _ = evaluated(arm, _posture(gain=K.tolist())).run(100, np.zeros(4))
    e = np.array([0.4, -0.8, 1.2, 0.3])
    for q in path:
        np.testing.assert_allclose([0.4, -0.8, 1.2, 0.3] - q, e, rtol=0, atol=ROUNDING)
        e = e - 0.01 * K @ e


def test_only_the_selected_joints_move(evaluated, arm):
    controller = evaluated(arm, _posture(joints=["j3", "j1"], posture=[1.0, -1.0]))
    path, _ = controller.run(400, [0.5, 0.5, 0.5, 0.5])
    np.testing.assert_array_equal(path[:, [0, 2]], 0.5)
    np.testing.assert_allclose(path[-1, [1, 3]], [-1.0, 1.0], rtol=0, atol=1e-6)


def test_reference_is_optional_and_takes_the_posture_s_place(evaluated, arm):
    controller = evaluated(arm, _posture())
    (reference,) = controller.controller.tasks[0].references
    assert (reference.name, reference.space, reference.required) == ("rest", "vector", False)
    assert controller.infos()["rest_reference"].default == (0.4, -0.8, 1.2, 0.3)
    path, _ = controller.run(400, np.zeros(4), rest_reference=np.array([1.0, 1.0, -1.0, 0.0]))
    np.testing.assert_allclose(path[-1], [1.0, 1.0, -1.0, 0.0], rtol=0, atol=1e-6)


def test_a_ramp_is_followed_without_error_with_feedforward_and_lags_without(evaluated, arm):
    """Euler steps on a straight line are exact: e⁺ = (1 − KT) e. Without ṙ, e → v/K."""
    v = np.array([0.5, -0.2, 0.1, 0.3])
    ramp = {"rest_reference": lambda t: v * t}
    controller = evaluated(arm, _posture())
    _, outputs = controller.run(500, np.zeros(4), rest_reference_velocity=v, **ramp)
    np.testing.assert_allclose(outputs["rest_error"], 0, rtol=0, atol=ROUNDING)
    _, outputs = controller.run(800, np.zeros(4), **ramp)
    np.testing.assert_allclose(outputs["rest_error"][-1], v / 5.0, rtol=0, atol=ROUNDING)


def test_a_curved_reference_is_followed_to_first_order_in_the_period(evaluated, arm):
    """e⁺ = (1 − KT) e + ½T² r̈(ξ), so |e| <= T a/(2K) from rest, and half of it at half of T."""
    worst = []
    for period in (0.01, 0.005):
        controller = evaluated(arm, _posture(), period=period)
        _, outputs = controller.run(
            round(6 / period),
            np.zeros(4),
            rest_reference=lambda t: np.full(4, np.sin(2 * t)),
            rest_reference_velocity=lambda t: np.full(4, 2 * np.cos(2 * t)),
        )
        worst.append(np.max(np.abs(outputs["rest_error"])))
        assert worst[-1] <= period * 4 / (2 * 5.0)
    # the error is periodic with an amplitude of T a / (2 |K + 2i|) to first order in T: 2 T is 2 %
    assert worst[0] / worst[1] == pytest.approx(2, rel=0.02)
    assert worst[1] == pytest.approx(0.005 * 4 / (2 * abs(5 + 2j)), rel=0.02)


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_below_a_tracking_task_it_moves_the_arm_within_the_null_space_alone(evaluated, arm, law):
    """The position is reached as if alone, and what is left of the posture error cannot be reached."""
    tracking = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 5.0, "damping": 1e-6}
    controller = evaluated(arm, tracking, _posture(), law=law)
    goal = np.array([0.6, 0.3])
    path, outputs = controller.run(6000, [0.3, 0.4, 0.5, 0.6], tool_reference=goal)
    assert np.max(np.abs(outputs["tool_error"][-1])) < 1e-6
    J = controller("jacobians", q=path[-1])["tool_jacobian"]
    null = np.linalg.svd(J)[2][2:]
    # along the null space the error shrinks at the gain, 5/s, less what its curvature takes: e^-30 is 1e-13
    assert np.max(np.abs(null @ outputs["rest_error"][-1])) < 1e-6
    assert np.max(np.abs(outputs["rest_error"][-1])) > 0.1


def test_operations_grow_linearly_with_the_joints(evaluated, plane_arm):
    counts = []
    for n in (5, 10, 20):
        robot = plane_arm([0.1] * n)
        counts.append(evaluated(robot, _posture(posture=[0.1] * n)).operations())
    # 5 more joints cost what the 5 before cost, each alike, up to a handful of constants shared
    assert counts[2] - counts[1] == pytest.approx(2 * (counts[1] - counts[0]), abs=5)


def test_random_states_step_to_finite_ones(evaluated, arm):
    rng = np.random.default_rng(2)
    q = rng.normal(size=(10_000, 4)) * 10.0 ** rng.uniform(-10, 5, (10_000, 1))
    q[:10] = 0
    for law in ("nsb", "augmented"):
        outputs = evaluated(arm, _posture(), law=law)(q=q, rest_reference=rng.normal(size=(10_000, 4)))
        assert all(np.all(np.isfinite(values)) for values in outputs.values())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"joints": ["j1", "j7"], "posture": [0.0, 0.0]}, "no joint 'j7'; valid choices: j0, j1, j2, j3"),
        ({"joints": ["j1", "j1"], "posture": [0.0, 0.0]}, "joint 'j1' is there twice"),
        ({"posture": [0.0, 0.0]}, r"rest_reference: wanted shape \(4,\), got \(2,\)"),
        ({"gain": [1.0, 2.0]}, r"rest_gain: wanted shape \(4,\), got \(2,\)"),
        ({"gain": [[1.0, 2.0], [2.0, 1.0]], "joints": ["j0", "j1"], "posture": [0.0, 0.0]}, "positive definite"),
        ({"joints": []}, "joints"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(evaluated, arm, wrong, message):
    with pytest.raises(BadInput, match=message) as error:
        evaluated(arm, _posture(**wrong))
    assert "\n" not in str(error.value)


def test_each_joint_has_its_unit(evaluated, space_arm):
    infos = evaluated(space_arm(), _posture(joints=["j1", "lift"], posture=[0.1, 0.2])).infos()
    assert infos["rest_reference"].unit == "rad, m"
    assert infos["rest_reference_velocity"].unit == "rad/s, m/s"
