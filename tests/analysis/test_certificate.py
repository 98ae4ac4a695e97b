"""The certificate against the compiled loop: bounds that hold, theorem and corollaries, on several robots."""

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from clikgen.analysis import certificate as certificate_module
from clikgen.analysis.certificate import (
    Bounds,
    Motion,
    Tuning,
    bounds_along,
    bounds_within_limits,
    certificate,
    certify,
    hessian_norms,
    largest_gain,
    largest_period,
    period_limit,
    planar_chain,
    recursion,
    set_point_gain,
    set_point_period,
    singular_values,
)
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec

X, Y, Z = [1, 0, 0], [0, 1, 0], [0, 0, 1]


def slide(axis):
    return {"type": "prismatic", "axis": axis, "lower": -5.0, "upper": 5.0}


def turn(lower=-3.0, upper=3.0, at=(0.0, 0.0, 0.0), axis=Z):
    return {"type": "revolute", "axis": axis, "xyz": list(at), "lower": lower, "upper": upper}


# What each has in it, from the root to the tip; the tool is at the last place.
ROBOTS = {
    "base4": ([slide(X), slide(Y), turn(), turn(at=(0.6, 0, 0))], (0.45, 0, 0)),
    "arm3": ([turn(), turn(0.5, 2.3, at=(0.5, 0, 0)), turn(0.3, 2.0, at=(0.4, 0, 0))], (0.3, 0, 0)),
    "arm10": ([turn(), *(turn(at=(0.1 + 0.01 * i, 0, 0)) for i in range(9))], (0.1, 0.02, 0)),
    "rail": ([slide(X), turn(-0.1, 0.1)], (0.5, 0, 0)),
    "elbow": ([turn(-1, 1), turn(-0.6, 0.6, axis=Y), turn(0.6, 2, at=(0.5, 0, 0), axis=Y)], (0.4, 0, 0)),
    "unit": ([slide(X), slide(Y), turn()], (1.0, 0, 0)),
    "arm2": ([turn(), turn(-2, 2, at=(0.5, 0, 0))], (0.4, 0, 0)),
    "lone": ([slide(X)], (0.0, 0.0, 0.0)),
    "skew": ([turn(), slide([0.6, 0.8, 0]), turn(-0.2, 0.2)], (0.5, 0, 0)),
    "plane": ([slide(X), slide([0.6, 0.8, 0])], (0.0, 0.0, 0.0)),
    "mirror": ([slide(Y), slide(X), turn(axis=[0, 0, -1]), turn(at=(0.3, 0.1, 0))], (0.2, 0, 0)),
}


