"""Sweeps: every row is a run of its own, and the same one whatever chunk, order or company it is run in."""

import itertools
import threading
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest, norm, qmc, truncnorm

from clikgen.analysis.metrics import metrics
from clikgen.analysis.sweep import bind, read_sweep
from clikgen.analysis.sweep_cluster import _packed, _unpacked
from clikgen.analysis.sweep_design import Drawn, Grid, ListedAxis, NormalAxis, RangeAxis, SweepFile
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, read_toml
from clikgen.runtime.scenario import CASES, Obstacle, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import shipped_folder

SHIPPED = Path(__file__).parents[2] / "benchmarks" / "sweeps"
ALL_METRICS = (
    "switches",
    "switch_rate",
    "reversal_rate",
    "hf_rms",
    "max_velocity_step",
    "total_variation",
    "tracking_rms",
    "tracking_max",
    "final_error",
    "min_clearance",
    "min_distance",
)
HEAD = f"""
scenario = "paper"
case = 3
metrics = {list(ALL_METRICS)}
chunk = 5
"""
RANDOM = '[design]\nkind = "random"\ncount = 12\nseed = 3\n'
GRID = '[design]\nkind = "grid"\n'


@pytest.fixture
def sweep_of(tmp_path):
    """The sweep that a text describes, on the controller that ships."""

    def sweep(text):
        (tmp_path / "sweep.toml").write_text(text)
        source = read_sweep(tmp_path / "sweep.toml")
        return bind(source, CompiledController.load(shipped_folder() / source.scenario.controller))

    return sweep


def axis(key, text):
    return f'[[axes]]\nkey = "{key}"\n{text}\n'


def whole(sweep):
    """All rows, in order."""
    return np.concatenate([table for _, table in sorted(sweep.tables(range(sweep.file.chunks)), key=itemgetter(0))])


def single(run):
    """The metrics of one run, as `clikgen simulate` has them."""
    measured = metrics(run.in_c()).as_dict()
    return {name: np.nan if value is None else value for name, value in measured.items()}


def expect_row(row, run):
    wanted = single(run)
    for name in set(row.dtype.names) & set(wanted):
        # the same trajectory bit for bit, of which sums are taken in another order: hf_rms, a difference, loses most
        np.testing.assert_allclose(row[name], wanted[name], rtol=1e-9, atol=1e-12, err_msg=name)


# ---- Rows are runs ----


def with_parameter(name, **settings):
    return lambda row, scenario: (scenario, {name: row[name], **settings})


def radii(row, scenario):
    own = [0.25, 0.25, 0.15, 0.15, 0.15, 0.15]
    own[4], own[5] = row["influence_radius[4]"], row["influence_radius[5]"]
    return scenario, {"influence_radius": own}


def obstacle(row, scenario):
    center = (row["obstacles[0].center[0]"], row["obstacles[0].center[1]"])
    obstacles = (Obstacle(center=tuple(map(float, center)), radius=float(row["obstacles[0].radius"])),)
    return scenario.model_copy(update={"obstacles": obstacles}), {}


def start(row, scenario):
    return scenario.model_copy(update={"q0": tuple(float(row[f"q[{i}]"]) for i in range(5))}), {}


def one_joint(row, scenario):
    q0 = list(scenario.q0)
    q0[4] = float(row["q[4]"])
    return scenario.model_copy(update={"q0": tuple(q0)}), {}


def diagonal(row, scenario):
    return scenario, {"tool_gain": [float(row["tool_gain[0]"]), float(row["tool_gain[1]"])]}


SWEPT = {
    "a number that stands for a matrix": (
        axis("tool_gain", 'range = [0.5, 20.0]\nscale = "log"'),
        with_parameter("tool_gain"),
    ),
    "diagonals from a list": (axis("tool_gain", "values = [[4.0, 1.0], [2.0, 8.0]]"), diagonal),
    "entries of a diagonal": (
        axis("tool_gain[0]", "range = [1.0, 8.0]") + axis("tool_gain[1]", "range = [1.0, 8.0]"),
        diagonal,
    ),
    "entries of a vector": (
        axis("influence_radius[4]", "range = [0.05, 0.3]") + axis("influence_radius[5]", "values = [0.1, 0.2]"),
        radii,
    ),
    "a number that fills a vector": (
        axis("filter_cutoff", "mean = 4.0\ndeviation = 2.0"),
        with_parameter("filter_cutoff"),
    ),
    "an obstacle": (
        axis("obstacles[0].center", "values = [[2.0, 0.3], [2.5, -0.1]]")
        + axis("obstacles[0].radius", "range = [0.0, 0.2]"),
        obstacle,
    ),
    "the start": (axis("q", "values = [[0, 0, 0, 0.5, -1], [0.1, 0, 0.2, 0.7, -1.3]]"), start),
    "the start of a joint": (axis("q[4]", "mean = -1.2\ndeviation = 0.2\nrange = [-2.0, 0.0]"), one_joint),
}


