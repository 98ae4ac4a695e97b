"""What one step costs in C: ours, CasADi's C of the same expressions, and CasADi's C of the paper's formulas.

`python benchmarks/step.py [--json]`

Each variant is compiled with its flags and stepped in C, in turn, round after round in one process; medians of the
rounds. `ns` is a step in a state that stays, `ns new` one in another state every time, in which the processor guesses
branches wrong. The floor is a model: additions, products, with an addition in one (FMA) where there is one, quotients
and roots, each at what it costs on this machine where nothing waits (`rate`), one after the other, one robot in scalar
code; loads, stores and selects for nothing. No step can be faster than its longest chain, in which each waits for the
one before (`delay`); one that keeps all units of the processor busy at once would take the greatest of these alone.
Instructions are callgrind's, where valgrind is there, and without the vectors and the FMA of this processor. Then the
call from Python, and a rollout.
"""

import json
import re
import shutil
import statistics
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import casadi as ca
import cffi
import growth
import numpy as np
import textbook
from common import compiler, machine, per_call
from numpy.typing import NDArray

from clikgen.runtime.compiler import FLAGS, NATIVE, find_compiler
from clikgen.runtime.controller import CompiledController, CompiledFunction, load_library
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import Run, prepare
from clikgen.symbolic.controller import Controller, ControllerFunction, build
from clikgen.symbolic.emitter import Names, function_text, module_text
from clikgen.symbolic.generate import generate
from clikgen.symbolic.graph import FUSED
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.stage import Procedure

ROUNDS = 25
CALLS = 20_000
ROLLOUTS = 10
SAME = 1e-6
PLAIN = ("-O2", "-fPIC")
FORMULAS = "the paper's formulas"
CHAINS = {"add": "add", "sub": "add", "mul": "mul", "div": "div", "sqrt": "sqrt", "select": "select"}
CHAINS |= dict.fromkeys(FUSED, "fma")
SINCOS = Counter(add=2, mul=6, fma=16)  # of our own sine and cosine together, bits aside
SINCOS_CHAIN = Counter(add=2, mul=3, fma=4)
HERE = Path(__file__).parent
_STEP = "int {}(const double **, double **, long long *, double *, int);"
_CALLS = """
typedef struct { void *function; const double **arg; double **res; long long *iw; double *w; } clikgen_evaluation;
typedef struct { double **pointer; long long stride; } clikgen_walk;
int clikgen_repeat(const clikgen_evaluation *, long long, const clikgen_walk *, int);
"""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Variant:
    name: str
    source: str
    flags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Floor:
    """What the model counts [ns]."""

    additions: float
    products: float
    divider: float
    chain: float

    @property
    def ns(self) -> float:
        """One after the other."""
        return self.additions + self.products + self.divider

    @property
    def at_once(self) -> float:
        return max(self.additions, self.products, self.divider, self.chain)


def variants(controller: Controller) -> Iterator[Variant]:
    """CasADi's C and ours, of the paper's formulas, of those with one improvement after the other, and of ours."""
    spec, function = controller.spec, controller.functions[-1]
    better = textbook.BETTER.get(spec.name)
    if better is not None:
        yield Variant(f"{FORMULAS}, CasADi's C, plain flags", _by_casadi(textbook.step(spec, function)), PLAIN)
    by_casadi = _by_casadi(function.procedure.unrolled(lambda _: True))
    yield Variant("our expressions, CasADi's C, plain flags", by_casadi, PLAIN)
    yield Variant("our expressions, CasADi's C, our flags", by_casadi, (*FLAGS, *NATIVE))
    for count in range(len(better or ()) + 1) if better else ():
        name = f"  {better[count - 1]}" if count else f"{FORMULAS}, our C"
        yield Variant(name, _emitted(function, textbook.step(spec, function, better[:count])), (*FLAGS, *NATIVE))
    files = generate(spec)
    header, source = files[f"{spec.name}.h"], files[f"{spec.name}.c"]
    source = source.replace(f'#include "{spec.name}.h"', header)
    yield Variant("ours with libm's sine and cosine", _with_libm(source), (*FLAGS, *NATIVE))
    yield Variant("ours", source, (*FLAGS, *NATIVE))


def _by_casadi(procedure: Procedure) -> str:
    function = procedure.casadi()
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    return str(generator.dump())


