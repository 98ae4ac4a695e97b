"""Rollouts inside compiled C, step by step from Python, and in real time: the same numbers, and clear refusals."""

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Obstacle
from clikgen.runtime.simulation import prepare


def _expect_equal_bits(first, second):
    assert first.keys() == second.keys()
    for name, array in first.items():
        assert array.shape == second[name].shape, name
        np.testing.assert_array_equal(array.view(np.uint64), second[name].view(np.uint64), err_msg=name)


@pytest.mark.parametrize("number", CASES)
def test_rollout_in_c_equals_stepping_from_python_bit_for_bit(number, paper_run):
    run = paper_run(number)
    in_c, stepwise = run.in_c(), run.stepwise()
    assert in_c.active.any()
    _expect_equal_bits(in_c.signals, stepwise.signals)


@pytest.mark.parametrize("number", CASES)
def test_rollout_equals_a_loop_written_by_hand(number, paper_run, planar5_folder):
    """Call the step, go on from q_next: nothing else happens in a rollout."""
    run = paper_run(number)
    rollout = run.in_c()
    controller = CompiledController.load(planar5_folder)
    q = run.values["q"]
    for k in range(run.steps):
        now = {
            name: value[k] if value.shape[:1] == (run.steps,) else value
            for name, value in run.values.items()
            if name != "q"
        }
        np.testing.assert_array_equal(q, rollout.q[k])
        outputs = controller.step(q=q, **now)
        for name in ("dq", "dq_law", "tool_error", "distance", "clearance", "active"):
            np.testing.assert_array_equal(outputs[name], rollout.signals[name][k])
        q = outputs["q_next"].copy()
    np.testing.assert_array_equal(q, rollout.q[run.steps])


def test_parameters_may_vary_over_time(planar5, planar5_folder):
    """Every input but the state, at once, as an array over time."""
    steps = 50
    rng = np.random.default_rng(0)
    info = planar5.step.info
    values = {signal.name: rng.uniform(0.5, 1.5, (steps, *signal.shape)) for signal in info.inputs}
    values["q"] = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    values["tool_gain"] = values["tool_gain"] * np.eye(2)
    values["lam_free"], values["lam_event"] = rng.random((2, steps))
    values["obstacle_count"] = rng.integers(0, 4, steps).astype(float)
    values["period"] = rng.uniform(0.001, 0.02, steps)
    rollout = planar5.rollout(steps, values)
    _expect_equal_bits(rollout, planar5.rollout_stepwise(steps, values))
    single = CompiledController.load(planar5_folder)
    for k in range(steps):
        outputs = single.step(**{name: array[k] for name, array in (values | {"q": rollout["q"]}).items()})
        np.testing.assert_array_equal(outputs["q_next"], rollout["q"][k + 1])
        np.testing.assert_array_equal(outputs["dq"], rollout["dq"][k])
    assert len(np.unique(rollout["lam"])) > 40


def test_a_constant_is_the_same_as_its_repetition(planar5):
    steps = 20
    base = {"q": np.full(5, 0.1), "tool_reference": np.array([1.5, 0.3])}
    repeated = base | {
        "tool_reference": np.tile([1.5, 0.3], (steps, 1)),
        "tool_gain": np.tile(4.0 * np.eye(2), (steps, 1, 1)),
        "period": np.full(steps, 0.01),
    }
    _expect_equal_bits(planar5.rollout(steps, base), planar5.rollout(steps, repeated))


def test_inputs_not_named_have_their_defaults_whatever_was_called_before(planar5, planar5_folder):
    fresh = CompiledController.load(planar5_folder)
    values = {"q": np.full(5, 0.1), "tool_reference": np.array([1.5, 0.3])}
    planar5.step(tool_gain=9 * np.eye(2), lam_free=1.0)
    planar5.rollout(3, values | {"period": 0.05})
    _expect_equal_bits(planar5.rollout(30, values), fresh.rollout(30, values))
    planar5.step(tool_gain=9 * np.eye(2), lam_free=1.0)
    _expect_equal_bits(planar5.rollout_stepwise(30, values), fresh.rollout(30, values))


def test_shapes_of_a_rollout(planar5):
    rollout = planar5.rollout(7, {"q": np.zeros(5)})
    info = planar5.step.info
    assert set(rollout) == {"q"} | {signal.name for signal in info.outputs} - {"q_next"}
    assert rollout["q"].shape == (8, 5)
    for signal in info.outputs:
        if signal.name != "q_next":
            assert rollout[signal.name].shape == (7, *signal.shape)


