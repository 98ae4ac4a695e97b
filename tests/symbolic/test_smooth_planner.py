"""The smooth planner: eqs. 16-18 with a state, and what reading C of eq. 16 and a low-pass of the velocity entail.

The oracle of the linear loop is python-control, built of the integrator T/(z − 1) and the low-pass b z/(z − (1 − b)).
"""

import math

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import lfilter

from clikgen.analysis.metrics import away_from_encounters, metrics, rms
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.models.table import RobotTable
from clikgen.symbolic.planners import event, smooth
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs

T, F_C = 0.01, 4.0
TAU = 1 / (2 * math.pi * F_C)  # [s]
PLANAR5 = read_spec({path.stem: path for path in shipped_specs()}["planar5"])
RADIUS = 0.1  # [m] influence radius of the gantry's tool

GANTRY = {
    "name": "gantry",
    "description": "a tool that slides along x and y",
    "period": T,
    "robot": {
        "space": "planar",
        "joints": [
            {"name": name, "type": "prismatic", "link": name, "axis": axis}
            | {"lower": -1e3, "upper": 1e3, "velocity": 1e3}
            for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]))
        ],
        "frames": [{"name": "tool", "link": "y"}],
        "points_of_interest": [{"name": "tool", "link": "y", "influence_radius": RADIUS}],
    },
    "obstacles": {"maximum": 1},
    "filter": {"kind": "first_order", "cutoff": F_C},
    "planner": {"kind": "smooth"},
}
TOOL = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0}
SWITCHED = {"name": "obstacles", "kind": "obstacle_avoidance", "activation": {"kind": "switched"}}
BARRIER = {"name": "obstacles", "kind": "obstacle_avoidance", "activation": {"kind": "barrier"}}
DRIVE = {
    "space": "planar",
    "base": {"kind": "differential", "mount_xyz": [0.2, 0.0, 0.0]},
    "joints": [
        {"name": "shoulder", "type": "revolute", "link": "upper", "lower": -2.8, "upper": 2.8, "velocity": 2.0},
        {"name": "elbow", "type": "revolute", "link": "lower", "xyz": [0.5, 0, 0]}
        | {"lower": -2.8, "upper": 2.8, "velocity": 2.0},
    ],
    "frames": [{"name": "tool", "link": "lower", "xyz": [0.4, 0, 0]}],
}


def share(lam, cutoff=F_C, period=T):
    """b = 1 − λ(1 − β)."""
    x = 2 * math.pi * period * cutoff
    return 1 - lam * (1 - x / (1 + x))


def largest_calm(b):
    """The largest K T without overshoot, (1 − r)/(1 + r)."""
    r = math.sqrt(1 - b)
    return (1 - r) / (1 + r)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """`compiled(spec)`: the controller of a spec, or of a table of one."""

    def load(spec):
        if isinstance(spec, dict):
            spec = ControllerSpec.parse(spec, "the test")
        folder = tmp_path_factory.mktemp(spec.name)
        for file, text in generate(spec).items():
            (folder / file).write_text(text)
        return CompiledController.load(folder)

    return load


@pytest.fixture(scope="module")
def gantry(compiled):
    return compiled(GANTRY | {"tasks": [SWITCHED, TOOL]})


@pytest.fixture(scope="module")
def guarded(compiled):
    return compiled(GANTRY | {"tasks": [BARRIER, TOOL]})


@pytest.fixture(scope="module")
def smooth5(compiled):
    """The shipped planar5 with this planner."""
    return compiled(PLANAR5.model_copy(update={"planner": smooth.Spec(kind="smooth")}))


@pytest.fixture(scope="module")
def paper_on(smooth5):
    """The paper's scenario on it, by the number of the case."""
    scenario = read_scenario(find_scenario("paper"))
    return lambda number: prepare(smooth5, scenario, CASES[number])


@pytest.fixture(scope="module")
def follow(gantry):
    """Outputs over time of the gantry that follows a reference along x, (steps,) [m] and its velocity [m/s]."""

    def run(gain, reference, velocity, lam=1.0, **values):
        steps = len(reference)
        along_x = np.array([1.0, 0.0])
        return gantry.rollout(
            steps,
            {
                "q": np.zeros(2),
                "tool_reference": np.outer(reference, along_x),
                "tool_reference_velocity": np.outer(np.broadcast_to(velocity, steps), along_x),
                "tool_gain": gain * np.eye(2),
                "lam_free": lam,
            }
            | values,
        )

    return run


