"""Batches: the numbers of single rollouts, whatever the company, the threads and the vectors; and clear refusals."""

import itertools
import os
import signal
import threading
import time
import tracemalloc
from dataclasses import fields, replace

import cffi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.signal import find_peaks

from clikgen.analysis import metrics as single
from clikgen.runtime import batch as batch_module
from clikgen.runtime import compiler as compiler_module
from clikgen.runtime.batch import METRICS, simulate_batch, simulate_batch_of
from clikgen.runtime.compiler import NATIVE, Compiler, compile_library, library_path
from clikgen.runtime.controller import CompiledController, CompiledFunction
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import FAR
from clikgen.runtime.scenario import CASES, MetricSettings, find_scenario, read_scenario
from clikgen.runtime.simulation import Rollout, prepare

EVERYTHING = (*METRICS, "final_q")
WHOLE = ("switches", "switch_rate", "reversal_rate", "tracking_max", "final_error", "min_clearance", "min_distance")
CONSTANT = {"q": np.array([0.0, 0.0, 0.0, 0.6, -1.2]), "tool_reference": np.array([1.5, 0.3])}


# ---- The same controllers, called in other ways ----


def _one_by_one(controller):
    """The controller without its step of many robots at once."""
    return replace(controller, manifest=controller.manifest.model_copy(update={"lanes": None}))


def _with_lanes(controller, folder, text, lanes=16):
    """The controller whose step of many robots at once is this C."""
    name = controller.manifest.controller
    (folder / f"{name}_lanes.c").write_text(
        f"enum {{ LANES = {lanes} }};\nvoid {name}_step_lanes(const double *const *arg, double *const *res);\n"
        f"{text.replace('STEP_LANES', f'{name}_step_lanes')}"
    )
    return replace(controller, folder=folder, manifest=controller.manifest.model_copy(update={"lanes": lanes}))


SIDE_BY_SIDE = """
#include "SOURCE"
void STEP_LANES(const double *const *arg, double *const *res) {
  static const int sizes[] = {SIZES};
  double own[INPUTS + OUTPUTS][ROOM];
  const double *one_arg[SZ_ARG];
  double *one_res[SZ_RES], w[SZ_W + 1];
  long long iw[SZ_IW + 1];
  for (int lane = 0; lane < LANES; ++lane) {
    for (int s = 0; s < INPUTS; ++s) {
      for (int e = 0; e < sizes[s]; ++e) own[s][e] = arg[s][e * LANES + lane];
      one_arg[s] = own[s];
    }
    for (int s = 0; s < OUTPUTS; ++s) one_res[s] = own[INPUTS + s];
    STEP(one_arg, one_res, iw, w, 0);
    for (int s = 0; s < OUTPUTS; ++s)
      for (int e = 0; e < sizes[INPUTS + s]; ++e) res[s][e * LANES + lane] = own[INPUTS + s][e];
  }
}
"""


def _side_by_side(controller, folder, lanes=16):
    """The controller whose step of many robots at once calls its step of one for each."""
    info, name = controller.step.info, controller.manifest.controller
    sizes = [signal.size for signal in (*info.inputs, *info.outputs)]
    for file in (f"{name}.c", f"{name}.h"):
        (folder / file).write_text((controller.folder / file).read_text())
    text = SIDE_BY_SIDE
    for word, value in {
        "SOURCE": str(folder / f"{name}.c"),
        "SIZES": ", ".join(map(str, sizes)),
        "INPUTS": len(info.inputs),
        "OUTPUTS": len(info.outputs),
        "ROOM": max(sizes),
        "SZ_ARG": info.sz_arg,
        "SZ_RES": info.sz_res,
        "SZ_IW": info.sz_iw,
        "SZ_W": info.sz_w,
        "STEP(": f"{info.symbol}(",
    }.items():
        text = text.replace(word, str(value))
    return _with_lanes(controller, folder, text, lanes)


# q stands still; dq, errors, distances and the active flag are what planar5 is told as reference, obstacles and shares
MIRROR = """
void STEP_LANES(const double *const *arg, double *const *res) {
  for (int i = 0; i < LANES; ++i) {
    for (int e = 0; e < 5; ++e) {
      res[0][e * LANES + i] = arg[0][e * LANES + i];
      res[1][e * LANES + i] = e < 2 ? arg[3][e * LANES + i] : 0.0;
    }
    for (int e = 0; e < 2; ++e) res[5][e * LANES + i] = arg[4][e * LANES + i];
    res[7][i] = arg[13][i];
    for (int e = 0; e < 6; ++e) res[8][e * LANES + i] = arg[7][e * LANES + i];
    res[9][i] = arg[7][i];
  }
}
"""


