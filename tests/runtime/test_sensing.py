"""Obstacles sensed late and with noise: what the step is told, and what the rollout says is true."""

from dataclasses import replace

import numpy as np
import pytest

from clikgen.runtime.clearance import distances
from clikgen.runtime.controller import CompiledController, find_controller
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import FAR, load_manifest
from clikgen.runtime.scenario import (
    CASES,
    Capsule,
    HalfSpace,
    Obstacle,
    Sensing,
    find_scenario,
    read_scenario,
    shipped_scenarios,
)
from clikgen.runtime.simulation import prepare

# The step and numpy add and multiply the same numbers, all below 10 m, in another order: some ten roundings.
ROUNDING = 1e-13  # [m]


def _senses(path):
    """Whether the controller of a scenario gives the distances of its points of interest."""
    step = load_manifest(find_controller(read_scenario(path).controller)).function("step")
    return "distance" in [signal.name for signal in step.outputs]


SENSING = [path.stem for path in shipped_scenarios() if _senses(path)]
PATH = {"kind": "circle", "center": [2.5, 0.2], "radius": 0.3, "period": 4.0, "phase": 0.5}


def _circle(t):
    """PATH in closed form, (k, 2) [m], and its velocity [m/s]."""
    rate = 2 * np.pi / 4.0
    angle = 0.5 + rate * t
    cos, sin = np.cos(angle), np.sin(angle)
    return np.column_stack([2.5 + 0.3 * cos, 0.2 + 0.3 * sin]), 0.3 * rate * np.column_stack([-sin, cos])


@pytest.fixture
def sensed_run(planar5):
    """The paper's scenario with a disc that circles on the path, and a still point, by what the sensing is like."""
    scenario = read_scenario(find_scenario("paper"))
    discs = (Obstacle(radius=0.1, path=PATH), Obstacle(center=(3.6, 0.4)))

    def run(number=1, **sensing):
        change = {"obstacles": discs, "sensing": Sensing(**sensing)}
        return prepare(planar5, scenario.model_copy(update=change), CASES[number])

    return run


def _expect_equal_bits(first, second):
    assert first.dtype == second.dtype == np.float64
    np.testing.assert_array_equal(first.view(np.uint64), second.view(np.uint64))


# ---- What the step is told ----


def test_noise_is_independent_gaussian_of_the_stated_deviation_on_every_coordinate(sensed_run):
    noise = 0.02
    sensed = sensed_run(noise=noise).values["obstacle_center"][:, :2]
    drawn = (sensed - sensed_run().values["obstacle_center"][:, :2]).reshape(len(sensed), 4) / noise
    samples = len(drawn)
    assert samples == 1700
    # five standard errors of each estimate: the mean's is 1/√N, the deviation's 1/√(2N), a correlation's 1/√N
    np.testing.assert_allclose(drawn.mean(axis=0), 0, rtol=0, atol=5 / np.sqrt(samples))
    np.testing.assert_allclose(drawn.std(axis=0), 1, rtol=0, atol=5 / np.sqrt(2 * samples))
    apart = np.corrcoef(np.hstack([drawn[1:], drawn[:-1]]).T) - np.eye(8)  # among coordinates, and one period on
    np.testing.assert_allclose(apart, 0, rtol=0, atol=5 / np.sqrt(samples))
    # of a normal distribution 0.27 % lie beyond 3 deviations: 18 of 6800, five of its deviations (4.3) either way
    assert 0 < np.count_nonzero(np.abs(drawn) > 3) < 40


def test_places_without_an_obstacle_stay_empty(sensed_run):
    values = sensed_run(noise=0.02, delay=0.1).values
    assert values["obstacle_center"].shape == (1700, 3, 2)
    assert not values["obstacle_center"][:, 2].any()
    assert values["obstacle_count"] == 2


