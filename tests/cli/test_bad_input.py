"""Every kind of bad input: one clear line on stderr that names the place, exit code 2, no traceback."""

from pathlib import Path

import pytest

from clikgen.runtime.scenario import find_scenario
from clikgen.symbolic.spec import shipped_specs

SPEC = next(path for path in shipped_specs() if path.stem == "planar5")
SCENARIO = find_scenario("paper")


def edited(source: Path, target: Path, old: str, new: str) -> Path:
    """A copy of a shipped file with one piece of text replaced; the piece has to be there."""
    text = source.read_text()
    assert old in text
    target.write_text(text.replace(old, new, 1))
    return target


def complaint(run, *arguments: object, **environment: str) -> str:
    """The one line that `clikgen ARGUMENTS` complains with."""
    outcome = run(*arguments, **environment)
    assert outcome.returncode == 2, outcome.stderr + outcome.stdout
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("clikgen: error: ")
    return lines[0]


SPEC_MISTAKES = {
    "unknown key": ('law = "nsb"', 'lawx = "nsb"', ["lawx", "did you mean 'law'"]),
    "unknown key in a table": ("upper = 10.0", "uper = 10.0", ["robot.joints.0", "uper", "upper"]),
    "missing key": ("lower = -10.0           # [m]\n", "", ["robot.joints.0", "'base_x'", "lower and upper"]),
    "misspelt task kind": ('kind = "frame_position"', 'kind = "frame_postion"', ["tasks.1", "frame_position"]),
    "misspelt law": ('law = "nsb"', 'law = "nbs"', ["no law 'nbs'", "nsb"]),
    "misspelt filter": ('kind = "first_order"', 'kind = "second_order"', ["filter", "first_order"]),
    "unknown frame": ('frame = "tool"', 'frame = "tol"', ["no frame 'tol'", "tool"]),
    "unknown link": ('name = "tool"\nlink = "forearm"', 'name = "tool"\nlink = "forarm"', ["forarm", "forearm"]),
    "negative radius": ("influence_radius = 0.25", "influence_radius = -0.25", ["points_of_interest.0", "-0.25"]),
    "not a number": ("gain = 250.0", 'gain = "250"', ["gain", "'250'"]),
    "not finite": ("gain = 250.0", "gain = inf", ["gain", "finite"]),
    "not a unit axis": ("axis = [1, 0, 0]", "axis = [1, 1, 0]", ["unit vector"]),
    "wrong length": ("xyz = [0.20, 0, 0]", "xyz = [0.20, 0]", ["robot.joints.3.xyz"]),
    "gain matrix of the wrong size": ("gain = 4.0", "gain = [1.0, 2.0, 3.0]", ["tool_gain", "(2, 2)", "(3,)"]),
    "gain matrix not positive definite": (
        "gain = 4.0",
        "gain = [[1.0, 2.0], [2.0, 1.0]]",
        ["tool_gain", "symmetric positive definite"],
    ),
    "gain matrix not symmetric": ("gain = 4.0", "gain = [[4.0, 1.0], [0.0, 4.0]]", ["tool_gain", "symmetric"]),
    "limits reversed": ("lower = -2.8", "lower = 28.0", ["lower <= upper"]),
    "leaves the plane": ("axis = [0, 0, 1]", "axis = [0, 1, 0]", ["base_yaw", "plane"]),
    "two of a name": ('name = "base_y"', 'name = "base_x"', ["joint 'base_x' is there twice"]),
    "no room for obstacles": ("maximum = 3", "maximum = 0", ["[obstacles] maximum"]),
    "period out of range": ("period = 0.01", "period = 0.0", ["period", "0.0"]),
    "share out of range": ("lam_event = 1.0", "lam_event = 1.5", ["planner.lam_event", "1.5"]),
    "name that C cannot hold": ('name = "planar5"', 'name = "planar-5"', ["name", "planar-5"]),
    "unreadable TOML": ("[robot]", "[robot", ["not valid TOML", "line"]),
}


@pytest.mark.parametrize("mistake", SPEC_MISTAKES)
def test_mistake_in_a_spec_is_one_line_that_names_file_and_key(mistake, run_clikgen, tmp_path):
    old, new, wanted = SPEC_MISTAKES[mistake]
    spec = edited(SPEC, tmp_path / "robot.toml", old, new)
    line = complaint(run_clikgen, "generate", spec, "--out", tmp_path / "out")
    for piece in ["robot.toml", *wanted]:
        assert piece in line
    assert not (tmp_path / "out").exists()


SCENARIO_MISTAKES = {
    "unknown key": ("duration = 17.0", "durations = 17.0", ["durations", "did you mean 'duration'"]),
    "unknown controller": ('controller = "planar5"', 'controller = "planar55"', ["planar55", "planar5"]),
    "start of the wrong length": ("q0 = [0.0, 0.0, 0.0, 0.6, -1.2]", "q0 = [0.0, 0.0]", ["q0", "5", "got 2"]),
    "unknown parameter": ("tool_gain = 4.0", "tol_gain = 4.0", ["tol_gain", "did you mean 'tool_gain'"]),
    "negative obstacle": ("radius = 0.1", "radius = -0.1", ["obstacles.0.radius", "-0.1"]),
    "obstacle in space": ("center = [2.5, 0.0]", "center = [2.5, 0.0, 0.0]", ["obstacles.0", "2 coordinates"]),
    "obstacle nowhere": ("center = [2.5, 0.0]", "", ["obstacles.0", "'center' or 'path'"]),
    "unknown trajectory": ('kind = "spline"', 'kind = "spiral"', ["references.tool", "spiral"]),
    "times that go back": ("times = [0.0, 3.5,", "times = [0.0, 30.5,", ["times that start at 0 and increase"]),
    "reference for no task": ("[references.tool]", "[references.tools]", ["no reference 'tools'", "tool"]),
    "frequency above Nyquist": ("f_h = 5.0", "f_h = 80.0", ["f_h", "Nyquist", "50"]),
    "cutoff out of limits": ("filter_cutoff = 4.0", "filter_cutoff = -4.0", ["filter_cutoff", "-4.0"]),
}


