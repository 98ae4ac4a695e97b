"""`clikgen sweep`: nothing lost and nothing done twice, whatever kills it and wherever it runs; clear refusals."""

import fcntl
import json
import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib.util import find_spec

import distributed
import numpy as np
import pyarrow.parquet
import pytest

from clikgen.analysis.sweep import bind, read_sweep
from clikgen.analysis.sweep_store import open_store
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import find_scenario

CLIKGEN = (sys.executable, "-c", "from clikgen.cli.main import main; main()", "sweep")
COUNT, CHUNK = 200, 4
SWEEP = f"""
scenario = "paper"
case = 3
steps = 1000
metrics = ["switches", "tracking_rms", "final_error", "min_clearance"]
format = "csv"
chunk = {CHUNK}

[design]
kind = "random"
count = {COUNT}
seed = 1

[[axes]]
key = "tool_gain"
range = [0.5, 20.0]
scale = "log"

[[axes]]
key = "obstacles[0].center[1]"
mean = 0.0
deviation = 0.3

[[axes]]
key = "influence_radius[5]"
values = [0.1, 0.15, 0.2]
"""


@pytest.fixture
def sweep(tmp_path):
    """A sweep file of fifty chunks."""
    path = tmp_path / "study.toml"
    path.write_text(SWEEP)
    return path


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    """The bytes of its results where nothing happens."""
    folder = tmp_path_factory.mktemp("uninterrupted")
    (folder / "study.toml").write_text(SWEEP)
    with begun(folder / "study.toml", folder / "out", COUNT // CHUNK) as store:
        store.finish()
    return (folder / "out" / "results.csv").read_bytes()


@contextmanager
def begun(sweep, folder, chunks):
    """The store of a sweep, the first few chunks of which are there."""
    bound = bind(read_sweep(sweep), CompiledController.load("planar5"))
    with open_store(folder, bound) as store:
        for chunk, table in bound.tables(range(chunks)):
            store.keep(chunk, table)
        yield store


@pytest.fixture
def half_done(sweep, tmp_path):
    """A folder with six parts."""
    with begun(sweep, tmp_path / "half_done", 6):
        return tmp_path / "half_done"


def started(*arguments):
    return subprocess.Popen([*CLIKGEN, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def parts(folder):
    """Every part with when it was written, and where."""
    found = {}
    for path in folder.glob("parts/*.part"):
        status = path.stat()
        found[path.name] = (status.st_mtime_ns, status.st_ino)
    return found


def wait_for_parts(process, folder, count):
    while process.poll() is None and len(parts(folder)) < count:
        time.sleep(1e-3)


# ---- Nothing lost, nothing twice ----


def test_killed_at_any_moment_it_goes_on_to_the_same_bytes_and_computes_nothing_twice(
    sweep, uninterrupted, run_clikgen, tmp_path
):
    folder, draw, kept = tmp_path / "killed", random.Random(4), {}
    for _ in range(3):
        process = started(sweep, "--out", folder, "--threads", 1)
        wait_for_parts(process, folder, len(kept) + draw.randint(1, 8))
        time.sleep(draw.uniform(0, 5e-3))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        now = parts(folder)
        assert process.returncode == -signal.SIGKILL
        assert kept.items() < now.items()  # all that was there is there, untouched
        kept = now
    assert len(kept) < COUNT // CHUNK
    document = json.loads(run_clikgen("sweep", sweep, "--out", folder, "--json").stdout)
    assert (document["resumed"], document["computed"]) == (CHUNK * len(kept), COUNT - CHUNK * len(kept))
    assert (folder / "results.csv").read_bytes() == uninterrupted
    assert sorted(path.name for path in folder.iterdir()) == [".lock", "provenance.json", "results.csv"]


def test_done_it_does_nothing_again(sweep, uninterrupted, run_clikgen, tmp_path):
    results = tmp_path / "out" / "results.csv"
    assert run_clikgen("sweep", sweep, "--out", results.parent).returncode == 0
    assert results.read_bytes() == uninterrupted
    before = results.stat().st_mtime_ns
    outcome = run_clikgen("sweep", sweep, "--out", results.parent, "--json")
    assert json.loads(outcome.stdout)["computed"] == 0
    assert "nothing to do" in outcome.stderr
    assert results.stat().st_mtime_ns == before


def flipped(content):
    return content[:100] + bytes([content[100] ^ 1]) + content[101:]


@pytest.mark.parametrize("damage", [flipped, lambda content: content[:-8], lambda content: b""])
def test_damaged_part_is_computed_again(damage, sweep, half_done, uninterrupted, run_clikgen):
    (half_done / "parts" / "0000002.part").write_bytes(damage((half_done / "parts" / "0000002.part").read_bytes()))
    document = json.loads(run_clikgen("sweep", sweep, "--out", half_done, "--json").stdout)
    assert document["resumed"] == CHUNK * 5
    assert (half_done / "results.csv").read_bytes() == uninterrupted


def test_part_of_another_sweep_is_not_taken(sweep, half_done, uninterrupted, run_clikgen, tmp_path):
    other = tmp_path / "other.toml"
    other.write_text(SWEEP.replace("seed = 1", "seed = 2"))
    with begun(other, tmp_path / "other", 1):
        pass
    (tmp_path / "other" / "parts" / "0000000.part").replace(half_done / "parts" / "0000000.part")
    assert run_clikgen("sweep", sweep, "--out", half_done).returncode == 0
    assert (half_done / "results.csv").read_bytes() == uninterrupted


def test_what_was_half_written_is_cleared_away(sweep, half_done, uninterrupted, run_clikgen):
    (half_done / "parts" / ".0000040.part.abc.clikgen-tmp").write_bytes(b"half")
    (half_done / "results.csv.clikgen-tmp").write_bytes(b"index,")
    assert run_clikgen("sweep", sweep, "--out", half_done).returncode == 0
    assert (half_done / "results.csv").read_bytes() == uninterrupted
    assert not list(half_done.rglob("*tmp"))


def test_killed_between_the_results_and_the_parts_it_only_clears_up(sweep, half_done, uninterrupted, run_clikgen):
    (half_done / "results.csv").write_bytes(uninterrupted)
    document = json.loads(run_clikgen("sweep", sweep, "--out", half_done, "--json").stdout)
    assert document["computed"] == 0
    assert not (half_done / "parts").exists()


# ---- The same on a cluster ----


@pytest.fixture(scope="module")
def cluster():
    """Two workers, each a process; the last test that has them takes them down."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as two:
        yield two


def test_cluster_of_which_a_worker_is_killed_gives_the_same_bytes(cluster, sweep, uninterrupted, tmp_path):
    folder = tmp_path / "cluster"
    with distributed.Client(cluster) as client:
        workers = client.run(os.getpid)
        process = started(sweep, "--out", folder, "--scheduler", cluster.scheduler_address, "--json")
        wait_for_parts(process, folder, 3)
        assert 3 <= len(parts(folder)) < COUNT // CHUNK
        os.kill(next(iter(workers.values())), signal.SIGKILL)
        said, complained = process.communicate()
    assert process.returncode == 0, complained
    assert json.loads(said)["computed"] == COUNT
    assert (folder / "results.csv").read_bytes() == uninterrupted


def test_scheduler_that_is_lost_is_one_line_and_threads_go_on(cluster, sweep, uninterrupted, run_clikgen, tmp_path):
    folder = tmp_path / "lost"
    process = started(sweep, "--out", folder, "--scheduler", cluster.scheduler_address)
    wait_for_parts(process, folder, 2)
    cluster.close()
    _, complained = process.communicate()
    assert process.returncode == 2, complained
    assert len(complained.strip().splitlines()) == 1, complained
    assert "is lost; run the same command again" in complained
    kept = len(parts(folder))
    document = json.loads(run_clikgen("sweep", sweep, "--out", folder, "--json").stdout)
    assert document["resumed"] == CHUNK * kept > 0
    assert (folder / "results.csv").read_bytes() == uninterrupted


def test_scheduler_that_is_not_there_is_one_line(sweep, run_clikgen, tmp_path, monkeypatch):
    monkeypatch.setattr("clikgen.analysis.sweep_cluster.PATIENCE", 0.2)
    for address in ("tcp://127.0.0.1:1", "nowhere"):
        line = complaint(run_clikgen, sweep, "--out", tmp_path / "out", "--scheduler", address)
        assert address in line


# ---- One folder, one sweep, one process ----


def complaint(run, *arguments):
    """The one line that `clikgen sweep ARGUMENTS` complains with."""
    outcome = run("sweep", *arguments)
    assert outcome.returncode == 2, outcome.stderr + outcome.stdout
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("clikgen: error: ")
    assert not outcome.stdout
    return lines[0]


def test_second_process_is_refused_while_the_first_runs(sweep, half_done, run_clikgen):
    with (half_done / ".lock").open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        before = parts(half_done)
        assert "in use by another sweep" in complaint(run_clikgen, sweep, "--out", half_done)
        assert parts(half_done) == before
    assert run_clikgen("sweep", sweep, "--out", half_done).returncode == 0


CHANGES = {
    "seed": ("seed = 1", "seed = 2", "sweep.design.seed is 1 there and 2 here"),
    "range": ("20.0", "21.0", "sweep.axes.0.range.1 is 20.0 there and 21.0 here"),
    "metrics": ('"switches", ', "", "sweep.metrics is"),
    "comment": ("steps = 1000", "steps = 1000 # of them", "sweep_sha256"),
    "setting": ("[design]", "[settings]\nobstacles_gain = 50.0\n[design]", "sweep.settings is null there"),
    "format": ("csv", "parquet", 'sweep.format is "csv" there and "parquet" here'),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changed_sweep_is_refused_with_what_differs(change, sweep, half_done, run_clikgen):
    old, new, wanted = CHANGES[change]
    assert old in SWEEP
    sweep.write_text(SWEEP.replace(old, new, 1))
    before = parts(half_done)
    line = complaint(run_clikgen, sweep, "--out", half_done)
    assert "of another sweep" in line
    assert wanted in line
    assert parts(half_done) == before


def test_changed_scenario_is_refused(run_clikgen, tmp_path):
    scenario, sweep = tmp_path / "mine.toml", tmp_path / "sweep.toml"
    scenario.write_text(find_scenario("paper").read_text())
    sweep.write_text(SWEEP.replace('"paper"', '"mine.toml"').replace("count = 200", "count = 4"))
    assert run_clikgen("sweep", sweep, "--out", tmp_path / "out").returncode == 0
    scenario.write_text(scenario.read_text().replace("radius = 0.1", "radius = 0.11"))
    assert "scenario_sha256" in complaint(run_clikgen, sweep, "--out", tmp_path / "out")


def test_folder_of_something_else_is_left_alone(sweep, run_clikgen, tmp_path):
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "results.csv").write_text("mine")
    assert "results.csv" in complaint(run_clikgen, sweep, "--out", tmp_path / "other")
    assert [path.name for path in (tmp_path / "other").iterdir()] == ["results.csv"]


# ---- What is written ----


def test_parquet_holds_what_csv_holds_to_the_last_bit_and_says_where_it_is_from(
    sweep, uninterrupted, run_clikgen, tmp_path
):
    sweep.write_text(SWEEP.replace("csv", "parquet"))
    assert run_clikgen("sweep", sweep, "--out", tmp_path / "parquet").returncode == 0
    table = pyarrow.parquet.read_table(tmp_path / "parquet" / "results.parquet")
    heads, *rows = [line.split(",") for line in uninterrupted.decode().splitlines()]
    assert table.column_names == heads
    assert len(rows) == table.num_rows == COUNT
    for head, cells in zip(heads, zip(*rows, strict=True), strict=True):
        kind = float if str(table[head].type) == "double" else int
        assert table[head].to_pylist() == [kind(cell) for cell in cells]
    beside = json.loads((tmp_path / "parquet" / "provenance.json").read_text())
    assert json.loads(table.schema.metadata[b"clikgen"]) == beside
    assert beside["sweep"]["design"] == {"kind": "random", "count": COUNT, "seed": 1}
    assert beside["controller"] == "planar5"


def test_number_of_threads_changes_no_byte(sweep, uninterrupted, run_clikgen, tmp_path):
    assert run_clikgen("sweep", sweep, "--out", tmp_path / "three", "--threads", 3).returncode == 0
    assert (tmp_path / "three" / "results.csv").read_bytes() == uninterrupted


def test_provenance_holds_no_place_and_is_the_same_anywhere(sweep, half_done, tmp_path):
    here = (half_done / "provenance.json").read_text()
    assert str(tmp_path) not in here
    (tmp_path / "elsewhere").mkdir()
    moved = sweep.replace(tmp_path / "elsewhere" / "renamed.toml")
    with begun(moved, tmp_path / "elsewhere" / "out", 0):
        assert (tmp_path / "elsewhere" / "out" / "provenance.json").read_text() == here


def test_table_shows_the_spread_of_every_metric_and_where(sweep, run_clikgen, tmp_path):
    said = run_clikgen("sweep", sweep, cwd=tmp_path)
    assert said.returncode == 0
    document = json.loads(run_clikgen("sweep", sweep, "--json", cwd=tmp_path).stdout)
    table = np.genfromtxt(tmp_path / "study-sweep" / "results.csv", delimiter=",", names=True)
    for name in ("tracking_rms", "min_clearance"):
        spread = document["metrics"][name]
        assert spread["least"] == table[name].min() == table[name][spread["least_index"]]
        assert spread["greatest"] == table[name].max() == table[name][spread["greatest_index"]]
        assert spread["median"] == np.percentile(table[name], 50, method="lower")
        assert f"{spread['least']:.4g} (#{spread['least_index']})" in said.stdout


# ---- Mistakes ----

AXIS = '[[axes]]\nkey = "tool_gain"\nrange = [0.5, 20.0]'


def axis(text):
    return (AXIS, f"[[axes]]\n{text}")


GRID = 'kind = "grid"'
DRAWN = f'kind = "random"\ncount = {COUNT}\nseed = 1'
MISTAKES = {
    "unknown key": ("chunk = 4", "chunks = 4", ["chunks", "did you mean 'chunk'"]),
    "no TOML": ("[design]", "[design", ["not valid TOML"]),
    "unknown scenario": ('"paper"', '"papper"', ["study.toml: scenario", "did you mean 'paper'"]),
    "missing scenario": ('"paper"', '"mine.toml"', ["mine.toml", "No such file"]),
    "no such case": ("case = 3", "case = 4", ["case", "4"]),
    "no case": ("case = 3", "", ["case", "1, 2 or 3", "axis"]),
    "unknown metric": ('"switches"', '"switchs"', ["metrics.0", "did you mean 'switches'", "hf_rms"]),
    "metric twice": ('"switches"', '"switches", "switches"', ["metrics", "'switches' 2 times"]),
    "unknown format": ('"csv"', '"xlsx"', ["format", "parquet", "xlsx"]),
    "no steps": ("steps = 1000", "steps = 0", ["steps", "0"]),
    "unknown setting": ("[design]", "[settings]\ntol_gain = 1\n[design]", ["settings", "did you mean 'tool_gain'"]),
    "setting out of limits": ("[design]", "[settings]\ntool_gain = -1\n[design]", ["settings", "tool_gain", "-1"]),
    "share as a setting": ("[design]", "[settings]\nlam_free = 1\n[design]", ["settings.lam_free", "case"]),
    "unknown design": ('"random"', '"sobel"', ["design", "sobel", "latin_hypercube"]),
    "no count": ("count = 200", "", ["design", "count"]),
    "negative seed": ("seed = 1", "seed = -1", ["seed", "-1"]),
    "too many": ("count = 200", "count = 1_000_000_000", ["count", "10000000"]),
    "no axes": (SWEEP[SWEEP.index("[[axes]]") :], "", ["axes", "required"]),
    "unknown parameter": ('"tool_gain"', '"tol_gain"', ["axes.0.key", "did you mean 'tool_gain'", "obstacles[0].ra"]),
    "obstacle that is not there": ("obstacles[0]", "obstacles[1]", ["axes.1.key", "obstacles[1].center"]),
    "index too large": ("influence_radius[5]", "influence_radius[6]", ["axes.2.key", "[0 to 5]"]),
    "index of a matrix": ('"tool_gain"', '"tool_gain[0][1]"', ["tool_gain", "diagonal"]),
    "reference": ('"tool_gain"', '"tool_reference"', ["no input 'tool_reference'"]),
    "set twice": ('"influence_radius[5]"', '"tool_gain[1]"', ["axes.2.key", "set by tool_gain already"]),
    "range that decreases": ("[0.5, 20.0]", "[20.0, 0.5]", ["axes.0", "increase"]),
    "logarithm of nothing": ("[0.5, 20.0]", "[0.0, 20.0]", ["axes.0", "positive", "log"]),
    "gain of nothing": ('[0.5, 20.0]\nscale = "log"', "[0.0, 20.0]", ["tool_gain", "positive definite"]),
    "beyond the limits": ("[0.5, 20.0]", "[0.5, 1e5]", ["tool_gain", "10000"]),
    "value beyond the limits": ("[0.1, 0.15, 0.2]", "[0.1, -0.15]", ["influence_radius[5]", "-0.15"]),
    "value that is no number": ("[0.1, 0.15, 0.2]", '["wide"]', ["axes.2", "finite numbers"]),
    "values of several shapes": ("[0.1, 0.15, 0.2]", "[0.1, [0.1]]", ["axes.2", "one shape"]),
    "values of the wrong shape": ("[0.1, 0.15, 0.2]", "[[0.1, 0.2]]", ["influence_radius[5]", "numbers", "[2]"]),
    "nothing that varies": (
        'range = [0.5, 20.0]\nscale = "log"',
        "",
        ["axes.0", "'values', 'range', or 'mean' and 'deviation'"],
    ),
    "points in a random design": ('scale = "log"', "count = 3", ["axes.0.count", "grid"]),
    "distribution in a grid": (DRAWN, GRID, ["axes.0", "grid", "'values'"]),
    "distribution of nothing": ("deviation = 0.3", "deviation = 0.0", ["axes.1", "deviation"]),
    "period too long": (AXIS, '[[axes]]\nkey = "period"\nrange = [1.0, 20.0]', ["period", "20"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_that_names_the_key_and_nothing_is_written(mistake, sweep, run_clikgen, tmp_path):
    old, new, wanted = MISTAKES[mistake]
    assert old in SWEEP
    sweep.write_text(SWEEP.replace(old, new, 1))
    line = complaint(run_clikgen, sweep, "--out", tmp_path / "out")
    for piece in wanted:
        assert piece in line
    assert not (tmp_path / "out").exists()


def test_frequency_above_nyquist_is_refused_for_the_longest_period(sweep, run_clikgen, tmp_path):
    text = SWEEP.replace('"switches"', '"hf_rms"').replace("steps = 1000", "steps = 10")
    sweep.write_text(text.replace(AXIS, '[[axes]]\nkey = "period"\nrange = [0.01, 0.2]'))
    assert "Nyquist frequency 2.5 Hz" in complaint(run_clikgen, sweep, "--out", tmp_path / "out")


def test_noise_is_refused_where_it_would_be_taken_for_the_truth(sweep, run_clikgen, tmp_path):
    settings = "[settings]\nsensing.noise = 0.01\n[design]"
    sweep.write_text(SWEEP.replace("[design]", settings))
    assert "perfect sensing for min_clearance" in complaint(run_clikgen, sweep, "--out", tmp_path / "out")
    sweep.write_text(SWEEP.replace("[design]", settings).replace(', "min_clearance"', ""))
    assert "perfect sensing for axes" in complaint(run_clikgen, sweep, "--out", tmp_path / "out")


OPTIONS = {
    "no such file": (["nowhere.toml"], ["nowhere.toml", "No such file"]),
    "no threads": (["study.toml", "--threads", "0"], ["--threads", "0"]),
    "threads of a cluster": (["study.toml", "--threads", "2", "--scheduler", "tcp://here:1"], ["--threads", "no --sc"]),
    "folder that cannot be made": (["study.toml", "--out", "/proc/clikgen"], ["/proc/clikgen"]),
    "file for a folder": (["study.toml", "--out", "study.toml"], ["study.toml", "folder"]),
}


@pytest.mark.parametrize("mistake", OPTIONS)
def test_mistake_on_the_command_line_is_one_line(mistake, sweep, run_clikgen, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments, wanted = OPTIONS[mistake]
    line = complaint(run_clikgen, *arguments)
    for piece in wanted:
        assert piece in line


@pytest.mark.parametrize(
    ("package", "text", "arguments", "wanted"),
    [
        ("pyarrow", SWEEP.replace("csv", "parquet"), [], "pip install 'clikgen[sweep]'"),
        ("distributed", SWEEP, ["--scheduler", "tcp://127.0.0.1:1"], "pip install 'clikgen[sweep]'"),
    ],
)
def test_package_that_is_not_there_is_one_line_that_says_what_to_install(
    package, text, arguments, wanted, sweep, run_clikgen, tmp_path, monkeypatch
):
    for module in ("clikgen.analysis.sweep_store", "clikgen.analysis.sweep_cluster"):
        monkeypatch.setattr(f"{module}.find_spec", lambda name: None if name == package else find_spec(name))
    sweep.write_text(text)
    line = complaint(run_clikgen, sweep, "--out", tmp_path / "out", *arguments)
    assert wanted in line
    assert not (tmp_path / "out").exists()