def test_one_seed_gives_one_noise_in_every_case_and_another_seed_another(sensed_run):
    first = sensed_run(1, noise=0.02, seed=3).values["obstacle_center"]
    _expect_equal_bits(first, sensed_run(1, noise=0.02, seed=3).values["obstacle_center"])
    _expect_equal_bits(first, sensed_run(3, noise=0.02, seed=3).values["obstacle_center"])
    assert np.all(first[:, :2] != sensed_run(1, noise=0.02, seed=4).values["obstacle_center"][:, :2])


def test_noise_grows_in_proportion_to_its_deviation(sensed_run):
    truth, small, large = (sensed_run(noise=noise).values["obstacle_center"] for noise in (0.0, 0.01, 0.02))
    # centres below 10 m are rounded at 1e-15, twice
    np.testing.assert_allclose(large - truth, 2 * (small - truth), rtol=0, atol=1e-14)


def test_a_delay_of_k_periods_senses_where_the_obstacle_was_k_samples_ago(sensed_run):
    late, now = (sensed_run(delay=delay).values["obstacle_center"][:, 0] for delay in (0.15, 0.0))
    # t − 0.15 s and t_{k−15} differ by rounding of t, 4e-15 s, at 0.5 m/s
    np.testing.assert_allclose(late[15:], now[:-15], rtol=0, atol=1e-14)
    np.testing.assert_array_equal(late[:16], np.tile(now[0], (16, 1)))  # not from before t = 0


