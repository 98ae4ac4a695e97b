"""One scenario under every law: what is compared, measured, listed and drawn."""

import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

from clikgen.analysis.comparison import (
    LAWS,
    ROUNDING,
    boundaries,
    chosen_laws,
    clearance,
    compare,
    comparison_document,
    comparison_table,
    deepest,
    intrusion_table,
    intrusions,
    parameters_of,
)
from clikgen.analysis.comparison_figures import comparison_plate, contrast_plate, drawable, save_comparison
from clikgen.analysis.comparison_film import animate, filmed
from clikgen.analysis.metrics import encounters, metrics
from clikgen.cli.compare import compiled_laws
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.variants import with_activation, with_planner

SPECS = {path.stem: read_spec(path) for path in shipped_specs()}
ONE_SIDED = [name for name, spec in SPECS.items() if any(isinstance(task, OneSidedSpec) for task in spec.tasks)]
KINDS = sorted({law.activation for law in LAWS.values()})


class Study:
    """A scenario under some laws."""

    def __init__(self, name, laws=None, settings=()):
        self.scenario = read_scenario(find_scenario(name), settings)
        self.own = CompiledController.load(self.scenario.controller)
        self.controllers = compiled_laws(chosen_laws(laws), self.scenario.controller)
        self.compared = self.run()

    def run(self, scenario=None, given=()):
        return compare(self.controllers, self.own.manifest, scenario or self.scenario, given)

    def __getitem__(self, law):
        return next(each for each in self.compared if each.law.name == law)


@pytest.fixture(scope="module")
def paper():
    return Study("paper")


@pytest.fixture(scope="module")
def inspection():
    return Study("inspection")


@pytest.fixture(scope="module")
def plate(paper):
    return comparison_plate(paper.compared)


# Variants of a spec.


def without_activations(spec):
    content = spec.model_dump(mode="json")
    for task in content["tasks"]:
        task.pop("activation", None)
    return content


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ONE_SIDED)
def test_another_activation_leaves_everything_else_as_it_is(name, kind):
    spec = SPECS[name]
    variant = with_activation(spec, kind)
    assert without_activations(variant) == without_activations(spec)
    for before, after in zip(spec.tasks, variant.tasks, strict=True):
        if not isinstance(before, OneSidedSpec) or before.activation.kind == kind:
            assert after == before
        else:
            assert after.activation == type(after.activation)(kind=kind)  # its defaults


def test_activation_that_is_there_already_changes_nothing():
    assert with_activation(SPECS["planar5"], "switched").sha256() == SPECS["planar5"].sha256()
    assert with_activation(SPECS["panda7"], "barrier").sha256() == SPECS["panda7"].sha256()


def test_spec_without_a_one_sided_task_and_unknown_kinds_are_refused():
    with pytest.raises(BadInput, match=r"planar3: wanted a one-sided task \(.*obstacle_avoidance.*\), got .*posture"):
        with_activation(SPECS["planar3"], "ramp")
    with pytest.raises(BadInput, match=r"no activation 'rampe'; did you mean 'ramp'"):
        with_activation(SPECS["planar5"], "rampe")
    with pytest.raises(BadInput, match=r"no planner 'smoth'; did you mean 'smooth'"):
        with_planner(SPECS["planar5"], "smoth")


def test_another_planner_keeps_both_shares_and_everything_else():
    spec = SPECS["planar5"]
    smooth = with_planner(spec, "smooth")
    assert (smooth.planner.lam_free, smooth.planner.lam_event) == (spec.planner.lam_free, spec.planner.lam_event)
    assert smooth.model_copy(update={"planner": spec.planner}) == spec
    assert with_planner(smooth, "smooth") == smooth


# What runs.


def test_every_law_runs_in_the_plane_and_in_space(paper, inspection):
    for study in (paper, inspection):
        assert [each.law.name for each in study.compared] == list(LAWS)
        for each in study.compared:
            assert each.rollout.diverged is None
            assert all(np.all(np.isfinite(values)) for values in each.rollout.signals.values())
            kinds = {task.activation for task in each.rollout.manifest.tasks if task.activation}
            assert kinds == {each.law.activation}