def spec(name):
    joints, tool = ROBOTS[name]
    named = [{"name": f"joint_{i}", "link": f"link_{i}", "velocity": 3.0, **joint} for i, joint in enumerate(joints)]
    return ControllerSpec.parse(
        {
            "name": name,
            "description": "a robot to certify",
            "period": 0.01,
            "robot": {
                "space": "spatial" if name == "elbow" else "planar",
                "joints": named,
                "frames": [{"name": "tool", "link": named[-1]["link"], "xyz": list(tool)}],
            },
            "tasks": [{"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0, "damping": 1e-6}],
            "filter": {"kind": "first_order", "cutoff": 4.0},
        },
        name,
    )


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Robots of the table above, or the shipped planar5, compiled, by name."""
    loaded = {"planar5": CompiledController.load("planar5")}

    def load(name):
        if name not in loaded:
            folder = tmp_path_factory.mktemp(name)
            for file, text in generate(spec(name)).items():
                (folder / file).write_text(text)
            loaded[name] = CompiledController.load(folder)
        return loaded[name]

    return load


def within_limits(controller, count, seed=0):
    lower, upper = np.array([(joint.lower, joint.upper) for joint in controller.manifest.joints]).T
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def circle(name, **settings):
    """A run on a circle of 0.3 m, once in 4 s, where the paper's scenario has planar5."""
    scenario = Scenario.parse(
        {
            "name": "circle",
            "description": "a circle",
            "controller": name,
            "duration": settings.pop("duration", 12.0),
            "q0": settings.pop("q0", [0.0, 0.0, 0.0, 0.6, -1.2]),
            "parameters": {"tool_damping": 1e-6} | settings,
            "references": {"tool": {"kind": "circle", "center": [0.6, 0.0], "radius": 0.3, "period": 4.0}},
        },
        "circle",
    )
    return lambda controller, case=1: prepare(controller, scenario, CASES[case])


# ---- σ and L ----


@pytest.mark.parametrize("name", ["planar5", "base4", "arm3", "arm10", "mirror", "rail"])
def test_closed_form_of_the_hessian_bound_holds_everywhere_and_is_attained(robot, name):
    controller = robot(name)
    chain = planar_chain(controller)
    q = np.random.default_rng(1).uniform(-3, 3, (4000, len(controller.manifest.joints)))
    # central differences of the Jacobian are wrong by less than 1e-8
    assert hessian_norms(controller, q).max() <= chain.hessian + 1e-8
    if name != "arm10" and name != "mirror":  # whose segments do not line up at q = 0
        assert hessian_norms(controller, 0 * q[:1])[0] == pytest.approx(chain.hessian, abs=1e-8)


def test_closed_form_of_planar5_is_that_of_its_lengths(robot):
    chain = planar_chain(robot("planar5"))
    np.testing.assert_allclose(chain.lengths, [0.2, 0.5, 0.4], atol=1e-12)
    np.testing.assert_array_equal(chain.angles, [[0, 0, 1, 0, 0], [0, 0, 1, 1, 0], [0, 0, 1, 1, 1]])
    b = chain.angles
    by_hand = 0.2 * np.outer(b[0], b[0]) + 0.5 * np.outer(b[1], b[1]) + 0.4 * np.outer(b[2], b[2])
    assert chain.hessian == pytest.approx(np.linalg.eigvalsh(by_hand)[-1], rel=1e-12)


def test_a_joint_that_turns_the_other_way_subtracts(robot):
    np.testing.assert_array_equal(planar_chain(robot("mirror")).angles, [[0, 0, -1, 0], [0, 0, -1, 1]])


@pytest.mark.parametrize("name", ["planar5", "base4", "mirror"])
def test_sliding_base_keeps_the_jacobian_regular_everywhere(robot, name):
    controller = robot(name)
    bounds = bounds_within_limits(controller)
    assert bounds.exact
    assert bounds.sigma_min == pytest.approx(1.0, abs=1e-12)
    assert bounds.where == "everywhere"
    q = np.random.default_rng(2).uniform(-10, 10, (100_000, len(controller.manifest.joints)))
    sigma = singular_values(controller, q)
    assert sigma.min() >= 1 - 1e-12
    assert sigma.min() < 1.001  # it comes near
    assert 0.95 * bounds.sigma_max < sigma.max() <= bounds.sigma_max + 1e-12


def test_slides_that_are_not_orthogonal_give_a_smaller_bound(robot):
    bounds = bounds_within_limits(robot("plane"))
    assert bounds.hessian == 0
    assert bounds.sigma_min == pytest.approx(np.sqrt(1 - 0.6))  # of [[1, 0.6], [0, 0.8]]


@pytest.mark.parametrize("name", ["planar5", "base4"])
def test_estimate_by_sampling_finds_the_closed_forms(robot, name, monkeypatch):
    exact = bounds_within_limits(robot(name))
    monkeypatch.setattr(certificate_module, "planar_chain", lambda controller: None)
    estimate = bounds_within_limits(robot(name))
    assert not estimate.exact
    for quantity in ("sigma_min", "sigma_max", "hessian"):
        # local searches end within 1e-6 of an extremum that is as flat as these
        assert getattr(estimate, quantity) == pytest.approx(getattr(exact, quantity), rel=1e-6), quantity


@pytest.mark.parametrize("name", ["elbow", "arm3"])
def test_estimate_covers_random_configurations(robot, name):
    controller = robot(name)
    bounds = bounds_within_limits(controller)
    assert not bounds.sigma_exact
    assert bounds.hessian_exact == (name == "arm3")
    q = within_limits(controller, 20_000)
    sigma, norms = singular_values(controller, q), hessian_norms(controller, q)
    assert sigma.min() >= bounds.sigma_min
    assert sigma.max() <= bounds.sigma_max
    assert norms.max() <= bounds.hessian * (1 + 1e-6)


def test_a_slide_behind_a_turn_has_no_closed_form(robot):
    assert planar_chain(robot("skew")) is None


@pytest.mark.parametrize("name", ["arm10", "arm2", "lone"])
def test_a_singular_jacobian_is_a_bad_input_that_says_where(robot, name):
    with pytest.raises(BadInput, match=rf"{name}: the Jacobian of task 'tool' is singular within .* q = \[") as told:
        bounds_within_limits(robot(name))
    assert "\n" not in str(told.value)


def test_along_a_rollout_bounds_are_tighter_and_cover_it(robot):
    controller = robot("arm3")
    run = circle("arm3", q0=[-0.5, 0.9, 0.9], duration=4.0)(controller)
    rollout = run.in_c()
    bounds = bounds_along(controller, rollout, margin=0.02)
    assert "0.02" in bounds.where
    sigma = singular_values(controller, rollout.q)
    assert bounds.sigma_min <= sigma.min() <= 1.3 * bounds.sigma_min
    assert sigma.max() <= bounds.sigma_max
    found = certify(controller, run, over="rollout")
    assert found.exists
    assert np.linalg.norm(rollout.error[-100:], axis=1).max() <= found.e_minus


# ---- The theorem, one step ----


def one_step(controller, tuning, motion, count, rng, size=None):
    """|e|, |e⁺| of `count` compiled steps under a tuning and any reference that the motion allows."""
    task = controller.manifest.tasks[-1].name
    q = within_limits(controller, count, rng.integers(1 << 30))
    m = controller.manifest.dimension
    position = controller.kinematics.map(count, {"q": q})[f"{task}_position"]
    error = unit(rng, count, m) * (10 ** rng.uniform(-5, 0.3, (count, 1)) if size is None else size)
    velocity = motion.speed * unit(rng, count, m) * rng.choice([1.0, 0.5], (count, 1))
    turned = np.linalg.qr(rng.standard_normal((m, m)))[0]
    gains = np.resize(tuning.gains, m)
    values = {
        "q": q,
        f"{task}_reference": position + error,
        f"{task}_reference_velocity": velocity,
        f"{task}_gain": turned @ np.diag(gains) @ turned.T,
        f"{task}_damping": tuning.damping,
        "period": tuning.period,
        "lam_free": 0.0 if tuning.cutoff is None else tuning.share,
        "filter_cutoff": np.full(q.shape[1], tuning.cutoff or 1.0),
    }
    after = controller.step.map(count, values)["q_next"]
    T = tuning.period
    target = position + error + T * velocity + T**2 / 2 * motion.acceleration * unit(rng, count, m)
    left = target - controller.kinematics.map(count, {"q": after})[f"{task}_position"]
    return np.linalg.norm(error, axis=1), np.linalg.norm(left, axis=1)


def unit(rng, count, m):
    directions = rng.standard_normal((count, m))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def any_tuning(rng):
    T, k = 10 ** rng.uniform(-4, 0), rng.uniform(0.01, 3)
    x = 10 ** rng.uniform(-2, 1)
    filtered = rng.random() < 0.5
    beta = x / (1 + x) if filtered else 1.0
    gain = k / (beta * T)
    return Tuning(
        gains=(gain,) if rng.random() < 0.5 else (gain, gain * rng.uniform(0.2, 1)),
        period=T,
        damping=10 ** rng.uniform(-6, 0.3),
        cutoff=x / (2 * np.pi * T) if filtered else None,
        share=rng.choice([1.0, 0.6]),
    )


@pytest.mark.parametrize(
    ("name", "tunings"), [("planar5", 500), ("base4", 200), ("unit", 200), ("arm3", 200), ("elbow", 100)]
)
def test_one_step_bound_is_never_violated(robot, name, tunings):
    """A million random steps: configuration, error, reference, gains, T, damping and filter."""
    controller, rng = robot(name), np.random.default_rng(3)
    bounds = bounds_within_limits(controller)
    if not bounds.hessian_exact:  # a step may leave the limits, where only a closed form still holds
        bounds = replace(bounds, hessian=0.5 * 2 + 0.4 * 3)  # each segment times the turns before it
    for _ in range(tunings):
        motion = Motion(10 ** rng.uniform(-3, 0.3), 10 ** rng.uniform(-3, 0.5))
        tuning = any_tuning(rng)
        here = recursion(bounds, motion, tuning)
        error, left = one_step(controller, tuning, motion, 1000, rng)
        bound = here.c2 * error**2 + (1 - here.rate) * error + here.c0
        assert np.all(left <= bound + 1e-13), (tuning, motion)  # rounding of positions of 10 m


@pytest.mark.parametrize("name", ["rail", "unit"])
def test_quadratic_term_is_attained(robot, name):
    """At kT = 1 and rest nothing but c2|e|² is left, and no smaller c2 would do for every robot.

    The rail's tip moves across by its turn alone, against the whole of J^#; on the robot "unit" a slide and a turn
    of 1 m share the motion, against the half of it.
    """
    controller = robot(name)
    bounds = bounds_within_limits(controller)
    assert bounds.sliding == (name == "unit")
    tuning = Tuning(gains=(100.0,), period=0.01, damping=1e-6)
    here = recursion(bounds, Motion(0, 0), tuning)
    error, left = one_step(controller, tuning, Motion(0, 0), 20_000, np.random.default_rng(4))
    small = (error > 1e-3) & (error < 0.05)
    ratio = (left / (here.c2 * error**2 + (1 - here.rate) * error))[small]
    assert 0.98 < ratio.max() <= 1.0
    assert here.c2 == pytest.approx(bounds.hessian / 2 / bounds.sigma_min**2 / (4 if bounds.sliding else 1))


@pytest.mark.parametrize("filtered", [False, True])
def test_every_ball_between_the_fixed_points_is_kept(robot, filtered):
    """100,000 compiled steps from the edge of a ball, a filter, a speed and an acceleration in each."""
    controller, rng = robot("planar5"), np.random.default_rng(5)
    bounds, motion = bounds_within_limits(controller), Motion(0.3, 0.5)
    tuning = Tuning((6.0,), 0.1, damping=1e-6, cutoff=8.0 if filtered else None)
    found = certificate(bounds, motion, tuning)
    for radius in np.geomspace(1.001 * found.e_minus, 0.999 * found.e_plus, 10):
        assert found.bound(radius) < radius
        error, left = one_step(controller, tuning, motion, 10_000, rng, size=radius)
        assert error.min() > 0.999 * radius
        assert left.max() <= radius
    assert found.bound(0.999 * found.e_minus) > 0.999 * found.e_minus
    assert found.bound(1.001 * found.e_plus) > 1.001 * found.e_plus


# ---- The theorem, over time ----


def ultimate(rollout):
    """The largest error in the last third of a run [m]."""
    return np.linalg.norm(rollout.error[2 * len(rollout.t) // 3 :], axis=1).max()


def test_error_ends_within_the_ball_from_wherever_it_starts(robot):
    controller, rng = robot("planar5"), np.random.default_rng(6)
    run = circle("planar5", period=0.05, tool_gain=4.0)(controller)
    found = certify(controller, run)
    position = run.values["tool_reference"][0]
    for _ in range(50):
        q = within_limits(controller, 1, rng.integers(1 << 30))[0]
        rollout = replace(run, values={**run.values, "q": q}).in_c()
        error = np.linalg.norm(rollout.error, axis=1)
        if error[0] >= found.e_plus:
            continue
        assert error.max() <= max(error[0], found.e_minus) * (1 + 1e-12)
        assert ultimate(rollout) <= found.e_minus
    assert found.e_plus > 5, position  # so that hardly a start is left out


@pytest.mark.parametrize("case", [1, 2])
@pytest.mark.parametrize("period", [0.1, 0.03, 0.01, 0.003])
def test_circle_is_tracked_within_the_ball_that_is_certified(robot, period, case):
    controller = robot("planar5")
    run = circle("planar5", period=period, tool_gain=4.0, filter_cutoff=20.0)(controller, case)
    found = certify(controller, run)
    assert found.exists
    assert found.bounds.exact
    assert found.motion.speed == pytest.approx(0.3 * np.pi / 2)
    assert found.motion.acceleration == pytest.approx(0.3 * (np.pi / 2) ** 2, rel=0.01)  # chords of T
    assert 0.3 * found.e_minus < ultimate(run.in_c()) <= found.e_minus


def test_certified_and_measured_error_halve_with_the_sampling_time(robot):
    controller = robot("planar5")
    runs = [circle("planar5", period=T, tool_gain=4.0)(controller) for T in (0.01, 0.005, 0.0025)]
    certified = np.array([certify(controller, run).e_minus for run in runs])
    measured = np.array([ultimate(run.in_c()) for run in runs])
    # the next order is k T/2 of it: 2 % at T = 0.01 s
    np.testing.assert_allclose(certified[:-1] / certified[1:], 2, rtol=0.02)
    np.testing.assert_allclose(measured[:-1] / measured[1:], 2, rtol=0.02)


def test_damping_leaves_an_error_that_does_not_vanish_with_the_sampling_time(robot):
    """λ²v/(σ²k), in the directions of J: e = λ²(J Jᵀ)⁻¹ṙ/k."""
    controller, left = robot("planar5"), []
    for period in (0.004, 0.002, 0.001):
        settings = {"period": period, "tool_gain": 100.0, "tool_damping": 0.3, "duration": 6.0}
        run = circle("planar5", **settings)(controller)
        rollout = run.in_c()
        J = controller.jacobians(q=rollout.q[-2])["tool_jacobian"]
        predicted = 0.3**2 * np.linalg.solve(J @ J.T, rollout.reference_velocity[-1]) / 100.0
        left.append(np.linalg.norm(rollout.error[-1]))
        # the circle turns and the arm moves on by ω/k = 1.6 % of themselves while the error settles
        assert left[-1] == pytest.approx(np.linalg.norm(predicted), rel=0.016)
        found = certify(controller, run)
        assert ultimate(rollout) <= found.e_minus
        assert found.e_minus >= 0.3**2 * found.motion.speed / 100.0
    assert left[1] == pytest.approx(left[2], rel=0.01)


def test_filter_leaves_the_ramp_lag_that_is_predicted(robot):
    """Case 2 on a straight line: v/(2πf_cKT), and a certificate that is not far above."""
    controller = robot("planar5")
    line = {"kind": "line", "start": [0.9, 0.0], "end": [4.5, 1.5], "duration": 13.0}
    scenario = Scenario.parse(
        {
            "name": "line",
            "description": "a ramp",
            "controller": "planar5",
            "duration": 12.9,
            "q0": [0.0, 0.0, 0.0, 0.6, -1.2],
            "parameters": {"tool_gain": 4.0, "filter_cutoff": 4.0, "period": 0.01, "tool_damping": 1e-6},
            "references": {"tool": line},
        },
        "line",
    )
    run = prepare(controller, scenario, CASES[2])
    rollout, found = run.in_c(), certify(controller, run)
    lag = found.motion.speed / (2 * np.pi * 4.0 * 4.0 * 0.01)
    measured = np.linalg.norm(rollout.error[-1])
    assert measured == pytest.approx(lag, rel=0.02)
    assert measured <= found.e_minus <= 1.02 * lag
    assert found.motion.acceleration < 1e-9


def test_acceleration_term_is_that_of_the_feedforward(robot):
    """With (r⁺ − r)/T fed forward in place of ṙ, only the curvature of f is left."""
    controller = robot("planar5")
    run = circle("planar5", period=0.02, tool_gain=4.0)(controller)
    chord = np.diff(run.values["tool_reference"], axis=0) / run.period
    fed = {"tool_reference_velocity": np.append(chord, chord[-1:], axis=0)}
    found = certify(controller, run)
    without = certificate(found.bounds, replace(found.motion, acceleration=0.0), found.tuning)
    assert without.e_minus < ultimate(run.in_c()) <= found.e_minus
    assert ultimate(replace(run, values=run.values | fed).in_c()) <= without.e_minus


# ---- Corollaries ----

ROUND = Bounds("tool", 0.5, 1.7, 2.0, True, True, False, "everywhere")


@pytest.mark.parametrize("damping", [0.0, 0.4])
@pytest.mark.parametrize("cutoff", [None, 3.0])
@pytest.mark.parametrize("gain", [1e-3, 1.0])
def test_limit_of_the_sampling_time_knows_neither_gain_nor_filter_nor_damping(gain, cutoff, damping):
    tuning = Tuning((gain,), 0.01, damping, cutoff)
    limit = 0.5**2 / (2 * 2.0 * 0.3)
    assert period_limit(ROUND, Motion(0.3, 0.0), tuning) == pytest.approx(limit, rel=1e-5)
    assert largest_period(ROUND, Motion(0.3, 0.0), tuning) == pytest.approx(limit, rel=1e-5)


def test_limit_of_the_sampling_time_with_acceleration_and_null_space_motion():
    T = period_limit(ROUND, Motion(0.3, 0.7, null_velocity=0.9), Tuning((1.0,), 0.01))
    m = 2.0 * T * 0.3 / 0.5**2
    assert 1 - 2 * m == pytest.approx((2.0 * T * 0.9 / 0.5) ** 2 + 2.0 * T**2 * 0.7 / 0.5**2, rel=1e-5)


def test_unequal_gains_shorten_the_limit_by_their_ratio():
    assert period_limit(ROUND, Motion(0.3, 0.0), Tuning((1.0, 0.25), 0.01)) == pytest.approx(
        0.25 * 0.5**2 / (2 * 2.0 * 0.3), rel=1e-5
    )


def test_sliding_base_lengthens_the_limit_four_times():
    slid = replace(ROUND, sliding=True)
    assert period_limit(slid, Motion(0.3, 0.0), Tuning((1.0,), 0.01)) == pytest.approx(
        4 * 0.5**2 / (2 * 2.0 * 0.3), rel=1e-5
    )
    assert recursion(slid, Motion(0.3, 0.0, 0.1), Tuning((1.0,), 0.01)) == recursion(
        ROUND, Motion(0.3, 0.0, 0.1), Tuning((1.0,), 0.01)
    )


def test_fixed_points_are_those_of_the_corollary():
    found = certificate(ROUND, Motion(0.3, 0.0), Tuning((5.0,), 0.04))
    m = 2.0 * 0.04 * 0.3 / 0.5**2
    for value, sign in ((found.e_minus, -1), (found.e_plus, 1)):
        assert value == pytest.approx(0.5**2 / (2 * 2.0 * 5.0 * 0.04) * (1 + sign * np.sqrt(1 - 2 * m)) ** 2)


@pytest.mark.parametrize("error", [1e-6, 0.05, 0.125, 0.3, 2.0])
def test_set_point_gain_is_that_of_the_corollary(error):
    h = 2.0 * error / (2 * 0.5**2)
    wanted = 1 / h if h >= 1 else (-1 + np.sqrt(1 + 8 * h)) / (2 * h)
    assert set_point_gain(ROUND, Tuning((1.0,), 0.01), error) * 0.01 == pytest.approx(wanted, rel=1e-9)
    assert set_point_period(ROUND, Tuning((7.0,), 0.01), error) * 7.0 == pytest.approx(wanted, rel=1e-9)


def test_limits_are_where_the_certificate_ends():
    motion, tuning = Motion(0.2, 0.5, 0.1, 0.01), Tuning((8.0, 6.0), 0.01, 0.05, 10.0, 0.7)
    found = certificate(ROUND, motion, tuning)
    for factor, exists in ((0.999, True), (1.001, False)):
        assert recursion(ROUND, motion, replace(tuning, period=factor * found.largest_period)).contracts == exists
        scaled = tuning.scaled(factor * found.largest_gain / 8.0)
        assert recursion(ROUND, motion, scaled).contracts == exists
    assert found.largest_period < found.period_limit


def test_without_speed_there_is_no_limit_and_without_contraction_no_certificate():
    assert period_limit(ROUND, Motion(0.0, 0.0), Tuning((1.0,), 0.01)) == np.inf
    assert certificate(ROUND, Motion(0.0, 0.0), Tuning((1.0,), 0.01)).as_dict()["period_limit"] is None
    never = certificate(ROUND, Motion(0.1, 0.0), Tuning((10.0, 1.0), 0.01, damping=0.5))
    assert not never.exists
    assert never.e_minus is never.e_plus is None
    assert never.largest_period == never.largest_gain == 0


def test_a_linear_task_is_certified_for_every_error():
    found = certificate(replace(ROUND, hessian=0.0), Motion(0.1, 1.0), Tuning((1.0,), 0.01))
    assert found.e_plus == np.inf
    assert found.e_minus == pytest.approx(0.01**2 / 2 / (0.01 * 1.0))
    assert largest_gain(replace(ROUND, hessian=0.0), Motion(0.1, 1.0), Tuning((1.0,), 0.01)) == pytest.approx(200)


# ---- Of a run ----


def test_certificate_of_a_run_is_that_of_its_rollout(robot):
    controller = robot("planar5")
    run = prepare(controller, read_scenario(find_scenario("paper")), CASES[2])
    found = certify(controller, run)
    assert found == certify(controller, run.in_c())
    assert found.tuning == Tuning((4.0,), 0.01, 1e-3, 4.0, 1.0)
    assert found.motion.null_velocity == found.motion.leak == 0
    assert certify(controller, prepare(controller, run.scenario, CASES[3])).beta == 1.0  # off until contact


def test_lower_tasks_are_measured(robot, planar5_spec_file, tmp_path):
    """Avoidance below the tracking task moves the null space, and leaks through the damping."""
    table = tomllib.loads(planar5_spec_file.read_text())
    table["tasks"].reverse()
    for file, text in generate(ControllerSpec.parse(table, "reversed")).items():
        (tmp_path / file).write_text(text)
    controller = CompiledController.load(tmp_path)
    scenario = read_scenario(find_scenario("paper"), ["tool_damping=0.05"])
    rollout = prepare(controller, scenario, CASES[1]).in_c()
    found = certify(controller, rollout)
    assert found.motion.null_velocity == 0  # nothing acts before contact
    touched = replace(rollout, signals={**rollout.signals, "active": 0 * rollout.signals["active"]})
    counted = certify(controller, touched)
    assert counted.motion.null_velocity > 0.1
    assert counted.motion.leak > 0.01
    largest = np.linalg.norm(rollout.error, axis=1)[200:].max()  # in contact, the start forgotten
    assert found.e_minus < largest <= counted.e_minus  # what lower tasks do is needed, and is enough


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Tuning((), 0.01), "gains"),
        (lambda: Tuning((1.0, -1.0), 0.01), "gains"),
        (lambda: Tuning((1.0,), 0.0), "period"),
        (lambda: Tuning((1.0,), 0.1, cutoff=float("nan")), "cutoff"),
        (lambda: Tuning((1.0,), 0.1, damping=-1.0), "damping"),
        (lambda: Tuning((1.0,), 0.1, share=1.5), "share"),
        (lambda: Motion(-1.0, 0.0), "speed"),
        (lambda: Motion(1.0, float("inf")), "acceleration"),
    ],
)
def test_numbers_that_make_no_sense_are_bad_inputs(make, complaint):
    with pytest.raises(BadInput, match=complaint):
        make()


def test_different_cut_offs_are_a_bad_input(robot):
    run = circle("planar5", filter_cutoff=[4.0, 4.0, 4.0, 4.0, 8.0])
    with pytest.raises(BadInput, match="one f_c for all joints"):
        certify(robot("planar5"), run(robot("planar5"), 2))
    assert certify(robot("planar5"), run(robot("planar5"), 1)).exists  # the filter is off


def test_a_margin_below_zero_or_a_diverged_rollout_has_no_bounds(robot):
    rollout = circle("planar5", duration=1.0)(robot("planar5")).in_c()
    with pytest.raises(BadInput, match="margin"):
        bounds_along(robot("planar5"), rollout, margin=-0.1)
    lost = replace(rollout, signals={**rollout.signals, "q": rollout.q * np.nan})
    with pytest.raises(BadInput, match="diverged"):
        bounds_along(robot("planar5"), lost)