@pytest.mark.parametrize("mistake", SCENARIO_MISTAKES)
def test_mistake_in_a_scenario_is_one_line_that_names_the_key(mistake, run_clikgen, tmp_path):
    old, new, wanted = SCENARIO_MISTAKES[mistake]
    scenario = edited(SCENARIO, tmp_path / "mine.toml", old, new)
    line = complaint(run_clikgen, "simulate", scenario)
    for piece in wanted:
        assert piece in line


COMMAND_MISTAKES = {
    "no such command": (["simulat", "paper"], ["simulat"]),
    "no such option": (["simulate", "paper", "--jsn"], ["--jsn"]),
    "no such case": (["simulate", "paper", "--case", "4"], ["--case", "1, 2, 3", "got 4"]),
    "no such scenario": (["simulate", "papper"], ["papper", "did you mean 'paper'"]),
    "missing file": (["simulate", "nowhere.toml"], ["nowhere.toml", "No such file"]),
    "missing spec": (["generate", "nowhere.toml"], ["nowhere.toml", "No such file"]),
    "setting without a value": (["simulate", "paper", "--set", "tool_gain"], ["tool_gain", "KEY=VALUE"]),
    "setting of an unknown key": (["simulate", "paper", "--set", "gain=1"], ["no parameter 'gain'"]),
    "setting that is not TOML": (["simulate", "paper", "--set", "tool_gain=four"], ["four", "not valid TOML"]),
    "gain not positive definite": (
        ["simulate", "paper", "--set", "tool_gain=[[1,2],[2,1]]"],
        ["tool_gain", "positive definite"],
    ),
    "negative gain": (["simulate", "paper", "--set", "tool_gain=-1"], ["tool_gain", "positive definite"]),
    "not finite": (["simulate", "paper", "--set", "period=nan"], ["period", "finite"]),
    "endless": (["simulate", "paper", "--set", "duration=1e9"], ["duration", "periods"]),
}


@pytest.mark.parametrize("mistake", COMMAND_MISTAKES)
def test_mistake_on_the_command_line_is_one_line(mistake, run_clikgen):
    arguments, wanted = COMMAND_MISTAKES[mistake]
    line = complaint(run_clikgen, *arguments)
    for piece in wanted:
        assert piece in line


def test_generated_code_that_was_edited_is_refused(run_clikgen, generated_copy):
    source = generated_copy / "planar5" / "planar5.c"
    source.write_text(source.read_text().replace("sqrt", "cbrt"))
    line = complaint(run_clikgen, "simulate", "paper", cwd=generated_copy.parent)
    assert "planar5.c" in line
    assert "clikgen generate" in line


def test_damaged_manifest_is_refused(run_clikgen, generated_copy):
    (generated_copy / "planar5" / "manifest.json").write_text("{")
    line = complaint(run_clikgen, "simulate", "paper", cwd=generated_copy.parent)
    assert "manifest.json" in line
    assert "not valid JSON" in line


def test_no_compiler_is_one_line_that_says_what_to_install(run_clikgen, tmp_path):
    line = complaint(run_clikgen, "simulate", "paper", PATH=str(tmp_path), CC="", CLIKGEN_CACHE=str(tmp_path / "cache"))
    assert "no C compiler" in line
    assert "clikgen[zig]" in line


def test_compiler_that_is_not_there_is_named(run_clikgen):
    assert "nonesuch-cc" in complaint(run_clikgen, "simulate", "paper", CC="nonesuch-cc")


def test_compiler_that_fails_is_one_line(run_clikgen, tmp_path):
    failing = tmp_path / "cc"
    failing.write_text("#!/bin/sh\necho 'fatal error: no licence' >&2\nexit 1\n")
    failing.chmod(0o755)
    line = complaint(run_clikgen, "simulate", "paper", CC=str(failing), CLIKGEN_CACHE=str(tmp_path / "cache"))
    assert "no licence" in line


def test_output_that_cannot_be_written_is_one_line(run_clikgen, tmp_path):
    # a file where the folder should be: refused for everyone, root included
    (tmp_path / "taken").write_text("mine")
    for arguments in (["simulate", "paper"], ["generate", SPEC], ["demo"]):
        assert "taken" in complaint(run_clikgen, *arguments, "--out", tmp_path / "taken")
    assert (tmp_path / "taken").read_text() == "mine"


@pytest.mark.parametrize("arguments", [["simulate", "paper"], ["generate", str(SPEC)], ["demo"]])
def test_folder_that_refuses_to_be_written_is_one_line(arguments, run_clikgen):
    # nobody, root included, makes a folder there
    assert "/proc/clikgen" in complaint(run_clikgen, *arguments, "--out", "/proc/clikgen")
