"""What one step costs: the bare C call, the same from Python, and per step of a whole rollout in C.

The three are timed in turn, round after round in one process, on the paper's scenario; medians of the rounds.
`python benchmarks/step.py [--json]`
"""

import json
import statistics
import sys
from collections.abc import Callable
from pathlib import Path

import cffi
import numpy as np
from common import compiler, machine, per_call

from clikgen.runtime.compiler import compile_library
from clikgen.runtime.controller import CompiledController, find_controller
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import Run, prepare

ROUNDS = 25
CALLS = 20_000
ROLLOUTS = 10


def main() -> None:
    controller = CompiledController.load("planar5")
    run = prepare(controller, read_scenario(find_scenario("paper")), CASES[3])
    rollout = run.in_c()
    k = int(np.flatnonzero(rollout.active)[100])  # a step in contact
    now = {
        name: np.array(
            rollout.q[k] if name == "q" else value[k] if value.ndim > len(buffer.shape) else value, dtype=float
        )
        for name, buffer in controller.step.inputs.items()
        for value in [np.asarray(run.values[name])]
    }
    moving = {name: now[name] for name in ("q", "tool_reference", "tool_reference_velocity", "obstacle_center")}
    controller.step(**now)
    bare = bare_call(controller)
    costs: dict[str, list[float]] = {
        "bare C step": [],
        "step() from Python": [],
        "step(...) from Python": [],
        "C rollout": [],
    }
    for _ in range(ROUNDS):
        costs["bare C step"].append(per_call(lambda: bare(CALLS), CALLS))
        costs["step() from Python"].append(per_call(lambda: repeat(controller.step, {}), CALLS // 10))
        costs["step(...) from Python"].append(per_call(lambda: repeat(controller.step, moving), CALLS // 10))
        costs["C rollout"].append(per_call(lambda: rollouts(run), ROLLOUTS * run.steps))
    report({name: statistics.median(values) for name, values in costs.items()}, len(moving))


def bare_call(controller: CompiledController) -> Callable[[int], int]:
    """A function that calls the compiled step so many times in C, on the controller's own buffers."""
    folder = find_controller("planar5")
    library = compile_library([folder / "planar5.c", Path(__file__).parent / "repeat.c"])
    ffi = cffi.FFI()
    ffi.cdef("int planar5_step(const double **, double **, long long *, double *, int);")
    ffi.cdef(
        "int clikgen_repeat(int (*)(const double **, double **, long long *, double *, int), long long, "
        "const double **, double **);"
    )
    compiled = ffi.dlopen(str(library))
    arg = ffi.new("const double *[]", [ffi.from_buffer("double *", b) for b in controller.step.inputs.values()])
    res = ffi.new("double *[]", [ffi.from_buffer("double *", b) for b in controller.step.outputs.values()])
    return lambda times: int(compiled.clikgen_repeat(compiled.planar5_step, times, arg, res))


def repeat(step: Callable[..., object], values: dict[str, np.ndarray]) -> None:
    for _ in range(CALLS // 10):
        step(**values)


def rollouts(run: Run) -> None:
    for _ in range(ROLLOUTS):
        run.controller.rollout(run.steps, run.values)


def report(cost: dict[str, float], named: int) -> None:
    bare = cost["bare C step"]
    budget = 5 * bare + 1500
    document = {
        "machine": machine(),
        "compiler": compiler(),
        "ns": {name: round(value) for name, value in cost.items()},
        "step(...) over its budget of 5 bare calls + 1.5 us": round(cost["step(...) from Python"] / budget, 3),
        "C rollout over bare": round(cost["C rollout"] / bare, 3),
    }
    if "--json" in sys.argv:
        print(json.dumps(document, indent=2))
        return
    print(
        f"{document['machine']}\n{document['compiler']}\n"
        f"planar5, paper scenario, a step in contact; medians of {ROUNDS} rounds\n"
    )
    for name, value in cost.items():
        note = f" ({named} inputs set)" if name == "step(...) from Python" else ""
        print(f"{name + note:<40}{value:8.0f} ns   {value / bare:6.2f} x bare")
    print(f"\nstep(...) / (5 bare + 1.5 us) = {cost['step(...) from Python'] / budget:.2f}   (at most 1)")
    print(f"C rollout / bare              = {cost['C rollout'] / bare:.2f}   (at most 1.3)")


if __name__ == "__main__":
    main()