def error_by_python_control(reference, velocity, gain, b):
    """E = (R − P F V)/(1 + K P F) with the integrator P = T/(z − 1) and the low-pass F = b z/(z − (1 − b))."""
    P, F = control.tf([T], [1, -1], T), control.tf([b, 0], [1, -(1 - b)], T)
    t = T * np.arange(len(reference))
    of_reference = control.forced_response(control.feedback(1, gain * P * F), t, reference).outputs
    of_velocity = control.forced_response(control.feedback(P * F, gain), t, velocity * np.ones(len(t))).outputs
    return of_reference - of_velocity


# ---- Which planner a spec names ----


def test_a_planner_without_a_kind_is_the_papers():
    for table in ({}, {"lam_free": 0.25}, {"kind": "event"}):
        spec = ControllerSpec.parse(GANTRY | {"tasks": [TOOL], "planner": table}, "the test")
        assert isinstance(spec.planner, event.Spec)
        assert spec.planner.lam_free == table.get("lam_free", 0.0)
    assert isinstance(PLANAR5.planner, event.Spec)


def test_naming_the_papers_planner_changes_nothing_that_is_generated():
    named = GANTRY | {"tasks": [TOOL], "planner": {"kind": "event"}}
    unnamed = {key: value for key, value in named.items() if key != "planner"}
    assert generate(ControllerSpec.parse(named, "")) == generate(ControllerSpec.parse(unnamed, ""))


def test_an_unknown_planner_is_refused_with_the_kinds_there_are():
    with pytest.raises(BadInput, match=r"planner: no kind 'smoth'; did you mean 'smooth'.*event, smooth"):
        ControllerSpec.parse(GANTRY | {"tasks": [TOOL], "planner": {"kind": "smoth"}}, "the test")


# ---- Eqs. 16-18 ----


