"""What a step of planar5 costs in batches: side by side in vectors of every width, with metrics, on more threads.

`python benchmarks/batch.py [--json]`

Everything in turn, round after round in one process; medians of the rounds, ratios within a round. All robots are in
states of their own. "one after the other" is the step in a loop in C, as it is, with vectors within a step, and
without any; "side by side" the same loop over blocks of lanes; all compiled here for the vectors of the row; then
`simulate_batch` as it is called, which brings up to date what it measures after every step. "arithmetic alone" is a
loop of vectors without memory on one thread and on all: no program gains more from a second core than that.
"""

import json
import statistics
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cffi
import growth
import numpy as np
from common import compiler, machine, per_call
from numpy.typing import NDArray

from clikgen.runtime.batch import METRICS, cores, simulate_batch
from clikgen.runtime.compiler import FLAGS, NATIVE, find_compiler
from clikgen.runtime.controller import CompiledController

ROUNDS = 25
STATES = 512  # of their own: they stay in the cache, as a batch does
LAPS = 256  # times over all of them
ROLLOUTS, PERIODS = 4096, 400
SPIN = 20_000_000
HERE = Path(__file__).parent
VECTORS = {"SSE2": ("x86-64", "sse2"), "AVX2": ("x86-64-v3", "avx2"), "AVX-512": ("x86-64-v4", "avx512dq")}
_LOOP = "long, long, int, double **, const long *, double **"
SCALAR = "one after the other, -march=native"
NO_VECTORS = ("-UCLIKGEN_OPENMP", "-fno-tree-vectorize")

Array = NDArray[np.float64]
Work = Callable[[], object]


def loop(controller: CompiledController, folder: Path, march: str, lanes: int, *extra: str) -> Work:
    """LAPS times all states in C: blocks of `lanes` robots side by side, or one robot after the other."""
    name, info = controller.manifest.controller, controller.step.info
    symbol, source = (f"{name}_step_lanes", f"{name}_lanes.c") if lanes > 1 else (f"{name}_step", f"{name}.c")
    library = folder / f"{symbol}-{march}{''.join(extra)}.so"
    flags = (*FLAGS, "-O3", f"-march={march}", *extra, "-shared", "-lm")
    sources = (HERE / "batch_loops.c", controller.folder / source)
    subprocess.run([*find_compiler().command, *map(str, sources), *flags, "-o", str(library)], check=True)
    ffi = cffi.FFI()
    ffi.cdef(f"int {symbol}(); void repeat(void *, void *, {_LOOP});")
    call, states, blocks = ffi.dlopen(str(library)), growth.states(controller), STATES // lanes
    inputs, strides = [], []
    for signal in info.inputs:
        own, size = signal.name in states, signal.size
        value = np.asarray(states[signal.name][:STATES] if own else controller.step.inputs[signal.name], dtype=float)
        rows = np.broadcast_to(value.reshape(-1, size), (STATES if own else lanes, size))
        inputs.append(aligned(rows.reshape(-1, lanes, size).transpose(0, 2, 1)))
        strides.append(size * lanes if own else 0)
    outputs = [aligned(np.zeros((signal.size, lanes))) for signal in info.outputs]
    arg, res = (
        ffi.new("double *[]", [ffi.cast("double *", array.ctypes.data) for array in arrays])
        for arrays in (inputs, outputs)
    )
    function = ffi.cast("void *", getattr(call, symbol))
    one, many = (ffi.NULL, function) if lanes > 1 else (function, ffi.NULL)
    kept = inputs, outputs, ffi

    def work() -> object:
        call.repeat(one, many, LAPS, blocks, len(strides), arg, strides, res)
        return kept

    return work


def aligned(array: Array) -> Array:
    """A copy that starts where a line of the cache does, as blocks of `simulate_batch` do."""
    room = np.empty(array.size + 8)
    start = -room.ctypes.data % 64 // 8
    copy = room[start : start + array.size].reshape(array.shape)
    copy[...] = array
    return copy


def batch(controller: CompiledController, metrics: tuple[str, ...], threads: int) -> None:
    """ROLLOUTS rollouts of PERIODS steps, the robots around one place, each to a target of its own."""
    rng = np.random.default_rng(4)
    q = np.array([0.0, 0.0, 0.0, 0.6, -0.9]) + rng.uniform(-0.2, 0.2, (ROLLOUTS, 5))
    shared = {"obstacle_center": np.array([[0.8, 0.93], [-1.22, 0.0], [0.2, -0.75]]), "obstacle_count": 3.0}
    each = {"q": q, "tool_reference": rng.uniform(-1, 1, (ROLLOUTS, 2))}
    simulate_batch(controller, PERIODS, ROLLOUTS, shared, each, metrics, threads=threads)


def spin(call: Any, threads: int) -> None:
    """SPIN turns on every thread."""
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(call.spin, [SPIN] * threads))


def main() -> None:
    controller, all_cores = CompiledController.load("planar5"), cores()
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    with TemporaryDirectory() as place:
        folder, count = Path(place), LAPS * STATES
        ways: dict[str, tuple[Work, int]] = {SCALAR: (loop(controller, folder, "native", 1), count)}
        ways["the same without vectors"] = loop(controller, folder, "native", 1, *NO_VECTORS), count
        for name, (march, flag) in VECTORS.items():
            if flag in flags:
                ways[f"side by side, {name}"] = loop(controller, folder, march, controller.manifest.lanes or 1), count
        work = ROLLOUTS * PERIODS
        for label, metrics in (("final state", ("final_q",)), ("all metrics", METRICS)):
            for threads in sorted({1, all_cores}):
                name = f"simulate_batch, {label}, {threads} thread{'s' * (threads > 1)}"
                ways[name] = partial(batch, controller, metrics, threads), work
        ffi = cffi.FFI()
        ffi.cdef("double spin(long long);")
        subprocess.run(
            [*find_compiler().command, *FLAGS, *NATIVE, "-o", f"{place}/spin.so", HERE / "batch_loops.c"],
            check=True,
        )
        call = ffi.dlopen(f"{place}/spin.so")
        for threads in sorted({1, all_cores}):
            name = f"arithmetic alone, {threads} thread{'s' * (threads > 1)}"
            ways[name] = partial(spin, call, threads), SPIN * threads
        costs: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, (one, calls) in ways.items():
                costs[name].append(per_call(one, calls))
    rows = []
    for name, values in costs.items():
        against = name.replace(f"{all_cores} threads", "1 thread") if name.endswith("threads") else SCALAR
        ratio = statistics.median(a / b for a, b in zip(costs[against], values, strict=True))
        alone = name.startswith("arithmetic") and against == SCALAR
        rows.append(
            {"name": name, "ns": statistics.median(values), "least": min(values), "times": None if alone else ratio}
        )
    document = {"machine": machine(), "compiler": compiler(), "rounds": ROUNDS, "rows": rows}
    if "--json" in sys.argv:
        print(json.dumps(document, indent=2))
        return
    print(f"{document['machine']}\n{document['compiler']}\nmedians of {ROUNDS} rounds\n")
    print(f"{'planar5, ns of a step of one robot':<50}{'ns':>8}{'least':>8}   as fast as")
    for row in rows:
        against = "one thread" if row["name"].endswith("threads") else "one after the other"
        times = f"   {row['times']:.2f} times {against}" if row["times"] and row["name"] != SCALAR else ""
        print(f"{row['name']:<50}{row['ns']:8.2f}{row['least']:8.2f}{times}")


if __name__ == "__main__":
    main()
