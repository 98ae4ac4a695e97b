"""Joint limits: every joint near a limit is held, and the others are free."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput

SWITCHED = {"kind": "switched", "gain": 50.0, "damping": 1e-3, "combine": "rows"}
STOPS = {"name": "stops", "kind": "joint_limits", "margin": 0.1, "activation": SWITCHED}
REST = {"name": "rest", "kind": "posture", "gain": 5.0}


@pytest.fixture(scope="module")
def arm():
    """Four joints in the plane: j2 turns without end, the others have limits of their own, the last in metres."""

    def joint(i, kind, **limits):
        return {"name": f"j{i}", "type": kind, "link": f"link{i}", "xyz": [0.3 * (i > 0), 0.0, 0.0]} | limits

    joints = [
        joint(0, "revolute", lower=-1.0, upper=2.0),
        joint(1, "revolute", lower=-2.0, upper=0.5),
        joint(2, "continuous"),
        joint(3, "prismatic", lower=0.0, upper=0.6, axis=[1, 0, 0]),
    ]
    return {"space": "planar", "joints": joints}


def _depths(q, lower, upper, margin):
    return np.maximum(lower + margin - q, 0), np.maximum(q - upper + margin, 0)


def test_rows_are_those_of_the_equations(evaluated, arm):
    margin = np.array([0.2, 0.3, 0.1])
    controller = evaluated(arm, STOPS | {"margin": margin.tolist()})
    q = np.random.default_rng(0).uniform([-1.5, -2.5, -9, -0.2], [2.5, 1.0, 9, 0.8], (500, 4))
    outputs, J = controller(q=q), controller("jacobians", q=q)["stops_jacobian"]
    limited = [0, 1, 3]
    below, above = _depths(q[:, limited], np.array([-1.0, -2.0, 0.0]), np.array([2.0, 0.5, 0.6]), margin)
    # differences of numbers of about 1
    np.testing.assert_allclose(outputs["stops_depth"], np.maximum(below, above), rtol=0, atol=1e-15)
    np.testing.assert_allclose(outputs["stops_potential"], (below**2 + above**2) / 2, rtol=0, atol=1e-15)
    expected = np.zeros((500, 3, 4))
    expected[:, range(3), limited] = above - below
    np.testing.assert_allclose(J, expected, rtol=0, atol=1e-15)
    for depth in (below, above):
        assert np.all(np.sum(depth > 0, axis=0) > 50)


def test_jacobian_is_the_derivative_of_the_potential(evaluated, arm):
    controller = evaluated(arm, STOPS)
    q = np.random.default_rng(1).uniform([-1.5, -2.5, -9, -0.2], [2.5, 1.0, 9, 0.8], (500, 4))
    J = controller("jacobians", q=q)["stops_jacobian"]
    # C¹: the curvature steps by 1 at the edge of a margin, within h = 1e-6; rounding of 1e-16 over 2h
    np.testing.assert_allclose(J, controller.derivative("stops_potential", q), rtol=0, atol=1e-6)


def test_limits_and_margins_are_parameters_and_joints_without_limits_have_none(evaluated, arm):
    infos = evaluated(arm, STOPS).infos()
    assert infos["stops_lower"].default == (-1.0, -2.0, 0.0)
    assert infos["stops_upper"].default == (2.0, 0.5, 0.6)
    assert infos["stops_margin"].default == (0.1, 0.1, 0.1)
    assert infos["stops_upper"].unit == "rad, rad, m"
    path, _ = evaluated(arm, STOPS, REST | {"posture": [0.0, 0.0, 0.0, 0.3]}).run(
        1000, np.zeros(4), stops_upper=np.array([-0.2, 0.5, 0.6])
    )
    assert path[-1, 0] < -0.2 - 0.09


@pytest.mark.parametrize("law", ["nsb", "augmented"])
@pytest.mark.parametrize(("period", "margin"), [(0.01, 0.25), (0.002, 0.1)])
def test_several_joints_pushed_into_limits_are_all_held_while_the_others_arrive(evaluated, arm, law, period, margin):
    """A joint enters its margin by T v at most, so with a margin beyond that it never passes its limit."""
    stops, rest = STOPS | {"margin": margin}, REST | {"posture": [5.0, -6.0, 4.0, 3.0]}
    controller = evaluated(arm, stops, rest, law=law, period=period)
    path, outputs = controller.run(round(10 / period), [0.5, -0.5, 0.0, 0.3])
    assert np.all(path[:, [0, 1, 3]] <= [2.0, 0.5, 0.6])
    assert np.all(path[:, [0, 1, 3]] >= [-1.0, -2.0, 0.0])
    edge = np.array([2.0 - margin, -2.0 + margin, 0.6 - margin])
    fastest = 5.0 * np.abs([5.0, -6.0, 3.0] - edge)  # [1/s]
    assert np.all(outputs["stops_depth"] <= period * fastest + 1e-12)
    # all three have come to rest where gain and damping balance, (2 d² v/K)^⅓ or nearer to the edge
    assert np.all(np.abs(path[-1, [0, 1, 3]] - edge) < 1.01 * (2 * 1e-3**2 * fastest / 50.0) ** (1 / 3))
    # the joint without limits arrives: e^-50
    assert path[-1, 2] == pytest.approx(4.0, abs=1e-6)


def test_a_constant_push_is_held_at_the_depth_where_damping_and_gain_balance(evaluated, arm):
    """Law nsb: x = (2 d² v/K)^⅓, the depth at which K x³/2 = d² v."""
    for d, v in ((1e-2, 1.0), (3e-2, 0.5), (3e-2, 2.0)):
        push = REST | {"gain": 1.0, "posture": [1.9 + v, -0.5, 0.0, 0.3]}
        controller = evaluated(arm, STOPS | {"activation": SWITCHED | {"damping": d}}, push, period=0.001)
        path, outputs = controller.run(8000, [1.8, -0.5, 0.0, 0.3])
        x = outputs["stops_depth"][-1, 0]
        # the push is v − x
        assert x == pytest.approx((2 * d**2 * (v - x) / 50.0) ** (1 / 3), rel=1e-4)
        assert path[-1, 0] < 2.0


def test_one_row_a_joint_holds_what_one_sum_would_let_slide(evaluated, arm):
    """Two joints as deep in their margins, one pushed on and one back: a sum's row (x, x) is blind to (1, −1)."""
    q = np.array([1.95, 0.45, 0.0, 0.3])
    push = REST | {"posture": [11.95, -9.55, 0.0, 0.3], "gain": 1.0}
    velocity = evaluated(arm, STOPS | {"activation": SWITCHED | {"damping": 1e-6}}, push)(q=q)["dq_law"]
    # each goes back by its own row, −K x/2; of the push of ±10 the share (1e-6/0.05)² = 4e-10 passes
    np.testing.assert_allclose(velocity[:2], [-50 * 0.05 / 2] * 2, rtol=0, atol=1e-8)


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_a_joint_beyond_its_limit_comes_back(evaluated, arm, law):
    controller = evaluated(arm, STOPS | {"activation": SWITCHED | {"damping": 1e-6}}, law=law)
    path, outputs = controller.run(1000, [2.7, -2.9, 1.0, -0.4])
    # the depth shrinks by 1 − K T/2 = 0.75 a step until it is near the damping
    depth = np.array([0.8, 1.0, 0.5])
    np.testing.assert_allclose(outputs["stops_depth"][:20], depth * 0.75 ** np.arange(20)[:, None], rtol=1e-6)
    np.testing.assert_allclose(path[-1], [1.9, -1.9, 1.0, 0.1], rtol=0, atol=1e-5)


