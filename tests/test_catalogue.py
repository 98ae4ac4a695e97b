"""Whatever ships is checked here, found by its file: a new robot, task kind or scenario needs no new test."""

import pkgutil
from importlib import import_module

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import is_positive_definite
from clikgen.runtime.scenario import CASES, read_scenario, shipped_scenarios
from clikgen.runtime.simulation import prepare
from clikgen.symbolic import filters, laws
from clikgen.symbolic.generate import difference, generate_file, shipped_folder
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.task import TaskSpec, task_kinds

SPECS = {path.stem: path for path in shipped_specs()}
SCENARIOS = {path.stem: path for path in shipped_scenarios()}


@pytest.fixture(params=SPECS)
def spec_file(request):
    return SPECS[request.param]


@pytest.fixture
def controller(spec_file):
    return CompiledController.load(shipped_folder() / spec_file.stem)


def states(controller, count, seed=0):
    """Random inputs: joints within their limits, obstacles among the points of interest, parameters as they ship."""
    draw = np.random.default_rng(seed)
    joints = controller.manifest.joints
    lower, upper = (np.array([getattr(joint, end) for joint in joints]) for end in ("lower", "upper"))
    values = {}
    for signal in controller.step.info.inputs:
        if signal.role == "state":
            values[signal.name] = draw.uniform(np.maximum(lower, -3), np.minimum(upper, 3), (count, len(joints)))
        elif signal.name == "obstacle_count":
            values[signal.name] = draw.integers(0, controller.manifest.obstacles + 1, count).astype(float)
        elif signal.name == "obstacle_radius":
            values[signal.name] = draw.uniform(0, 0.3, (count, *signal.shape))
        elif signal.role == "signal":
            values[signal.name] = draw.uniform(-3, 3, (count, *signal.shape))
    return values


def test_file_and_controller_share_their_name(spec_file):
    assert read_spec(spec_file).name == spec_file.stem


def test_generated_files_are_fresh(spec_file):
    name, files = generate_file(spec_file)
    assert not difference({name: files}, shipped_folder(), complete=False)


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


def test_every_task_jacobian_is_the_derivative_of_what_the_task_measures(controller):
    """Central differences: error h²·|D³f|/6 and rounding eps/h, both below 1e-8 at h = 1e-5 for lengths of metres."""
    count, h, n = 200, 1e-5, len(controller.manifest.joints)
    values = states(controller, count)
    own = {name: value for name, value in values.items() if name in controller.jacobians.inputs}
    jacobians = controller.jacobians.map(count, own)
    for task in controller.manifest.tasks:
        measured = next(
            name for name in (f"{task.name}_position", f"{task.name}_potential") if name in controller.step.outputs
        )
        columns = []
        for i in range(n):
            moved = [
                controller.step.map(count, values | {"q": values["q"] + sign * h * np.eye(n)[i]}) for sign in (1, -1)
            ]
            columns.append((moved[0][measured] - moved[1][measured]) / (2 * h))
        differences = np.stack(columns, axis=-1)
        jacobian = jacobians[f"{task.name}_jacobian"]
        # the potential has a kink in its curvature at the boundary: its derivative is continuous, to h·ν²
        np.testing.assert_allclose(jacobian, differences, atol=1e-4 if "potential" in measured else 1e-7)


def test_point_jacobians_are_derivatives_of_the_points(controller):
    if not controller.manifest.points:
        assert "point_jacobian" not in controller.jacobians.outputs
        return
    count, h, n = 200, 1e-5, len(controller.manifest.joints)
    values = states(controller, count)
    q = values["q"]
    own = {name: value for name, value in values.items() if name in controller.jacobians.inputs}
    jacobian = controller.jacobians.map(count, own)["point_jacobian"]
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


def test_random_states_step_to_finite_ones(controller):
    for outputs in (controller.step.map(20_000, states(controller, 20_000, seed=1)),):
        assert all(np.all(np.isfinite(values)) for values in outputs.values())


def test_every_task_kind_is_a_spec_of_its_file_s_name_and_ships_in_a_controller():
    used = {task.kind for path in SPECS.values() for task in read_spec(path).tasks}
    for name, kind in task_kinds().items():
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