@pytest.fixture(scope="session")
def mirror(planar5_folder, tmp_path_factory):
    """A controller that gives out what it is told."""
    return _with_lanes(CompiledController.load(planar5_folder), tmp_path_factory.mktemp("mirror"), MIRROR)


def _mirrored(controller, period, f_h, dead_band, dq, error, active, distance):
    """The rollout of the mirror, as a single one is judged."""
    N = len(dq)
    signals = {
        "q": np.zeros((N + 1, 5)),
        "dq": np.hstack([dq, np.zeros((N, 3))]),
        "tool_error": error,
        "active": active,
        "distance": distance,
        "clearance": distance[:, 0],
    }
    scenario = read_scenario(find_scenario("paper")).model_copy(
        update={"metrics": MetricSettings(f_h=f_h, dead_band=dead_band)}
    )
    return Rollout(
        scenario=scenario,
        case=CASES[1],
        manifest=controller.manifest,
        period=period,
        t=period * np.arange(N, dtype=float),
        signals=signals,
        tracked="tool",
        parameters={},
        reference=np.zeros((N, 2)),
        reference_velocity=np.zeros((N, 2)),
        obstacle_center=np.zeros((N, 0, 2)),
        obstacle_radius=np.zeros(0),
    )


def _expect_single(batch, i, rollout):
    """Row i of a batch is what a single rollout measures."""
    with np.errstate(all="ignore"):  # one that diverges may overflow on its way
        expected = single.metrics(rollout).as_dict()
        speed = single.rms(rollout.before_divergence().dq)
    for name, value in expected.items():
        got = batch[name][i]
        value = np.nan if value is None else value
        if name in WHOLE:
            # the same operations in the same order: at most the root of a sum of squares is rounded otherwise
            np.testing.assert_allclose(got, value, rtol=1e-15, err_msg=name)
        elif name == "hf_rms" and np.isfinite(value):
            # the difference of two energies: 1e-14 of the whole, a few rounding errors
            assert abs(got**2 - value**2) <= 1e-12 * value**2 + 1e-14 * speed**2, (name, got, value)
        else:
            np.testing.assert_allclose(got, value, rtol=1e-12, err_msg=name)  # sums of thousands, in another order
    diverged = batch["diverged_at"][i]
    assert diverged == (np.inf if rollout.diverged is None else rollout.diverged)
    np.testing.assert_array_equal(batch["final_q"][i], rollout.q[-1])


def _expect_equal_bits(first, second):
    assert first.keys() == second.keys()
    for name, array in first.items():
        np.testing.assert_array_equal(array, second[name], err_msg=name)  # bits: 0.0 and -0.0 alone are not told apart


@pytest.fixture(scope="session")
def paper(planar5_folder):
    """The paper's scenario, by the number of the case, on a planar5 that steps one robot after the other."""
    controller = _one_by_one(CompiledController.load(planar5_folder))
    scenario = read_scenario(find_scenario("paper"))
    return lambda number, **changes: prepare(controller, scenario.model_copy(update=changes), CASES[number])


@pytest.fixture(scope="session")
def many(paper):
    """Values of 37 rollouts of the paper's scenario that all differ: starts, gains, obstacles and references."""
    rng = np.random.default_rng(3)
    run, count = paper(3, duration=6.0), 37
    gain = 1.0 + 4.0 * rng.random(count)
    return run, {
        "q": run.values["q"] + 0.01 * rng.standard_normal((count, 5)),
        "tool_gain": gain[:, None, None] * np.eye(2),
        "obstacles_gain": rng.uniform(50, 300, count),
        "filter_cutoff": rng.uniform(1, 10, (count, 5)),
        "lam_event": rng.random(count),
        "obstacle_center": rng.uniform(-0.2, 0.2, (count, 1, 3, 2)) + run.values["obstacle_center"],
        "obstacle_radius": rng.uniform(0, 0.2, (count, 3)),
        "tool_reference": rng.uniform(-0.1, 0.1, (count, 1, 2)) + run.values["tool_reference"],
    }