def test_step_is_the_low_pass_of_the_velocity(smooth5):
    rng, count = np.random.default_rng(0), 5_000
    q = rng.uniform(-2, 2, (count, 5))
    points = smooth5.kinematics.map(count, {"q": q})["point_position"]
    centers = points[np.arange(count), rng.integers(0, 6, count)] + rng.uniform(-0.4, 0.4, (count, 2))
    values = {
        "q": q,
        "u_previous": rng.uniform(-1, 1, (count, 5)),
        "obstacle_center": np.repeat(centers[:, None], 3, axis=1),
        "obstacle_count": rng.integers(0, 2, count).astype(float),
        "tool_reference": rng.uniform(-2, 2, (count, 2)),
        "filter_cutoff": rng.uniform(0.5, 20, (count, 5)),
        "lam_free": rng.random(count),
        "lam_event": rng.random(count),
        "planner_width": 10 ** rng.uniform(-2, 0, count),
        "period": 10 ** rng.uniform(-3, -1, count),
        "obstacles_damping": np.array(1e-2),
    }
    outputs = smooth5.step.map(count, values)
    near = 1 - outputs["clearance"] / values["planner_width"]
    inside, outside = near >= 1, near <= 0
    assert min(np.sum(inside), np.sum(outside), np.sum(~inside & ~outside)) > 500
    near = np.clip(near, 0, 1)
    s = 3 * near**2 - 2 * near**3
    lam = values["lam_free"] + (values["lam_event"] - values["lam_free"]) * s
    np.testing.assert_allclose(outputs["lam"], lam, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(outputs["lam"][inside], values["lam_event"][inside])
    np.testing.assert_array_equal(outputs["lam"][outside], values["lam_free"][outside])
    period = values["period"][:, None]
    x = 2 * math.pi * period * values["filter_cutoff"]
    b = 1 - lam[:, None] / (1 + x)
    u = b * outputs["dq_law"] + (1 - b) * values["u_previous"]
    # (q_next − q)/T loses the rounding of positions of a few metres over T >= 1e-3 s
    scale = 1 + np.abs(outputs["dq_law"])
    np.testing.assert_allclose(outputs["dq"] / scale, u / scale, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(outputs["u_next"], outputs["dq"])


def test_lambda_is_once_continuously_differentiable_in_the_clearance(gantry):
    width, count = 0.05, 20_001
    x = np.linspace(-0.02, 0.08, count)
    q = np.column_stack([1 - RADIUS - x, np.zeros(count)])
    outputs = gantry.step.map(
        count,
        {
            "q": q,
            "obstacle_center": np.array([[1.0, 0.0]]),
            "obstacle_count": np.array(1.0),
            "lam_free": np.array(0.2),
            "lam_event": np.array(0.9),
            "planner_width": np.array(width),
        },
    )
    np.testing.assert_allclose(outputs["clearance"], x, rtol=0, atol=1e-15)
    step = x[1] - x[0]
    slope = np.diff(outputs["lam"]) / step
    assert np.all(slope <= 1e-9)  # rounding of λ over a step of 5e-6 m
    assert np.min(slope) == pytest.approx(-0.7 * 1.5 / width, rel=1e-6)
    # |s''| <= 6/w²; a jump of the slope would be larger by 1/step
    assert np.max(np.abs(np.diff(slope))) <= 0.7 * 6 / width**2 * step * (1 + 1e-3)


def test_without_an_obstacle_lambda_is_lam_free(gantry, compiled):
    for count in (0.0, 1.0):
        outputs = gantry.step.map(1, {"obstacle_count": np.array(count), "lam_free": np.array(0.3)})
        assert outputs["lam"] == (0.3 if count == 0 else 1.0)  # the only obstacle sits on the tool
    alone = compiled({**GANTRY, "tasks": [TOOL], "obstacles": {}, "name": "alone"})
    assert not {"lam_event", "planner_width"} & alone.step.inputs.keys()
    assert alone.step(lam_free=0.3)["lam"] == 0.3


def test_lambda_zero_is_case_1_bit_for_bit(paper_on, paper_run):
    ours, papers = paper_on(1).in_c(), paper_run(1).in_c()
    for name in ("q", "dq", "dq_law", "lam", "clearance"):
        np.testing.assert_array_equal(ours.signals[name], papers.signals[name])


def test_state_is_the_velocity_that_was_run_and_goes_round_in_every_loop(paper_on):
    run = paper_on(3)
    rollout, stepwise = run.in_c(), run.stepwise()
    np.testing.assert_array_equal(rollout.signals["u_previous"][1:], rollout.dq)
    for name, values in rollout.signals.items():
        np.testing.assert_array_equal(values, stepwise.signals[name])


# ---- The loop while λ is constant ----


@pytest.mark.parametrize("lam", [0.3, 0.8, 1.0])
@pytest.mark.parametrize("limit", [0.02, 0.5, 0.95, 1.05])
def test_loop_has_the_poles_of_reading_c(follow, lam, limit):
    """A set point: E/R = (z − 1)(z − (1 − b))/(z² − (2 − b − b K T) z + 1 − b), stable iff K T < 2 (2 − b)/b."""
    b, steps = share(lam), 400
    gain = limit * 2 * (2 - b) / (b * T)
    reference = np.full(steps, 1e-3)
    error = follow(gain, reference, 0.0, lam)["tool_error"][:, 0]
    poles = np.roots([1, -(2 - b - b * gain * T), 1 - b])
    assert (np.max(np.abs(poles)) < 1) == (limit < 1)
    expected = error_by_python_control(reference, 0.0, gain, b)
    size = np.maximum.accumulate(np.abs(expected))  # rounding is carried on by the loop's own modes
    np.testing.assert_allclose(error / size, expected / size, rtol=0, atol=1e-8)
    late = np.max(np.abs(error[-20:]))
    assert late < 0.05 * np.max(np.abs(error)) if limit < 1 else late == np.max(np.abs(error))
    oracle = control.feedback(1, gain * control.tf([T], [1, -1], T) * control.tf([b, 0], [1, -(1 - b)], T)).poles()
    np.testing.assert_allclose(np.sort_complex(oracle), np.sort_complex(poles), rtol=0, atol=1e-7)


@pytest.mark.parametrize(("over", "overshoots"), [(0.5, False), (0.98, False), (1.1, True)])
@pytest.mark.parametrize("lam", [0.5, 1.0])
def test_overshoot_from_rest_begins_at_one_minus_r_over_one_plus_r(follow, lam, over, overshoots):
    gain = over * largest_calm(share(lam)) / T
    error = follow(gain, np.full(3_000, 0.1), 0.0, lam)["tool_error"][:, 0]
    assert abs(error[-1]) < 1e-6
    # rounding of positions of 0.1 m is 1e-17 m; the overshoot at 1.1 is exp(−π/√0.1) = 5e-5 of 0.1 m
    assert (np.min(error) < -1e-9) == overshoots


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1.0), st.floats(0.05, 1.0))
def test_error_never_overshoots_however_lambda_varies(seed, beta, share_of_limit):
    """The cone 0 <= u <= m K e is invariant for every b in [β, 1] where K T <= (1 − r)/(1 + r), r = √(1 − β)."""
    rng = np.random.default_rng(seed)
    KT = share_of_limit * (1.0 if beta == 1 else largest_calm(beta))
    lam = rng.choice([rng.random(200), rng.integers(0, 2, 200).astype(float)])
    e, step = 1.0, 0.0  # step = T u
    for b in 1 - lam * (1 - beta):
        step = b * KT * e + (1 - b) * step
        assert -1e-12 <= e - step <= e  # a double pole at the limit leaves rounding
        e -= step


