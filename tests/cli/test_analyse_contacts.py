"""`clikgen analyse chatter` beyond the paper's task and perfect sensing: a barrier's margin, noise, delay, refusals."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from clikgen.analysis import barrier_study
from clikgen.symbolic.spec import shipped_specs

SPEC = next(path for path in shipped_specs() if path.stem == "planar5")


def columns(path):
    with path.open() as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def guarded(document, case):
    return {each["name"]: each for each in document["cases"][case]["guarded"]}


def test_clearances_of_a_barrier_are_held_against_its_margin(run_clikgen, tmp_path):
    outcome = run_clikgen("analyse", "chatter", "snake", "--out", tmp_path, "--json")
    assert outcome.returncode == 0, outcome.stderr
    found = json.loads(outcome.stdout)
    assert all(one["holds"] for one in found["cases"].values())
    joint_5 = guarded(found, "1")["joint_5"]
    assert joint_5["least_clearance"] < 0
    assert 0.5 < joint_5["used"] <= 1
    margin = joint_5["margin"]
    assert margin["total"] == pytest.approx(sum(value for name, value in margin.items() if name != "total"))
    assert margin["total"] < joint_5["margin_beforehand"]
    assert {path.stem for path in tmp_path.glob("*.svg")} == {"barrier_clearance", "barrier_margin_over_period"}
    clearance = columns(tmp_path / "barrier_clearance.csv")
    for name, h in clearance.items():
        if name.endswith(" h [m]"):
            assert np.all(h >= clearance[name.replace(" h [m]", " −m_k [m]")] - 1e-10)
    over = columns(tmp_path / "barrier_margin_over_period.csv")
    assert over["T [ms]"][1:] / over["T [ms]"][:-1] == pytest.approx(2)
    assert over["m [mm]"][1:] / over["m [mm]"][:-1] == pytest.approx(2, rel=0.02)


def test_table_and_verdict_say_what_the_margin_is_made_of(run_clikgen):
    outcome = run_clikgen(
        "analyse", "chatter", "snake", "--set", "sensing.noise=0.002", "--set", "duration=6.0", COLUMNS="160"
    )
    assert outcome.returncode == 0
    said = " ".join(outcome.stdout.split())
    for words in ("own path", "its position", "m before", "Case 1: kept; obstacles: joint_", "of its margin m_k"):
        assert words in said
    assert "VIOLATED" not in said


def test_violated_margin_is_exit_code_1(run_clikgen, monkeypatch):
    measured = barrier_study.kept

    def shrunk(run, rollout):
        found = measured(run, rollout)
        return tuple(replace(each, slack=each.slack - 1e-3) if each.name == "joint_9" else each for each in found)

    monkeypatch.setattr(barrier_study, "kept", shrunk)
    outcome = run_clikgen("analyse", "chatter", "snake", "--set", "duration=6.0")
    assert outcome.returncode == 1
    assert "Case 1: VIOLATED by obstacles: joint_9" in " ".join(outcome.stdout.split())


def test_walls_and_their_points_have_a_margin_too(run_clikgen):
    outcome = run_clikgen("analyse", "chatter", "inspection", "--json")
    assert outcome.returncode == 0, outcome.stderr
    found = json.loads(outcome.stdout)
    assert set(guarded(found, "1")) == {"elbow", "wrist", "tool"}
    assert guarded(found, "1")["tool"]["least_clearance"] == pytest.approx(0, abs=1e-6)  # held at the table


def test_joints_at_their_limits_are_in_the_table(run_clikgen):
    found = json.loads(run_clikgen("analyse", "chatter", "shelf", "--set", "duration=1.0", "--json").stdout)
    joint = guarded(found, "1")["joint4"]
    assert joint["margin"]["total"] == pytest.approx(0, abs=1e-10)
    assert joint["margin_beforehand"] is None


def test_noisy_encounters_of_the_paper_are_measured_but_not_predicted(run_clikgen):
    outcome = run_clikgen("analyse", "chatter", "paper", "--set", "sensing.noise=0.005", "--json")
    assert outcome.returncode == 0, outcome.stderr
    for case in json.loads(outcome.stdout)["cases"].values():
        assert case["encounters"]
        assert case["stretches"] == []
    said = run_clikgen("analyse", "chatter", "paper", "--set", "sensing.noise=0.005").stdout
    assert "the normal map knows no noise and no delay, so nothing is predicted" in " ".join(said.split())


def test_delay_of_what_does_not_move_changes_nothing(run_clikgen):
    late, now = (
        json.loads(run_clikgen("analyse", "chatter", "paper", "--set", f"sensing.delay={delay}", "--json").stdout)
        for delay in (0.05, 0.0)
    )
    assert [case["stretches"] for case in late["cases"].values()] == [
        case["stretches"] for case in now["cases"].values()
    ]
    assert any(case["stretches"] for case in now["cases"].values())


@pytest.fixture
def chatter_of(run_clikgen, tmp_path, monkeypatch):
    """Runs the paper's scenario on planar5 with another activation."""
    monkeypatch.chdir(tmp_path)

    def run(activation, *settings):
        text = SPEC.read_text().replace('name = "planar5"', f'name = "{activation}5"', 1)
        begin, end = text.index("[tasks.activation]"), text.index('[[tasks]]\nname = "tool"')
        own = f'[tasks.activation]\nkind = "{activation}"\n\n'
        (tmp_path / "spec.toml").write_text(text[:begin] + own + text[end:])
        assert run_clikgen("generate", "spec.toml").returncode == 0
        given = [f'controller="{activation}5"', "parameters={}", *settings]
        return run_clikgen("analyse", "chatter", "paper", *(part for one in given for part in ("--set", one)), "--json")

    return run


def test_barrier_without_velocity_limits_has_no_margin_beforehand(chatter_of):
    outcome = chatter_of("barrier")
    assert outcome.returncode == 0, outcome.stderr
    for each in guarded(json.loads(outcome.stdout), "1").values():
        assert each["margin_beforehand"] is None
        assert each["holds"]


def test_barrier_of_a_loop_that_diverges_is_one_line(chatter_of):
    outcome = chatter_of("barrier", "tool_gain=400")
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1
    assert "case 1 diverged at t = " in outcome.stderr


def test_other_activations_are_refused_in_one_line(chatter_of):
    outcome = chatter_of("ramp")
    assert outcome.returncode == 2
    assert outcome.stderr == (
        "clikgen: error: ramp5: task 'obstacles': wanted the activation 'switched', of which the normal map speaks, "
        "got 'ramp'\n"
    )


MISTAKES = {
    "nothing there": (["snake", "--set", "obstacles=[]"], "no obstacle, wall or limit to keep away from"),
    "bodies of the robot": (["carry"], "not covered: apart; the margin speaks of points of interest"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_the_margin_does_not_speak_of_is_one_line(mistake, run_clikgen):
    arguments, wanted = MISTAKES[mistake]
    outcome = run_clikgen("analyse", "chatter", *arguments)
    assert outcome.returncode == 2
    assert len(outcome.stderr.strip().splitlines()) == 1, outcome.stderr
    assert wanted in outcome.stderr