def _alone(run, each, i):
    """Rollout i of many, by itself."""
    own = {name: values[i] for name, values in each.items()}
    return replace(run, values={**run.values, **own}, period=float(own.get("period", run.period))).in_c()


# ---- The numbers of single rollouts ----


@pytest.mark.parametrize("number", CASES)
def test_a_batch_of_the_papers_scenario_has_the_metrics_of_its_rollouts(number, paper):
    run = paper(number)
    starts = run.values["q"] + 0.01 * np.random.default_rng(number).standard_normal((3, 5))
    batch = simulate_batch_of(run, {"q": starts}, EVERYTHING)
    for i in range(3):
        _expect_single(batch, i, _alone(run, {"q": starts}, i))
    assert np.all(batch["switches"] > 0)


@pytest.mark.parametrize(
    ("name", "duration", "acts"), [("snake", 6.0, True), ("stretch", 12.0, False), ("inspection", 3.0, False)]
)
def test_other_controllers_and_laws_have_the_metrics_of_their_rollouts(name, duration, acts):
    """A barrier on moving obstacles, an arm without obstacles, and a barrier against walls."""
    scenario = read_scenario(find_scenario(name)).model_copy(update={"duration": duration})
    run = prepare(_one_by_one(CompiledController.load(scenario.controller)), scenario, CASES[3])
    starts = run.values["q"] + 1e-3 * np.random.default_rng(5).standard_normal((3, run.values["q"].size))
    batch = simulate_batch_of(run, {"q": starts}, EVERYTHING)
    for i in range(3):
        _expect_single(batch, i, _alone(run, {"q": starts}, i))
    assert np.all((batch["switches"] > 0) == acts)
    assert np.all(np.isnan(batch["min_distance"]) == ("distance" not in run.in_c().signals))


def test_values_of_a_rollout_act_on_it_alone(many):
    run, each = many
    batch = simulate_batch_of(run, each, EVERYTHING)
    for i in range(0, 37, 3):
        _expect_single(batch, i, _alone(run, each, i))
    other = {name: values.copy() for name, values in each.items()}
    for values in other.values():
        values[20] *= 0.9
    changed = simulate_batch_of(run, other, EVERYTHING)
    for name, values in batch.items():
        same = np.all(np.reshape(values == changed[name], (37, -1)) | np.isnan(values.reshape(37, -1)), axis=1)
        assert same[np.arange(37) != 20].all(), name
    assert not np.array_equal(batch["final_q"][20], changed["final_q"][20])


def test_shared_values_over_time_equal_their_repetition_for_each(many):
    run, each = many
    own = each | {"tool_reference_velocity": np.broadcast_to(run.values["tool_reference_velocity"], (37, run.steps, 2))}
    assert np.ptp(run.values["tool_reference_velocity"]) > 0
    _expect_equal_bits(simulate_batch_of(run, own, EVERYTHING), simulate_batch_of(run, each, EVERYTHING))


def test_rollouts_may_have_their_own_periods(many):
    run, each = many
    count = 6
    own = {name: values[:count] for name, values in each.items()}
    own["period"] = np.array([0.01, 0.007, 0.01, 0.0031, 0.0123, 0.02])  # segments of 200, 286, 645, 163 and 100 steps
    batch = simulate_batch_of(run, own, EVERYTHING)
    for i in range(count):
        _expect_single(batch, i, _alone(run, own, i))


def test_inputs_not_named_have_their_defaults(planar5):
    controller = _one_by_one(planar5)
    batch = simulate_batch(controller, 50, 2, {"q": CONSTANT["q"]}, {}, ("final_q",))
    rollout = controller.rollout(50, {"q": CONSTANT["q"]})
    np.testing.assert_array_equal(batch["final_q"], [rollout["q"][-1]] * 2)