@pytest.mark.parametrize("swept", SWEPT)
def test_row_equals_a_single_run_with_its_settings(swept, sweep_of):
    axes, put = SWEPT[swept]
    sweep = sweep_of(HEAD + RANDOM + axes)
    table = whole(sweep)
    assert len(table) == 12
    assert len(np.unique(table["tracking_rms"])) > 1  # the axis does something
    for row in table[[0, 4, 11]]:
        scenario, parameters = put(row, sweep.scenario)
        given = {name: value if isinstance(value, list) else float(value) for name, value in parameters.items()}
        scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, **given}})
        expect_row(row, prepare(sweep.controller, scenario, CASES[3]))


def test_cases_are_an_axis_and_so_are_their_shares(sweep_of):
    sweep = sweep_of(HEAD.replace("case = 3", "") + GRID + '[[axes]]\nkey = "case"\nvalues = [1, 2, 3]')
    table = whole(sweep)
    assert table["case"].tolist() == [1, 2, 3]
    for row in table:
        expect_row(row, prepare(sweep.controller, sweep.scenario, CASES[row["case"]]))
    shares = sweep_of(HEAD + GRID + '[[axes]]\nkey = "lam_event"\nvalues = [0.0, 1.0]')
    case_1, case_3 = whole(shares)
    expect_row(case_1, prepare(sweep.controller, sweep.scenario, CASES[1]))
    expect_row(case_3, prepare(sweep.controller, sweep.scenario, CASES[3]))


def test_periods_have_steps_of_their_own_for_the_scenario_s_duration(sweep_of):
    axes = (
        '[[axes]]\nkey = "period"\nvalues = [0.01, 0.02, 0.005]\n[[axes]]\nkey = "obstacles_gain"\nvalues = [50, 250]'
    )
    sweep = sweep_of(HEAD + GRID + axes)
    for row in whole(sweep):
        given = {"period": float(row["period"]), "obstacles_gain": float(row["obstacles_gain"])}
        scenario = sweep.scenario.model_copy(update={"parameters": {**sweep.scenario.parameters, **given}})
        run = prepare(sweep.controller, scenario, CASES[3])
        assert run.steps == round(17.0 / row["period"])
        expect_row(row, run)


def test_periods_share_the_number_of_steps_that_is_asked_for(sweep_of):
    text = HEAD.replace("chunk", "steps = 300\nchunk") + GRID + '[[axes]]\nkey = "period"\nvalues = [0.01, 0.02]'
    sweep = sweep_of(text)
    for row in whole(sweep):
        parameters = {**sweep.scenario.parameters, "period": float(row["period"])}
        scenario = sweep.scenario.model_copy(update={"parameters": parameters, "duration": 300 * float(row["period"])})
        run = prepare(sweep.controller, scenario, CASES[3])
        assert run.steps == 300
        expect_row(row, run)


def test_settings_are_those_of_simulate(sweep_of):
    settings = "[settings]\nobstacles_gain = 50.0\nduration = 6.0\nmetrics.f_h = 8.0\n"
    sweep = sweep_of(HEAD + settings + GRID + '[[axes]]\nkey = "tool_gain"\nvalues = [4.0]')
    scenario = read_scenario(find_scenario("paper"), ["obstacles_gain=50", "duration=6.0", "metrics.f_h=8.0"])
    expect_row(whole(sweep)[0], prepare(sweep.controller, scenario, CASES[3]))


def test_obstacle_that_stands_still_is_swept_beside_one_that_moves(sweep_of, tmp_path):
    paper = find_scenario("paper").read_text()
    moving = '[[obstacles]]\npath = {kind = "line", start = [3.0, 1.0], end = [3.5, 0.0], duration = 8.0}\n\n[metrics]'
    (tmp_path / "moving.toml").write_text(paper.replace("[metrics]", moving))
    text = (
        HEAD.replace('"paper"', '"moving.toml"')
        + RANDOM
        + '[[axes]]\nkey = "obstacles[0].center[1]"\nrange = [-0.2, 0.2]'
    )
    sweep = sweep_of(text)
    for row in whole(sweep)[[0, 7]]:
        first, second = sweep.scenario.obstacles
        first = first.model_copy(update={"center": (2.5, float(row["obstacles[0].center[1]"]))})
        scenario = sweep.scenario.model_copy(update={"obstacles": (first, second)})
        expect_row(row, prepare(sweep.controller, scenario, CASES[3]))