def test_cases_of_a_switched_controller_are_those_that_simulate_runs(paper):
    for number, case in CASES.items():
        simulated = prepare(paper.own, paper.scenario, case).in_c()
        assert np.array_equal(simulated.dq, paper[f"case{number}"].rollout.dq)


def test_barrier_of_a_barrier_controller_is_its_own_first_case(inspection):
    simulated = prepare(inspection.own, inspection.scenario, CASES[1]).in_c()
    assert np.array_equal(simulated.dq, inspection["barrier"].rollout.dq)


def test_only_the_cases_of_the_paper_chatter(paper):
    """On and off once an encounter is no chatter; total variation and intrusion say the same."""
    assert {each.law.name for each in paper.compared if each.chatters} == {"case1", "case2", "case3", "smooth"}
    one, barrier = metrics(paper["case1"].rollout), metrics(paper["barrier"].rollout)
    assert barrier.total_variation < one.total_variation / 50
    assert barrier.hf_rms < one.hf_rms / 50
    assert deepest(paper["barrier"].rollout) == 0 < deepest(paper["case1"].rollout)


def test_nobody_says_whether_a_wall_alone_is_chattered_at(inspection):
    """`active` speaks of obstacles, `barrier_steps` of barriers: the other laws are not called calm."""
    assert [each.chatters for each in inspection.compared] == [None] * 7 + [False]
    assert [each.switches for each in inspection.compared] == [""] * 7 + ["1 switch"]
    figure = contrast_plate(inspection["case1"], inspection["barrier"]).figure
    assert (figure.axes[0].get_title(), figure.axes[3].get_title()) == ("case1", "none")


def test_barrier_engages_though_no_region_is_met(paper):
    rollout = paper["barrier"].rollout
    assert not np.any(rollout.signals["active"] > 0)
    assert np.array_equal(rollout.active, rollout.signals["barrier_steps"] > 0)
    assert metrics(rollout).switches == 2 * len(encounters(rollout)) == 4


# Parameters.


def given_to(study, name):
    return {each.law.name for each in study.compared if name in each.rollout.scenario.parameters}


def test_parameters_of_an_activation_reach_its_own_laws_alone(paper):
    """K_o T = 2.5 is the paper's own chatter; the ramp's gain is another thing under the same name."""
    assert given_to(paper, "obstacles_gain") == {"case1", "case2", "case3", "smooth"}
    assert given_to(paper, "tool_gain") == set(LAWS)
    assert float(paper["case1"].rollout.parameters["obstacles_gain"]) == 250
    assert float(paper["ramp"].rollout.parameters["obstacles_gain"]) == 20


def test_given_parameters_reach_every_law_that_has_them(paper):
    scenario = paper.scenario.model_copy(update={"parameters": {"obstacles_gain": 30.0, "obstacles_width": 0.02}})
    for law, controller in paper.controllers.items():
        got = parameters_of(
            law, controller.manifest, paper.own.manifest, scenario.parameters, ["obstacles_gain", "obstacles_width"]
        )
        has = {signal.name for signal in controller.manifest.function("step").inputs}
        assert got == {name: value for name, value in scenario.parameters.items() if name in has}
        assert ("obstacles_gain" in got) == (law.name != "barrier")


def test_parameter_that_nobody_has_is_refused_and_one_of_the_own_controller_is_not(paper):
    barrier = {law: controller for law, controller in paper.controllers.items() if law.name == "barrier"}
    assert compare(barrier, paper.own.manifest, paper.scenario, ())
    with pytest.raises(BadInput, match=r"no parameter 'obstacles_gain' of barrier; .*obstacles_rate"):
        compare(barrier, paper.own.manifest, paper.scenario, ("obstacles_gain",))
    typo = paper.scenario.model_copy(update={"parameters": {"tol_gain": 1.0}})
    with pytest.raises(BadInput, match=r"no parameter 'tol_gain' of case1, .*; did you mean 'tool_gain'"):
        paper.run(typo)