def test_a_diverged_rollout_counts_up_to_there(planar5):
    """Gains far above 2/T = 200/s from some step on: lost within the first segment, after it, at once, or never."""
    run = prepare(_one_by_one(planar5), read_scenario(find_scenario("paper")), CASES[1])
    gain = np.array([4.0, 300.0, 300.0, 400.0, 300.0, 600.0, 5e3, 1e200, 4.0, 4.0, 4.0])
    onset = np.array([0, 600, 1000, 139, 0, 0, 0, 0, 0, 0, 0])
    high = np.arange(run.steps) >= onset[:, None]  # (11, steps)
    over_time = np.where(high, gain[:, None], 4.0)[:, :, None, None] * np.eye(2)
    starts = np.tile(run.values["q"], (gain.size, 1))
    starts[-3:, 0] = [2e6, 0.999e6, np.nan]
    each = {"q": starts, "tool_gain": over_time}
    progress = []
    batch = simulate_batch_of(run, each, EVERYTHING, progress=lambda done, of: progress.append((done, of)))
    for i in range(gain.size - 1):
        _expect_single(batch, i, _alone(run, each, i))
    assert progress[-1] == (gain.size, gain.size)
    steps = np.round(batch["diverged_at"] / run.period)
    assert np.isinf(steps[0])
    assert {0.0} < set(steps[steps < 10])  # some at once
    assert np.any((steps > 10) & (steps < 200))  # within the first segment
    assert np.any((steps > 200) & (steps < run.steps))
    assert steps[-1] == 0  # a start that is not a number
    assert np.isnan(batch["tracking_rms"][-1])
    _expect_equal_bits(
        {name: batch[name] for name in METRICS},
        simulate_batch_of(run, each, METRICS),  # which need not go on once all have diverged
    )


# ---- Every metric on signals of any kind ----


def _mirror_batch(mirror, period, f_h, dead_band, dq, error=None, active=None, distance=None):
    count, N = dq.shape[:2]
    each = {
        "tool_reference": dq,
        "tool_reference_velocity": np.zeros((count, N, 2)) if error is None else error,
        "lam_event": np.zeros((count, N)) if active is None else active,
        "obstacle_center": np.full((count, N, 3, 2), FAR) if distance is None else distance.reshape(count, N, 3, 2),
    }
    settings = MetricSettings(f_h=f_h, dead_band=dead_band)
    return simulate_batch(mirror, N, count, {"period": period}, each, EVERYTHING, settings, threads=1)


@pytest.mark.parametrize("period", [0.01, 0.009, 0.3, 0.0021])  # segments of 200, 222, 8 and 952 samples
@pytest.mark.parametrize("N", [2, 3, 7, 199, 200, 201, 299, 300, 301, 450])
def test_metrics_of_random_signals_equal_those_of_a_single_rollout(N, period, mirror):
    """Segments with an even and an odd number of samples, one or several of them, whole or cut short."""
    rng = np.random.default_rng(N)
    f_h, dead_band = 0.45 / period * rng.random() ** 2, 0.5
    dq = np.cumsum(rng.standard_normal((3, N, 2)), axis=1) + 10 * rng.random((3, 1, 2))
    error, distance = rng.standard_normal((3, N, 2)), rng.standard_normal((3, N, 6))
    active = (rng.random((3, N)) < np.array([[0.03], [0.5], [0.0]])).astype(float)
    batch = _mirror_batch(mirror, period, f_h, dead_band, dq, error, active, distance)
    for i in range(3):
        one = _mirrored(mirror, period, f_h, dead_band, dq[i], error[i], active[i], distance[i])
        _expect_single(batch, i, one)


def test_gaps_just_up_to_the_limit_join_encounters(mirror):
    period, N = 0.1, 60
    active = np.zeros((4, N))
    for i, gap in enumerate([4, 5, 6, 7]):  # steps between two contacts; 0.5 s is not above the limit
        active[i, [10, 10 + gap]] = 1.0
    batch = _mirror_batch(mirror, period, 1.0, 0.0, np.zeros((4, N, 2)), active=active)
    np.testing.assert_array_equal(batch["switches"], 4)
    np.testing.assert_allclose(batch["switch_rate"], [4 / 0.5, 4 / 0.6, 4 / 0.2, 4 / 0.2], rtol=1e-15)


def test_a_calm_signal_on_a_fast_one_of_the_same_size_is_measured_to_rounding(mirror):
    """hf_rms is a difference of energies: of a sine of 1 it keeps what lies 1e-5 below, and more is not promised."""
    period, N = 0.001, 8000
    t = period * np.arange(N)
    dq = np.zeros((1, N, 2))
    dq[0, :, 0] = np.sin(2 * np.pi * 0.5 * t) + 1e-5 * np.sin(2 * np.pi * 40.0 * t)
    batch = _mirror_batch(mirror, period, 20.0, 0.0, dq)
    assert batch["hf_rms"][0] == pytest.approx(1e-5 / np.sqrt(2), rel=1e-3)


