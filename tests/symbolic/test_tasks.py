"""Obstacle avoidance (eqs. 6-10), tracking (eq. 4) and their combination (eqs. 11-12)."""

import casadi as ca
import numpy as np
import pytest

from clikgen.symbolic.damping import ConstantDamping
from clikgen.symbolic.laws import nsb
from clikgen.symbolic.task import Task

NAN = np.nan


@pytest.fixture
def resting():
    """Step inputs for planar5 with its arm along x, no obstacle: the tool is at (1.1, 0)."""
    return {
        "q": np.zeros(5),
        "tool_reference": np.array([1.1, 0.0]),
        "obstacle_center": np.full((3, 2), 50.0),
        "obstacle_radius": np.zeros(3),
        "obstacle_count": 0.0,
    }


# ---- Eqs. 8-9: what is sensed, and the potential ----


def test_potential_jacobian_is_the_potentials_derivative(evaluate_many, planar_model, states_near_contact, one_state):
    values = states_near_contact(2_000, 1)
    # A kink of V sits where another obstacle becomes the closest one, a step of V's curvature at d = s, a pole
    # of it at d + R = 0: keep the states that stay 1e-4 m away from all of them.
    smooth = np.array([_is_smooth(planar_model, one_state(values, i)) for i in range(2_000)])
    values = {name: array[smooth] for name, array in values.items()}
    J_o = evaluate_many("jacobians", values)["obstacles_jacobian"]
    assert np.sum(np.any(J_o != 0, axis=1)) > 300  # in contact
    h = 1e-6
    for j in range(5):
        ends = [
            evaluate_many("step", values | {"q": values["q"] + sign * h * np.eye(5)[j]})["obstacles_potential"]
            for sign in (1, -1)
        ]
        # rounding of V <= 2 over 2h is 2e-10; h²/6 of V''' < 1e3 is 2e-10
        np.testing.assert_allclose(J_o[:, j], np.subtract(*ends) / (2 * h), rtol=0, atol=2e-9)


def _is_smooth(planar_model, values, margin=1e-4):
    points = np.array([planar_model.position(values["q"], point) for point in planar_model.POINTS])
    apart = np.linalg.norm(values["obstacle_center"][None] - points[:, None], axis=-1)
    apart = apart[:, : int(values["obstacle_count"])]
    distance = np.sort(apart - values["obstacle_radius"][: apart.shape[1]], axis=1)
    on_boundary = np.abs(distance - values["influence_radius"][:, None]) < margin
    return not (np.any(np.diff(distance) < margin) or np.any(on_boundary) or np.any(apart < 3e-2))


def test_what_is_sensed_equals_the_model_by_hand(evaluate_many, planar_model, states_near_contact, one_state):
    values = states_near_contact(500, 2)
    # On a centre the direction is a convention (tested below) that the model does not share.
    values["obstacle_center"] += 1e-3
    outputs, jacobians = evaluate_many("step", values), evaluate_many("jacobians", values)
    for i in range(500):
        state = one_state(values, i)
        V, J_o = planar_model.potential(state)
        distance, _ = planar_model.sensed(state)
        # ten terms below 10 m, each with a rounding unit of 2e-15 m
        np.testing.assert_allclose(outputs["distance"][i], distance, rtol=0, atol=2e-14)
        np.testing.assert_allclose(outputs["obstacles_potential"][i], V, rtol=0, atol=2e-14)
        # a direction to a centre 1e-3 m away magnifies that rounding a thousand times
        np.testing.assert_allclose(jacobians["obstacles_jacobian"][i], J_o[0], rtol=0, atol=2e-11)
        expected = np.min(distance - state["influence_radius"])
        np.testing.assert_allclose(outputs["clearance"][i], expected, rtol=0, atol=2e-14)
        assert outputs["active"][i] == np.any(distance <= state["influence_radius"])
    assert 100 < np.sum(outputs["active"]) < 400


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_closest_obstacle_counts_whatever_its_place(planar5, resting, order):
    center = np.array([[1.3, 0.0], [1.1, 0.12], [1.6, 0.0]])[list(order)]
    radius = np.array([0.0, 0.0, 0.45])[list(order)]  # the last is a disc whose edge is the nearest, at 0.05 m
    outputs = planar5.step(**resting | {"obstacle_center": center, "obstacle_radius": radius, "obstacle_count": 3})
    # positions of about 1 m have a rounding unit of 2.2e-16 m
    assert outputs["distance"][5] == pytest.approx(0.05, abs=1e-15)
    assert (
        planar5.jacobians(
            **{name: value for name, value in resting.items() if name in planar5.jacobians.inputs}
            | {"obstacle_center": center, "obstacle_radius": radius, "obstacle_count": 3}
        )["obstacles_jacobian"][0]
        > 0
    )  # toward +x, where the disc is, lies the greater potential


