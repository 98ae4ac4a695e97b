"""The margin of a sampled barrier: its formulas, its bounds on curvature, and that no rollout falls below it.

A crank, a slide that carries a turning arm, is driven into the worst case of every single term: each margin is
reached there, so none could be smaller. Random runs of other robots mix all terms.
"""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.analysis.barrier_margin import Disturbance, Margin, direction_error, expected, greatest_motion, margin
from clikgen.analysis.certificate import planar_chain
from clikgen.analysis.measured_barrier import ROUNDING, kept, uncovered
from clikgen.runtime.clearance import distances
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.activations import barrier
from clikgen.symbolic.generate import generate
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.spec import ControllerSpec

TERMS = list(Margin.__dataclass_fields__)
RADIUS = 0.5  # [m] of the crank's arm
KEEP = 0.05  # [m] s of its tip

CRANK = {
    "name": "crank",
    "description": "a slide that carries a turning arm",
    "period": 0.005,
    "robot": {
        "space": "planar",
        "joints": [
            {
                "name": "slide",
                "type": "prismatic",
                "link": "carriage",
                "axis": [1, 0, 0],
                "lower": -100.0,
                "upper": 100.0,
                "velocity": 5.0,
            },
            {
                "name": "turn",
                "type": "revolute",
                "link": "arm",
                "axis": [0, 0, 1],
                "lower": -100.0,
                "upper": 100.0,
                "velocity": 2.0,
            },
        ],
        "points_of_interest": [{"name": "tip", "link": "arm", "offset": [RADIUS, 0, 0], "influence_radius": KEEP}],
    },
    "obstacles": {"maximum": 2, "half_spaces": 1},
    "tasks": [
        {"name": "limits", "kind": "joint_limits", "margin": 1.0, "activation": {"kind": "barrier", "rate": 20.0}},
        {"name": "obstacles", "kind": "obstacle_avoidance", "activation": {"kind": "barrier", "rate": 100.0}},
        {"name": "hold", "kind": "posture", "posture": [0.0, 0.0], "gain": 20.0},
    ],
    "velocity_limits": {"kind": "clamp"},
    "filter": {"kind": "first_order", "cutoff": 4.0},
}


def generated(spec, folder):
    folder = Path(folder) / spec.name
    folder.mkdir()
    for name, text in generate(spec).items():
        (folder / name).write_text(text)
    return CompiledController.load(folder)


@pytest.fixture(scope="module")
def crank(tmp_path_factory):
    return generated(ControllerSpec.parse(CRANK, "a test's table"), tmp_path_factory.mktemp("generated"))


@pytest.fixture(scope="module")
def robots(planar5_spec, tmp_path_factory):
    """Controllers by name, the shipped ones and planar5 with a barrier."""
    tasks = tuple(
        task.model_copy(update={"activation": barrier.Spec(kind="barrier")}) if isinstance(task, OneSidedSpec) else task
        for task in planar5_spec.tasks
    )
    loaded = {
        "planar5": generated(planar5_spec.model_copy(update={"tasks": tasks}), tmp_path_factory.mktemp("generated"))
    }

    def load(name):
        if name not in loaded:
            loaded[name] = CompiledController.load(name)
        return loaded[name]

    return load


# ---- Formulas ----

a_rate = st.floats(1.0, 200.0)
a_period = st.floats(5e-4, 2e-2)
a_bound = st.floats(0.0, 3.0)
disturbances = st.builds(
    Disturbance,
    curvature=a_bound,
    speed=st.floats(0.1, 3.0),
    acceleration=a_bound,
    velocity_error=a_bound,
    position_error=st.floats(0.0, 0.05),
    direction_error=st.floats(0.0, 0.3),
    excess=a_bound,
)


def next_clearance(h, d, g, T, share):
    """The least h⁺ that is possible at each h: from the true position or the sensed one, whichever says more."""
    sensed = h + d.position_error * np.linspace(-1, 1, 41)[:, None]
    known = d.velocity_error + share * d.excess
    from_truth = h - T * np.minimum(g * sensed + d.direction_error * d.speed + known, d.speed)
    from_sensed = sensed - d.position_error - T * np.minimum(g * sensed + known, d.speed)
    return np.maximum(from_truth, from_sensed).min(axis=0) - T**2 / 2 * (d.curvature + d.acceleration)


