"""One origin of a URDF moves by 10 mm: everything that depends on it follows, and nothing else is touched."""

import csv
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from clikgen.runtime.controller import CompiledController

URDF = """<robot name="arm">
  <!-- three turning joints -->
  <link name="base_link"/>
  <link name="upper">
    <inertial><mass value="2.5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.4 0.1 0.1"/></geometry></visual>
  </link>
  <link name="fore"/>
  <link name="hand"/>
  <joint name="shoulder" type="revolute">
    <parent link="base_link"/><child link="upper"/><origin xyz="0 0 0.3"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="1.5" effort="7"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0" rpy="0.1 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="1.5" effort="7"/>
  </joint>
  <joint name="wrist" type="revolute">
    <parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" velocity="1.5" effort="7"/>
  </joint>
</robot>
"""
ELBOW = '<origin xyz="0.4 0 0" rpy="0.1 0 0"/>'
MOVED = '<origin xyz="0.41 0 0" rpy="0.1 0 0"/>'

SPEC = """name = "my_arm"
description = "three turning joints"
period = 0.01

[robot]
urdf = "arm.urdf"
frames = [{name = "tip", link = "hand", xyz = [0.25, 0, 0]}]

[[tasks]]
name = "hand"
kind = "frame_position"
frame = "tip"
gain = 4.0

[filter]
kind = "first_order"
cutoff = 5.0
"""
OTHER = SPEC.replace("my_arm", "other").replace(
    'urdf = "arm.urdf"\nframes = [{name = "tip", link = "hand", xyz = [0.25, 0, 0]}]',
    """joints = [
  {name = "x", type = "prismatic", link = "cart", axis = [1, 0, 0], lower = -1, upper = 1},
  {name = "turn", type = "continuous", link = "tip"},
]""",
)
SCENARIO = """name = "reach"
description = "the hand goes to a place and stays"
controller = "my_arm"
duration = 4.0
q0 = [0.0, 0.3, 0.6]

[references.hand]
kind = "fixed"
position = [0.7, 0.2, 0.1]
"""
TIP = np.array([0.25, 0.0, 0.0])
ROUNDING = 1e-13  # [m] of an arm of 1 m
CODE = {"my_arm/my_arm.c", "my_arm/my_arm_lanes.c"}
CONTROLLER = {*CODE, "my_arm/my_arm.h", "my_arm/manifest.json"}