def test_a_robot_inside_all_margins_does_what_the_task_below_wants(evaluated, arm):
    rest = REST | {"posture": [0.3, -0.7, 5.0, 0.2]}
    q = np.random.default_rng(2).uniform([-0.8, -1.8, -9, 0.15], [1.8, 0.3, 9, 0.45], (300, 4))
    with_it, without = evaluated(arm, STOPS, rest)(q=q), evaluated(arm, rest)(q=q)
    np.testing.assert_array_equal(with_it["dq_law"], without["dq_law"])


def test_operations_grow_linearly_with_the_joints(evaluated, plane_arm):
    counts = [evaluated(plane_arm([0.1] * n), STOPS).operations() for n in (5, 10, 20)]
    # 5 more joints cost what the 5 before cost, each alike, up to a handful of constants shared
    assert counts[2] - counts[1] == pytest.approx(2 * (counts[1] - counts[0]), abs=5)


def test_random_and_degenerate_states_step_to_finite_ones(evaluated, arm):
    rng = np.random.default_rng(3)
    q = rng.normal(size=(10_000, 4)) * 10.0 ** rng.uniform(-10, 5, (10_000, 1))
    q[::5, :2] = [1.9, 0.4]  # on the edges
    q[::7] += 10.0 ** rng.uniform(-18, -3, q[::7].shape)
    q[:10] = [2.0, 0.5, 0.0, 0.6]
    for law in ("nsb", "augmented"):
        outputs = evaluated(arm, STOPS, REST | {"posture": [9.0, 9.0, 9.0, 9.0]}, law=law)(q=q)
        assert all(np.all(np.isfinite(values)) for values in outputs.values())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"margin": 0.31}, r"task 'stops': joint 'j3' moves from 0 to 0.6 m: wanted a margin of at most half of that"),
        ({"margin": [0.1, 0.1]}, r"stops_margin: wanted shape \(3,\), got \(2,\)"),
        ({"margin": -0.1}, "margin"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(evaluated, arm, wrong, message):
    with pytest.raises(BadInput, match=message) as error:
        evaluated(arm, STOPS | wrong)
    assert "\n" not in str(error.value)


def test_a_robot_without_limits_is_told_so(evaluated):
    joints = [{"name": "j0", "type": "continuous", "link": "link0"}]
    with pytest.raises(BadInput, match="task 'stops': wanted a joint with limits, got none"):
        evaluated({"space": "planar", "joints": joints}, STOPS)