@given(disturbances, a_rate, a_period, st.floats(0.2, 1.0))
def test_nothing_at_the_margin_or_above_falls_below_it_in_a_step(d, rate, period, share):
    m = margin(d, rate, period, share).total
    h = -m + np.concatenate([[0.0], np.geomspace(1e-6, 10.0, 400)])
    assert np.min(next_clearance(h, d, share * rate, period, share)) >= -m - 1e-12 * (1 + m)


@given(disturbances, a_rate, a_period, st.floats(0.2, 1.0))
def test_no_smaller_margin_would_do(d, rate, period, share):
    """Where the direction is counted as it stands: there is a clearance from which the margin is reached."""
    g = share * rate
    d = replace(d, direction_error=min(d.direction_error, 2 * d.position_error * max(0.0, 1 / period - g) / d.speed))
    m = margin(d, rate, period, share).total
    c = g * d.position_error + d.direction_error * d.speed + d.velocity_error + share * d.excess
    h = -m if g * period <= 1 else (d.speed - c) / g  # where the row allows just the greatest speed
    lowest = h - period * min(g * h + c, d.speed) - period**2 / 2 * (d.curvature + d.acceleration)
    assert lowest == pytest.approx(-m, abs=1e-9)


@given(disturbances, st.floats(1.0, 50.0), st.floats(5e-4, 2e-2))
def test_terms_scale_with_period_and_rate_as_stated(d, rate, period):
    one, half, twice = margin(d, rate, period), margin(d, rate, period / 2), margin(d, 2 * rate, period / 2)
    for name in ("curvature", "acceleration"):  # T/γ
        assert getattr(half, name) == pytest.approx(getattr(one, name) / 2)
        assert getattr(twice, name) == pytest.approx(getattr(one, name) / 4)
    for name in ("velocity", "excess"):  # 1/γ
        assert getattr(half, name) == getattr(one, name)
        assert getattr(twice, name) == pytest.approx(getattr(one, name) / 2)
    assert one.position == half.position == twice.position == d.position_error
    assert one.overshoot == half.overshoot == twice.overshoot == 0


def test_margin_is_continuous_where_the_barrier_becomes_faster_than_the_sampling():
    d = Disturbance(curvature=2.0, speed=1.5, acceleration=0.3, velocity_error=0.2, position_error=0.01, excess=0.1)
    below, above = (margin(replace(d, direction_error=0.1), rate, 0.01).total for rate in (100 - 1e-9, 100 + 1e-9))
    assert below == pytest.approx(above, rel=1e-9)


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ((0.0, 0.01, 1.0), "rate"),
        ((10.0, -0.01, 1.0), "period"),
        ((10.0, 0.01, 0.0), "share"),
        ((10.0, 0.01, 1.5), "share"),
    ],
)
def test_numbers_out_of_range_are_refused(given, wanted):
    with pytest.raises(BadInput, match=wanted):
        margin(Disturbance(1.0, 1.0), *given)


def test_a_negative_bound_is_refused():
    with pytest.raises(BadInput, match="position_error: wanted 0 or more, got -1"):
        Disturbance(1.0, 1.0, position_error=-1)


# ---- What the derivation rests on ----