@pytest.mark.parametrize("delay", [0.004, 0.15, 1.237, 100.0])
def test_any_delay_senses_the_path_at_the_earlier_time(delay, sensed_run):
    run = sensed_run(delay=delay)
    t = 0.01 * np.arange(run.steps)
    place, _ = _circle(np.maximum(t - delay, 0))
    # an angle below 30 rad is rounded at 4e-15, at a radius of 0.3 m
    np.testing.assert_allclose(run.values["obstacle_center"][:, 0], place, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(run.values["obstacle_center"][:, 1], np.tile([3.6, 0.4], (run.steps, 1)))


def test_noise_comes_on_top_of_the_delay(sensed_run):
    truth, noisy, late, both = (
        sensed_run(**sensing).values["obstacle_center"]
        for sensing in ({}, {"noise": 0.02}, {"delay": 0.15}, {"noise": 0.02, "delay": 0.15})
    )
    np.testing.assert_allclose(both - late, noisy - truth, rtol=0, atol=1e-14)  # centres rounded at 1e-15, twice


def _whose_step_wants(velocities, controller):
    """The controller, its step with or without the obstacles' velocities; good for preparing a run, not for running."""
    step = controller.manifest.function("step")
    inputs = [signal for signal in step.inputs if signal.name != "obstacle_velocity"]
    if velocities:
        inputs.append(step.input("obstacle_center").model_copy(update={"name": "obstacle_velocity", "unit": "m/s"}))
    changed = step.model_copy(update={"inputs": tuple(inputs)})
    functions = tuple(changed if one.name == "step" else one for one in controller.manifest.functions)
    return replace(controller, manifest=controller.manifest.model_copy(update={"functions": functions}))


@pytest.mark.parametrize("delay", [0.0, 0.15])
def test_a_step_that_wants_velocities_gets_those_of_the_path_as_late_and_without_noise(delay, sensed_run):
    run = sensed_run(noise=0.02, delay=delay)
    values = prepare(_whose_step_wants(True, run.controller), run.scenario, run.case).values
    t = 0.01 * np.arange(run.steps)
    _, velocity = _circle(np.maximum(t - delay, 0))
    # an angle below 30 rad is rounded at 4e-15, at a speed of 0.5 m/s
    np.testing.assert_allclose(values["obstacle_velocity"][:, 0], velocity, rtol=0, atol=1e-14)
    assert not values["obstacle_velocity"][:, 1:].any()  # a point that stays, and an empty place
    _expect_equal_bits(values["obstacle_center"], run.values["obstacle_center"])


def test_a_step_that_wants_no_velocities_gets_none(sensed_run):
    run = sensed_run(delay=0.1)
    values = prepare(_whose_step_wants(False, run.controller), run.scenario, run.case).values
    assert "obstacle_velocity" not in values


# ---- The truth ----


@pytest.mark.parametrize("name", SENSING)
@pytest.mark.parametrize("number", CASES)
def test_numpy_distances_are_those_of_the_compiled_step(name, number):
    scenario = read_scenario(find_scenario(name)).model_copy(update={"sensing": Sensing()})
    controller = CompiledController.load(scenario.controller)
    rollout = prepare(controller, scenario, CASES[number]).in_c()
    points = controller.kinematics.map(len(rollout.t), {"q": rollout.q[:-1]})["point_position"]
    found = distances(points, rollout.obstacle_center, scenario)
    np.testing.assert_allclose(found, rollout.signals["distance"], rtol=0, atol=ROUNDING)


def test_scenarios_with_balls_capsules_and_half_spaces_are_among_those():
    scenarios = [read_scenario(find_scenario(name)) for name in SENSING]
    assert any(len(one.obstacles) >= 2 for one in scenarios)
    assert any(one.capsules for one in scenarios)
    assert any(one.half_spaces for one in scenarios)


@pytest.fixture
def panda7():
    return CompiledController.load("panda7")


def _step_and_numpy(panda7, count, shapes):
    """The distances of 1,000 random poses to shapes, as the step gives them and as numpy does."""
    scenario = read_scenario(find_scenario("shelf")).model_copy(
        update={"obstacles": (), "capsules": (), "half_spaces": (), "sensing": Sensing(), "duration": 0.01} | shapes
    )
    run = prepare(panda7, scenario, CASES[1])
    q = np.random.default_rng(0).uniform(*np.clip(panda7.manifest.limits.T, -3, 3), (count, 7))
    fed = {name: value for name, value in run.values.items() if "_reference" not in name}
    if scenario.obstacles:
        fed |= {name: fed[name][0] for name in ("obstacle_center", "obstacle_velocity")}  # as the run begins
    own = panda7.step.map(count, fed | {"q": q})["distance"]
    points = panda7.kinematics.map(count, {"q": q})["point_position"]
    centers = np.tile([one.motion.sample(np.zeros(1))[0][0] for one in scenario.obstacles], (count, 1, 1))
    return own, distances(points, centers.reshape(count, -1, 3), scenario)


BALL = Obstacle(center=(0.3, 0.1, 0.6), radius=0.4)
CAPSULE = Capsule(start=(0.2, -0.5, 0.4), end=(0.3, 0.6, 0.8), radius=0.3)
SPHERE = Capsule(start=(0.2, -0.5, 0.4), end=(0.2, -0.5, 0.4), radius=0.4)
SLOPE = HalfSpace(normal=(0.6, 0.0, 0.8), offset=0.4)


@pytest.mark.parametrize(
    "shapes",
    [
        {"obstacles": (BALL,)},
        {"capsules": (CAPSULE,)},
        {"capsules": (SPHERE,)},
        {"half_spaces": (SLOPE,)},
        {"obstacles": (BALL, Obstacle(center=(-0.3, 0.2, 0.2))), "capsules": (CAPSULE,), "half_spaces": (SLOPE,)},
    ],
    ids=["ball", "capsule", "capsule without length", "half-space", "all of them"],
)
def test_numpy_distances_are_those_of_the_step_inside_and_outside_of_every_shape(shapes, panda7):
    own, found = _step_and_numpy(panda7, 1000, shapes)
    np.testing.assert_allclose(found, own, rtol=0, atol=ROUNDING)
    assert found.min() < -0.01
    assert found.max() > 0.3


def test_without_an_obstacle_everything_is_far(panda7):
    own, found = _step_and_numpy(panda7, 10, {})
    np.testing.assert_array_equal(found, np.full((10, 4), FAR))
    np.testing.assert_array_equal(found, own)


def test_a_point_that_has_diverged_is_far_as_the_step_says(planar5):
    scenario = read_scenario(find_scenario("paper"))
    q = np.array([[np.nan] * 5, [np.inf, 0, 0, 0, 0], [1e300, 1e300, 0, 0, 0]])
    points = planar5.kinematics.map(3, {"q": q})["point_position"]
    given = {"obstacle_center": [[2.5, 0.0], [0, 0], [0, 0]], "obstacle_radius": [0.1, 0, 0], "obstacle_count": 1.0}
    own = planar5.step.map(3, given | {"q": q})["distance"]
    found = distances(points, np.tile([2.5, 0.0], (3, 1, 1)), scenario)
    np.testing.assert_array_equal(found, own)


@pytest.mark.parametrize("sensing", [{"noise": 0.02}, {"delay": 0.2}, {"noise": 0.01, "delay": 0.3, "seed": 8}])
@pytest.mark.parametrize("number", CASES)
def test_distance_and_clearance_are_what_the_step_would_say_of_the_true_obstacles(number, sensing, sensed_run):
    run = sensed_run(number, **sensing)
    rollout = run.in_c()
    truth = sensed_run(number).values | {"q": rollout.q[:-1]}
    outputs = run.controller.step.map(run.steps, truth)
    for name in ("distance", "clearance"):
        np.testing.assert_allclose(rollout.signals[name], outputs[name], rtol=0, atol=ROUNDING)
    place, _ = _circle(rollout.t)
    np.testing.assert_allclose(rollout.obstacle_center[:, 0], place, rtol=0, atol=1e-14)  # as above
    assert rollout.obstacle_center.shape == (run.steps, 2, 2)


@pytest.mark.parametrize("sensing", [{"noise": 0.02}, {"delay": 0.2}, {"noise": 0.01, "delay": 0.3}])
def test_all_the_rest_is_as_the_step_gave_it_and_what_it_took_for_true_is_kept(sensing, sensed_run):
    run = sensed_run(**sensing)
    raw, signals = run.controller.rollout(run.steps, run.values), run.in_c().signals
    assert set(signals) == set(raw) | {"sensed_distance", "sensed_clearance"}
    renamed = {"distance": "sensed_distance", "clearance": "sensed_clearance"}
    for name, array in raw.items():
        _expect_equal_bits(signals[renamed.get(name, name)], array)
    felt = np.any(signals["sensed_distance"] <= run.values["influence_radius"], axis=1)
    np.testing.assert_array_equal(signals["active"] > 0, felt)


@pytest.mark.parametrize("sensing", [{"noise": 0.02}, {"delay": 0.2}, {"noise": 0.01, "delay": 0.3}])
def test_clearance_is_misjudged_by_at_most_what_the_obstacles_are_misplaced(sensing, sensed_run):
    """A distance is 1-Lipschitz in the obstacle's place, and so is the least of several."""
    run = sensed_run(**sensing)
    rollout = run.in_c()
    misplaced = run.values["obstacle_center"][:, :2] - rollout.obstacle_center
    most = np.linalg.norm(misplaced, axis=2).max(axis=1) + ROUNDING
    off = np.abs(rollout.signals["clearance"] - rollout.signals["sensed_clearance"])
    assert np.all(off <= most)
    assert off.max() > 0.5 * most.max()  # the bound is nearly met
    assert np.all(np.abs(rollout.signals["distance"] - rollout.signals["sensed_distance"]) <= most[:, None])


def test_a_rollout_up_to_its_divergence_keeps_what_was_sensed_up_to_there(sensed_run):
    run = sensed_run(noise=0.02)
    wild = replace(run, values={**run.values, "tool_gain": 500 * np.eye(2)})  # K_g T = 5 > 2
    rollout = wild.in_c()
    assert rollout.diverged is not None
    kept = rollout.before_divergence()
    assert len(kept.signals["sensed_distance"]) == len(kept.signals["distance"]) == len(kept.t) < run.steps


# ---- Perfect sensing ----


@pytest.mark.parametrize("name", [path.stem for path in shipped_scenarios()])
def test_perfect_sensing_leaves_what_the_controller_gave_bit_for_bit(name):
    scenario = read_scenario(find_scenario(name)).model_copy(update={"sensing": Sensing(seed=5)})
    controller = CompiledController.load(scenario.controller)
    run = prepare(controller, scenario, CASES[3])
    rollout, raw = run.in_c(), controller.rollout(run.steps, run.values)
    assert rollout.signals.keys() == raw.keys()
    for signal, array in raw.items():
        _expect_equal_bits(rollout.signals[signal], array)
    for i, obstacle in enumerate(scenario.obstacles):
        place = obstacle.motion.sample(rollout.t)[0]
        np.testing.assert_array_equal(rollout.obstacle_center[:, i], place)
        np.testing.assert_array_equal(run.values["obstacle_center"][:, i], place)


def test_a_controller_that_senses_nothing_runs_as_ever():
    scenario = read_scenario(find_scenario("stretch"))
    controller = CompiledController.load(scenario.controller)
    assert "distance" not in controller.step.outputs
    blind = scenario.model_copy(update={"sensing": Sensing(noise=0.1, delay=0.1)})
    plain, other = (prepare(controller, one, CASES[3]).in_c().signals for one in (scenario, blind))
    assert plain.keys() == other.keys()
    for name, array in plain.items():
        _expect_equal_bits(other[name], array)


def test_every_way_of_running_senses_the_same(sensed_run):
    run = sensed_run(3, noise=0.02, delay=0.1)
    in_c, stepwise = run.in_c().signals, run.stepwise().signals
    for name, array in in_c.items():
        _expect_equal_bits(stepwise[name], array)


# ---- Settings ----


def test_sensing_can_be_set_over_a_scenario():
    path = find_scenario("paper")
    assert read_scenario(path).sensing.perfect
    sensing = read_scenario(path, ["sensing.noise=0.005", "sensing.seed=7"]).sensing
    assert sensing == Sensing(noise=0.005, seed=7)
    assert not sensing.perfect
    assert not read_scenario(path, ["sensing.delay=0.1"]).sensing.perfect


def test_sensing_is_a_table_of_the_scenario_file(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(find_scenario("paper").read_text() + "\n[sensing]\nnoise = 0.005\ndelay = 0.03\nseed = 2\n")
    assert read_scenario(file).sensing == Sensing(noise=0.005, delay=0.03, seed=2)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("sensing.noise=-0.1", ["sensing.noise", "greater than or equal to 0", "-0.1"]),
        ("sensing.noise=inf", ["sensing.noise", "finite", "inf"]),
        ("sensing.noise=1e308", ["sensing.noise", "less than or equal to 1000", "1e+308"]),
        ("sensing.noise='much'", ["sensing.noise", "number", "'much'"]),
        ("sensing.noise=[0.1, 0.1]", ["sensing.noise", "number", "[0.1, 0.1]"]),
        ("sensing.delay=-1e-3", ["sensing.delay", "greater than or equal to 0", "-0.001"]),
        ("sensing.delay=nan", ["sensing.delay", "finite", "nan"]),
        ("sensing.seed=-1", ["sensing.seed", "greater than or equal to 0", "-1"]),
        ("sensing.seed=1.5", ["sensing.seed", "integer", "1.5"]),
        ("sensing.seed=true", ["sensing.seed", "integer", "True"]),
        ("sensing.nois=0.1", ["sensing", "nois", "did you mean 'noise'"]),
        ("sensing.noise.x=0.1", ["sensing.noise", "number"]),
        ("sensing=0.1", ["sensing", "0.1"]),
    ],
)
def test_bad_sensing_is_one_line_that_names_file_and_key(setting, words):
    with pytest.raises(BadInput) as caught:
        read_scenario(find_scenario("paper"), [setting])
    message = str(caught.value)
    assert "\n" not in message
    for word in ["paper.toml", *words]:
        assert word in message
