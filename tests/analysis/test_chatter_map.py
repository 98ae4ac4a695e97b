"""The chatter map against single rollouts, and against the edges of the normal map."""

import numpy as np
import pytest

from clikgen.analysis.chatter_map import EDGES, chatter_map, chatter_map_plate
from clikgen.analysis.discrete_filter import cutoff_of
from clikgen.analysis.metrics import metrics
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare

PERIOD = 0.01


@pytest.fixture(scope="module")
def paper():
    return read_scenario(find_scenario("paper"))


@pytest.fixture(scope="module")
def maps(paper):
    planar5 = CompiledController.load("planar5")
    return {number: chatter_map(planar5, paper, number, CASES[number]) for number in (2, 3)}


@pytest.mark.parametrize("number", [2, 3])
@pytest.mark.parametrize(("row", "column"), [(0, 59), (10, 20), (25, 55), (40, 30), (49, 59), (49, 0)])
def test_a_cell_is_the_rollout_with_its_gain_and_filter(number, row, column, maps, paper, planar5):
    one = maps[number]
    beta, strength = one.betas[row], one.gains[column]
    own = {"obstacles_gain": strength / PERIOD, "filter_cutoff": [cutoff_of(beta, PERIOD)] * 5}
    scenario = paper.model_copy(update={"parameters": {**paper.parameters, **own}})
    alone = metrics(prepare(planar5, scenario, CASES[number]).in_c())
    assert one.switching[row, column] == pytest.approx(alone.switch_rate * PERIOD, rel=1e-12)


@pytest.mark.parametrize("number", [2, 3])
def test_between_the_edges_contacts_switch_with_every_sample_and_below_seldom(number, maps):
    one = maps[number]
    between = one.switching[(one.filtered_gain > 2.2) & (one.filtered_gain < 3.8)]
    assert np.mean(between > 0.95) > 0.97
    below = one.switching[one.filtered_gain < 1.8]
    assert np.max(below) < 0.95
    assert np.median(below) < 0.4


def test_where_there_is_hardly_a_filter_the_cases_are_alike(maps):
    two, three = (maps[number].switching[-1] for number in (2, 3))
    calm = maps[2].filtered_gain[-1] < 3.8  # beyond, a run is as irregular as its last bits
    np.testing.assert_allclose(two[calm], three[calm], atol=0.05)


def test_the_scenario_stands_where_its_gain_and_filter_say(maps, paper):
    run = prepare(CompiledController.load("planar5"), paper, CASES[3])
    x = 2 * np.pi * PERIOD * float(run.values["filter_cutoff"][0])
    assert maps[3].own == pytest.approx((float(run.values["obstacles_gain"]) * PERIOD, x / (1 + x)))


def test_the_picture_has_a_panel_a_case_the_edges_and_all_numbers(maps):
    plate = chatter_map_plate(list(maps.values()))
    cells = maps[2].switching.size
    assert f"{2 * cells} compiled rollouts" in plate.caption
    assert [len(values) for values in plate.data.values()] == [cells] * 4
    np.testing.assert_array_equal(plate.data["switches per sample, case 3"], maps[3].switching.ravel())
    panels = [axes for axes in plate.figure.axes if axes.get_title().startswith("Case")]
    assert len(panels) == 2
    for axes in panels:
        for line, edge in zip(axes.lines, EDGES, strict=False):
            strength, beta = line.get_data()
            np.testing.assert_allclose(strength * beta, edge)
            assert (beta[0], strength[-1]) == pytest.approx((axes.get_ylim()[1], axes.get_xlim()[1]))


def test_a_run_that_diverges_is_not_counted(planar5, paper):
    far = paper.model_copy(update={"parameters": {**paper.parameters, "tool_gain": [[1e4, 0.0], [0.0, 1e4]]}})
    one = chatter_map(planar5, far, 2, CASES[2], np.array([1.0]), np.array([0.9]))
    assert np.isnan(one.switching).all()
    assert np.isnan(one.median(0, 2))


def test_a_map_wants_the_papers_switched_avoidance(paper):
    panda = CompiledController.load("panda7")
    scenario = read_scenario(find_scenario("shelf"))
    with pytest.raises(BadInput, match="wanted the activation 'switched'"):
        chatter_map(panda, scenario, 2, CASES[2])
