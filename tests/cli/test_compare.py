"""`clikgen compare`: laws beside each other on the command line."""

import json
import os
from pathlib import Path

import pytest

from clikgen.analysis.comparison import LAWS
from clikgen.runtime.scenario import find_scenario
from clikgen.symbolic.spec import shipped_specs

PLANAR5 = next(path for path in shipped_specs() if path.stem == "planar5")


def libraries():
    """Every compiled library of this test run with when it was written."""
    return {path.name: path.stat().st_mtime_ns for path in Path(os.environ["CLIKGEN_CACHE"]).glob("*.so")}


def test_table_has_a_row_per_law_and_the_intrusions_follow(run_clikgen):
    outcome = run_clikgen("compare", "paper")
    assert outcome.returncode == 0
    table, listed = outcome.stdout.split("intrusions")
    for law in LAWS:
        assert f"│ {law} " in table
    assert "8.48 mm" in listed
    assert "none under barrier" in listed


def test_document_is_that_of_simulate_by_law(run_clikgen):
    compared = json.loads(run_clikgen("compare", "paper", "--laws", "case1,case3", "--json").stdout)
    simulated = json.loads(run_clikgen("simulate", "paper", "--json").stdout)
    for key in ("scenario", "controller", "spec_sha256", "period", "steps", "f_h", "dead_band", "units"):
        assert compared[key] == simulated[key]
    for number in (1, 3):
        law, case = compared["laws"][f"case{number}"], simulated["cases"][str(number)]
        assert {name: law[name] for name in case if name != "title"} == {
            name: value for name, value in case.items() if name != "title"
        }


def test_second_time_compiles_nothing(run_clikgen):
    first = run_clikgen("compare", "paper", "--json")
    before = libraries()
    assert run_clikgen("compare", "paper", "--json").stdout == first.stdout
    assert libraries() == before


def test_setting_reaches_every_law_that_has_the_parameter(run_clikgen):
    laws = json.loads(run_clikgen("compare", "paper", "--set", "obstacles_gain=30", "--json").stdout)["laws"]
    assert {name for name, law in laws.items() if law["parameters"].get("obstacles_gain") == 30} == set(LAWS) - {
        "barrier"
    }
    laws = json.loads(run_clikgen("compare", "paper", "--set", "parameters.obstacles_width=0.02", "--json").stdout)[
        "laws"
    ]
    assert {name for name, law in laws.items() if "obstacles_width" in law["parameters"]} == {"hysteresis", "ramp"}
    assert {name for name, law in laws.items() if "obstacles_gain" in law["parameters"]} == {
        "case1",
        "case2",
        "case3",
        "smooth",
    }


def test_files_hold_figures_data_film_and_document(run_clikgen, tmp_path):
    arguments = ["compare", "paper", "--laws", "case1,barrier", "--set", "duration=2"]
    assert run_clikgen(*arguments, "--out", tmp_path / "new" / "folder", "--no-animation").returncode == 0
    names = {path.name for path in (tmp_path / "new" / "folder").iterdir()}
    wanted = {f"{name}.{ending}" for name in ("comparison", "contrast") for ending in ("png", "svg", "csv")}
    assert names == wanted | {"comparison.json"}
    document = json.loads((tmp_path / "new" / "folder" / "comparison.json").read_text())
    assert document == json.loads(run_clikgen(*arguments, "--json").stdout)


def test_film_is_written_unless_it_is_not_wanted(run_clikgen, tmp_path):
    outcome = run_clikgen("compare", "paper", "--laws", "barrier", "--set", "duration=0.1", "--out", tmp_path)
    assert outcome.returncode == 0
    assert "animation.gif" in outcome.stderr
    assert (tmp_path / "animation.gif").stat().st_size > 0


def test_controller_of_one_s_own_is_compared_by_the_spec_beside_it(run_clikgen, tmp_path):
    spec, scenario = tmp_path / "mine.toml", tmp_path / "run.toml"
    spec.write_text(PLANAR5.read_text().replace('name = "planar5"', 'name = "mine"', 1))
    scenario.write_text(find_scenario("paper").read_text().replace('controller = "planar5"', 'controller = "mine"', 1))
    assert run_clikgen("generate", "mine.toml", cwd=tmp_path).returncode == 0
    arguments = ["compare", "run.toml", "--laws", "case1,ramp", "--set", "duration=7", "--json"]
    outcome = run_clikgen(*arguments, cwd=tmp_path)
    assert json.loads(outcome.stdout)["controller"] == "mine"
    spec.unlink()
    outcome = run_clikgen(*arguments, cwd=tmp_path)
    assert outcome.returncode == 2
    assert "mine: wanted its spec" in outcome.stderr


def test_help_names_every_law(run_clikgen):
    said = "".join(run_clikgen("compare", "--help", COLUMNS="200").stdout.split())
    assert ",".join(LAWS) in said


MISTAKES = {
    "unknown law": (["paper", "--laws", "case1,barier"], ["no law 'barier'", "did you mean 'barrier'", "hysteresis"]),
    "no law": (["paper", "--laws", ""], ["no law ''", "barrier"]),
    "unknown scenario": (["papper"], ["papper", "did you mean 'paper'"]),
    "unknown parameter": (["paper", "--set", "tol_gain=1"], ["no parameter 'tol_gain'", "did you mean 'tool_gain'"]),
    "parameter of none of the laws": (
        ["paper", "--laws", "barrier", "--set", "obstacles_gain=1"],
        ["no parameter 'obstacles_gain' of barrier", "obstacles_rate"],
    ),
    "parameter out of its limits": (
        ["paper", "--laws", "ramp", "--set", "obstacles_width=-1"],
        ["obstacles_width", "-1"],
    ),
    "no one-sided task": (["stretch"], ["planar3", "one-sided", "obstacle_avoidance"]),
    "folder that cannot be made": (["paper", "--laws", "ramp", "--out", "/proc/clikgen"], ["/proc/clikgen"]),
    "too short to draw": (
        ["paper", "--laws", "ramp", "--set", "duration=0.02", "--out", "."],
        ["5 steps or more", "got 2"],
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_exit_code_2(mistake, run_clikgen, tmp_path):
    arguments, wanted = MISTAKES[mistake]
    outcome = run_clikgen("compare", *arguments, cwd=tmp_path)
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1, outcome.stderr
    assert outcome.stderr.startswith("clikgen: error: ")
    for piece in wanted:
        assert piece in outcome.stderr