def test_compiled_loop_does_not_overshoot_while_lambda_varies(follow):
    lam = np.random.default_rng(3).integers(0, 2, 3_000).astype(float)
    gain = 0.98 * largest_calm(share(1.0)) / T
    error = follow(gain, np.full(3_000, 0.1), 0.0, lam)["tool_error"][:, 0]
    assert np.all(np.diff(error) <= 1e-16)
    assert -1e-15 < error[-1] < 1e-6


@pytest.mark.parametrize("lam", [0.0, 0.4, 1.0])
def test_a_ramp_is_followed_without_lag(follow, lam):
    speed, steps, gain = 0.3, 4_000, 4.0
    error = follow(gain, speed * T * np.arange(steps), speed, lam)["tool_error"][:, 0]
    start = error_by_python_control(speed * T * np.arange(steps), speed, gain, share(lam))
    np.testing.assert_allclose(error, start, rtol=0, atol=1e-12)  # rounding of positions of 12 m over K T = 0.04
    assert abs(error[-1]) < 1e-12
    if lam:
        assert np.max(np.abs(error)) > 1e-3  # it did lag at first: it started from rest


@pytest.mark.parametrize("lam", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("gain", [4.0, 20.0])
def test_an_acceleration_leaves_tau_and_half_a_period_over_the_gain(follow, lam, gain):
    acceleration, steps, b = 0.2, 3_000, share(lam)
    t = T * np.arange(steps)
    error = follow(gain, acceleration * t**2 / 2, acceleration * t, lam)["tool_error"][:, 0]
    tau = (1 - b) * T / b
    assert error[-1] == pytest.approx(acceleration * (tau + T / 2) / gain, rel=1e-9)  # 90 m round to 1e-14 m
    expected = error_by_python_control(acceleration * t**2 / 2, acceleration * t, gain, b)
    np.testing.assert_allclose(error, expected, rtol=0, atol=1e-11)
    if lam == 1:
        assert tau == pytest.approx(TAU, rel=1e-12)


@pytest.mark.parametrize("lam", [0.4, 1.0])
def test_white_noise_is_left_with_b_over_two_minus_b_of_its_variance(follow, lam):
    """The sum of squares of the response to one impulse; then the same from drawn noise."""
    b, steps = share(lam), 2_000
    impulse = np.eye(1, steps)[0]
    response = follow(0.0, np.zeros(steps), impulse, lam)["dq"][:, 0]
    np.testing.assert_allclose(response, lfilter([b], [1, -(1 - b)], impulse), rtol=0, atol=1e-14)
    assert np.sum(response**2) == pytest.approx(b / (2 - b), rel=1e-12)
    noise = np.random.default_rng(1).standard_normal(200_000)
    seen = follow(0.0, np.zeros(noise.size), noise, lam)["dq"][:, 0]
    # the variance of N draws whose correlation dies within 1/b: relative error √(2/(N b)) = 0.7 %, four of them
    assert np.var(seen) / np.var(noise) == pytest.approx(b / (2 - b), rel=0.03)


@pytest.mark.parametrize("gain", [4.0, 40.0])
def test_noise_of_the_reference_reaches_the_joints_as_the_lyapunov_equation_says(follow, gain):
    b, steps = share(1.0), 20_000
    response = follow(gain, np.eye(1, steps)[0], 0.0)["dq"][:, 0]
    # (q, u)⁺ = A (q, u) + B n with u⁺ = (1 − b) u + b K (n − q), q⁺ = q + T u⁺
    A = np.array([[1 - b * gain * T, (1 - b) * T], [-b * gain, 1 - b]])
    B = np.array([[b * gain * T], [b * gain]])
    variance = solve_discrete_lyapunov(A, B @ B.T)[1, 1]
    assert np.sum(response**2) == pytest.approx(variance, rel=1e-9)


# ---- What the robot has on entering a region it keeps ----


def test_lambda_may_jump_without_the_velocity_jumping(follow, compiled):
    speed, steps = 0.3, 600
    reference, lam = speed * T * np.arange(steps), np.repeat([0.0, 1.0, 0.0], steps // 3)
    np.testing.assert_allclose(follow(4.0, reference, speed, lam)["dq"][:, 0], speed, rtol=0, atol=1e-11)
    papers = compiled({**GANTRY, "tasks": [SWITCHED, TOOL], "planner": {}})
    jumping = papers.rollout(
        steps,
        {
            "tool_reference": np.outer(reference, [1.0, 0.0]),
            "tool_reference_velocity": np.array([speed, 0.0]),
            "lam_free": lam,
        },
    )["dq"][:, 0]
    assert np.max(np.abs(np.diff(jumping))) > 0.7 * speed  # 1 − β = 0.8 of it


@pytest.fixture(scope="module")
def approach():
    """Outputs of a gantry that runs at `speed` into an obstacle at rest, from `start` [m] short of its region."""

    def run(controller, speed, start, steps=400, lam_event=1.0, **values):
        return controller.rollout(
            steps,
            {
                "q": np.zeros(2),
                "u_previous": np.array([speed, 0.0]),
                "tool_gain": np.zeros((2, 2)),  # so that the tool is asked for `speed` also when it is late
                "tool_reference_velocity": np.array([speed, 0.0]),
                "obstacle_center": np.array([[start + RADIUS, 0.0]]),
                "obstacle_count": np.array(1.0),
                "lam_event": lam_event,
            }
            | {name: np.array(value) for name, value in values.items()},
        )

    return run


@pytest.mark.parametrize("start", [0.2001, 0.2015, 0.2029])
@pytest.mark.parametrize("lam_event", [0.5, 1.0])
def test_a_law_that_stops_at_the_boundary_is_run_on_by_tau_times_the_speed(gantry, approach, start, lam_event):
    speed, b = 0.3, share(lam_event)
    run = approach(gantry, speed, start, lam_event=lam_event, obstacles_gain=0.0)
    entry = int(np.argmax(run["active"]))
    assert np.all(run["active"][entry:])
    depth = -run["clearance"][entry:]
    expected = depth[0] + T * np.cumsum(lfilter([b], [1, -(1 - b)], np.zeros(399 - entry), zi=[(1 - b) * speed])[0])
    # the damping of J_o⁺, 1e-9 against a depth of 1e-4 m, lets 1e-10 of the speed through
    np.testing.assert_allclose(depth[1:], expected, rtol=0, atol=1e-9)
    tau = (1 - b) * T / b
    assert depth[-1] - depth[0] == pytest.approx(tau * speed, rel=1e-6)
    assert 0 < depth[0] < T * speed
    assert depth.max() < (tau + T) * speed


@pytest.mark.parametrize("gain", [1.0, 20.0, 250.0])
def test_a_law_that_pushes_out_intrudes_less(gantry, approach, gain):
    speed = 0.3
    stopped, pushed = (
        -approach(gantry, speed, 0.2001, obstacles_gain=one, steps=2_000)["clearance"].min() for one in (0.0, gain)
    )
    assert 0 < pushed < stopped < (TAU + T) * speed


@pytest.mark.parametrize(("over", "intrudes"), [(0.95, False), (1.3, True)])
def test_a_barrier_is_kept_up_to_the_rate_of_the_calm_loop(guarded, approach, over, intrudes):
    rate, speed = over * largest_calm(share(1.0)) / T, 0.3
    clearance = approach(guarded, speed, 0.5, steps=1_500, lam_free=1.0, obstacles_rate=rate)["clearance"]
    assert (clearance.min() < -1e-9) == intrudes
    assert -(TAU + T) * speed < clearance.min() < 1e-3  # it got there


def test_velocities_stay_within_limits_that_the_law_keeps(compiled):
    limited = compiled({**GANTRY, "tasks": [SWITCHED, TOOL], "velocity_limits": {"kind": "scale", "limit": [0.4, 0.3]}})
    rng = np.random.default_rng(2)
    run = limited.rollout(
        2_000,
        {
            "tool_reference": rng.uniform(-1, 1, (2_000, 2)),
            "tool_reference_velocity": rng.uniform(-1, 1, (2_000, 2)),
            "lam_free": rng.random(2_000),
        },
    )
    assert np.all(np.abs(run["dq"]) <= np.array([0.4, 0.3]) * (1 + 1e-12))
    assert np.max(np.abs(run["dq"][:, 0])) > 0.35


# ---- Robots ----


@pytest.fixture(scope="module", params=[0.5, 1.0])
def rolled(request, compiled, tmp_path_factory):
    """A differential drive from rest to a goal beside and behind it, the filter half on and all on."""
    robot = RobotTable.parse(DRIVE, "the test").build(tmp_path_factory.mktemp("drive"), "the test").robot
    table = GANTRY | {"name": "rolling", "robot": robot, "obstacles": {}, "velocity_limits": {"kind": "scale"}}
    controller = compiled(table | {"tasks": [TOOL | {"gain": 2.0}]})
    start = np.array([0.0, 0.0, 0.0, 0.6, -1.2])
    return controller.rollout(4_000, {"q": start, "tool_reference": np.array([-0.5, 1.5]), "lam_free": request.param})


def test_a_differential_drive_never_slides_sideways(rolled):
    yaw, dq = rolled["q"][:-1, 2], rolled["dq"]
    sideways = -np.sin(yaw) * dq[:, 0] + np.cos(yaw) * dq[:, 1]
    np.testing.assert_allclose(sideways, 0, rtol=0, atol=1e-12)  # (q_next − q)/T loses the rounding of q over T
    turned = np.max(np.abs(np.diff(yaw)))
    assert turned > 1e-3  # a velocity carried on in the world would slide by this share of it
    assert np.ptp(rolled["base_velocity"][:, 0]) > 0.05


def test_the_state_of_a_differential_drive_is_its_input_velocity(rolled):
    assert rolled["u_previous"].shape == (4_001, 4)
    np.testing.assert_array_equal(rolled["u_previous"][1:, :2], rolled["base_velocity"])
    np.testing.assert_array_equal(rolled["u_previous"][1:, 2:], rolled["dq"][:, 3:])
    assert np.linalg.norm(rolled["tool_error"][-1]) < 1e-6


def test_paper_case_2_no_longer_leaves_the_path(paper_on, paper_run):
    errors = []
    for rollout in (paper_run(2).in_c(), paper_on(2).in_c()):
        away = away_from_encounters(rollout)
        errors.append(rms(np.linalg.norm(rollout.error[away], axis=1)))
    assert errors[0] > 0.2  # [m]
    assert errors[1] < 0.002


def test_paper_case_3_enters_and_leaves_without_a_jump(paper_on, paper_run):
    papers, ours = paper_run(3).in_c(), paper_on(3).in_c()
    b = share(1.0)
    at_entry = int(np.argmax(ours.active))
    for rollout, loses in ((papers, True), (ours, False)):
        kept = rollout.dq[at_entry] @ rollout.dq[at_entry - 1] / np.sum(rollout.dq[at_entry - 1] ** 2)
        assert (kept < 0.5) == loses
    change = np.abs(np.diff(ours.dq, axis=0))
    asked = np.abs(ours.signals["dq_law"][1:] - ours.dq[:-1])
    inside = ours.active[1:]
    np.testing.assert_allclose(change[inside], b * asked[inside], rtol=1e-6, atol=1e-12)
    assert metrics(ours).max_velocity_step < 0.2 * metrics(papers).max_velocity_step
    assert metrics(ours).hf_rms < 0.3 * metrics(papers).hf_rms


@pytest.mark.parametrize("number", [2, 3])
def test_paper_cases_intrude_less_than_the_bound(paper_on, number):
    rollout = paper_on(number).in_c()
    clearance = rollout.signals["clearance"]
    fastest = np.max(-np.diff(clearance)[np.abs(clearance[:-1]) < 0.02]) / T  # v_n [m/s]
    assert 0 < -clearance.min() < (TAU + T) * fastest