def test_a_disc_is_sensed_at_its_edge_and_a_point_at_its_place(planar5, resting):
    at = {"obstacle_center": np.array([[1.6, 0.0], [9, 9], [9, 9]]), "obstacle_count": 1}
    point = planar5.step(**resting | at)["distance"].copy()
    disc = planar5.step(**resting | at | {"obstacle_radius": np.array([0.2, 0, 0])})["distance"]
    assert point[5] == 1.6 - 1.1
    np.testing.assert_array_equal(disc, point - 0.2)


def test_inside_a_disc_the_distance_is_negative_and_the_push_goes_out(planar5, resting):
    disc = {"obstacle_center": np.array([[1.2, 0.0], [9, 9], [9, 9]]), "obstacle_radius": np.array([0.25, 0, 0])}
    only_tool = {"influence_radius": np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 0.15])}
    outputs = planar5.step(**resting | disc | only_tool | {"obstacle_count": 1})
    assert outputs["distance"][5] == pytest.approx(-0.15, abs=1e-15)  # rounding of positions of about 1 m
    assert outputs["clearance"] == outputs["distance"][5] - 0.15
    depth = 0.3
    assert outputs["obstacles_potential"] == pytest.approx(depth**2 / 2, rel=1e-14)
    # J_o = x u: ẋ = −K_o V / x along u = +x, and nothing else moves. Damping/x = 3e-6 changes it by its square.
    expected = [-250 * depth / 2, 0, 0, 0, 0]
    np.testing.assert_allclose(outputs["dq_law"], expected, rtol=0, atol=1e-9)


def test_a_point_on_an_obstacles_centre_is_pushed_toward_minus_x(planar5, resting):
    q = np.array([0.3, -0.2, 0.5, 0.7, -0.4])
    tool = planar5.kinematics(q=q)["point_position"][5].copy()
    on_top = {"q": q, "tool_reference": tool, "obstacle_center": np.array([tool, [9, 9], [9, 9]])}
    only_tool = {"influence_radius": np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 0.15])}
    outputs = planar5.step(**resting | on_top | only_tool | {"obstacle_count": 1})
    assert abs(outputs["distance"][5]) < 4 * 2.0**-53 * np.linalg.norm(tool)  # the step rounds where it is by itself
    velocity = planar5.jacobians(q=q)["tool_jacobian"] @ outputs["dq_law"]
    assert velocity[0] < -1
    # away from a centre the push has the direction of the offset, however small that is
    beside = tool - [0, 1e-9]
    outputs = planar5.step(obstacle_center=np.array([beside, [9, 9], [9, 9]]))
    velocity = planar5.jacobians(q=q)["tool_jacobian"] @ outputs["dq_law"]
    assert velocity[1] > 1