walks = st.lists(st.integers(-3, 3), min_size=2, max_size=60)


@hypothesis_settings(max_examples=150)
@given(steps=st.lists(walks, min_size=1, max_size=16), band=st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 5.0]))
def test_reversals_of_quantised_walks_are_the_peaks_by_their_prominence(steps, band, mirror):
    """With plateaus, equal peaks, and peaks that only just stand out."""
    N = max(map(len, steps))
    walk = np.zeros((len(steps), N, 2))
    for i, one in enumerate(steps):
        walk[i, : len(one), 0] = np.cumsum(one)
        walk[i, len(one) :, 0] = walk[i, len(one) - 1, 0]
    walk[:, :, 1] = np.clip(walk[:, :, 0], -2, 2)
    got = _mirror_batch(mirror, 1.0, 0.1, band, walk)["reversal_rate"] * N
    np.testing.assert_array_equal(np.round(got), [_peaks(one, band) for one in walk])


@pytest.mark.parametrize("band", [0.0, 0.3, 1.0, 4.0])
def test_reversals_of_random_walks_are_the_peaks_by_their_prominence(band, mirror):
    rng = np.random.default_rng(8)
    walk = np.cumsum(rng.standard_normal((40, 500, 2)), axis=1)
    got = _mirror_batch(mirror, 1.0, 0.1, band, walk)["reversal_rate"] * 500
    expected = [_peaks(one, band) for one in walk]
    np.testing.assert_array_equal(np.round(got), expected)
    assert min(expected) > 0


def _peaks(signal, band):
    return sum(find_peaks(side * one, prominence=max(band, 1e-12))[0].size for one in signal.T for side in (1, -1))


def test_the_definitions_are_those_of_single_rollouts():
    assert (*(field.name for field in fields(single.Metrics)), "diverged_at") == METRICS


# ---- Whatever the company, the threads and the vectors ----


@pytest.mark.parametrize("lanes", [16, 8])
@pytest.mark.parametrize("name", ["planar5", "planar10"])
def test_robots_side_by_side_have_the_bits_of_robots_one_by_one(name, lanes, tmp_path):
    scenario = read_scenario(find_scenario({"planar5": "paper", "planar10": "snake"}[name]))
    controller = CompiledController.load(name)
    run = prepare(_one_by_one(controller), scenario.model_copy(update={"duration": 4.0}), CASES[3])
    starts = run.values["q"] + 0.01 * np.random.default_rng(6).standard_normal((19, run.values["q"].size))
    expected = simulate_batch_of(run, {"q": starts}, EVERYTHING)
    run = replace(run, controller=_side_by_side(controller, tmp_path, lanes))
    _expect_equal_bits(simulate_batch_of(run, {"q": starts}, EVERYTHING), expected)


def _shortened(run, each, steps):
    """The same for fewer steps."""
    cut = {name: values[:steps] if values.shape[:1] == (run.steps,) else values for name, values in run.values.items()}
    own = {name: values[:, :steps] if values.shape[1:2] == (run.steps,) else values for name, values in each.items()}
    return replace(run, steps=steps, values=cut), own


def test_what_is_generated_for_many_robots_at_once_has_the_bits_of_the_step_of_one(planar5, many):
    run, each = many
    one_by_one = simulate_batch_of(run, each, EVERYTHING)
    _expect_equal_bits(simulate_batch_of(replace(run, controller=planar5), each, EVERYTHING), one_by_one)


@pytest.mark.parametrize("count", [1, 15, 16, 17, 32])
def test_the_last_block_need_not_be_full(count, many):
    run, each = many
    whole = simulate_batch_of(run, each, EVERYTHING)
    part = simulate_batch_of(run, {name: values[:count] for name, values in each.items()}, EVERYTHING)
    _expect_equal_bits(part, {name: values[:count] for name, values in whole.items()})