@pytest.mark.parametrize("dimension", [2, 3])
def test_distance_never_falls_by_more_than_the_approach_along_the_first_direction(dimension):
    """d⁺ >= d − û·(y⁺ − y), however far the step: ball, capsule and half-space are convex."""
    rng = np.random.default_rng(dimension)
    steps = 20_000
    places = rng.normal(size=(2, steps, dimension))
    normal = np.eye(dimension)[0]
    shapes = {
        "obstacles": [{"center": [0.1] * dimension, "radius": 0.3}],
        "capsules": [{"start": [0.2] * dimension, "end": [-0.4] * dimension, "radius": 0.2}],
        "half_spaces": [{"normal": normal.tolist(), "offset": 0.1}],
    }
    for key, (shape,) in shapes.items():
        scenario = Scenario.parse(
            {"name": "one", "description": "", "controller": "any", "duration": 1.0, "q0": (0.0,), key: (shape,)}, "one"
        )
        centers = np.broadcast_to(np.full(dimension, 0.1), (steps, len(scenario.obstacles), dimension))
        d, d_next = (distances(each[:, None], centers, scenario)[:, 0] for each in places)
        h = 1e-7
        nudged = [distances((places[0] + h * axis)[:, None], centers, scenario)[:, 0] for axis in np.eye(dimension)]
        toward = -(np.array(nudged).T - d[:, None]) / h  # û = −∂d/∂r, by differences
        fall = np.sum(toward * (places[1] - places[0]), axis=1)
        assert np.min(d_next - (d - fall)) > -1e-5  # the differences' own error, times steps of some metres


@given(st.floats(1e-4, 0.5), st.floats(1e-4, 0.5), st.floats(0, 2 * math.pi))
def test_direction_error_bounds_every_error_of_that_size(e, distance, angle):
    truth = np.array([distance, 0.0])
    sensed = truth + e * np.array([math.cos(angle), math.sin(angle)])
    if np.linalg.norm(sensed) > 1e-9:
        apart = np.linalg.norm(sensed / np.linalg.norm(sensed) - truth / distance)
        assert apart <= direction_error(e, distance) + 1e-9


def test_direction_error_is_reached_at_the_tangent():
    e, distance = 0.03, 0.1
    reach = math.sqrt(distance**2 - e**2)  # the sensed place where the line of sight touches the circle of errors
    sensed = reach / distance * np.array([reach, e])
    assert np.linalg.norm(sensed - [distance, 0]) == pytest.approx(e)
    apart = np.linalg.norm(sensed / np.linalg.norm(sensed) - [1, 0])
    assert apart == pytest.approx(direction_error(e, distance))


def sampled_motion(controller, velocity, count, seed):
    """|ṙ| and |D²r[q̇, q̇]| of the points at random configurations and velocities, half of these in the corners."""
    rng = np.random.default_rng(seed)
    limits = np.where(np.isinf(controller.manifest.limits), [-np.pi, np.pi], controller.manifest.limits)
    q = rng.uniform(limits[:, 0], limits[:, 1], (count, len(velocity)))
    w = velocity * np.where(rng.random((count, 1)) < 0.5, rng.choice([-1.0, 1.0], q.shape), rng.uniform(-1, 1, q.shape))
    h = 1e-5
    J, ahead, behind = (controller.jacobians.map(count, {"q": q + k * h * w})["point_jacobian"] for k in (0, 1, -1))
    speed = np.linalg.norm(np.einsum("kpdn,kn->kpd", J, w), axis=2)
    bend = np.linalg.norm(np.einsum("kpdn,kn->kpd", (ahead - behind) / (2 * h), w), axis=2)
    return speed, bend


@pytest.mark.parametrize("name", ["planar5", "planar10", "panda7", "mobile_panda"])
def test_no_point_is_faster_or_bends_more_than_its_bound(name, robots):
    controller = robots(name)
    velocity = np.array([joint.velocity for joint in controller.manifest.joints])
    speed, curvature = greatest_motion(controller, velocity)
    found_speed, found = sampled_motion(controller, velocity, 4000, 1)
    assert np.all(found_speed <= speed * (1 + 1e-9))
    assert np.all(found <= curvature * (1 + 1e-6) + 1e-6)  # the differences' error
    assert np.all(found.max(axis=0) > 0.1 * curvature)  # and not by far, though few samples are near the worst
    unequal = velocity * np.linspace(0.1, 1.0, len(velocity))
    assert np.all(sampled_motion(controller, unequal, 4000, 2)[1] <= greatest_motion(controller, unequal)[1] + 1e-6)


