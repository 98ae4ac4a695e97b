"""Many rollouts at once in compiled C, on every core: their metrics, and no trajectory.

A rollout's numbers depend on its own inputs alone: bit for bit the same in whatever company, on any number of threads
and with vectors of any width.
"""

import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import cffi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.runtime.compiler import NATIVE, compile_library, find_compiler
from clikgen.runtime.controller import CompiledController, CompiledFunction
from clikgen.runtime.documents import BadInput, choices
from clikgen.runtime.manifest import FAR, FunctionInfo, Manifest, SignalInfo
from clikgen.runtime.scenario import MetricSettings
from clikgen.runtime.simulation import LOST, Run

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Progress = Callable[[int, int], None]
"""Called with how many rollouts are done, and of how many."""

METRICS = (
    *("switches", "switch_rate", "hf_rms", "reversal_rate", "max_velocity_step", "total_variation"),
    *("tracking_rms", "tracking_max", "final_error", "min_clearance", "min_distance", "diverged_at"),
)
"""What can be measured, defined as for a single rollout; `diverged_at` [s] is infinite where a rollout never did."""

WINDOW = 2.0  # [s] length of a Welch segment: the PSD resolves 0.5 Hz
ENCOUNTER_GAP = 0.5  # [s] contacts nearer than this to each other are one encounter
LEAST_PROMINENCE = 1e-12  # of a turning point, whatever the dead-band
LANES = 16  # rollouts side by side, where the generated code does not say how many
ALIGNMENT = 64  # [bytes] of what vectors are loaded from
WORK = 100_000_000  # operations of steps between two looks at whether to stop: some 50 ms
PIECES = 8  # of what a thread is given, one after the other: one that is held up leaves the rest to the others

_ffi = cffi.FFI()
_ffi.cdef("""
typedef struct { const double *data; long long by_rollout, by_step; int size; } clikgen_value;
typedef struct {
  void *step, *step_lanes;
  int inputs, outputs, sz_arg, sz_res, sz_iw, sz_w;
  const clikgen_value *input;
  const int *size, *feeds, *watched;
  long long steps;
  const long long *rollout;
  int q, period;
  int dq, error, clearance, distance;
  int flags;
  const int *flag;
  double lost, far, encounter_gap, dead_band;
  long long segment;
  int bins;
  const double *cosine, *sine, *weight;
  double total_weight;
  double **result, **final;
} clikgen_batch;
long long clikgen_batch_room(const clikgen_batch *);
void clikgen_batch_open(const clikgen_batch *, void *, long long, long long);
int clikgen_batch_advance(const clikgen_batch *, void *, long long);
""")


def simulate_batch(
    controller: CompiledController,
    steps: int,
    count: int,
    shared: Mapping[str, ArrayLike],
    each: Mapping[str, ArrayLike],
    metrics: Sequence[str] = METRICS,
    settings: MetricSettings | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Array]:
    """`count` rollouts of `steps` periods: metric -> (count,), in the order of `metrics`.

    Values in `shared` are those of every rollout: a constant in its input's shape or one over time,
    (steps, *shape). Those in `each` have the rollouts first: (count, *shape) or (count, steps, *shape). A state is
    where a rollout starts; inputs not named have their defaults. The period may differ from rollout to rollout but not
    within one.

    `final_<state>` among the metrics is the state after the last step, (count, *shape). Only what is named is
    computed. Distances are those that the step senses: the true ones where sensing is perfect. There are NaN for
    `min_clearance` and `min_distance` without obstacles, and of a rollout that diverged the metrics count up to there.
    `hf_rms` comes out of a difference of energies: where it is below 1e-7 of the RMS of q̇, it is rounding.

    One thread per core unless `threads` says otherwise; memory does not grow with `steps`. `progress` is called in this
    thread; where that raises, or Ctrl-C is pressed, the others stop within some 50 ms.

    Raises BadInput for an unknown name or an f_h above the Nyquist frequency, ValueError for another shape.
    """
    workers = cores() if threads is None else threads
    if workers < 1:
        raise ValueError(f"threads must be 1 or more, got {threads}")
    batch = _prepare(controller, steps, count, shared, each, metrics, settings or MetricSettings())
    early = batch.run(batch.groups(np.arange(count), np.full(count, steps)), metrics, workers, progress)
    if early.size:  # diverged within its first segment: its spectrum is that of one segment, as long as it lasted
        groups = batch.groups(early, batch.kept[early].astype(np.int64))
        batch.run(groups, ("hf_rms",), workers, progress, done=count - early.size)
    return {name: batch.results[name] for name in metrics}