def _emitted(function: ControllerFunction, procedure: Procedure) -> str:
    """In our C, nothing of it in a loop."""
    names = Names("double")
    labels = [[one.info.name for one in signals] for signals in (function.inputs, function.outputs)]
    return module_text([function_text(procedure, *labels, names)], names)


def _with_libm(source: str) -> str:
    """The same but for the sine and the cosine."""
    text, count = re.subn(
        r"(static inline void clikgen_sincos\(.*?\) \{\n).*?\n\}",
        r"\1  *sine = sin(x);\n  *cosine = cos(x);\n}",
        source,
        flags=re.DOTALL,
    )
    assert count == 1
    return text


def measured(controller: Controller, folder: Path) -> list[tuple[str, float, float, float | None]]:
    """Name, ns, ns in new states, instructions of each variant."""
    name = controller.spec.name
    for file, text in generate(controller.spec).items():
        (folder / file).write_text(text)
    loaded = CompiledController.load(folder)
    states = growth.states(loaded)
    rows, work = [], []
    for variant in variants(controller):
        library = built(variant, folder)
        ffi = cffi.FFI()
        ffi.cdef(_CALLS + _STEP.format(f"{name}_step"))
        call = ffi.dlopen(str(library))
        work.append((stepping(ffi, call, loaded, states, new=False), stepping(ffi, call, loaded, states, new=True)))
        rows.append(variant)
        check(variant, loaded, load_library(library, [loaded.step.info.symbol]), states)
    costs: list[tuple[list[float], list[float]]] = [([], []) for _ in rows]
    for _ in range(ROUNDS):
        for (staying, new), (cost, cost_new) in zip(work, costs, strict=True):
            cost.append(per_call(staying, CALLS))
            cost_new.append(per_call(new, growth.STATES))
    return [
        (one.name, statistics.median(cost), statistics.median(cost_new), instructions(one, loaded, states, folder))
        for one, (cost, cost_new) in zip(rows, costs, strict=True)
    ]


def check(variant: Variant, loaded: CompiledController, code: object, states: dict[str, Array]) -> None:
    """What is compared gives our numbers, in all states; the textbook's quaternion loses half its digits at w = 0."""
    ours, theirs = (one.map(growth.STATES, states) for one in (loaded.step, CompiledFunction(loaded.step.info, code)))
    for name, value in ours.items():
        scale = np.maximum(np.abs(value.reshape(growth.STATES, -1)).max(axis=1), 1)
        apart = np.abs(theirs[name] - value).reshape(growth.STATES, -1).max(axis=1) / scale
        if np.max(apart) > SAME:
            raise SystemExit(f"{variant.name}: {name} of another step, {np.max(apart):.2g} apart")


def built(variant: Variant, folder: Path) -> Path:
    """The shared library of a variant."""
    place = folder / re.sub(r"\W+", "_", variant.name)
    place.with_suffix(".c").write_text(variant.source)
    calls = Path(CompiledController.load.__globals__["__file__"]).parent / "calls.c"
    command = [*find_compiler().command, "-shared", *variant.flags, "-o", str(place.with_suffix(".so"))]
    subprocess.run([*command, str(place.with_suffix(".c")), str(calls), "-lm"], check=True, capture_output=True)
    return place.with_suffix(".so")


def stepping(
    ffi: cffi.FFI, library: object, loaded: CompiledController, states: dict[str, Array], *, new: bool
) -> Callable[[], int]:
    """Work in C: CALLS steps in one state after each other, or one in each of the states."""
    info = loaded.step.info
    count = growth.STATES if new else CALLS
    inputs = [np.ascontiguousarray(states.get(one.name, loaded.step.inputs[one.name])) for one in info.inputs]
    moving = [(k, one.size) for k, one in enumerate(info.inputs) if new and one.name in states]
    outputs = [np.zeros(one.size) for one in info.outputs]
    iw, w = ffi.new("long long[]", 4096), ffi.new("double[]", 65536)
    pad = [ffi.NULL] * 64

    def work() -> int:
        arg = ffi.new("const double *[]", [ffi.from_buffer("double *", one) for one in inputs] + pad)
        res = ffi.new("double *[]", [ffi.from_buffer("double *", one) for one in outputs] + pad)
        function = ffi.cast("void *", getattr(library, info.symbol))
        one = ffi.new("clikgen_evaluation *", {"function": function, "arg": arg, "res": res, "iw": iw, "w": w})
        walks = ffi.new("clikgen_walk[]", [(ffi.cast("double **", arg + k), size) for k, size in moving])
        return int(library.clikgen_repeat(one, count, walks, len(walks)))

    return work