ARM = """
name = "arm"
description = "the small arm stands still below a beam and above a table"
controller = "small_arm"
duration = 2.0
q0 = [0.0, -0.5, 1.0]

[references]
tip = {kind = "line", start = [0.7, 0.0, 0.6], end = [0.6, 0.2, 0.5], duration = 2.0}
wrist = {kind = "orientation", rpy = [0.0, 0.5, 0.0]}

[[capsules]]
start = [0.6, -0.5, 0.7]
end = [0.6, 0.5, 0.7]
radius = 0.03

[[half_spaces]]
normal = [0.0, 0.0, 1.0]
offset = 0.0
"""


def test_capsules_and_half_spaces_are_swept_too(small_arm, tmp_path):
    (tmp_path / "arm.toml").write_text(ARM)
    text = 'scenario = "arm.toml"\ncase = 3\nmetrics = ["min_clearance", "tracking_rms"]\n' + GRID
    text += axis("capsules[0].radius", "values = [0.03, 0.09]") + axis("capsules[0].end[2]", "values = [0.8, 0.7]")
    (tmp_path / "sweep.toml").write_text(text + axis("half_spaces[0].offset", "values = [0.0, 0.45]"))
    sweep = bind(read_sweep(tmp_path / "sweep.toml"), small_arm())
    rows = whole(sweep)
    assert len(set(rows["tracking_rms"])) == 8  # every axis does something
    for row in rows:
        beam, table = sweep.scenario.capsules[0], sweep.scenario.half_spaces[0]
        end = (*beam.end[:2], float(row["capsules[0].end[2]"]))
        changed = {
            "capsules": (beam.model_copy(update={"radius": float(row["capsules[0].radius"]), "end": end}),),
            "half_spaces": (table.model_copy(update={"offset": float(row["half_spaces[0].offset"])}),),
        }
        expect_row(row, prepare(sweep.controller, sweep.scenario.model_copy(update=changed), CASES[3]))


# ---- Any chunk, at any time ----


@pytest.mark.parametrize("kind", ["random", "latin_hypercube", "sobol"])
def test_row_is_the_same_in_any_chunk(kind, sweep_of):
    axes = '[[axes]]\nkey = "tool_gain"\nrange = [0.5, 20.0]\n[[axes]]\nkey = "obstacles_gain"\nrange = [1.0, 500.0]'
    text = HEAD.replace("chunk = 5", "chunk = 5\nsteps = 20")
    tables = []
    for chunk in (1, 5, 16, 64):
        design = f'[design]\nkind = "{kind}"\ncount = 33\nseed = 8\n'
        sweep = sweep_of(text.replace("chunk = 5", f"chunk = {chunk}") + design + axes)
        tables.append(whole(sweep))
    for table in tables[1:]:
        np.testing.assert_array_equal(table, tables[0])
    assert tables[0]["index"].tolist() == list(range(33))
    assert len(np.unique(tables[0]["tool_gain"])) == 33


def test_sweep_that_is_left_early_leaves_no_thread_behind(sweep_of):
    sweep = sweep_of(HEAD + RANDOM.replace("12", "5000") + axis("tool_gain", "range = [0.5, 20.0]"))
    before = threading.active_count()
    tables = sweep.tables(range(sweep.file.chunks), threads=3)
    next(tables)
    tables.close()
    assert threading.active_count() == before


def test_grid_is_every_combination_the_last_axis_fastest():
    axes = (
        ListedAxis(key="a", values=(3.0, 1.0)),
        RangeAxis(key="b", range=(1.0, 100.0), scale="log", count=3),
        RangeAxis(key="c", range=(0.0, 1.0), count=4),
    )
    wanted = list(itertools.product([3.0, 1.0], [1.0, 10.0, 100.0], np.linspace(0, 1, 4)))
    grid = Grid(kind="grid")
    assert grid.size(axes) == len(wanted) == 24
    got = np.column_stack(grid.rows(axes, 0, 24))
    np.testing.assert_allclose(got, wanted, rtol=1e-15)
    np.testing.assert_array_equal(np.column_stack(grid.rows(axes, 7, 9)), got[7:16])