@pytest.fixture
def project(tmp_path, run_clikgen) -> Path:
    """A folder of a user's own: a URDF, its spec and scenario, another spec, and both controllers generated."""
    for name, text in (("arm.urdf", URDF), ("my_arm.toml", SPEC), ("other.toml", OTHER), ("reach.toml", SCENARIO)):
        (tmp_path / name).write_text(text)
    outcome = run_clikgen("generate", "my_arm.toml", "other.toml", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    return tmp_path


def replace_in_urdf(project: Path, old: str, new: str) -> None:
    text = (project / "arm.urdf").read_text()
    assert old in text
    (project / "arm.urdf").write_text(text.replace(old, new, 1))


def state(folder: Path) -> dict[str, tuple[bytes, int]]:
    """File -> content and time of the last change."""
    return {
        path.relative_to(folder).as_posix(): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in folder.rglob("*")
        if path.is_file()
    }


def regenerated(run, project: Path) -> set[str]:
    """The files under generated/ that `clikgen generate` of both specs changed; all others are as they were."""
    before = state(project / "generated")
    outcome = run("generate", "my_arm.toml", "other.toml", cwd=project)
    assert outcome.returncode == 0, outcome.stderr
    after = state(project / "generated")
    assert after.keys() == before.keys()
    changed = {name for name in after if after[name] != before[name]}
    assert all(after[name][0] != before[name][0] for name in changed)  # none is written anew as it was
    wrote = {line.removeprefix("wrote generated/") for line in outcome.stderr.splitlines() if line.startswith("wrote")}
    assert wrote == changed
    return changed


def test_check_says_which_files_a_moved_origin_makes_stale_and_writes_nothing(run_clikgen, project):
    assert run_clikgen("generate", "my_arm.toml", "other.toml", "--check", cwd=project).returncode == 0
    replace_in_urdf(project, ELBOW, MOVED)
    before = state(project)
    stale = run_clikgen("generate", "my_arm.toml", "other.toml", "--check", cwd=project)
    assert stale.returncode == 1
    heads = {line.split()[1] for line in stale.stdout.splitlines() if line.startswith("--- ")}
    assert heads == {f"generated/{name}" for name in CONTROLLER - {"my_arm/my_arm.h"}}
    added = [line for line in stale.stdout.splitlines() if line.startswith("+")]
    assert any("0.41" in line for line in added)
    assert "stale: run 'clikgen generate'" in stale.stderr
    assert run_clikgen("generate", "other.toml", "--check", cwd=project).returncode == 0
    assert state(project) == before

    assert run_clikgen("generate", "my_arm.toml", cwd=project).returncode == 0
    assert run_clikgen("generate", "my_arm.toml", "other.toml", "--check", cwd=project).returncode == 0


def test_stale_controller_is_told_of_and_not_run_until_it_is_generated_again(run_clikgen, project):
    def states() -> dict[str, str]:
        listed = json.loads(run_clikgen("list", "--json", cwd=project).stdout)["controllers"]
        return {one["name"]: one["state"] for one in listed if one["name"] in ("my_arm", "other")}

    assert states() == {"my_arm": "fresh", "other": "fresh"}
    replace_in_urdf(project, ELBOW, MOVED)
    assert states() == {"my_arm": "stale", "other": "fresh"}
    refused = run_clikgen("simulate", "reach.toml", cwd=project)
    assert refused.returncode == 2
    assert refused.stderr.count("\n") == 1
    for piece in ("clikgen: error: ", "my_arm: stale", "my_arm.toml or its URDF changed; run 'clikgen generate"):
        assert piece in refused.stderr
    assert run_clikgen("generate", "my_arm.toml", cwd=project).returncode == 0
    assert states() == {"my_arm": "fresh", "other": "fresh"}


MATTERS = {  # what changes in the URDF -> old, new, the files that are written
    "origin": (ELBOW, MOVED, CONTROLLER - {"my_arm/my_arm.h"}),
    "rotation": ('rpy="0.1 0 0"', 'rpy="0.2 0 0"', CONTROLLER - {"my_arm/my_arm.h"}),
    "position limit": ('lower="-3"', 'lower="-2"', {"my_arm/manifest.json"}),  # no task asks for it
    "velocity limit": ('velocity="1.5"', 'velocity="2"', {"my_arm/manifest.json"}),
    "name of a joint": ('"shoulder"', '"waist"', CONTROLLER - CODE),  # in the header's comments
    "type of a joint": ('"wrist" type="revolute"', '"wrist" type="fixed"', CONTROLLER),
}


@pytest.mark.parametrize("what", MATTERS)
def test_generate_writes_what_depends_on_it_and_nothing_else(what, run_clikgen, project):
    old, new, expected = MATTERS[what]
    replace_in_urdf(project, old, new)
    assert regenerated(run_clikgen, project) == expected
    assert regenerated(run_clikgen, project) == set()
    manifest = json.loads((project / "generated" / "my_arm" / "manifest.json").read_text())
    assert len(manifest["joints"]) == (2 if what == "type of a joint" else 3)


DOES_NOT_MATTER = {
    "mass": ('<mass value="2.5"/>', '<mass value="9.5"/>'),
    "visual": ('<box size="0.4 0.1 0.1"/>', '<cylinder radius="0.1" length="1"/>'),
    "comment": ("<!-- three turning joints -->", "<!-- as measured on Monday -->"),
    "effort": ('effort="7"', 'effort="70"'),
    "layout": ('xyz="0.4 0 0"', 'xyz=" 4e-1  0.0   0 "'),
    "default": ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 2"/>'),  # a direction: its length says nothing
    "name of the robot": ('<robot name="arm">', '<robot name="other_arm">'),
}


@pytest.mark.parametrize("what", DOES_NOT_MATTER)
def test_what_does_not_move_a_joint_makes_nothing_stale(what, run_clikgen, project):
    replace_in_urdf(project, *DOES_NOT_MATTER[what])
    outcome = run_clikgen("generate", "my_arm.toml", "--check", cwd=project)
    assert outcome.returncode == 0
    assert outcome.stdout == ""
    assert regenerated(run_clikgen, project) == set()


def simulated(run, project: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """Case 1 of the scenario: the figures of --json, and the columns that --out writes."""
    command = ["simulate", "reach.toml", "--case", "1", "--json", "--out", "run"]
    outcome = run(*command, cwd=project, CLIKGEN_CACHE=str(project / "cache"))
    assert outcome.returncode == 0, outcome.stderr
    with (project / "run" / "case1.csv").open() as file:
        head, *rows = csv.reader(file)
    return json.loads(outcome.stdout), dict(zip(head, np.array(rows, dtype=float).T, strict=True))


def vectors(columns: dict[str, np.ndarray], name: str) -> np.ndarray:
    """The signal `name` over time, (steps, 3)."""
    return np.column_stack([columns[f"{name}_{i}"] for i in range(3)])


def tips(urdf: Path, q: np.ndarray) -> np.ndarray:
    """Where Pinocchio puts the tip at q (k, 3), (k, 3) [m]."""
    model = pin.buildModelFromUrdf(str(urdf))
    data, frame, places = model.createData(), model.getFrameId("hand"), []
    for one in q:
        pin.framesForwardKinematics(model, data, one)
        places.append(data.oMf[frame].act(TIP))
    return np.array(places)


def libraries(project: Path) -> int:
    """How many compiled controllers the cache of `simulated` holds."""
    return len(list((project / "cache").glob("my_arm-*.so")))


def test_simulation_follows_the_new_geometry(run_clikgen, project):
    figures, before = simulated(run_clikgen, project)
    assert libraries(project) == 1
    (project / "old.urdf").write_text(URDF)
    replace_in_urdf(project, ELBOW, MOVED)
    assert regenerated(run_clikgen, project)
    new_figures, after = simulated(run_clikgen, project)
    again, _ = simulated(run_clikgen, project)
    assert libraries(project) == 2  # compiled anew once

    q, new_q = vectors(before, "q"), vectors(after, "q")
    assert np.abs(vectors(before, "hand_position") - tips(project / "old.urdf", q)).max() < ROUNDING
    assert np.abs(vectors(after, "hand_position") - tips(project / "arm.urdf", new_q)).max() < ROUNDING
    assert np.abs(vectors(after, "hand_position") - tips(project / "old.urdf", new_q)).max() > 0.009
    for columns in (before, after):  # both arrive, with other joint positions
        assert np.abs(vectors(columns, "hand_position")[-1] - [0.7, 0.2, 0.1]).max() < 1e-6
    assert np.abs(new_q[-1] - q[-1]).max() > 0.01
    assert new_figures["spec_sha256"] != figures["spec_sha256"]
    assert new_figures["cases"] != figures["cases"]
    assert again == new_figures  # the difference is the geometry's


def test_kinematics_of_the_rebuilt_library_are_pinocchios(run_clikgen, project):
    q = np.random.default_rng(0).uniform(-3, 3, (1000, 3))
    folder = project / "generated" / "my_arm"
    for origin in (ELBOW, MOVED):
        replace_in_urdf(project, ELBOW, origin)
        run_clikgen("generate", "my_arm.toml", cwd=project)
        ours = CompiledController.load(folder).kinematics.map(len(q), {"q": q})["hand_position"]
        assert np.abs(ours - tips(project / "arm.urdf", q)).max() < ROUNDING


def test_pictures_change_with_the_geometry_and_only_with_it(run_clikgen, project):
    def pictures() -> tuple[bytes, bytes]:
        film = run_clikgen("view", "reach.toml", "--case", "1", "--set", "duration=0.3", "--save", "x.gif", cwd=project)
        assert film.returncode == 0, film.stderr
        drawing = run_clikgen("inspect", "my_arm.toml", "--out", "x.png", cwd=project)
        assert drawing.returncode == 0, drawing.stderr
        return (project / "x.gif").read_bytes(), (project / "x.png").read_bytes()

    film, drawing = pictures()
    assert pictures() == (film, drawing)
    replace_in_urdf(project, ELBOW, MOVED)
    run_clikgen("generate", "my_arm.toml", cwd=project)
    new_film, new_drawing = pictures()
    assert new_film != film
    assert new_drawing != drawing
