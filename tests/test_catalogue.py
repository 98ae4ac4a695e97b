"""Whatever ships is checked here, found by its file: a new robot, task kind or scenario needs no new test."""

import pkgutil
from importlib import import_module

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import is_positive_definite
from clikgen.runtime.scenario import CASES, read_scenario, shipped_scenarios
from clikgen.runtime.simulation import prepare
from clikgen.symbolic import filters, laws, tasks
from clikgen.symbolic.activations.switched import Spec as Switched
from clikgen.symbolic.controller import build
from clikgen.symbolic.generate import difference, generate, generate_file, shipped_folder
from clikgen.symbolic.kinds import kinds_in
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.task import TaskSpec

SPECS = {path.stem: path for path in shipped_specs()}
SCENARIOS = {path.stem: path for path in shipped_scenarios()}


@pytest.fixture(params=SPECS)
def spec_file(request):
    return SPECS[request.param]


@pytest.fixture
def controller(spec_file):
    return CompiledController.load(shipped_folder() / spec_file.stem)


@pytest.fixture
def switched(spec_file, tmp_path):
    """The controller with a row for each contact, as the paper has them: a barrier tells neither potential nor row."""
    spec, rows = read_spec(spec_file), Switched(kind="switched", combine="rows")
    tables = [
        task.model_copy(update={"activation": rows}) if isinstance(task, OneSidedSpec) else task for task in spec.tasks
    ]
    for name, text in generate(spec.model_copy(update={"tasks": tuple(tables)})).items():
        (tmp_path / name).write_text(text)
    return CompiledController.load(tmp_path)


def states(controller, count, seed=0):
    """Random inputs: joints within their limits, obstacles among the points of interest, parameters as they ship."""
    draw = np.random.default_rng(seed)
    lower, upper = controller.manifest.limits.T
    values = {}
    for signal in controller.step.info.inputs:
        shape = (count, *signal.shape)
        if signal.role == "state":
            values[signal.name] = draw.uniform(np.maximum(lower, -3), np.minimum(upper, 3), shape)
        elif signal.name.endswith("_count"):
            values[signal.name] = draw.integers(0, int(signal.maximum) + 1, count).astype(float)
        elif signal.name.endswith("_radius") and signal.role == "signal":
            values[signal.name] = draw.uniform(0, 0.3, shape)
        elif signal.name == "half_space_normal":
            normal = draw.standard_normal(shape)
            values[signal.name] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        elif signal.role == "signal":
            values[signal.name] = draw.uniform(-3, 3, shape)
    return values


def own_inputs(function, values):
    return {name: value for name, value in values.items() if name in function.inputs}


def rate(function, outputs, values, joint, h=1e-5):
    """Central difference of what a task measures, along one joint: (count, rows).

    A quaternion's rate is turned into the angular velocity ω = 2 (q̇ ⊗ q̄), a potential's or a value's is plain.
    """
    ahead, behind = (
        function.map(len(values["q"]), values | {"q": values["q"] + sign * h * np.eye(values["q"].shape[1])[joint]})
        for sign in (1, -1)
    )
    rows = []
    for name in outputs:
        difference = ahead[name] - behind[name]
        if name.endswith("_orientation"):
            turned = (
                Rotation.from_quat(ahead[name], scalar_first=True)
                * Rotation.from_quat(behind[name], scalar_first=True).inv()
            )
            difference = turned.as_rotvec()
        rows.append(difference.reshape(len(values["q"]), -1) / (2 * h))
    return np.concatenate(rows, axis=1)


def test_file_and_controller_share_their_name(spec_file):
    assert read_spec(spec_file).name == spec_file.stem


def test_generated_files_are_fresh(spec_file):
    made = generate_file(spec_file)
    assert not difference({made.name: made.files}, shipped_folder(), complete=False)


def test_defaults_lie_within_the_limits(controller):
    for function in controller.manifest.functions:
        for signal in function.inputs:
            assert signal.minimum < signal.maximum
            if signal.role == "parameter":
                default = signal.value(np.reshape(signal.default, signal.shape), signal.name)
                assert not signal.positive_definite or is_positive_definite(default)


def test_every_signal_has_a_unit_and_a_meaning(controller):
    for function in controller.manifest.functions:
        for signal in (*function.inputs, *function.outputs):
            assert signal.unit
            assert signal.description


