"""A sweep on a compiled controller: what every axis sets, and a chunk of the design as a table of metrics.

Row i of the table depends on the file, the controller and i alone: neither on the chunk it is in, nor on the threads
or the process that it is computed by, nor on what was computed before.
"""

import itertools
import json
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.sweep_design import AnyAxis, NormalAxis, SweepFile
from clikgen.analysis.sweep_targets import BY_CASE, Setting, Target, find_targets
from clikgen.runtime.batch import METRICS, cores, simulate_batch
from clikgen.runtime.compiler import FLAGS, NATIVE, has_fma
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, choices, read_text, read_toml
from clikgen.runtime.manifest import SignalInfo, sha256
from clikgen.runtime.references import Csv
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import Run, prepare

Array = NDArray[np.float64]
Table = NDArray[np.void]
"""A structured array: `index`, a column for every entry of an axis, a column for every metric."""

Progress = Callable[[int], None]
"""Called with how many more rollouts are done."""

WHOLE = ("index", "case", "switches")  # columns of whole numbers
SENSED = ("min_clearance", "min_distance")  # measured from what the step is told of the obstacles
ROOM = 2**26  # bytes, for an input over the time of all rollouts that are run together


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """A sweep that has been checked against its controller: every row of it can be run.

    `provenance` is all that decides the bytes of the result; it holds no clock, path or machine.
    """

    file: SweepFile
    scenario: Scenario
    controller: CompiledController
    settings: tuple[Setting, ...]
    provenance: Mapping[str, Any]

    @property
    def dtype(self) -> np.dtype[np.void]:
        """The columns of the table: whole numbers are <i8, all others <f8."""
        heads = ["index", *(head for axis in self.file.axes for head in axis.heads), *self.file.metrics]
        return np.dtype([(head, "<i8" if head in WHOLE else "<f8") for head in heads])

    def table(self, chunk: int, threads: int | None = None, progress: Progress | None = None) -> Table:
        """The rows of a chunk, run by that many threads (None: one for each core)."""
        span, drawn = self.file.span(chunk), self.file.rows(chunk)
        table: Table = np.zeros(len(span), self.dtype)
        table["index"] = span
        for axis, values in zip(self.file.axes, drawn, strict=True):
            for head, column in zip(axis.heads, values.reshape(len(span), -1).T, strict=True):
                table[head] = column
        for period, rows in self._by_period(drawn):
            run = _sampled(self.file, self.scenario, self.controller, period)
            for block in np.array_split(rows, -(-len(rows) // self._most_together(run))):
                measured = self._measured(run, [values[block] for values in drawn], threads, progress)
                for name, column in measured.items():
                    table[name][block] = column
        return table

    def tables(
        self, chunks: Iterable[int], threads: int | None = None, progress: Progress | None = None
    ) -> Iterator[tuple[int, Table]]:
        """The chunks of those numbers and their rows, each as soon as it is done.

        A chunk is a thread's, so that what is not compiled is done side by side too; of few chunks, each has several.
        Left early, the iterator returns once all threads have stopped, after some 50 ms.
        """
        waiting, threads, stop = deque(chunks), threads or cores(), threading.Event()
        workers = max(1, min(threads, len(waiting)))
        self.make_ready()

        def done(rollouts: int) -> None:
            if stop.is_set():
                raise CancelledError
            if progress:
                progress(rollouts)

        pool = ThreadPoolExecutor(workers)
        running: dict[Future[Table], int] = {}
        try:
            while waiting or running:
                while waiting and len(running) <= workers:  # one more than run, so that none waits for the next
                    chunk = waiting.popleft()
                    running[pool.submit(self.table, chunk, threads // workers, done)] = chunk
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)

    def make_ready(self) -> None:
        """Make what threads would make each for itself: the compiled code and, of a Latin hypercube, all of it."""
        self.file.rows(0)
        simulate_batch(self.controller, 1, 1, {}, {}, ())

    def _by_period(self, drawn: Sequence[Array]) -> Iterator[tuple[float | None, NDArray[np.int64]]]:
        """Every period among the rows with the rows that have it; None, the scenario's own, where no axis sets it."""
        at = next((i for i, axis in enumerate(self.file.axes) if axis.key == "period"), None)
        if at is None:
            yield None, np.arange(len(drawn[0]))
            return
        periods, which = np.unique(drawn[at], return_inverse=True)
        for i, period in enumerate(periods):
            yield float(period), np.flatnonzero(which == i)

    def _most_together(self, run: Run) -> int:
        """How many rollouts fit where every one has its own obstacles over time."""
        over_time = [run.values[name] for name in self._set(run) if _varies(run, name)]
        return max(1, ROOM // max((array.nbytes for array in over_time), default=1))

    def _set(self, run: Run) -> list[str]:
        """The inputs that axes set, but for the period, which is the run's."""
        names = dict.fromkeys(target.signal.name for setting in self.settings for target in setting.targets)
        return [name for name in names if name != "period"]

    def _measured(
        self, run: Run, drawn: Sequence[Array], threads: int | None, progress: Progress | None
    ) -> dict[str, Array]:
        """The metrics of the rollouts of a run with these values of the axes, by their names."""
        count = len(drawn[0])
        each = {name: _repeated(run, name, count) for name in self._set(run)}
        for setting, values in zip(self.settings, drawn, strict=True):
            for target, entries in setting.values(values):
                if target.signal.name in each:
                    target.put(each[target.signal.name], entries)
        shared = {name: array for name, array in run.values.items() if name not in each}
        return simulate_batch(
            self.controller,
            run.steps,
            count,
            shared,
            each,
            self.file.metrics,
            self.scenario.metrics,
            threads,
            progress and _increments(progress),
        )


def _increments(progress: Progress) -> Callable[[int, int], None]:
    """`progress`, told of how many rollouts are done."""
    told = 0

    def so_far(done: int, _: int) -> None:
        nonlocal told
        progress(done - told)
        told = done

    return so_far


def _sampled(
    file: SweepFile, scenario: Scenario, controller: CompiledController, period: float | None, source: str = "scenario"
) -> Run:
    """The scenario where no axis sets anything but the period [s]: as many steps as the file wants, or its duration."""
    if period is not None:
        scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, "period": period}})
    if file.steps is not None:
        default = controller.step.info.input("period").default[0]
        scenario = scenario.model_copy(
            update={"duration": file.steps * float(scenario.parameters.get("period", default))}
        )
    return prepare(controller, scenario, CASES[file.case or 1], source)


def _constant(run: Run, name: str) -> Array | None:
    """An input of a run that is the same in every step; None where it is not."""
    signal, array = run.controller.step.info.input(name), run.values[name]
    if array.shape == signal.shape:
        return array
    return array[0] if np.all(array == array[0]) else None


def _varies(run: Run, name: str) -> bool:
    return _constant(run, name) is None


def _repeated(run: Run, name: str, count: int) -> Array:
    """An input of a run for each of `count` rollouts, to be written to."""
    constant = _constant(run, name)
    array = run.values[name] if constant is None else constant
    return np.broadcast_to(array, (count, *array.shape)).copy()


# ---- From a file ----


@dataclass(frozen=True, slots=True)
class SweepSource:
    """A sweep as it was read: its file, the scenario under its settings, and the content of both."""

    name: str  # the file it is from, as error messages call it
    file: SweepFile
    scenario: Scenario
    provenance: Mapping[str, Any]


def read_sweep(path: Path) -> SweepSource:
    """The sweep in a TOML file; a scenario of one's own is found from its folder. Raises BadInput."""
    file = SweepFile.parse(read_toml(path), str(path))
    try:
        found = find_scenario(file.scenario)
    except BadInput as error:
        raise BadInput(f"{path}: scenario: {error}") from None
    place = path.parent / found if file.scenario.endswith(".toml") else found
    read_scenario(place)  # so that what is wrong with it is not blamed on the settings
    try:
        scenario = read_scenario(
            place, [f"{key}={json.dumps(value, default=str)}" for key, value in _flat(file.settings)]
        )
    except BadInput as error:
        raise BadInput(f"{path}: settings: {error}") from None
    files = [place, *(Path(motion.file) for motion in scenario.references.values() if isinstance(motion, Csv))]
    files += [Path(one.path.file) for one in scenario.obstacles if isinstance(one.path, Csv)]
    provenance = {
        "scenario": scenario.name,
        "scenario_sha256": sha256("".join(sha256(read_text(one).encode()) for one in files).encode()),
        "sweep": file.model_dump(mode="json", exclude={"scenario"}, exclude_unset=True),
        "sweep_sha256": sha256(read_text(path).encode()),
    }
    return SweepSource(str(path), file, scenario, provenance)


def _flat(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The entries of a table of tables under dotted keys."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def bind(source: SweepSource, controller: CompiledController) -> Sweep:
    """The sweep on its scenario's controller; raises BadInput where a row of it cannot be run."""
    file, scenario, manifest = source.file, source.scenario, controller.manifest
    _check_metrics(file, scenario, source.name)
    settings: list[Setting] = []
    for i, axis in enumerate(file.axes):
        where = f"{source.name}: axes.{i}.key"
        targets = find_targets(axis.key, manifest, scenario, where)
        for other in settings:
            if any(target.meets(one) for target in targets for one in other.targets):
                raise BadInput(f"{where}: {axis.key} is set by {other.axis.key} already")
        settings.append(Setting(_cut_off(axis, targets[0], f"{source.name}: axes.{i}"), targets))
    for name in BY_CASE:
        if name in source.file.settings:
            raise BadInput(f"{source.name}: settings.{name}: set by the case; wanted 'case', or an axis '{name}'")
    if (file.case is None) == all(axis.key != "case" for axis in file.axes):
        raise BadInput(f"{source.name}: case: wanted either case = 1, 2 or 3, or an axis 'case'")
    file = file.model_copy(update={"axes": tuple(setting.axis for setting in settings)})
    sweep = Sweep(file, scenario, controller, tuple(settings), {**source.provenance, **_made_by(controller)})
    _check_limits(sweep, source.name)
    return sweep


def _made_by(controller: CompiledController) -> dict[str, Any]:
    """What else decides the numbers: the generated code, how it is compiled, and the packages that draw and measure."""
    manifest = controller.manifest
    return {
        "controller": manifest.controller,
        "spec_sha256": manifest.spec_sha256,
        "source_sha256": manifest.source_sha256,
        "compiler_flags": [*FLAGS, *NATIVE],
        "fma": has_fma(controller.folder / f"{manifest.controller}.c", controller.compiler),
        "versions": {name: version(name) for name in ("clikgen", "numpy", "scipy")},
    }


def _check_metrics(file: SweepFile, scenario: Scenario, source: str) -> None:
    for i, name in enumerate(file.metrics):
        if name not in METRICS:
            raise BadInput(f"{source}: metrics.{i}: no metric '{name}'; {choices(name, METRICS)}")
        if name in SENSED and not scenario.sensing.perfect:
            raise BadInput(f"{source}: metrics.{i}: wanted perfect sensing for {name}, got noise or delay")
    if not scenario.sensing.perfect and any(axis.key.startswith("obstacles[") for axis in file.axes):
        raise BadInput(f"{source}: axes: wanted perfect sensing for axes of obstacles, got noise or delay")


def _cut_off(axis: AnyAxis, target: Target, source: str) -> AnyAxis:
    """The axis, and a normal one without a range cut off at the limits of what it sets."""
    if not isinstance(axis, NormalAxis) or axis.range:
        return axis
    low, high = target.signal.minimum, target.signal.maximum
    if low is None or high is None or target.signal.positive_definite:
        raise BadInput(f"{source}: wanted a 'range' of what {axis.key} may be, to cut the distribution off")
    return axis.model_copy(update={"range": (low, high)})


def _check_limits(sweep: Sweep, source: str) -> None:
    """Raises BadInput where an axis leaves what its input may be: the ends are looked at, what may be is convex."""
    for i, setting in enumerate(sweep.settings):
        where = f"{source}: axes.{i}: {setting.axis.key}"
        ends = setting.axis.ends
        if setting.axis.key == "case":
            if ends.ndim > 1 or not set(ends.tolist()) <= set(CASES):
                raise BadInput(f"{where}: wanted values of {', '.join(map(str, CASES))}, got {ends.tolist()}")
        elif ends.shape[1:] not in setting.targets[0].shapes:
            shapes = " or ".join("numbers" if not one else f"arrays {list(one)}" for one in setting.targets[0].shapes)
            raise BadInput(f"{where}: wanted {shapes}, got arrays {list(ends.shape[1:])}")
    base = _sampled(sweep.file, sweep.scenario, sweep.controller, None, f"{source}: settings")
    for names, signal, array in _extremes(sweep, base):
        signal.value(array.tolist(), f"{source}: axes: {names}")
    for period in next(
        (setting.axis.ends for setting in sweep.settings if setting.axis.key == "period"), [base.period]
    ):
        run = _sampled(sweep.file, sweep.scenario, sweep.controller, float(period), source)
        if "hf_rms" in sweep.file.metrics and (f_h := sweep.scenario.metrics.f_h) >= 0.5 / run.period:
            raise BadInput(
                f"{source}: metrics.f_h: wanted less than the Nyquist frequency {0.5 / run.period:g} Hz, got {f_h:g}"
            )


def _extremes(sweep: Sweep, base: Run) -> Iterator[tuple[str, SignalInfo, Array]]:
    """What inputs the axes set are at most: whose keys they are, and the input.

    Limits bound every entry on its own, so every axis is taken alone; a matrix has to be positive definite, so the
    axes of its diagonal are taken together, at every corner.
    """
    settings = [setting for setting in sweep.settings if setting.axis.key != "case"]
    for name in dict.fromkeys(setting.targets[0].signal.name for setting in settings):
        owners = [setting for setting in settings if setting.targets[0].signal.name == name]
        together = [owners] if owners[0].targets[0].signal.positive_definite else [[one] for one in owners]
        for group in together:
            ends = [one.axis.ends for one in group]
            outermost = [np.array([each.min(), each.max()]) if each.ndim == 1 else each for each in ends]
            for corner in itertools.product(*outermost):
                array = _repeated(base, name, 1)
                for one, value in zip(group, corner, strict=True):
                    one.targets[0].put(array, np.asarray(value)[None])
                signal = group[0].targets[0].signal
                yield ", ".join(one.axis.key for one in group), signal, array.reshape(-1, *signal.shape)[0]
