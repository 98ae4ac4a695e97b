"""Euler step, filter and planner (eqs. 13-19), and the stability and lag that follow from them."""

import math
from fractions import Fraction

import numpy as np
import pytest

from clikgen.runtime.scenario import CASES
from clikgen.symbolic import planners
from clikgen.symbolic.kinds import kinds_in

# ---- Eqs. 13-19 ----


def test_step_equals_the_printed_equations(evaluate_many, planar_model, states_near_contact, one_state):
    values = states_near_contact(1_000, 6)
    values["obstacle_center"] += 1e-3  # on a centre the direction is a convention the model does not share
    values["obstacles_damping"][:] = 1e-2
    outputs = evaluate_many("step", values)
    for i in range(1_000):
        for name, expected in planar_model.step(one_state(values, i)).items():
            # a direction to a centre 1e-3 m away is known to 2e-12, and J_o⁺ <= 1/(2·1e-2) magnifies what comes
            # of it, velocities up to 1e4, and their cancellation in (q_next − q)/T with T >= 3e-4
            scale = 1e-8 * (1 + np.max(np.abs(expected)))
            np.testing.assert_allclose(outputs[name][i], expected, rtol=0, atol=scale, err_msg=name)


def test_law_depends_neither_on_filter_nor_on_planner(evaluate_many, states_near_contact):
    values = states_near_contact(500, 7)
    changed = values | {
        "filter_cutoff": 2 * values["filter_cutoff"],
        "lam_free": 1 - values["lam_free"],
        "lam_event": 1 - values["lam_event"],
        "period": 0.5 * values["period"],
    }
    before, after = evaluate_many("step", values), evaluate_many("step", changed)
    np.testing.assert_array_equal(before["dq_law"], after["dq_law"])
    assert np.all(before["lam"] != after["lam"])


def test_beta_is_eq_15_for_each_joint(evaluate_many, states_near_contact):
    values = states_near_contact(1_000, 8)
    values["lam_free"][:], values["lam_event"][:] = 1, 1
    values["filter_cutoff"] = 10 ** np.random.default_rng(8).uniform(-2, 3, (1_000, 5))
    outputs = evaluate_many("step", values)
    x = 2 * math.pi * values["period"][:, None] * values["filter_cutoff"]
    moved = values["period"][:, None] * outputs["dq_law"]
    far_enough = np.abs(moved) > 1e-3
    assert np.sum(far_enough) > 1_000
    measured = (outputs["q_next"] - values["q"]) / np.where(far_enough, moved, 1)
    # the rounding unit of q < 4 is 4e-16; four such terms over a motion of 1e-3, relative to β > 2e-5
    np.testing.assert_allclose(measured[far_enough], (x / (1 + x))[far_enough], rtol=0, atol=2e-12)


def test_lambda_zero_is_case_1_bit_for_bit(evaluate_many, states_near_contact, states_within_limits):
    """The sum of eq. 13 is rounded once where the processor has FMA, and else twice."""
    for values in (states_near_contact(10_000, 9), states_within_limits(10_000, 9)):
        values["lam_free"][:], values["lam_event"][:] = 0, 0
        outputs = evaluate_many("step", values)
        T = values["period"][:, None]
        terms = zip(*(a.ravel() for a in np.broadcast_arrays(values["q"], T, outputs["dq_law"])), strict=True)
        once = np.array([float(Fraction(q) + Fraction(t) * Fraction(dq)) for q, t, dq in terms])
        twice = values["q"] + T * outputs["dq_law"]
        assert np.any(once != twice.ravel())
        assert any(np.array_equal(outputs["q_next"].ravel(), expected.ravel()) for expected in (once, twice))
        np.testing.assert_array_equal(outputs["dq"], outputs["dq_law"])
        np.testing.assert_array_equal(outputs["lam"], 0)


def test_lambda_one_is_case_2_to_rounding(evaluate_many, states_near_contact):
    values = states_near_contact(10_000, 10)
    values["lam_free"][:], values["lam_event"][:] = 1, 1
    outputs = evaluate_many("step", values)
    T = values["period"][:, None]
    x = 2 * np.pi * T * values["filter_cutoff"]
    beta = x / (1 + x)
    q_raw = values["q"] + T * outputs["dq_law"]
    # a few roundings of the greatest of the terms, 2^-53 each
    scale = np.abs(values["q"]) + np.abs(T * outputs["dq_law"])
    assert np.max(np.abs(outputs["q_next"] - (beta * q_raw + (1 - beta) * values["q"])) / scale) < 4 * 2.0**-53
    np.testing.assert_array_equal(outputs["lam"], 1)