@pytest.mark.parametrize("name", ["planar5", "planar10"])
def test_bound_on_the_curvature_is_reached_by_a_straight_planar_arm(name, robots):
    controller = robots(name)
    velocity = np.array([joint.velocity for joint in controller.manifest.joints])
    q = np.zeros((1, len(velocity)))
    h = 1e-5
    ahead, behind = (controller.jacobians.map(1, {"q": q + k * h * velocity})["point_jacobian"][0] for k in (1, -1))
    bend = np.linalg.norm((ahead - behind) @ velocity / (2 * h), axis=1)
    straight = [i for i, point in enumerate(controller.manifest.points) if point.offset[1] == 0]
    assert bend[straight] == pytest.approx(greatest_motion(controller, velocity)[1][straight], rel=1e-6)


def test_bound_on_the_curvature_is_that_of_the_closed_form_of_a_planar_chain(robots):
    """Of planar5's tool, Σ l_i (b_iᵀ v)², which is L |v|² at most."""
    controller = robots("planar5")
    chain, velocity = planar_chain(controller), np.array([1.5, 1.5, 3.0, 3.0, 3.0])
    tool = [point.name for point in controller.manifest.points].index("tool")
    curvature = greatest_motion(controller, velocity)[1][tool]
    assert curvature == pytest.approx(chain.lengths @ (np.abs(chain.angles) @ velocity) ** 2)
    assert curvature <= chain.hessian * velocity @ velocity


def test_joints_without_a_velocity_limit_leave_no_bound(robots):
    speed, curvature = greatest_motion(robots("planar5"), np.array([np.inf, np.inf, 1.0, 1.0, 1.0]))
    assert np.all(np.isinf(speed))
    assert np.all(np.isfinite(curvature))  # sliding does not bend
    assert np.all(np.isinf(greatest_motion(robots("planar5"), np.full(5, np.inf))[1]))


# ---- Each term is reached ----


def crank_run(crank, case=1, **table):
    """A run of the crank: by default it stays where it starts, at q0."""
    q0 = table.setdefault("q0", (0.0, 0.0))
    scenario = {
        "name": "crank",
        "description": "",
        "controller": "crank",
        "duration": 1.0,
        "references": {"hold": {"kind": "fixed", "position": list(q0)}},
        **table,
    }
    return prepare(crank, Scenario.parse(scenario, "a test's scenario"), CASES[case])


def tip(run, rollout=None):
    """What was kept of the crank's tip."""
    (found,) = [each for each in kept(run, rollout or run.in_c()) if each.is_point]
    return found


WALL = {"normal": [1.0, 0.0], "offset": 0.0}  # the tip stays on its right


def into_the_wall(crank, period=0.005, rate=100.0):
    """The arm turns past the wall's normal at full speed, while the slide presses the tip against the wall."""
    start = [KEEP + 1e-3 - RADIUS * math.cos(0.7), -0.7]
    onward = {"kind": "line", "start": start, "end": [start[0] - 1.0, 1.3], "duration": 1.0}
    parameters = {"period": period, "obstacles_rate": rate}
    return crank_run(
        crank, q0=start, duration=0.7, references={"hold": onward}, half_spaces=(WALL,), parameters=parameters
    )


def test_own_path_reaches_the_margin_that_is_known_beforehand(crank):
    """κ_r = R θ̇² with θ̇ at its limit: a point on a circle, and a flat wall."""
    run = into_the_wall(crank)
    (before,) = expected(run)
    assert before.margin.total == pytest.approx(0.005 * RADIUS * 2.0**2 / (2 * 100.0))
    found = tip(run)
    assert found.holds
    assert 0.98 < -found.least / before.margin.total <= 1
    assert found.margin.total == pytest.approx(before.margin.total, rel=0.02)
    assert found.margin.curvature == pytest.approx(found.margin.total)
    assert found.used > 0.99


def test_intrusion_falls_with_the_period_and_with_the_rate(crank):
    slow, fast, firm = (-tip(into_the_wall(crank, *given)).least for given in ((0.004, 50), (0.002, 50), (0.004, 100)))
    assert slow / fast == pytest.approx(2, rel=0.03)  # θ turns by ω/γ = 0.04 rad within the time that h takes
    assert slow / firm == pytest.approx(2, rel=0.03)