@pytest.mark.parametrize("garbage", [NAN, np.inf, -np.inf, 0.0])
@pytest.mark.parametrize("count", [0.0, 1.0, 2.0])
def test_absent_obstacles_are_ignored_whatever_they_hold(planar5, resting, garbage, count):
    present = int(count)
    center, radius = np.array([[1.2, 0.05], [0.3, 0.3], [0, 0]]), np.array([0.05, 0.1, 0.0])
    clean = center.copy(), radius.copy()
    for array, rest in ((center, garbage), (radius, garbage)):
        array[present:] = rest
    for array in clean:
        array[present:] = 40.0
    clean[1][present:] = 0.0
    results = []
    for c, r in ((center, radius), clean):
        given = resting | {"obstacle_center": c, "obstacle_radius": r, "obstacle_count": count}
        results.append({name: array.copy() for name, array in planar5.step(**given).items()})
        given = {name: value for name, value in given.items() if name in planar5.jacobians.inputs}
        results[-1] |= {name: array.copy() for name, array in planar5.jacobians(**given).items()}
    for name, array in results[1].items():
        np.testing.assert_array_equal(results[0][name], array, err_msg=name)
        assert np.all(np.isfinite(array))
    assert results[0]["active"] == (count > 0)


def test_the_boundary_belongs_to_the_influence_region(planar5, resting):
    at = resting | {"obstacle_center": np.array([[1.3, 0.07], [9, 9], [9, 9]]), "obstacle_count": 1}
    small = np.full(6, 1e-6)
    distance = float(planar5.step(**at, influence_radius=small)["distance"][5])
    small[5] = distance
    outputs = planar5.step(influence_radius=small)
    assert outputs["active"] == 1  # d <= s, eq. 8
    assert outputs["clearance"] == 0
    assert outputs["obstacles_potential"] == 0
    inputs = {name: planar5.step.inputs[name] for name in planar5.jacobians.inputs}
    np.testing.assert_array_equal(planar5.jacobians(**inputs)["obstacles_jacobian"], np.zeros(5))
    small[5] = np.nextafter(distance, 0)
    assert planar5.step(influence_radius=small)["active"] == 0


# ---- Eqs. 4, 10-12: the law ----


def test_law_equals_the_printed_equations(evaluate_many, planar_model, states_near_contact, one_state):
    values = states_near_contact(1_000, 3)
    values["obstacle_center"] += 1e-3  # off the centres, see above
    rng = np.random.default_rng(3)
    values["obstacles_damping"] = 10 ** rng.uniform(-4, 0, 1_000)
    values["tool_damping"] = 10 ** rng.uniform(-4, 0, 1_000)
    outputs = evaluate_many("step", values)
    for i in range(1_000):
        expected = planar_model.step(one_state(values, i))["dq_law"]
        # J_o is known to 2e-11 (see above) and divided by up to its damping, 1e-4: six digits at worst
        np.testing.assert_allclose(outputs["dq_law"][i], expected, rtol=0, atol=1e-6 * (1 + np.linalg.norm(expected)))
    regular = np.linalg.norm(evaluate_many("jacobians", values)["obstacles_jacobian"], axis=1) > 1e-2
    assert np.sum(regular) > 200
    for i in np.flatnonzero(regular):
        expected = planar_model.step(one_state(values, i))["dq_law"]
        # there 2e-11 is divided by 1e-2, and velocities of 1e2 remain
        np.testing.assert_allclose(outputs["dq_law"][i], expected, rtol=1e-8, atol=1e-8)


def test_lower_task_leaves_higher_task_velocity_unchanged(evaluate_many, states_near_contact):
    values = states_near_contact(2_000, 4)
    values["obstacles_damping"][:] = 1e-9
    J_o = evaluate_many("jacobians", values)["obstacles_jacobian"]
    regular = np.linalg.norm(J_o, axis=1) > 1e-2
    assert np.sum(regular) > 500
    first = evaluate_many("step", values)
    second = evaluate_many("step", values | {"tool_reference": values["tool_reference"] + [3.0, -2.0]})
    higher = [np.sum(J_o * outputs["dq_law"], axis=1)[regular] for outputs in (first, second)]
    # (damping/|J_o|)² = 1e-14 of a velocity below 1e2 leaks, and rounding of such velocities
    np.testing.assert_allclose(*higher, rtol=0, atol=1e-11)
    # and it is the one that eq. 10 asks for
    wanted = -values["obstacles_gain"] * first["obstacles_potential"]
    np.testing.assert_allclose(higher[0], wanted[regular], rtol=0, atol=1e-11)
    # while the lower task did change what the robot does
    assert np.median(np.linalg.norm(first["dq_law"] - second["dq_law"], axis=1)) > 1


