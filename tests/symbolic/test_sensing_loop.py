"""Sensing in a loop, for many points and obstacles, against the same unrolled: the same numbers, less code."""

import casadi as ca
import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.symbolic import obstacles
from clikgen.symbolic.controller import build
from clikgen.symbolic.generate import generate

POINTS, BALLS, CAPSULES, WALLS = 12, 5, 2, 1
COUNT = 3_000


@pytest.fixture(scope="module")
def spec(planar5_spec):
    """planar5 with two points where it has one, and room for eight obstacles: 96 pairs."""
    old = planar5_spec.robot.points_of_interest
    more = [point.model_copy(update={"name": f"{point.name}_b", "offset": (0.1, 0.02, 0.0)}) for point in old]
    robot = planar5_spec.robot.model_copy(update={"points_of_interest": (*old, *more)})
    capacity = obstacles.ObstacleCapacity(maximum=BALLS, capsules=CAPSULES, half_spaces=WALLS)
    return planar5_spec.model_copy(update={"robot": robot, "obstacles": capacity, "name": "many"})


@pytest.fixture(scope="module")
def both(spec, tmp_path_factory):
    """The controller generated with the loop, and unrolled."""
    folder = tmp_path_factory.mktemp("loop")
    loaded = {}
    for name, pairs in (("looped", 0), ("unrolled", 10**6)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(obstacles, "UNROLLED", pairs)
            files = generate(spec)
        (folder / name).mkdir()
        for file, text in files.items():
            (folder / name / file).write_text(text)
        loaded[name] = CompiledController.load(folder / name)
    return loaded


def states():
    rng = np.random.default_rng(0)
    return {
        "q": rng.uniform(-1.5, 1.5, (COUNT, 5)),
        "obstacle_center": rng.uniform(-1.5, 1.5, (COUNT, BALLS, 2)),
        "obstacle_radius": rng.uniform(0, 0.2, (COUNT, BALLS)),
        "obstacle_count": rng.integers(0, BALLS + 1, COUNT).astype(float),
        "capsule_start": rng.uniform(-1.5, 1.5, (COUNT, CAPSULES, 2)),
        "capsule_end": rng.uniform(-1.5, 1.5, (COUNT, CAPSULES, 2)),
        "capsule_radius": rng.uniform(0, 0.1, (COUNT, CAPSULES)),
        "capsule_count": rng.integers(0, CAPSULES + 1, COUNT).astype(float),
        "half_space_normal": np.broadcast_to([[0.6, 0.8]], (COUNT, WALLS, 2)),
        "half_space_offset": rng.uniform(-2, -0.5, (COUNT, WALLS)),
        "half_space_count": rng.integers(0, WALLS + 1, COUNT).astype(float),
        "tool_reference": rng.uniform(-1, 1, (COUNT, 2)),
    }


@pytest.mark.parametrize("function", ["step", "jacobians"])
def test_looped_and_unrolled_code_agree_bit_for_bit(both, function):
    outputs = []
    for controller in both.values():
        compiled = getattr(controller, function)
        outputs.append(compiled.map(COUNT, {name: v for name, v in states().items() if name in compiled.inputs}))
    touched = outputs[0]["active"] if function == "step" else np.abs(outputs[0]["obstacles_jacobian"]).sum(axis=1)
    assert np.count_nonzero(touched) > COUNT // 100
    for name, values in outputs[0].items():
        np.testing.assert_array_equal(values, outputs[1][name], err_msg=name)


def test_looped_code_equals_the_casadi_vm_bit_for_bit(both, spec, monkeypatch):
    monkeypatch.setattr(obstacles, "UNROLLED", 0)
    function = next(one for one in build(spec).functions if one.name == "step")
    step, values = both["looped"].step, states()
    compiled = step.map(COUNT, values)
    for k in range(0, COUNT, 300):
        inputs = [values[i.name][k] if i.name in values else np.reshape(i.default, i.shape) for i in step.info.inputs]
        results = function.casadi.call([ca.DM(np.ravel(value)) for value in inputs])
        for signal, result in zip(function.outputs, results, strict=True):
            np.testing.assert_array_equal(np.ravel(compiled[signal.info.name][k]), np.array(result)[:, 0])


def test_one_call_equals_many_and_stepping_equals_the_rollout(both):
    """Each call has a workspace of its own, which a loop needs."""
    controller = both["looped"]
    assert controller.step.info.sz_w > 0
    assert both["unrolled"].step.info.sz_w == 0
    scene = {name: value[0] for name, value in states().items()}
    rollout, stepwise = controller.rollout(50, scene), controller.rollout_stepwise(50, scene)
    for name, values in rollout.items():
        np.testing.assert_array_equal(values, stepwise[name])


def test_instructions_are_counted_as_carried_out(both):
    looped, unrolled = (both[name].step.info for name in ("looped", "unrolled"))
    assert looped.instructions > 0.9 * unrolled.instructions


def test_code_grows_with_obstacles_or_points_but_not_with_their_product(spec):
    """Four times the points: the search itself is there once."""

    def size(points, balls):
        old = spec.robot.points_of_interest[:6]
        more = [p.model_copy(update={"name": f"{p.name}_{i}"}) for i in range(points // 6) for p in old]
        robot = spec.robot.model_copy(update={"points_of_interest": tuple(more)})
        capacity = obstacles.ObstacleCapacity(maximum=balls)
        return len(generate(spec.model_copy(update={"robot": robot, "obstacles": capacity}))["many.c"])

    assert size(24, 40) - size(24, 20) < 1.2 * (size(12, 40) - size(12, 20))