def test_known_velocity_of_an_obstacle_costs_nothing_and_an_unknown_one_a_whole_time_constant(crank):
    path = {"kind": "line", "start": [RADIUS + 0.3, 0.0], "end": [RADIUS - 0.7, 0.0], "duration": 2.0}
    run = crank_run(crank, obstacles=({"radius": 0.1, "path": path},), parameters={"obstacles_rate": 25.0})
    told = tip(run)
    assert told.least > -ROUNDING
    assert told.margin.total < 1e-9
    run = replace(run, values={**run.values, "obstacle_velocity": np.zeros_like(run.values["obstacle_velocity"])})
    untold = tip(run)
    assert untold.holds
    assert untold.margin.velocity == pytest.approx(0.5 / 25.0)
    assert -untold.least == pytest.approx(untold.margin.total, rel=1e-3)
    assert expected(run)[0].margin.velocity == pytest.approx(0.5 / 25.0)


def test_delay_costs_the_way_that_the_obstacle_makes_in_it(crank):
    path = {"kind": "line", "start": [RADIUS + 0.3, 0.0], "end": [RADIUS - 0.7, 0.0], "duration": 2.0}
    run = crank_run(crank, obstacles=({"radius": 0.1, "path": path},), sensing={"delay": 0.04})
    found = tip(run)
    assert found.holds
    assert -found.least == pytest.approx(0.5 * 0.04, rel=1e-3)
    assert found.margin.position == pytest.approx(0.5 * 0.04)
    assert expected(run)[0].margin.position == pytest.approx(0.5 * 0.04)


def test_filter_follows_a_moving_obstacle_late(crank):
    """Case 2: the step runs the share μ = β of what the barrier asks for, (1 − μ)|ȯ|/(μγ) short."""
    path = {"kind": "line", "start": [RADIUS + 0.3, 0.0], "end": [RADIUS - 0.7, 0.0], "duration": 2.0}
    parameters = {"obstacles_rate": 50.0}
    run = crank_run(crank, case=2, obstacles=({"radius": 0.1, "path": path},), parameters=parameters, duration=1.9)
    X = 2 * math.pi * 4.0 * 0.005
    found = tip(run)
    assert found.holds
    assert found.margin.velocity == pytest.approx(0.5 / X / 50.0)  # (1 − β)/β = 1/X
    assert -found.least == pytest.approx(found.margin.total, rel=1e-3)


def test_acceleration_of_an_obstacle_counts_as_the_points_own_does(crank):
    """A disc as good as flat whose centre goes round, and the tip is pressed against it: ö points at the tip."""
    x = 50 + RADIUS + KEEP + 1e-3 - 0.5 * math.cos(0.7)
    path = {"kind": "circle", "center": [x, 0.0], "radius": 0.5, "period": math.pi, "phase": -0.7}
    into = {"hold": {"kind": "fixed", "position": [1.0, 0.0]}}
    run = crank_run(crank, obstacles=({"radius": 50.0, "path": path},), references=into, duration=0.7)
    found = tip(run)
    assert found.holds
    assert found.clearance[0] > 0
    assert found.margin.acceleration == pytest.approx(0.005 * 0.5 * 2.0**2 / (2 * 100.0), rel=1e-3)
    (before,) = expected(run)
    assert found.margin.acceleration <= before.margin.acceleration * (1 + 1e-9)
    assert before.margin.acceleration == pytest.approx(found.margin.acceleration, rel=0.01)
    assert found.used > 0.9
    assert -found.least > 0.9 * found.margin.acceleration


def test_rows_that_contradict_each_other_cost_what_the_barrier_reports(crank):
    """Two discs close on the tip from either side: nothing can be kept, and the excess says so."""
    discs = tuple(
        {
            "radius": 0.1,
            "path": {
                "kind": "line",
                "start": [RADIUS + side * 0.2, 0.0],
                "end": [RADIUS + side * 0.12, 0.0],
                "duration": 0.8,
            },
        }
        for side in (1, -1)
    )
    found = tip(crank_run(crank, obstacles=discs))
    assert found.least == pytest.approx(0.12 - 0.1 - KEEP, abs=1e-4)
    assert found.holds
    assert found.used > 0.9
    assert found.margin.excess == pytest.approx(found.margin.total, rel=0.1)