# Tables and document.


def test_table_and_document_say_what_the_metrics_say(paper):
    _, heads, rows = comparison_table(paper.compared)
    names = [re.sub(r"\n\(.*", "", head, flags=re.DOTALL).replace("_\n", "_") for head in heads]
    document = comparison_document(paper.compared, paper.own.manifest)
    assert list(document["laws"]) == [row[0] for row in rows] == list(LAWS)
    assert document["spec_sha256"] == paper.own.manifest.spec_sha256
    for each, row in zip(paper.compared, rows, strict=True):
        cells, said = dict(zip(names, row, strict=True)), document["laws"][each.law.name]
        for name, value in metrics(each.rollout).as_dict().items():
            assert said[name] == value
            assert float(cells[name]) == pytest.approx(value, rel=1e-3)  # four digits
        assert said["parameters"] == each.rollout.scenario.parameters


def test_barrier_says_that_it_kept_every_row_and_the_others_say_nothing(paper):
    laws = comparison_document(paper.compared, paper.own.manifest)["laws"]
    kept = laws.pop("barrier")["barrier"]
    assert (kept["infeasible"], kept["unsolved"], kept["most_steps"]) == (0, 0, 1)
    assert kept["excess"] < ROUNDING
    assert all(said["barrier"] is None for said in laws.values())


def test_intrusions_are_where_the_clearance_is_negative(paper):
    listed = intrusions(paper.compared)
    for each in paper.compared:
        of_law = [one for one in listed if one.law == each.law.name]
        t, values = each.rollout.t, each.rollout.signals["clearance"]
        inside = t[values < -ROUNDING]
        assert all(any(one.start <= at <= one.end for one in of_law) for at in inside)
        ends = {end for one in of_law for end in (one.start, one.end, one.at)}
        assert ends <= set(inside)
        assert max((one.depth for one in of_law), default=0.0) == max(0.0, -values.min()) * (len(inside) > 0)
        assert deepest(each.rollout) == pytest.approx(max((one.depth for one in of_law), default=0.0))


def test_every_intrusion_is_listed_with_its_law_its_point_and_its_depth(paper):
    title, _, rows = intrusion_table(paper.compared)
    assert len(rows) == len(intrusions(paper.compared))
    assert ["case1", "tool", "8.48 mm", "6.89 s", "5.99 to 7.81 s"] in rows
    assert title.endswith("none under barrier")


def test_walls_are_kept_off_too(inspection):
    """No obstacle there: what is near, and what intrudes, are a wall and the points that keep off it."""
    ramp = inspection["ramp"].rollout
    manifest = ramp.manifest
    walls = next(task for task in manifest.tasks if task.activation)
    distance, margin = ramp.signals[f"{walls.name}_distance"], ramp.parameters[f"{walls.name}_margin"]
    assert len(list(boundaries(ramp))) == distance[0].size
    np.testing.assert_array_equal(clearance(ramp), (distance - margin[:, None]).min(axis=(1, 2)))
    listed = [one for one in intrusions(inspection.compared) if one.law == "ramp"]
    assert {one.point for one in listed} == {f"{walls.name}[0, 2]"}
    assert not [one for one in intrusions(inspection.compared) if one.law == "barrier"]


# Pictures.


def texts_in_sight(figure):
    """Whether all that is written lies on the page."""
    FigureCanvasAgg(figure).draw()
    page, inch = figure.bbox, figure.dpi
    box = figure.get_tightbbox()
    return box.x0 * inch >= 0 and box.y0 * inch >= 0 and box.x1 * inch <= page.x1 and box.y1 * inch <= page.y1