def test_lambda_is_lam_event_while_a_region_meets_an_obstacle_and_lam_free_otherwise(
    evaluate_many, states_near_contact
):
    values = states_near_contact(10_000, 11)
    outputs = evaluate_many("step", values)
    active = outputs["active"] == 1
    assert 1_000 < np.sum(active) < 9_000
    np.testing.assert_array_equal(outputs["lam"], np.where(active, values["lam_event"], values["lam_free"]))
    np.testing.assert_array_equal(active, np.any(outputs["distance"] <= values["influence_radius"], axis=1))


@pytest.mark.parametrize("kind", kinds_in(planners))
def test_every_planner_with_lambda_zero_is_the_law_alone_and_with_one_share_keeps_it(kind, evaluated, plane_arm):
    arm = plane_arm([0.5, 0.4], points_of_interest=[{"name": "end", "link": "link1", "influence_radius": 0.3}])
    tool = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0}
    tried = evaluated(arm, tool, planner={"kind": kind}, obstacles={"maximum": 1})
    q = np.random.default_rng(4).uniform(-2, 2, (500, 2))
    given = {"tool_reference": np.array([0.4, 0.3]), "obstacle_count": 1.0, "obstacle_center": np.array([[0.6, 0.0]])}
    for lam in (0.0, 0.7):
        outputs = tried(q=q, lam_free=lam, lam_event=lam, **given)
        assert 50 < np.sum(outputs["active"]) < 450
        np.testing.assert_allclose(outputs["lam"], lam, rtol=1e-15, atol=0)
        if lam == 0:
            np.testing.assert_array_equal(outputs["q_next"], q + tried.period * outputs["dq_law"])


@pytest.mark.parametrize("number", CASES)
def test_paper_cases_filter_when_they_should(number, paper_run):
    rollout = paper_run(number).in_c()
    assert 0.05 < np.mean(rollout.active) < 0.5  # the path does meet the obstacle
    expected = {1: np.zeros, 2: np.ones, 3: lambda _: rollout.active}[number](len(rollout.t))
    np.testing.assert_array_equal(rollout.signals["lam"], expected)


def test_case_3_leaves_the_path_alone_until_the_first_contact(paper_run):
    rollouts = {number: paper_run(number).in_c() for number in CASES}
    first = int(np.argmax(rollouts[1].active))
    assert first > 100
    np.testing.assert_array_equal(rollouts[3].q[: first + 1], rollouts[1].q[: first + 1])
    assert not np.array_equal(rollouts[3].q[first + 1], rollouts[1].q[first + 1])
    assert not np.array_equal(rollouts[2].q[1], rollouts[1].q[1])


# ---- Reading A of eq. 16: the filtered q is the state ----

T, F_C, SPEED = 0.01, 4.0, 0.3
BETA = 2 * math.pi * T * F_C / (1 + 2 * math.pi * T * F_C)


@pytest.fixture
def ramp(planar5):
    """Errors along x (steps,) [m] of the compiled loop behind a reference at constant speed along x.

    The arm points along x, so that only base_x moves: the loop is exactly the scalar e⁺ = (1 − βTK) e +
    (1 − β) T v (β = 1 without the filter), up to damping² = 1e-12.
    """

    def run(gain, lam, steps, start_error=0.0, speed=SPEED):
        reference = np.zeros((steps, 2))
        reference[:, 0] = 1.1 + start_error + speed * T * np.arange(steps)
        rollout = planar5.rollout(
            steps,
            {
                "q": np.zeros(5),
                "tool_reference": reference,
                "tool_reference_velocity": np.array([speed, 0.0]),
                "tool_gain": gain * np.eye(2),
                "tool_damping": 1e-6,
                "filter_cutoff": np.full(5, F_C),
                "lam_free": lam,
                "period": T,
            },
        )
        assert not np.any(rollout["active"])
        assert not np.any(rollout["q"][:, 1:])  # the scalar loop it claims to be
        return rollout["tool_error"][:, 0]

    return run