def instructions(variant: Variant, loaded: CompiledController, states: dict[str, Array], folder: Path) -> float | None:
    """Of one step in the first of the states, counted by callgrind; None without valgrind."""
    if shutil.which("valgrind") is None:
        return None
    info, many = loaded.step.info, 1000
    values = [
        np.ravel(states[one.name][0] if one.name in states else loaded.step.inputs[one.name]) for one in info.inputs
    ]
    tables = "".join(
        f"static const double i{k}[] = {{{', '.join(map(repr, map(float, value)))}}};\n"
        for k, value in enumerate(values)
    )
    tables += "".join(f"static double o{k}[{one.size}];\n" for k, one in enumerate(info.outputs))
    arg = ", ".join(f"i{k}" for k in range(len(values)))
    res = ", ".join(f"o{k}" for k in range(len(info.outputs)))
    program = (
        f"#include <stdlib.h>\nint {info.symbol}(const double **, double **, long long *, double *, int);\n{tables}"
        f"int main(int n, char **v) {{\n  (void)n;\n  static long long iw[4096];\n  static double w[65536];\n"
        f"  for (int k = atoi(v[1]); k > 0; --k) {{\n    const double *arg[128] = {{{arg}}};\n"
        f"    double *res[128] = {{{res}}};\n    {info.symbol}(arg, res, iw, w, 0);\n  }}\n  return 0;\n}}\n"
    )
    (folder / "main.c").write_text(program)
    source = folder / (re.sub(r"\W+", "_", variant.name) + ".c")
    flags = [flag for flag in variant.flags if flag not in ("-shared", "-march=native")]
    command = [*find_compiler().command, *flags, "-o", str(folder / "main"), str(folder / "main.c"), str(source), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    counts = [_collected(folder, times) for times in (1, many + 1)]
    return (counts[1] - counts[0]) / many


def _collected(folder: Path, times: int) -> int:
    command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder / 'callgrind'}", str(folder / "main")]
    outcome = subprocess.run([*command, str(times)], check=True, capture_output=True, text=True)
    found = re.search(r"Collected : (\d+)", outcome.stderr)
    assert found, outcome.stderr
    return int(found[1])


def floor(controller: Controller, rate: dict[str, float], delay: dict[str, float]) -> Floor:
    """The model for a step whose loops are all written out."""
    graph = controller.functions[-1].procedure.unrolled(lambda _: True).graph().fused()
    needed = graph.needed()
    count = Counter(CHAINS[graph.nodes[i].operation] for i in needed if graph.nodes[i].operation in CHAINS)
    angles = {graph.nodes[i].arguments for i in needed if graph.nodes[i].operation in ("sin", "cos")}
    for _ in angles:
        count += SINCOS
    ready: dict[int, float] = {}
    for i in needed:
        node = graph.nodes[i]
        own = delay[CHAINS[node.operation]] if node.operation in CHAINS else 0.0
        if node.operation in ("sin", "cos"):
            own = sum(times * delay[kind] for kind, times in SINCOS_CHAIN.items())
        ready[i] = own + max((ready[k] for k in node.arguments), default=0.0)
    return Floor(
        count["add"] * rate["add"],
        count["mul"] * rate["mul"] + count["fma"] * rate["fma"],
        count["div"] * rate["div"] + count["sqrt"] * rate["sqrt"],
        max(ready.values()),
    )