def test_figure_has_a_row_per_law_and_labels_units_and_a_legend(plate):
    figure = plate.figure
    assert [axes.get_title("left") for axes in figure.axes[::4]] == [law.title for law in LAWS.values()]
    assert all(re.search(r"\[.+\]", axes.get_ylabel()) for axes in figure.axes)
    assert [axes.get_xlabel() for axes in figure.axes[-4:]] == ["$x$ [m]", "$t$ [s]", "$t$ [s]", "$t$ [s]"]
    legend = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"commanded path", "traced path", "boundary, $d = s$", "intrusion", "velocity of base x"} <= legend
    assert texts_in_sight(figure)


def test_laws_share_their_axes_and_the_boundary_is_in_sight(paper, plate):
    figure = plate.figure
    for column in range(4):
        assert len({axes.get_ylim() for axes in figure.axes[column::4]}) == 1
    low, high = figure.axes[1].get_ylim()
    assert low < -1e3 * max(deepest(each.rollout) for each in paper.compared) < 0 < high


def test_figure_in_space_is_seen_where_the_path_is_widest_and_shows_the_walls_clearance(inspection):
    figure = comparison_plate(inspection.compared[-2:]).figure
    assert (figure.axes[-4].get_xlabel(), figure.axes[-4].get_ylabel()) == ("$y$ [m]", "$z$ [m]")
    assert "no intrusion" in [axes.get_title("right") for axes in figure.axes]
    assert texts_in_sight(figure)


def test_two_laws_side_by_side_are_told_apart_in_a_word(paper):
    figure = contrast_plate(paper["case1"], paper["barrier"]).figure
    left, right = figure.axes[:3], figure.axes[3:]
    assert (left[0].get_title(), right[0].get_title()) == ("chatter", "none")
    assert [(axes.get_xlim(), axes.get_ylim()) for axes in left] == [
        (axes.get_xlim(), axes.get_ylim()) for axes in right
    ]
    facts = [text.get_text() for text in figure.axes[0].texts]
    assert any("284 switches" in fact and "total variation 374" in fact and "8.5 mm" in fact for fact in facts)
    assert texts_in_sight(figure)


def test_data_of_the_figure_are_those_of_the_rollouts(paper, plate):
    data = plate.data
    ramp = paper["ramp"].rollout
    np.testing.assert_array_equal(data["ramp: base_x velocity [m/s]"], ramp.dq[:, 0])
    np.testing.assert_array_equal(data["ramp: clearance [m]"], ramp.signals["clearance"])


def test_film_shows_a_few_laws_from_the_first_to_the_last(paper, inspection, tmp_path):
    assert [each.law.name for each in filmed(paper.compared, 4)] == ["case1", "case3", "ramp", "barrier"]
    assert [each.law.name for each in filmed(paper.compared[:2], 4)] == ["case1", "case2"]
    for study in (paper, inspection):
        film = tmp_path / f"{study.scenario.name}.gif"
        animate(study.compared, film, frames=3)
        with Image.open(film) as image:
            assert image.n_frames == 3


def test_law_that_diverges_is_measured_but_not_drawn(paper, tmp_path):
    """K T = 4 > 2 diverges without the filter; with it β K T = 0.8."""
    scenario = paper.scenario.model_copy(update={"parameters": {**paper.scenario.parameters, "tool_gain": 400.0}})
    compared = [each for each in paper.run(scenario) if each.law.name in ("case1", "case2")]
    assert [each.law.name for each in drawable(compared)] == ["case2"]
    _, heads, rows = comparison_table(compared)
    assert "diverged_\nat\n(s)" in heads
    assert len(rows) == 2
    assert {path.name for path in save_comparison(compared, tmp_path, film=False)} == {
        f"comparison.{ending}" for ending in ("png", "svg", "csv")
    }
    with pytest.raises(BadInput, match="case1: all diverged"):
        drawable(compared[:1])


def test_run_of_a_few_steps_is_refused(paper):
    short = [
        replace(each, rollout=replace(each.rollout, t=each.rollout.t[:3], signals={"q": each.rollout.q[:4]}))
        for each in paper.compared[:1]
    ]
    with pytest.raises(BadInput, match="5 steps or more to draw, got 3"):
        drawable(short)
