"""The chatter benchmark under the barrier: nothing oscillates, and its page holds what it measures."""

import importlib.util
import json
import sys
from pathlib import Path

import pytest

from clikgen.analysis.comparison import LAWS

FOLDER = Path(__file__).parents[1] / "benchmarks"
SENSED = {"noise of 2 mm", "delay of 50 ms"}  # intrusions there are those of the sensing
ROUNDING = 1e-5
"""[m, rad] what the curvature of a sample's way takes of a boundary that is approached with γ T <= 0.2."""


@pytest.fixture(scope="module")
def benchmark():
    spec = importlib.util.spec_from_file_location("chatter", FOLDER / "chatter.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["chatter"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def under_the_barrier(benchmark, tmp_path_factory):
    """Every trial under the barrier alone."""
    workshop = benchmark.Workshop(tmp_path_factory.mktemp("chatter"))
    return {trial.title: benchmark.tried(trial, workshop, (LAWS["barrier"],))["barrier"] for trial in benchmark.TRIALS}


def test_there_are_twenty_scenarios_with_sampling_times_from_half_a_millisecond_to_twenty(under_the_barrier):
    periods = [one.compared.rollout.period for one in under_the_barrier.values()]
    assert len(periods) == 20
    assert (min(periods), max(periods)) == (0.0005, 0.02)


def test_no_joint_oscillates(under_the_barrier):
    assert {title: one.oscillating for title, one in under_the_barrier.items() if one.oscillating} == {}


def test_every_row_can_be_kept_and_the_program_is_always_solved(under_the_barrier):
    for one in under_the_barrier.values():
        signals = one.compared.rollout.signals
        assert signals["barrier_row"].max() == -1
        assert signals["barrier_solved"].min() == 1
        assert signals["barrier_steps"].max() <= 3


def test_the_barrier_acts_in_every_scenario(under_the_barrier):
    assert [title for title, one in under_the_barrier.items() if not one.compared.rollout.active.any()] == []


def test_what_is_sensed_as_it_is_is_not_entered(under_the_barrier):
    entered = {
        title for title, one in under_the_barrier.items() if any(each.depth > ROUNDING for each in one.intrusions)
    }
    assert entered <= SENSED


def test_the_page_holds_what_is_measured(under_the_barrier):
    kept = json.loads((FOLDER / "chatter" / "results.json").read_text())
    assert list(kept) == list(under_the_barrier)
    for title, one in under_the_barrier.items():
        shown = kept[title]["barrier"]
        assert shown["oscillating"] == [each.joint for each in one.oscillating]
        deepest = max((each.depth for each in one.intrusions), default=0.0)
        assert shown["deepest_intrusion"] == pytest.approx(deepest, abs=1e-6)  # other compilers round otherwise


def test_the_switched_law_oscillates_on_the_papers_scenario(benchmark, tmp_path):
    result = benchmark.tried(benchmark.TRIALS[0], benchmark.Workshop(tmp_path), (LAWS["case1"],))["case1"]
    assert len(result.oscillating) == 5