@pytest.mark.parametrize("threads", [2, 3, 40])
@pytest.mark.parametrize("work", [1, 10_000_000, 10**12])
def test_any_number_of_threads_and_any_chunks_give_the_same_bits(threads, work, many, monkeypatch):
    run, each = _shortened(*many, 300)
    expected = simulate_batch_of(run, each, EVERYTHING, threads=1)
    monkeypatch.setattr(batch_module, "WORK", work)
    _expect_equal_bits(simulate_batch_of(run, each, EVERYTHING, threads=threads), expected)


TWICE = "-DCLIKGEN_FMA=0"  # rounds a product, and then its sum


@pytest.mark.parametrize("rounding", [(), (TWICE,)], ids=["as this processor rounds", "without FMA"])
def test_vectors_of_any_width_give_the_same_bits(rounding, planar5, many, monkeypatch):
    run, each = many
    run = replace(run, controller=planar5)  # with the step of many robots at once, where it ships
    monkeypatch.setattr(batch_module, "NATIVE", (*NATIVE, *rounding))
    expected = simulate_batch_of(run, each, EVERYTHING)
    for flags in [("-O0", "-march=native"), ("-O1", "-march=native"), *([("-O0",), ("-O3",)] if rounding else [])]:
        monkeypatch.setattr(batch_module, "NATIVE", (*flags, *rounding))
        _expect_equal_bits(simulate_batch_of(run, each, EVERYTHING), expected)


def test_a_metric_is_the_same_whatever_else_is_measured(many):
    run, each = many
    everything = simulate_batch_of(run, each, EVERYTHING)
    for name in EVERYTHING:
        _expect_equal_bits(simulate_batch_of(run, each, (name,)), {name: everything[name]})


def test_a_batch_changes_none_of_its_inputs(many):
    run, each = many
    given = {f"shared {name}": values for name, values in run.values.items()} | each
    before = {name: values.copy() for name, values in given.items()}
    simulate_batch_of(run, each, EVERYTHING)
    _expect_equal_bits(given, before)


# ---- Progress, interruption, memory ----


def test_progress_is_told_in_this_thread_and_reaches_the_end(many, monkeypatch):
    run, each = many
    monkeypatch.setattr(batch_module, "WORK", 1)
    told = []
    simulate_batch_of(
        run,
        each,
        ("final_q",),
        threads=2,
        progress=lambda done, of: told.append((done, of, threading.current_thread())),
    )
    assert len(told) == 3  # blocks of 16, 16 and 5
    assert [of for _, of, _ in told] == [37] * 3
    assert told[-1][0] == 37
    assert all(first[0] < second[0] for first, second in itertools.pairwise(told))
    assert {thread for *_, thread in told} == {threading.current_thread()}


def _threads_of_batches():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("clikgen-batch")]


def _expect_no_thread_to_stay():
    """One that was being started when the keys were pressed is not waited for, but it ends of itself."""
    for _ in range(1000):
        if not _threads_of_batches():
            return
        time.sleep(0.01)
    raise AssertionError(_threads_of_batches())


def test_an_interruption_in_the_progress_leaves_no_thread_running(planar5):
    seen = []

    def interrupt(done, of):
        seen.append(_threads_of_batches())
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate_batch(planar5, 20_000, 640, CONSTANT, {}, ("final_q",), threads=2, progress=interrupt)
    assert len(seen) == 1
    assert seen[0]  # there were some
    _expect_no_thread_to_stay()