def units(folder: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Nanoseconds of each operation: where nothing waits, and where each waits for the one before."""
    library = folder / "units.so"
    flags = ["-O2", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared", "-march=native", "-ffp-contract=fast"]
    subprocess.run([*find_compiler().command, *flags, "-o", str(library), str(HERE / "units.c"), "-lm"], check=True)
    ffi, kinds = cffi.FFI(), sorted(set(CHAINS.values()))
    ffi.cdef("".join(f"double {way}_{kind}(long, double);" for way in ("rate", "delay") for kind in kinds))
    call, n = ffi.dlopen(str(library)), 4_000_000
    found: dict[str, dict[str, float]] = {}
    for way in ("rate", "delay"):
        found[way] = {kind: min(getattr(call, f"{way}_{kind}")(n, 1.0000001) for _ in range(5)) for kind in kinds}
    return found["rate"], found["delay"]


def from_python() -> dict[str, float]:
    """Nanoseconds of a step called from Python, in contact, and of a rollout's step."""
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
    step = controller.step
    without = CompiledFunction(step.info, step.code)
    for function in (step, without):
        function(**now)
    ways: dict[str, tuple[Callable[[], object], int]] = {
        "step()": (lambda: bare(step, CALLS), CALLS),
        "step(...), 4 inputs by name": (lambda: by_name(step, CALLS, **moving), CALLS),
        "the same without Python.h": (lambda: by_name(without, CALLS // 10, **moving), CALLS // 10),
        "a rollout, whole in C": (lambda: rollouts(run), ROLLOUTS * run.steps),
    }
    costs: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, (work, calls) in ways.items():
            costs[name].append(per_call(work, calls))
    return {name: statistics.median(values) for name, values in costs.items()}


def bare(step: CompiledFunction, calls: int) -> None:
    for _ in range(calls):
        step()


def by_name(
    step: CompiledFunction,
    calls: int,
    q: Array,
    tool_reference: Array,
    tool_reference_velocity: Array,
    obstacle_center: Array,
) -> None:
    for _ in range(calls):
        step(
            q=q,
            tool_reference=tool_reference,
            tool_reference_velocity=tool_reference_velocity,
            obstacle_center=obstacle_center,
        )


def rollouts(run: Run) -> None:
    for _ in range(ROLLOUTS):
        run.controller.rollout(run.steps, run.values)


def main() -> None:
    document: dict[str, object] = {"machine": machine(), "compiler": compiler(), "rounds": ROUNDS}
    specs = [read_spec(path) for path in (*shipped_specs(), HERE / "peers" / "arm7.toml")]
    written = "--json" in sys.argv
    with TemporaryDirectory() as place:
        rate, delay = units(Path(place))
        document["ns of an operation"] = {"rate": rate, "delay": delay}
        if not written:
            print(f"{document['machine']}\n{document['compiler']}\nmedians of {ROUNDS} rounds\n")
        chosen = {spec.name: spec for spec in specs if spec.name in ("planar5", "arm7")}
        many = growth.with_obstacles(chosen["planar5"], 100)
        for controller in map(build, (*chosen.values(), many)):
            folder = Path(place) / controller.spec.name
            folder.mkdir()
            rows, least = measured(controller, folder), floor(controller, rate, delay)
            document[controller.spec.name] = {
                "variants": [dict(zip(("name", "ns", "ns new", "instructions"), row, strict=True)) for row in rows],
                "floor": {
                    "ns": least.ns,
                    "at once": least.at_once,
                    **{key: getattr(least, key) for key in least.__slots__},
                },
            }
            if not written:
                report(controller.spec.name, rows, least)
    document["from Python"] = from_python()
    if written:
        print(json.dumps(document, indent=2))
        return
    print("planar5 from Python, in contact")
    for name, value in document["from Python"].items():
        print(f"{name:<55}{value:8.0f} ns")


def report(name: str, rows: list[tuple[str, float, float, float | None]], least: Floor) -> None:
    ours = rows[-1]
    print(f"{name:<55}{'ns':>8}{'of ours':>9}{'ns new':>9}{'of ours':>9}{'instructions':>14}")
    for title, ns, ns_new, count in rows:
        counted = f"{count:14.0f}" if count is not None else f"{'':>14}"
        print(f"{title:<55}{ns:8.0f}{ns / ours[1]:9.2f}{ns_new:9.0f}{ns_new / ours[2]:9.2f}{counted}")
    bounds = ", ".join(f"{key} {getattr(least, key):.0f}" for key in least.__slots__)
    print(f"{'floor: ' + bounds:<55}{least.ns:8.0f}   ours is {ours[1] / least.ns:.2f} times it")
    print(
        f"{'all at once, the longest chain included':<55}{least.at_once:8.0f}   {ours[1] / least.at_once:.2f} times\n"
    )


if __name__ == "__main__":
    main()