@pytest.mark.parametrize("rate_period", [1.5, 2.5])
def test_barrier_that_is_faster_than_the_sampling_overshoots_by_what_is_stated(crank, rate_period):
    """Started a whole number of steps before h = V/γ, where the row allows just the speed V."""
    period, speed = 0.01, 1.0
    rate = rate_period / period
    start = [KEEP - RADIUS + speed / rate + 3 * period * speed, 0.0]
    far = {"hold": {"kind": "fixed", "position": [start[0] - 1.0, 0.0]}}
    parameters = {"period": period, "obstacles_rate": rate, "velocity_limit": [speed, 1.0]}
    run = crank_run(crank, q0=start, references=far, half_spaces=(WALL,), parameters=parameters, duration=0.3)
    found = tip(run)
    assert found.holds
    assert -found.least == pytest.approx((rate_period - 1) * speed / rate)
    assert found.margin.overshoot == pytest.approx(-found.least)
    assert expected(run)[0].margin.overshoot >= found.margin.overshoot


def test_start_inside_returns_as_fast_as_the_rate_says(crank):
    run = crank_run(crank, q0=(KEEP - RADIUS - 0.03, 0.0), half_spaces=(WALL,), parameters={"obstacles_rate": 40.0})
    found = tip(run)
    k = np.arange(run.steps + 1)
    assert found.clearance[0] == pytest.approx(-0.03)
    assert found.clearance[:100] == pytest.approx(-0.03 * (1 - 40.0 * 0.005) ** k[:100], abs=1e-9)
    assert found.holds
    assert found.bound[:100] == pytest.approx(-found.clearance[:100], abs=1e-9)


def test_joint_limit_is_kept_exactly(crank):
    """A linear row: no curvature, no margin; from inside a joint returns no faster than its velocity limit."""
    run = crank_run(crank, q0=(98.5, 0.0), references={"hold": {"kind": "fixed", "position": [99.9, 0.0]}})
    slide = {each.name: each for each in kept(run, run.in_c())}["slide"]
    assert slide.holds
    assert 0 <= slide.least < 1e-6
    assert slide.margin.total < 1e-9
    inside = crank_run(crank, q0=(99.5, 0.0), references={"hold": {"kind": "fixed", "position": [99.9, 0.0]}})
    slide = {each.name: each for each in kept(inside, inside.in_c())}["slide"]
    assert slide.clearance[0] == pytest.approx(-0.5)  # γ · 0.5 m is 10 m/s, twice the limit
    assert slide.clearance[1] == pytest.approx(-0.5 + 5.0 * 0.005)
    assert slide.holds
    assert slide.clearance[-1] == pytest.approx(0, abs=1e-4)


# ---- Walls, and what is not covered ----

SLIDE, TURN = CRANK["robot"]["joints"]
WALLS = [{"normal": [1.0, 0.0], "offset": 0.0}, {"normal": [0.0, -1.0], "offset": -9.0}]
YARD = {
    **{key: value for key, value in CRANK.items() if key != "obstacles"},
    "name": "yard",
    "robot": {
        **CRANK["robot"],
        "joints": [SLIDE, {**SLIDE, "name": "lift", "link": "fork", "axis": [0, 1, 0]}, TURN],
        "frames": [{"name": "end", "link": "arm", "xyz": [RADIUS / 2, 0, 0]}],
        "bodies": [
            {"name": "hook", "link": "arm", "start": [RADIUS, 0, 0], "radius": 0.01},
            {"name": "foot", "link": "carriage", "start": [-5, 0, 0], "radius": 0.01},
        ],
    },
    "tasks": [
        {"name": "walls", "kind": "workspace_walls", "walls": WALLS, "margin": [KEEP, 0.1]},
        {"name": "fence", "kind": "workspace_walls", "walls": WALLS[1:], "margin": KEEP, "frames": ["end"]},
        {"name": "apart", "kind": "self_collision", "pairs": [["hook", "foot"]], "margin": 0.1},
        {"name": "hold", "kind": "posture", "posture": [0.0, 0.0, 0.0], "gain": 20.0},
    ],
}