def test_a_rollout_of_no_steps_is_the_start_alone(planar5):
    rollout = planar5.rollout(0, {"q": np.arange(5.0)})
    np.testing.assert_array_equal(rollout["q"], [np.arange(5.0)])
    assert rollout["dq"].shape == (0, 5)


def test_arrays_of_any_layout_and_type_are_read_as_what_they_hold(planar5):
    reference = np.random.default_rng(1).uniform(0, 2, (10, 2))
    integers = {"q": [0, 0, 1, 0, -1], "tool_reference": reference}
    expected = planar5.rollout(10, integers)
    wide = np.zeros((10, 4))
    wide[:, ::2] = reference
    fancy = [
        np.asfortranarray(reference),
        wide[:, ::2],
        reference.astype(">f8"),
        reference[::-1][::-1],
        reference.tolist(),
    ]
    for other in fancy:
        given = {"q": np.array([0, 0, 1, 0, -1], dtype=np.int8), "tool_reference": other}
        _expect_equal_bits(planar5.rollout(10, given), expected)
        _expect_equal_bits(planar5.rollout_stepwise(10, given), expected)
    frozen = reference.copy()
    frozen.setflags(write=False)
    _expect_equal_bits(planar5.rollout(10, integers | {"tool_reference": frozen}), expected)


def test_a_rollout_changes_none_of_its_inputs(planar5):
    values = {"q": np.full(5, 0.1), "tool_reference": np.full((10, 2), 1.2), "tool_gain": 3 * np.eye(2)}
    before = {name: array.copy() for name, array in values.items()}
    planar5.rollout(10, values)
    planar5.rollout_stepwise(10, values)
    _expect_equal_bits(values, before)


def test_rollouts_keep_their_numbers_when_another_one_runs(planar5):
    first = planar5.rollout(10, {"q": np.full(5, 0.1)})
    copies = {name: array.copy() for name, array in first.items()}
    planar5.rollout(10, {"q": np.full(5, 0.7), "tool_reference": np.ones(2)})
    planar5.rollout_stepwise(10, {"q": np.full(5, 0.9)})
    _expect_equal_bits(first, copies)


def test_two_steppers_of_one_controller_do_not_disturb_each_other(planar5):
    values = [
        {"q": np.full(5, 0.1), "tool_reference": np.array([1.5, 0.3])},
        {"q": np.full(5, 0.4), "tool_reference": np.array([-1.0, 0.5]), "period": 0.002},
    ]
    expected = [planar5.rollout(10, value) for value in values]
    (first, step_first), (second, step_second) = (planar5.stepper(10, value) for value in values)
    for k in range(10):
        step_first(k)
        step_second(k)
    _expect_equal_bits(second, expected[1])
    _expect_equal_bits(first, expected[0])


class _SteadyClock:
    """A clock on which sleeping is exact and work takes no time."""

    def __init__(self):
        self.time = 0.0

    def now(self):
        return self.time

    def sleep_until(self, deadline):
        self.time = max(self.time, deadline)


def test_real_time_gives_the_numbers_of_the_rollout(paper_run):
    run = paper_run(3)
    rollout, timing = run.in_real_time(_SteadyClock())
    _expect_equal_bits(rollout.signals, run.in_c().signals)
    assert timing.overruns == 0
    assert len(timing.latency) == run.steps


# ---- What is refused ----


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"q": np.zeros(4)}, ["q", "(5,)", "(4,)"]),
        ({"q": 0.0}, ["q", "(5,)", "()"]),
        ({"q": np.zeros((10, 5))}, ["q", "(5,)", "(10, 5)"]),  # a state is where it starts, not an array over time
        ({"tool_reference": 1.0}, ["tool_reference", "(2,)", "(10, 2)", "()"]),
        ({"tool_reference": np.zeros((9, 2))}, ["tool_reference", "(10, 2)", "(9, 2)"]),
        ({"tool_gain": 4.0}, ["tool_gain", "(2, 2)", "()"]),
        ({"tool_gain": np.ones(4)}, ["tool_gain", "(2, 2)", "(4,)"]),
        ({"period": np.ones((10, 1))}, ["period", "(10,)", "(10, 1)"]),
        ({"tool_refrence": np.zeros(2)}, ["tool_refrence", "did you mean 'tool_reference'"]),
        ({"dq": np.zeros(5)}, ["'dq'", "valid choices", "lam_free"]),
    ],
)
@pytest.mark.parametrize("way", ["rollout", "rollout_stepwise"])
def test_a_rollout_refuses_wrong_shapes_and_unknown_names(way, values, words, planar5):
    with pytest.raises(ValueError, match=r".") as caught:
        getattr(planar5, way)(10, values)
    _expect_one_line_with(caught, words)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"q": 0.0}, ["q", "(5,)", "()", "planar5_step"]),
        ({"q": np.zeros((5, 1))}, ["q", "(5,)", "(5, 1)", "planar5_step"]),
        ({"tool_gain": np.ones(4)}, ["tool_gain", "(2, 2)", "(4,)"]),
        ({"period": np.ones(1)}, ["period", "()", "(1,)"]),
        ({"perod": 0.01}, ["perod", "did you mean 'period'", "planar5_step"]),
        ({"dq": np.zeros(5)}, ["'dq'", "valid choices"]),
    ],
)
def test_a_step_refuses_wrong_shapes_and_unknown_names(values, words, planar5):
    with pytest.raises(ValueError, match=r".") as caught:
        planar5.step(**values)
    _expect_one_line_with(caught, words)


