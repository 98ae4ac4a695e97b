"""`clikgen simulate`: the paper's study in figures, as JSON, as files, in real time."""

import csv
import json

import pytest

METRICS = [
    "switches",
    "switch_rate",
    "hf_rms",
    "reversal_rate",
    "max_velocity_step",
    "total_variation",
    "tracking_rms",
    "tracking_max",
    "final_error",
    "min_clearance",
    "min_distance",
]


@pytest.fixture
def paper(run_clikgen):
    outcome = run_clikgen("simulate", "paper", "--json")
    assert outcome.returncode == 0
    return json.loads(outcome.stdout)


def test_every_metric_of_every_case_is_reported(paper):
    assert list(paper["cases"]) == ["1", "2", "3"]
    for case in paper["cases"].values():
        assert all(isinstance(case[name], int | float) for name in METRICS)


def test_case_1_chatters_and_the_filter_takes_it_to_a_fifth(paper):
    one, two, three = (paper["cases"][number] for number in "123")
    assert paper["f_h"] == 5.0
    assert one["switches"] >= 100
    assert two["hf_rms"] <= one["hf_rms"] / 5
    assert two["tracking_rms"] > 2 * three["tracking_rms"] > 2 * one["tracking_rms"]


def test_obstacle_is_never_touched(paper):
    assert all(case["min_distance"] > 0 for case in paper["cases"].values())


def test_one_case_alone_is_the_same_case(run_clikgen, paper):
    alone = json.loads(run_clikgen("simulate", "paper", "--case", "3", "--json").stdout)
    assert alone["cases"] == {"3": paper["cases"]["3"]}


def test_setting_changes_the_run(run_clikgen, paper):
    slower = json.loads(
        run_clikgen("simulate", "paper", "--set", "obstacles_gain=50", "--set", "duration=10", "--json").stdout
    )
    assert slower["steps"] == 1000
    assert slower["cases"]["1"]["hf_rms"] != paper["cases"]["1"]["hf_rms"]


def test_files_hold_what_was_run(run_clikgen, paper, tmp_path):
    outcome = run_clikgen("simulate", "paper", "--out", tmp_path / "new" / "folder")
    assert outcome.returncode == 0
    assert json.loads((tmp_path / "new" / "folder" / "metrics.json").read_text()) == paper
    with (tmp_path / "new" / "folder" / "case1.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == paper["steps"]
    errors = [float(row["tool_error_0"]) ** 2 + float(row["tool_error_1"]) ** 2 for row in rows]
    assert (sum(errors) / len(errors)) ** 0.5 == pytest.approx(paper["cases"]["1"]["tracking_rms"], rel=1e-12)


def test_real_time_run_moves_as_the_simulation_and_tells_how_punctual_it_was(run_clikgen):
    arguments = ["simulate", "paper", "--case", "1", "--set", "duration=0.5", "--json"]
    simulated = json.loads(run_clikgen(*arguments).stdout)
    real = json.loads(run_clikgen(*arguments, "--realtime").stdout)
    assert real["cases"] == simulated["cases"]
    timing = real["realtime"]["1"]
    assert 0 <= timing["latency_us"]["p50"] <= timing["latency_us"]["p99"] <= timing["latency_us"]["max"]
    assert isinstance(timing["overruns"], int)


def test_a_run_that_diverges_says_when_and_is_measured_up_to_there(run_clikgen, recwarn):
    outcome = run_clikgen("simulate", "paper", "--set", "tool_gain=400", "--json")
    assert outcome.returncode == 0
    cases = json.loads(outcome.stdout)["cases"]
    # K T = 4 > 2: the error triples with every step, alternating, from under a millimetre to 1e6 m
    assert cases["1"]["diverged_s"] == cases["3"]["diverged_s"]
    assert 0.15 < cases["1"]["diverged_s"] < 0.5
    assert all(cases["1"][name] is not None for name in METRICS)
    assert cases["2"]["diverged_s"] is None  # with the filter β K T = 0.8
    assert "diverged at" in run_clikgen("simulate", "paper", "--set", "tool_gain=400").stdout
    assert not recwarn.list  # no overflow met on the way


def test_without_obstacles_clearance_is_none(run_clikgen):
    free = json.loads(run_clikgen("simulate", "paper", "--set", "obstacles=[]", "--json").stdout)
    for case in free["cases"].values():
        assert case["switches"] == 0
        assert case["min_clearance"] is case["min_distance"] is None


def test_doctor_finds_this_machine_fit(run_clikgen):
    outcome = run_clikgen("doctor", "--json")
    assert outcome.returncode == 0
    assert all(finding["works"] for finding in json.loads(outcome.stdout))


def test_doctor_says_what_to_do_without_a_compiler(run_clikgen, tmp_path):
    outcome = run_clikgen("doctor", "--json", PATH=str(tmp_path), CC="", CLIKGEN_CACHE=str(tmp_path))
    assert outcome.returncode == 1
    assert any("clikgen[zig]" in finding["advice"] for finding in json.loads(outcome.stdout))