def test_wall_is_a_half_space_and_other_guards_are_named_as_not_covered(tmp_path):
    """As the crank into the wall."""
    yard = generated(ControllerSpec.parse(YARD, "a test's table"), tmp_path)
    start = [KEEP + 1e-3 - RADIUS * math.cos(0.7), 0.0, -0.7]
    onward = {"kind": "line", "start": start, "end": [start[0] - 1.0, 0.0, 1.3], "duration": 1.0}
    table = {"name": "yard", "description": "", "controller": "yard", "duration": 0.7, "q0": tuple(start)}
    table |= {"references": {"hold": onward}, "parameters": {"period": 0.005, "walls_rate": 100.0}}
    run = prepare(yard, Scenario.parse(table, "a test's scenario"), CASES[1])
    rollout = run.in_c()
    found = tip(run, rollout)
    assert found.task == "walls"
    assert found.holds
    assert 0.98 < -found.least / expected(run)[0].margin.curvature <= 1
    assert uncovered(run, rollout) == ["fence", "apart"]


def test_filter_of_unequal_cutoffs_is_refused_where_it_acts(crank):
    table = {"obstacles": ({"radius": 0.1, "center": [1.0, 0.0]},), "parameters": {"filter_cutoff": [4.0, 8.0]}}
    assert tip(crank_run(crank, **table)).holds
    run = crank_run(crank, case=2, **table)
    for speaks_of in (expected, lambda run: kept(run, run.in_c())):
        with pytest.raises(BadInput, match=r"at λ > 0 .* got first_order, 2 cut-off"):
            speaks_of(run)


def test_barrier_that_does_not_hold_its_rows_is_found_out(crank):
    """The same rollout, held against a rate that its barrier did not have: rows and margin are violated."""
    run = into_the_wall(crank, rate=20.0)
    rollout = run.in_c()
    assert tip(run, rollout).holds
    claimed = replace(run, values={**run.values, "obstacles_rate": np.array(60.0)})
    found = tip(claimed, rollout)
    assert not found.holds
    assert found.unreported > 1e-3
    assert found.used > 1


def test_row_that_is_violated_far_from_the_boundary_is_found_out_too(crank):
    """Held against a slower rate the approach was too fast, though nothing ever fell below the boundary."""
    far = {"hold": {"kind": "fixed", "position": [KEEP - RADIUS + 0.1, 0.0]}}
    run = crank_run(crank, q0=(1.0, 0.0), references=far, half_spaces=(WALL,), parameters={"obstacles_rate": 20.0})
    rollout = run.in_c()
    assert tip(run, rollout).holds
    found = tip(replace(run, values={**run.values, "obstacles_rate": np.array(2.0)}), rollout)
    assert found.least > 0.05
    assert not found.holds


def test_filter_that_is_on_at_times_has_the_worse_of_both_margins_beforehand(crank):
    """Case 3: unfiltered γT = 3 overshoots, filtered μγT < 1 lags behind the obstacle."""
    path = {"kind": "line", "start": [RADIUS + 0.3, 0.0], "end": [RADIUS - 0.7, 0.0], "duration": 2.0}
    table = {"obstacles": ({"radius": 0.1, "path": path},), "parameters": {"obstacles_rate": 600.0}}
    free, filtered, both = (expected(crank_run(crank, case=case, **table))[0].margin for case in (1, 2, 3))
    assert free.overshoot > 0 == filtered.overshoot
    assert filtered.velocity > 0 == free.velocity
    for term in TERMS:
        assert getattr(both, term) == max(getattr(free, term), getattr(filtered, term))


# ---- Random runs ----

SCENES = {"planar5": "paper", "planar10": "snake", "panda7": "shelf", "mobile_panda": "corridor"}
TRACKED = {"planar5": "tool", "planar10": "tool", "panda7": "hand", "mobile_panda": "hand"}


