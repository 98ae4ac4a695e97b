"""Led out of its reach and back: the arm stretches, stays within its velocity limits, moves smoothly, and recovers."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.references import Spline
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec, read_robot, read_spec, shipped_specs

SPECS = {path.stem: path for path in shipped_specs()}
ROBOTS = Path(SPECS["planar3"]).parent / "robots"
LAWS = ["nsb", "augmented"]
ARMS = {  # the frame, a bent start, and how far out of the arm's reach the target goes, as a share of its distance
    "ur6": ("tool0", [0.0, -1.8, -1.9, -1.0, 1.5708, 0.0], 2.0),
    "panda7": ("flange", [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785], 2.6),
}
VELOCITY = 1.5  # [rad/s]


@cache
def arm(name, law):
    """An arm whose tool follows a position, near its posture, with damping that acts near singularities."""
    frame, start, _ = ARMS[name]
    damping = {"maximum": 0.1, "near": 0.2}
    tool = {"name": "tool", "kind": "frame_position", "frame": frame, "gain": 10.0, "damping": damping, "speed": 0.5}
    table = {
        "name": f"{name}_{law}",
        "description": "an arm led out of its reach",
        "period": 0.005,
        "law": law,
        "robot": read_robot(ROBOTS / f"{name}.urdf").robot,
        "tasks": [tool, {"name": "posture", "kind": "posture", "posture": start, "gain": 1.0}],
        "velocity_limits": {"kind": "scale", "limit": VELOCITY},
        "filter": {"kind": "first_order", "cutoff": 10.0},
    }
    return ControllerSpec.parse(table, "the test")


@pytest.fixture
def compiled(tmp_path):
    """The controller of a spec, compiled."""

    def load(spec):
        folder = tmp_path / spec.name
        folder.mkdir()
        for file, text in generate(spec).items():
            (folder / file).write_text(text)
        return CompiledController.load(folder)

    return load


def led_out_and_back(controller, name, period):
    """The rollout of an arm after a target that leaves its reach and returns."""
    _, start, beyond = ARMS[name]
    here = controller.kinematics(q=np.array(start))["tool_position"].copy()
    shoulder = np.array([0.0, 0.0, 0.333 if name == "panda7" else 0.1625])
    out = shoulder + beyond * (here - shoulder)
    path = Spline(kind="spline", waypoints=(tuple(here), tuple(out), tuple(here)), times=(0.0, 4.0, 8.0))
    steps = round(10.0 / period)
    reference, velocity = path.sample(period * np.arange(steps))
    given = {"q": np.array(start), "period": np.array(period), "lam_free": np.array(0.0)}
    return controller.rollout(steps, given | {"tool_reference": reference, "tool_reference_velocity": velocity})


def largest_step(dq):
    return np.max(np.linalg.norm(np.diff(dq, axis=0), axis=1))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ARMS)
def test_an_arm_led_beyond_its_reach_stays_within_its_limits_moves_smoothly_and_recovers(name, law, compiled):
    controller = compiled(arm(name, law))
    coarse, fine = (led_out_and_back(controller, name, period) for period in (0.005, 0.0025))
    error = np.linalg.norm(coarse["tool_error"], axis=1)
    J = controller.jacobians.map(len(error), {"q": coarse["q"][:-1]})["tool_jacobian"]
    assert np.max(error) > 0.1  # it was out of reach
    assert np.min(np.linalg.svd(J, compute_uv=False)[:, -1]) < 0.1  # and the arm well stretched
    assert np.max(np.abs(coarse["dq"])) <= VELOCITY * (1 + 1e-12)
    # continuous: half the period, half the step of the velocity, but for what the discrete path differs
    assert largest_step(fine["dq"]) < 0.65 * largest_step(coarse["dq"])
    assert largest_step(coarse["dq"]) < 0.15  # [rad/s], that is 30 rad/s² at most
    assert error[-1] < 1e-6


@pytest.mark.parametrize("law", LAWS)
def test_planar3_stretches_and_comes_back(law, compiled):
    scenario = read_scenario(find_scenario("stretch"))
    spec = read_spec(SPECS["planar3"]).model_copy(update={"law": law, "name": f"planar3_{law}"})
    controller = compiled(spec)
    coarse, fine = (
        prepare(controller, scenario.model_copy(update={"parameters": {"period": period}}), CASES[1]).in_c()
        for period in (0.005, 0.0025)
    )
    reach = np.linalg.norm(coarse.position, axis=1)
    assert np.max(np.linalg.norm(coarse.reference, axis=1)) > 1.25  # the arm reaches 1.15 m
    assert 1.14 < np.max(reach) < 1.15
    assert np.max(np.abs(coarse.dq)) <= 2.0 * (1 + 1e-12)
    assert largest_step(fine.dq) < 0.65 * largest_step(coarse.dq)
    assert np.linalg.norm(coarse.error[-1]) < 1e-8


@pytest.mark.parametrize("law", LAWS)
def test_without_damping_the_stretched_arm_jumps(law, compiled):
    """So that the claims above can fail: the same arm with next to no damping and no limit of its feedback."""
    spec = arm("ur6", law)
    bare = spec.tasks[0].model_copy(update={"damping": 1e-6, "speed": None})
    spec = spec.model_copy(update={"tasks": (bare, spec.tasks[1]), "name": f"bare_{law}"})
    outputs = led_out_and_back(compiled(spec), "ur6", 0.005)
    assert largest_step(outputs["dq"]) > 1.0