def test_filter_always_on_lags_a_ramp_by_speed_over_cutoff_gain_and_period(ramp):
    gain = 10.0
    lag = ramp(gain, lam=1.0, steps=2_000)[-1]
    # (1 − βTK)^2000 = 1e-19 of the transient remains; damping² = 1e-12 and rounding of a position of 7 m
    assert lag == pytest.approx((1 - BETA) * SPEED / (BETA * gain), rel=1e-11)
    assert lag == pytest.approx(SPEED / (2 * math.pi * F_C * gain * T), rel=1e-11)


def test_no_filter_lags_a_ramp_by_nothing(ramp):
    # a few roundings a step of positions of up to 7 m, 9e-16 each, held by the loop to 1/(KT) = 10 times that
    assert abs(ramp(10.0, lam=0.0, steps=2_000)[-1]) < 1e-13


@pytest.mark.parametrize(("lam", "limit"), [(1.0, 2 / (BETA * T)), (0.0, 2 / T)])
@pytest.mark.parametrize("share", [0.5, 0.99, 1.01])
def test_error_shrinks_below_the_gain_limit_and_grows_above(ramp, lam, limit, share):
    steps, start = 401, 1e-3
    gain = share * limit
    steady = (1 - BETA) * SPEED / (BETA * gain) if lam else 0.0
    error = ramp(gain, lam, steps, start) - steady
    ratio = 1 - 2 * share  # per step: 0, −0.98, −1.02
    start -= steady
    assert error[0] == pytest.approx(start, abs=1e-15)
    # rounding of 1e-16..1e-15 m a step, carried on by the loop's own factor; damping² changes the factor by
    # 2e-12, which makes 1e-9 of 401 steps
    atol = 2e-13 * max(1, abs(ratio) ** steps)
    np.testing.assert_allclose(error, start * ratio ** np.arange(steps), rtol=1e-9, atol=atol)
    assert (abs(error[-1]) > 100 * abs(start)) == (share > 1)
    assert (abs(error[-1]) < 0.01 * abs(start)) == (share < 1)


@pytest.mark.parametrize("lam", [0.0, 1.0])
@pytest.mark.parametrize("share", [0.99, 1.01])
def test_the_gain_limit_holds_in_any_posture(planar5, lam, share):
    """The linear loop again, from a bent arm and in both directions: an error too small for the curvature."""
    q = np.array([0.3, -0.5, 0.4, 0.6, -1.2])
    tool = planar5.kinematics(q=q)["tool_position"].copy()
    gain = share * 2 / T / (BETA if lam else 1)
    rollout = planar5.rollout(
        300,
        {
            "q": q,
            "tool_reference": tool + np.array([3e-8, -4e-8]),
            "tool_gain": gain * np.eye(2),
            "tool_damping": 1e-6,
            "filter_cutoff": np.full(5, F_C),
            "lam_free": lam,
            "period": T,
        },
    )
    size = np.linalg.norm(rollout["tool_error"], axis=1)
    # the growth over 300 steps takes 5e-8 m to 2e-5 m: L|e|²/σ² stays below 1e-9 of it, rounding below 1e-7
    expected = 5e-8 * abs(1 - 2 * share) ** np.arange(300)
    np.testing.assert_allclose(size, expected, rtol=1e-4, atol=0)


def test_the_slowest_cutoff_may_differ_from_joint_to_joint(planar5):
    """A_β is diagonal: a joint with a tiny cutoff stands almost still, the others do not notice in one step."""
    cutoff = np.array([4.0, 4.0, 1e-6, 4.0, 4.0])
    q = np.array([0.3, -0.5, 0.4, 0.6, -1.2])
    given = {"q": q, "tool_reference": np.array([3.0, 2.0]), "lam_free": 1.0}
    outputs = {name: array.copy() for name, array in planar5.step(**given, filter_cutoff=cutoff).items()}
    same = planar5.step(filter_cutoff=np.full(5, 4.0))
    others = [0, 1, 3, 4]
    np.testing.assert_array_equal(outputs["q_next"][others], same["q_next"][others])
    assert abs(outputs["dq"][2]) < 1e-6 * abs(outputs["dq_law"][2])
    assert abs(same["dq"][2]) > 0.1 * abs(same["dq_law"][2])