def random_run(controller, name, rng):
    """A motion of the tracked frame past obstacles near the way of the points, some moving, some sensed badly."""
    scenario, manifest = read_scenario(find_scenario(SCENES[name])), controller.manifest
    duration = float(rng.uniform(0.5, 1.2))
    period = float(np.exp(rng.uniform(math.log(5e-4), math.log(0.02))))
    fastest = min(80.0, 1 / period) if rng.random() < 0.85 else 4 / period
    rate = float(np.exp(rng.uniform(math.log(5.0), math.log(fastest))))
    start = controller.kinematics(q=np.array(scenario.q0))[f"{TRACKED[name]}_position"].copy()
    way = {"kind": "point_to_point", "start": start.tolist(), "duration": float(rng.uniform(0.4, duration))}
    way["end"] = (start + rng.uniform(-0.4, 0.4, start.shape)).tolist()
    data = scenario.model_dump(exclude={"obstacles", "capsules", "half_spaces", "sensing", "parameters", "references"})
    data["references"] = {key: one.model_dump() for key, one in scenario.references.items()} | {TRACKED[name]: way}
    data |= {"duration": duration, "parameters": {"period": period, "obstacles_rate": rate}}
    alone = prepare(controller, Scenario.parse(data, "alone"), CASES[1])
    places = controller.kinematics.map(alone.steps, {"q": alone.in_c().q[:-1]})["point_position"]
    data["obstacles"] = tuple(random_ball(manifest, places, duration, rng) for _ in range(rng.integers(1, 4)))
    if manifest.half_spaces and rng.random() < 0.5:
        data["half_spaces"] = ({"normal": [0.0, 0.0, 1.0], "offset": float(places[:, :, 2].min() - 0.1)},)
    if rng.random() < 0.4:
        data["sensing"] = {
            "noise": float(10 ** rng.uniform(-4, -2)),
            "delay": float(rng.choice([0.0, 0.03])),
            "seed": int(rng.integers(100)),
        }
    run = prepare(controller, Scenario.parse(data, "random"), CASES[int(rng.choice([1, 1, 2, 3]))])
    if rng.random() < 0.3:
        run = replace(run, values={**run.values, "obstacle_velocity": np.zeros_like(run.values["obstacle_velocity"])})
    return run


def random_ball(manifest, places, duration, rng):
    """A disc or ball that a point would meet or nearly so; half of them get there while the point does."""
    i, k = int(rng.integers(places.shape[1])), int(rng.integers(places.shape[0]))
    radius = float(rng.choice([0.0, 0.02, 0.1]))
    near = controller_radius(manifest, i) + radius
    aside = rng.normal(size=places.shape[2])
    there = places[k, i] + aside / np.linalg.norm(aside) * near * rng.uniform(0.8, 1.1)
    if rng.random() < 0.5:
        return {"radius": radius, "center": there.tolist()}
    begin = there + rng.uniform(-0.3, 0.3, there.shape)
    kind = str(rng.choice(["line", "point_to_point"]))
    return {
        "radius": radius,
        "path": {"kind": kind, "start": begin.tolist(), "end": there.tolist(), "duration": duration},
    }


def controller_radius(manifest, i):
    radii = {signal.name: signal.default for signal in manifest.function("step").inputs}["influence_radius"]
    return radii[i]


@pytest.mark.parametrize("name", SCENES)
def test_no_random_run_falls_below_its_margin(name, robots):
    controller, rng = robots(name), np.random.default_rng(list(SCENES).index(name))
    used = []
    for _ in range(40):
        run = random_run(controller, name, rng)
        rollout = run.in_c()
        beforehand = {(each.task, each.point): each.margin for each in expected(run)}
        for each in kept(run, rollout):
            assert each.holds, (each.label, each.least, each.unreported)
            if each.is_point and each.clearance[0] > 0:
                used.append(each.used)
                before = beforehand[each.task, each.name]
                for term in TERMS:
                    if term != "excess":  # beforehand every row is taken for kept
                        assert getattr(each.margin, term) <= getattr(before, term) * (1 + 1e-9) + 1e-9, term
    assert np.count_nonzero(np.array(used) > 0.5) >= 3
    print(name, sorted(np.round(np.array(used)[np.array(used) > 0], 3)))