def test_another_axis_leaves_random_draws_of_the_others_as_they_were():
    one, two = RangeAxis(key="a", range=(0.0, 1.0)), RangeAxis(key="b", range=(0.0, 1.0))
    design = Drawn(kind="random", count=100, seed=5)
    (alone,) = design.rows([one], 0, 100)
    first, second = design.rows([one, two], 0, 100)
    np.testing.assert_array_equal(first, alone)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.3
    assert not np.array_equal(Drawn(kind="random", count=100, seed=6).rows([one], 0, 100)[0], alone)


def test_latin_hypercube_has_a_row_in_every_layer_of_every_axis():
    axes = [RangeAxis(key=key, range=(0.0, 1.0)) for key in "abc"]
    for column in Drawn(kind="latin_hypercube", count=50, seed=1).rows(axes, 0, 50):
        assert sorted(np.floor(50 * column).clip(0, 49)) == list(range(50))


def test_sobol_is_that_of_scipy():
    axes = [RangeAxis(key=key, range=(0.0, 1.0)) for key in "abc"]
    got = np.column_stack(Drawn(kind="sobol", count=1024, seed=9).rows(axes, 0, 1024))
    np.testing.assert_array_equal(got, qmc.Sobol(3, rng=9).random_base2(10))


def test_distributions_are_what_they_are_called():
    count = 20_000
    axes = {
        RangeAxis(key="a", range=(2.0, 5.0)): lambda x: (x - 2) / 3,
        RangeAxis(key="b", range=(1e-3, 10.0), scale="log"): lambda x: np.log(x / 1e-3) / np.log(1e4),
        NormalAxis(key="c", mean=1.0, deviation=2.0): norm(1.0, 2.0).cdf,
        NormalAxis(key="d", mean=1.0, deviation=2.0, range=(0.0, 1.5)): truncnorm(-0.5, 0.25, 1.0, 2.0).cdf,
    }
    for values, cdf in zip(
        Drawn(kind="random", count=count, seed=0).rows(list(axes), 0, count), axes.values(), strict=True
    ):
        assert kstest(values, cdf).pvalue > 0.01
    (values,) = Drawn(kind="random", count=count).rows([ListedAxis(key="e", values=(1.0, 2.0, 3.0))], 0, count)
    np.testing.assert_allclose([np.mean(values == k) for k in (1, 2, 3)], 1 / 3, atol=0.02)  # 6 deviations


def test_ends_of_a_distribution_are_never_passed():
    u = np.array([0.0, 2.0**-60, 0.5, 1 - 2.0**-53, 1.0])
    for axis in (
        RangeAxis(key="a", range=(0.1, 0.3)),
        RangeAxis(key="a", range=(0.1, 0.3), scale="log"),
        NormalAxis(key="a", mean=0.0, deviation=1e-3, range=(0.1, 0.3)),
        ListedAxis(key="a", values=(0.1, 0.2, 0.3)),
    ):
        values = axis.pick(u)
        assert np.all((values >= 0.1) & (values <= 0.3))
        assert np.all(np.diff(values) >= 0)


# ---- What ships ----


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.toml")), ids=lambda path: path.stem)
def test_sweep_that_ships_is_sound_and_its_first_rows_run(path):
    source = read_sweep(path)
    sweep = bind(source, CompiledController.load(shipped_folder() / source.scenario.controller))
    small = replace(sweep, file=sweep.file.model_copy(update={"chunk": 4}))
    table = small.table(0)
    assert all(np.isfinite(table[name]).all() for name in sweep.file.metrics)


def test_million_is_a_million_of_a_thousand_steps():
    file = SweepFile.parse(read_toml(SHIPPED / "million.toml"), "million")
    assert (file.count, file.steps) == (1_000_000, 1000)


@pytest.mark.parametrize("change", [{"fma": "?"}, {"versions": {"clikgen": "0", "numpy": "0", "scipy": "0"}}])
def test_worker_that_would_give_other_numbers_refuses(change, sweep_of, tmp_path, monkeypatch):
    monkeypatch.setenv("CLIKGEN_CACHE", str(tmp_path))
    sweep = sweep_of(HEAD + RANDOM + axis("filter_cutoff", "range = [1.0, 20.0]"))
    source = read_sweep(tmp_path / "sweep.toml")
    assert _unpacked(_packed(source, sweep)).provenance == sweep.provenance
    with pytest.raises(BadInput, match=r"wanted (\?|0), as where the results are written, got "):
        _unpacked(_packed(source, replace(sweep, provenance={**sweep.provenance, **change})))