def test_a_free_robot_moves_its_tool_as_eq_4_asks(evaluate_many, states_near_contact):
    values = states_near_contact(1_000, 5)
    values["obstacle_count"][:] = 0
    values["tool_damping"][:] = 1e-6
    outputs = evaluate_many("step", values)
    moved = np.einsum("kij,kj->ki", evaluate_many("jacobians", values)["tool_jacobian"], outputs["dq_law"])
    wanted = values["tool_reference_velocity"] + np.einsum("kij,kj->ki", values["tool_gain"], outputs["tool_error"])
    # σ_min(J_g) >= 1 for a mobile base: damping² = 1e-12 of a velocity below 30 m/s is lost
    np.testing.assert_allclose(moved, wanted, rtol=0, atol=3e-11)
    error = values["tool_reference"] - evaluate_many("kinematics", values)["tool_position"]
    rounding = 8 * 2.0**-53 * np.max(np.abs(values["q"][:, :2])) + 8 * 2.0**-53
    np.testing.assert_allclose(outputs["tool_error"], error, rtol=0, atol=rounding)


def _task(jacobian, velocity, error, gain, damping):
    return Task(
        name="synthetic",
        jacobian=ca.SX(jacobian),
        error=ca.SX(error),
        feedforward=ca.SX(velocity),
        gain=ca.SX(gain),
        damping=ConstantDamping(ca.SX(damping)),
        parameters=(),
        diagnostics=(),
        values=(),
        jacobians=(),
    )


@pytest.mark.parametrize("seed", range(20))
def test_three_levels_equal_the_nested_projectors(seed, planar_model):
    rng = np.random.default_rng(seed)
    n = 7
    tasks, velocities, inverses, projectors = [], [], [], []
    for m in rng.permutation([1, 2, 3]):
        J, feedforward, error = rng.normal(size=(m, n)), rng.normal(size=m), rng.normal(size=m)
        gain, damping = np.diag(rng.uniform(0.5, 5, m)), 10 ** rng.uniform(-3, 0)
        tasks.append(_task(J, feedforward, error, gain, damping))
        inverse = planar_model.inverse(J, damping)
        velocities.append(inverse @ (feedforward + gain @ error))
        projectors.append(np.eye(n) - inverse @ J)
        inverses.append(inverse)
    q1, q2, q3 = velocities
    N1, N2, _ = projectors
    expected = q1 + N1 @ (q2 + N2 @ q3)
    # random 3×7 Jacobians have condition numbers below 1e2: a gram matrix loses four of sixteen digits
    np.testing.assert_allclose(np.array(ca.DM(nsb.combine(tasks)))[:, 0], expected, rtol=0, atol=1e-11)
    # the order matters, so the comparison can tell it
    assert np.linalg.norm(q3 + projectors[2] @ (q2 + N2 @ q1) - expected) > 1e-2


def test_one_level_is_its_damped_inverse_alone(planar_model):
    rng = np.random.default_rng(0)
    J, v = rng.normal(size=(2, 4)), rng.normal(size=2)
    task = _task(J, v, np.zeros(2), np.eye(2), 0.1)
    expected = planar_model.inverse(J, 0.1) @ v
    # a well-conditioned 2×2 gram matrix
    np.testing.assert_allclose(np.array(ca.DM(nsb.combine([task])))[:, 0], expected, rtol=0, atol=1e-14)