def simulate_batch_of(
    run: Run,
    each: Mapping[str, ArrayLike],
    metrics: Sequence[str] = METRICS,
    threads: int | None = None,
    progress: Progress | None = None,
) -> dict[str, Array]:
    """A run of a scenario again and again, each time with the values in `each` (rollouts first) instead of its own.

    Everything else is as in `simulate_batch`. References and obstacles stay as they were sampled, whatever `period`
    a rollout has.
    """
    counts = {name: np.shape(value)[:1] for name, value in each.items()}
    if not counts or () in counts.values():
        raise ValueError(f"each must name values with the rollouts first, got shapes {counts}")
    count = next(iter(counts.values()))[0]
    shared = {name: value for name, value in run.values.items() if name not in each}
    return simulate_batch(
        run.controller, run.steps, count, shared, each, metrics, run.scenario.metrics, threads, progress
    )


# ---- What is run ----


@dataclass(frozen=True, slots=True, eq=False)
class _Value:
    """An input of all rollouts: entry e of rollout r in step k is array.flat[r * by_rollout + k * by_step + e]."""

    array: Array
    size: int
    by_rollout: int
    by_step: int


@dataclass(frozen=True, slots=True, eq=False)
class _Group:
    """Rollouts that run for as many steps and whose Welch segments have as many samples.

    `bins` frequencies of such a segment, from 0 Hz on, lie below f_h.
    """

    rollouts: Indices
    steps: int
    segment: int
    bins: int

    def blocks(self, lanes: int) -> Indices:
        """The rollouts of every block, (blocks, lanes); the last of them fills up the last block."""
        blocks = np.full(-(-self.rollouts.size // lanes) * lanes, self.rollouts[-1])
        blocks[: self.rollouts.size] = self.rollouts
        return blocks.reshape(-1, lanes)


@dataclass(frozen=True, slots=True, eq=False)
class _Batch:
    """A batch that has been checked; its `results` are filled in by running groups of its rollouts."""

    controller: CompiledController
    engine: "_Engine"
    values: Mapping[str, _Value]
    settings: MetricSettings
    period: Array  # (count,) [s]
    results: Mapping[str, Array]
    kept: Array  # (count,) steps before a rollout diverged

    def groups(self, rollouts: Indices, steps: Indices) -> list[_Group]:
        """The rollouts, each for that many steps, sorted into groups. Without a spectrum the period does not matter."""
        period = self.period[rollouts] if "hf_rms" in self.results else np.ones(rollouts.size)
        pairs, pair = np.unique(steps + 1j * period, return_inverse=True)  # sorted far sooner than rows are
        every = [(int(one.real), *_segment(int(one.real), one.imag, self.settings.f_h)) for one in pairs.tolist()]
        kinds, kind_of = np.unique(every, axis=0, return_inverse=True)
        kind = kind_of[pair]
        order = np.argsort(kind, kind="stable")
        parts = np.split(rollouts[order], np.flatnonzero(np.diff(kind[order])) + 1)
        return [_Group(part, *row) for part, row in zip(parts, kinds.tolist(), strict=True)]

    def run(
        self, groups: Sequence[_Group], metrics: Sequence[str], threads: int, progress: Progress | None, done: int = 0
    ) -> Indices:
        """Fill in these metrics, for rollouts of which so many more are `done`; those too short for their segment."""
        stop = threading.Event()
        with ThreadPoolExecutor(threads, "clikgen-batch") as pool:
            try:
                chunks = [chunk for group in groups for chunk in self._chunks(group, metrics, threads)]
                for future in as_completed([pool.submit(self._work, *chunk, stop) for chunk in chunks]):
                    done += future.result()
                    if progress:
                        progress(done, self.period.size)
            finally:  # where it was interrupted: every thread ends at its next look
                stop.set()
                pool.shutdown(cancel_futures=True)
        short = [group.rollouts[self.kept[group.rollouts] < group.segment] for group in groups]
        return np.sort(np.concatenate(short))

    @property
    def _most(self) -> int:
        """Steps of a block that are WORK: side by side, operations take about as long as for one."""
        operations = max(1, self.controller.step.info.operations)
        return max(1, WORK // (operations if self.engine.step_lanes else operations * self.engine.lanes))

    def _chunks(self, group: _Group, metrics: Sequence[str], threads: int) -> Iterator[tuple["_Plan", int, int]]:
        """The group in pieces: the first block, and the block after the last."""
        plan = _plan(self, group, metrics)
        blocks = len(plan.blocks)
        share = -(-blocks // threads)
        piece = max(-(-share // PIECES), self._most // (4 * PIECES * group.steps))  # worth the way through Python
        together = max(1, min(self._most // group.steps, share, piece))
        for first in range(0, blocks, together):
            yield plan, first, min(first + together, blocks)

    def _work(self, plan: "_Plan", first: int, end: int, stop: threading.Event) -> int:
        """Run a chunk, in this thread; how many of its rollouts have all their results now."""
        code = self.engine.code
        room = _aligned(code.clikgen_batch_room(plan.pointer))
        block = _ffi.cast("void *", room.ctypes.data)
        code.clikgen_batch_open(plan.pointer, block, first, end)
        while not stop.is_set():
            left = code.clikgen_batch_advance(plan.pointer, block, self._most)
            if left < 0:
                raise RuntimeError(f"{self.controller.step.info.symbol} failed")
            if not left:
                break
        lanes = self.engine.lanes
        rollouts = plan.group.rollouts[first * lanes : end * lanes]
        return int(np.count_nonzero(self.kept[rollouts] >= plan.group.segment))


def _prepare(
    controller: CompiledController,
    steps: int,
    count: int,
    shared: Mapping[str, ArrayLike],
    each: Mapping[str, ArrayLike],
    metrics: Sequence[str],
    settings: MetricSettings,
) -> _Batch:
    """Everything checked and compiled."""
    if steps < 1 or count < 1:
        raise ValueError(f"wanted 1 or more rollouts of 1 or more steps, got {count} of {steps}")
    info = controller.step.info
    results = _room_for_results(info, count, metrics)
    values = _values(info, steps, count, shared, each)
    period = _periods(values["period"], count)
    slowest = float(period.max())
    if "hf_rms" in metrics and settings.f_h >= 0.5 / slowest:
        raise BadInput(
            f"metrics.f_h: wanted less than the Nyquist frequency {0.5 / slowest:g} Hz, got {settings.f_h:g}"
        )
    return _Batch(controller, _engine(controller, NATIVE), values, settings, period, results, np.zeros(count))


def _room_for_results(info: FunctionInfo, count: int, metrics: Sequence[str]) -> dict[str, Array]:
    """An array for every metric and every last state; raises BadInput for any other name."""
    shapes: dict[str, tuple[int, ...]] = dict.fromkeys(METRICS, ())
    shapes |= {f"final_{one.feeds}": one.shape for one in info.outputs if one.feeds}
    for name in metrics:
        if name not in shapes:
            raise BadInput(f"{info.symbol}: no metric '{name}'; {choices(name, shapes)}")
    return {name: np.empty((count, *shapes[name])) for name in metrics}


def _values(
    info: FunctionInfo, steps: int, count: int, shared: Mapping[str, ArrayLike], each: Mapping[str, ArrayLike]
) -> dict[str, _Value]:
    """Every input, checked."""
    for name in (*shared, *each):
        info.input(name)
    if both := sorted(set(shared) & set(each)):
        raise ValueError(f"{both[0]} must be shared or given for each rollout, got both")
    states = {signal.feeds for signal in info.outputs}
    values = {}
    for signal in info.inputs:
        name, rollouts = signal.name, (count,) if signal.name in each else ()
        given = each[name] if name in each else shared.get(name, _default(signal))
        array = np.asarray(given, dtype=np.float64, order="C")
        wanted = [(*rollouts, *signal.shape)]
        if name not in states:
            wanted.append((*rollouts, steps, *signal.shape))
        if array.shape not in wanted:
            raise ValueError(f"{name} must have shape {' or '.join(map(str, wanted))}, got {array.shape}")
        by_step = 0 if array.shape == wanted[0] else signal.size
        by_rollout = signal.size * (steps if by_step else 1) if rollouts else 0
        values[name] = _Value(array, signal.size, by_rollout, by_step)
    return values


def _default(signal: SignalInfo) -> Array:
    return np.reshape(signal.default or np.zeros(signal.size), signal.shape)


def _periods(value: _Value, count: int) -> Array:
    """The period of every rollout, (count,) [s]."""
    if value.by_step:
        raise ValueError("period must be constant over a rollout to measure it, got one over time")
    period = np.broadcast_to(value.array, (count,))
    if wrong := period[~((period > 0) & np.isfinite(period))].tolist():
        raise ValueError(f"period must be above 0 s, got {wrong[0]}")
    return period


def _segment(steps: int, period: float, f_h: float) -> tuple[int, int]:
    """Samples in a Welch segment, and how many of its frequencies, from 0 Hz on, are below f_h."""
    segment = min(steps, max(8, round(WINDOW / period)))
    return segment, int(np.count_nonzero(np.fft.rfftfreq(segment, 1 / (1 / period)) < f_h))  # as Welch's method has it


# ---- The way to C ----


@dataclass(frozen=True, slots=True, eq=False)
class _Engine:
    """batch.c, compiled for blocks of `lanes` rollouts, and the step of as many at once, null where there is none."""

    code: Any
    lanes: int
    step_lanes: Any
    kept: Any  # the library that step_lanes is in


@lru_cache(maxsize=16)
def _engine(controller: CompiledController, flags: tuple[str, ...]) -> _Engine:
    """The engine of a controller; finding it anew would cost as much as a batch of a few thousand steps."""
    manifest, compiler = controller.manifest, controller.compiler or find_compiler()
    lanes = manifest.lanes or LANES
    own = Path(str(resources.files(__package__))) / "batch.c"
    engine = _library(_ffi, compile_library([own], compiler, (*flags, f"-DLANES={lanes}")))
    if manifest.lanes is None:
        return _Engine(engine, lanes, _ffi.NULL, None)
    source = controller.folder / f"{manifest.controller}_lanes.c"
    symbol = f"{manifest.controller}_step_lanes"
    library = _library(_declaring(symbol), compile_library([source], compiler, flags))
    return _Engine(engine, lanes, _ffi.cast("void *", getattr(library, symbol)), library)


@lru_cache
def _declaring(symbol: str) -> cffi.FFI:
    """What knows a step of many robots by this name; making it costs as much as a short batch."""
    ffi = cffi.FFI()
    ffi.cdef(f"void {symbol}(const double *const *, double *const *);")
    return ffi


def _library(ffi: Any, path: Path) -> Any:
    try:
        return ffi.dlopen(str(path))
    except OSError as error:
        raise BadInput(f"{path}: cannot be loaded, delete it to compile anew: {error}") from None


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """A group as C wants it, and what has to outlive its use."""

    group: _Group
    blocks: Indices
    pointer: Any
    kept: Any


def _plan(batch: _Batch, group: _Group, metrics: Sequence[str]) -> _Plan:
    """What C is told: the step, its inputs, what is measured, and where the results go."""
    blocks = group.blocks(batch.engine.lanes)
    wanted = {name: array for name, array in batch.results.items() if name in metrics}
    results = [*(wanted.get(name) for name in METRICS), batch.kept]
    states = [wanted.get(f"final_{name}") for name in batch.values]
    cosine, sine, weight = _spectrum(group.segment)
    told = {
        **_the_step(batch.controller.step, batch.engine),
        **_the_signals(batch.controller.manifest),
        "input": _ffi.new("clikgen_value[]", [_the_value(value) for value in batch.values.values()]),
        "steps": group.steps,
        "rollout": _ffi.cast("long long *", blocks.ctypes.data),
        "result": _ffi.new("double *[]", [_address(array) for array in results]),
        "final": _ffi.new("double *[]", [_address(array) for array in states]),
        "lost": LOST,
        "far": FAR,
        "encounter_gap": ENCOUNTER_GAP,
        "dead_band": max(batch.settings.dead_band, LEAST_PROMINENCE),
        "segment": group.segment,
        "bins": group.bins,
        "cosine": _address(cosine),
        "sine": _address(sine),
        "weight": _address(weight),
        "total_weight": float(np.sum(weight)),
    }
    return _Plan(group, blocks, _ffi.new("clikgen_batch *", told), (told, cosine, sine, weight))


def _the_step(step: CompiledFunction, engine: _Engine) -> dict[str, Any]:
    info = step.info
    inputs = [signal.name for signal in info.inputs]
    feeds = [inputs.index(signal.feeds) if signal.feeds else -1 for signal in info.outputs]
    return {
        "step": step.pointer,
        "step_lanes": engine.step_lanes,
        "inputs": len(info.inputs),
        "outputs": len(info.outputs),
        "sz_arg": info.sz_arg,
        "sz_res": info.sz_res,
        "sz_iw": info.sz_iw,
        "sz_w": info.sz_w,
        "size": _ffi.new("int[]", [signal.size for signal in info.outputs]),
        "feeds": _ffi.new("int[]", feeds),
    }


def _the_signals(manifest: Manifest) -> dict[str, Any]:
    """Which inputs and outputs the metrics are made of; what says that a one-sided task acts is as for one rollout."""
    info = manifest.function("step")
    inputs = [signal.name for signal in info.inputs]
    outputs = {signal.name: i for i, signal in enumerate(info.outputs)}
    tracked = next((f"{task.name}_error" for task in manifest.tracking_tasks), "")
    flags = ["active", "barrier_steps", *(f"{task.name}_share" for task in manifest.tasks)]
    flag = [outputs[name] for name in flags if name in outputs]
    measured = {name: outputs.get(name, -1) for name in ("dq", tracked, "clearance", "distance")}
    watched = [bool(one.feeds) or i in flag or i in measured.values() for i, one in enumerate(info.outputs)]
    return {
        "q": inputs.index("q"),
        "period": inputs.index("period"),
        "dq": measured["dq"],
        "error": measured[tracked],
        "clearance": measured["clearance"],
        "distance": measured["distance"],
        "flags": len(flag),
        "flag": _ffi.new("int[]", flag),
        "watched": _ffi.new("int[]", watched),
    }


def _spectrum(segment: int) -> tuple[Array, Array, Array]:
    """cos φ, sin φ and Hann's window squared, ((1 − cos φ)/2)² and a 0 at the end, at φ = 2πj/N in a segment of N."""
    angle = 2 * np.pi * np.arange(segment) / segment
    return np.cos(angle), np.sin(angle), np.append((0.5 - 0.5 * np.cos(angle)) ** 2, 0.0)


def _the_value(value: _Value) -> dict[str, Any]:
    where = {"by_rollout": value.by_rollout, "by_step": value.by_step}
    return {"data": _address(value.array), "size": value.size, **where}


def _address(array: Array | None) -> Any:
    """Where an array starts, which it is up to the caller to keep."""
    return _ffi.NULL if array is None else _ffi.cast("double *", array.ctypes.data)


def _aligned(size: int) -> NDArray[np.uint8]:
    """That many bytes, the first at a multiple of ALIGNMENT."""
    room = np.empty(size + ALIGNMENT, dtype=np.uint8)
    start = -room.ctypes.data % ALIGNMENT
    return room[start : start + size]


def cores() -> int:
    """The processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # where a process is not bound to some of them
        return os.cpu_count() or 1