@pytest.fixture
def control_c():
    """Raises KeyboardInterrupt, also where the tests run in the background and SIGINT is ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("control_c")
@pytest.mark.parametrize("side_by_side", [True, False])
def test_control_c_stops_a_long_batch_while_c_runs(side_by_side, planar5):
    """It would take minutes. That the other thread gets to press the keys shows that C does not hold it up."""
    controller = planar5 if side_by_side else _one_by_one(planar5)

    def press():
        while not _threads_of_batches():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    presser = threading.Thread(target=press)
    presser.start()
    with pytest.raises(KeyboardInterrupt):
        simulate_batch(controller, 10_000_000, 1600, CONSTANT, {}, ("final_q",), threads=2)
    presser.join()
    _expect_no_thread_to_stay()


def test_memory_does_not_grow_with_the_number_of_steps(planar5):
    def peak(steps):
        tracemalloc.start()
        simulate_batch(planar5, steps, 64, CONSTANT, {}, EVERYTHING, threads=1)
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(400)  # what is made once
    assert peak(20_000) < peak(400) + 16_384  # of which a trajectory of dq alone would have 50 million bytes


# ---- Refusals ----


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"steps": 0}, ["1 or more", "3 of 0"]),
        ({"count": 0}, ["1 or more", "0 of 20"]),
        ({"threads": 0}, ["threads", "1 or more", "got 0"]),
        ({"metrics": ("tracking_rsm",)}, ["no metric 'tracking_rsm'", "did you mean 'tracking_rms'", "final_q"]),
        ({"shared": {"perod": 0.01}}, ["no input 'perod'", "did you mean 'period'"]),
        ({"each": {"dq": np.zeros((3, 5))}}, ["no input 'dq'", "valid choices"]),
        ({"shared": {"q": np.zeros(4)}}, ["q must have shape (5,)", "(4,)"]),
        ({"shared": {"q": np.zeros((20, 5))}}, ["q must have shape (5,)", "(20, 5)"]),
        ({"shared": {"tool_reference": np.zeros((19, 2))}}, ["tool_reference", "(2,) or (20, 2)", "(19, 2)"]),
        ({"each": {"q": np.zeros((4, 5))}}, ["q must have shape (3, 5)", "(4, 5)"]),
        ({"each": {"tool_reference": np.zeros((3, 19, 2))}}, ["(3, 2) or (3, 20, 2)", "(3, 19, 2)"]),
        ({"each": {"lam_event": 0.5}}, ["lam_event", "(3,) or (3, 20)", "()"]),
        ({"shared": {"q": np.zeros(5)}, "each": {"q": np.zeros((3, 5))}}, ["q", "shared", "each", "both"]),
        ({"shared": {"period": np.full(20, 0.01)}}, ["period", "constant"]),
        ({"each": {"period": np.array([0.01, 0.0, 0.01])}}, ["period", "above 0", "0.0"]),
        ({"shared": {"period": 0.1}, "settings": MetricSettings(f_h=5.0)}, ["metrics.f_h", "Nyquist", "5 Hz"]),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(change, words, planar5):
    call = {"steps": 20, "count": 3, "shared": {}, "each": {}} | change
    with pytest.raises(ValueError, match=r".") as caught:
        simulate_batch(planar5, **call)
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("each", [{}, {"lam_event": 0.5}])
def test_a_batch_of_a_run_wants_to_know_how_many(each, paper):
    with pytest.raises(ValueError, match="each must name values with the rollouts first"):
        simulate_batch_of(paper(1), each)


def test_a_frequency_above_nyquist_matters_to_the_spectrum_alone(planar5):
    with pytest.raises(BadInput, match="Nyquist"):
        simulate_batch(planar5, 20, 3, {"period": 0.2}, {}, ("hf_rms",))
    assert simulate_batch(planar5, 20, 3, {"period": 0.2}, {}, ("switches",))["switches"].tolist() == [0.0] * 3


def test_a_step_that_fails_is_an_error(planar5, tmp_path, monkeypatch):
    source = tmp_path / "failing.c"
    source.write_text(
        "int failing(const double **arg, double **res, long long *iw, double *w, int mem) { return 1; }\n"
    )
    ffi = cffi.FFI()
    ffi.cdef("int failing(const double **, double **, long long *, double *, int);")
    library = ffi.dlopen(str(compile_library([source])))
    monkeypatch.setattr(CompiledFunction, "pointer", property(lambda self: ffi.cast("void *", library.failing)))
    with pytest.raises(RuntimeError, match="planar5_step failed"):
        simulate_batch(_one_by_one(planar5), 10, 40, CONSTANT, {}, ("final_q",))
    assert _threads_of_batches() == []


def test_a_library_for_this_processor_is_not_taken_for_another_ones(tmp_path, monkeypatch):
    source = tmp_path / "answer.c"
    source.write_text("int answer(void) { return 42; }\n")
    compiler = Compiler(("cc",), "cc 1")
    keys = [library_path([source], compiler), library_path([source], compiler, NATIVE)]
    assert library_path([source], compiler, NATIVE) == keys[1]
    keys.append(library_path([source], compiler, (*NATIVE, "-DLANES=8")))
    monkeypatch.setattr(compiler_module, "_processor", lambda: "another one")
    assert library_path([source], compiler) == keys[0]
    keys.append(library_path([source], compiler, NATIVE))
    assert len(set(keys)) == 4