def _expect_one_line_with(caught, words):
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


def test_a_name_that_is_no_controller_is_a_bad_input():
    with pytest.raises(BadInput, match=r"no generated controller 'planar6'; did you mean 'planar5'\?"):
        CompiledController.load("planar6")


def test_files_of_another_generation_are_a_bad_input(planar5_folder, tmp_path):
    for file in planar5_folder.iterdir():
        (tmp_path / file.name).write_text(file.read_text())
    source = tmp_path / "planar5.c"
    source.write_text(source.read_text() + "\n")
    with pytest.raises(BadInput, match=r"planar5\.c: not the file its manifest describes; run 'clikgen generate'"):
        CompiledController.load(tmp_path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"q0": (0.0, 0.0)}, ["q0", "5", "2"]),
        ({"parameters": {"periode": 0.01}}, ["periode", "did you mean 'period'"]),
        ({"parameters": {"period": 0.0}}, ["parameters.period", "1e-06 to 10", "0.0"]),
        ({"parameters": {"tool_gain": -1.0}}, ["tool_gain", "positive definite"]),
        ({"parameters": {"tool_gain": [[1.0, 2.0], [0.0, 1.0]]}}, ["tool_gain", "symmetric"]),
        ({"parameters": {"influence_radius": [1.0, 2.0]}}, ["influence_radius", "(6,)", "(2,)"]),
        ({"parameters": {"obstacles_gain": "much"}}, ["obstacles_gain", "'much'"]),
        ({"references": {}}, ["references.tool", "missing"]),
        ({"duration": 1e-3}, ["duration", "0.01 s", "got 0"]),
        ({"duration": 1e9}, ["duration", "10000000"]),
    ],
)
def test_a_scenario_that_does_not_fit_its_controller_is_a_bad_input(change, words, paper_run):
    run = paper_run(1)
    with pytest.raises(BadInput) as caught:
        prepare(run.controller, run.scenario.model_copy(update=change), run.case, "paper.toml")
    _expect_one_line_with(caught, ["paper.toml", *words])


def test_more_obstacles_than_the_controller_holds_are_a_bad_input(paper_run):
    run = paper_run(1)
    scenario = run.scenario.model_copy(update={"obstacles": run.scenario.obstacles * 4})
    with pytest.raises(BadInput, match="at most 3 for planar5, got 4"):
        prepare(run.controller, scenario, run.case)


def test_an_obstacle_moves_along_its_path_and_is_met_when_it_arrives(paper_run):
    run = paper_run(1)
    path = {"kind": "line", "start": [6.0, 0.7], "end": [-2.0, 0.7], "duration": 8.0, "delay": 1.0}
    moving = Obstacle.parse({"path": path, "radius": 0.1}, "a test")
    scenario = run.scenario.model_copy(update={"obstacles": (moving,)})
    rollout = prepare(run.controller, scenario, run.case).in_c()
    x = np.clip(6.0 - (rollout.t - 1.0), -2.0, 6.0)
    # one multiplication and one addition of numbers below 10 m
    expected = np.column_stack([x, np.full(len(x), 0.7)])
    np.testing.assert_allclose(rollout.obstacle_center[:, 0], expected, rtol=0, atol=4e-15)
    np.testing.assert_allclose(
        rollout.signals["distance"][:, 5],
        np.linalg.norm(expected - rollout.position, axis=1) - 0.1,
        rtol=0,
        atol=2e-14,  # ten such operations
    )
    assert rollout.active.any()
    assert not rollout.active[:150].any()