def test_every_task_jacobian_is_the_derivative_of_what_the_task_measures(switched):
    """Central differences at h = 1e-5: truncation h²·|D³f|/6 and rounding eps/h stay below 1e-7 for lengths of metres.

    Kinks and poles (a potential's boundary, looking away, a heading's wrap, w = 0) are met by few of the states.
    """
    count = 400
    values = states(switched, count)
    jacobians = switched.jacobians.map(count, own_inputs(switched.jacobians, values))
    for task in switched.manifest.tasks:
        kinds = ("position", "orientation", "potential", "value")
        wanted = [f"{task.name}_{kind}" for kind in kinds if f"{task.name}_{kind}" in switched.step.outputs]
        assert wanted, f"{task.kind} says nothing of what it measures"
        columns = [rate(switched.step, wanted, values, i) for i in range(values["q"].shape[1])]
        jacobian = jacobians[f"{task.name}_jacobian"].reshape(count, -1, values["q"].shape[1])
        wrong = np.abs(jacobian - np.stack(columns, axis=-1)).max(axis=(1, 2)) > 1e-6 * (
            1 + np.abs(jacobian).max(axis=(1, 2))
        )
        assert np.count_nonzero(wrong) <= count // 50, f"{task.kind}: {np.count_nonzero(wrong)} of {count}"


def test_point_jacobians_are_derivatives_of_the_points(controller):
    if not controller.manifest.points:
        assert "point_jacobian" not in controller.jacobians.outputs
        return
    count, h, n = 200, 1e-5, len(controller.manifest.joints)
    values = states(controller, count)
    q = values["q"]
    jacobian = controller.jacobians.map(count, own_inputs(controller.jacobians, values))["point_jacobian"]
    for i in range(n):
        ahead, behind = (
            controller.kinematics.map(count, {"q": q + sign * h * np.eye(n)[i]})["point_position"] for sign in (1, -1)
        )
        np.testing.assert_allclose(jacobian[..., i], (ahead - behind) / (2 * h), atol=1e-8)


def test_link_poses_are_rotations(controller):
    pose = controller.kinematics.map(100, {"q": states(controller, 100)["q"]})["link_pose"]
    rotation = pose[..., :3]
    identity = np.broadcast_to(np.eye(3), rotation.shape)
    np.testing.assert_allclose(rotation @ rotation.swapaxes(-1, -2), identity, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-12)


def test_the_compiled_step_is_the_one_that_casadi_evaluates(controller, spec_file):
    """To rounding, and where a barrier acts to that of its solver, 1e-7; test_emitter derives the bounds."""
    function, count = build(read_spec(spec_file)).function("step"), 500
    values = states(controller, count)
    given = {
        signal.name: np.broadcast_to(
            values.get(signal.name, np.reshape(signal.default or 0.0, signal.shape)), (count, *signal.shape)
        )
        for signal in controller.step.info.inputs
    }
    compiled = controller.step.map(count, given)
    columns = [given[name].reshape(count, -1).T for name in function.name_in()]
    results = dict(zip(function.name_out(), map(np.array, function.map(count).call(columns)), strict=True))
    kept = np.ones(count, dtype=bool)
    if "barrier_excess" in results:  # rows that contradict each other have no solution to agree on
        kept = (results["barrier_excess"][0] < 1e-8) & (results["barrier_solved"][0] == 1)
    assert np.sum(kept) > count / 4
    for name, result in results.items():
        expected = result.T.reshape(compiled[name].shape)
        np.testing.assert_allclose(compiled[name][kept], expected[kept], rtol=1e-7, atol=1e-7, err_msg=name)


def test_a_million_random_states_step_to_finite_ones(controller, anything):
    """Half of them as they occur, half anywhere within the limits of the inputs."""
    count, chunks = 20_000, 50
    for seed in range(chunks):
        values = states(controller, count, seed) if seed % 2 else anything(controller.step.info, count, seed)
        for name, outputs in controller.step.map(count, values).items():
            assert np.all(np.isfinite(outputs)), name


def test_every_task_kind_is_a_spec_of_its_file_s_name_and_ships_in_a_controller():
    used = {task.kind for path in SPECS.values() for task in read_spec(path).tasks}
    for name, kind in kinds_in(tasks).items():
        assert issubclass(kind, TaskSpec)
        assert kind.model_fields["kind"].annotation.__args__ == (name,)
        assert name in used


@pytest.mark.parametrize("law", [module.name for module in pkgutil.iter_modules(laws.__path__)])
def test_every_law_combines_tasks(law):
    assert callable(import_module(f"{laws.__name__}.{law}").combine)


@pytest.mark.parametrize("kind", [module.name for module in pkgutil.iter_modules(filters.__path__)])
def test_every_filter_is_a_spec_of_its_file_s_name(kind):
    spec = import_module(f"{filters.__name__}.{kind}").Spec
    assert spec.model_fields["kind"].annotation.__args__ == (kind,)


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_runs_in_every_case(name):
    scenario = read_scenario(SCENARIOS[name])
    assert scenario.name == name
    controller = CompiledController.load(scenario.controller)
    for case in CASES.values():
        rollout = prepare(controller, scenario, case).in_c()
        assert all(np.all(np.isfinite(values)) for values in rollout.signals.values())
