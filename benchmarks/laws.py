"""What a step costs under each activation, against the paper's switched one, and what the barrier's worst case costs.

Every state of the paper's scenario that is timed is timed under all laws in turn, round after round in one process;
so are states drawn at random, with three obstacles around the arm, among which the worst one is looked for.
`python benchmarks/laws.py [--json]`
"""

import json
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from common import compiler, machine, per_call
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.quadratic_program import MOST_STEPS
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.variants import with_activation

Array = NDArray[np.float64]
LAWS = ("switched", "hysteresis", "ramp", "damped", "barrier")
STATES = 120  # of the scenario, evenly spread
REPEATS = 10_000  # of one state in C, per round
ROUNDS = 7
RANDOM = 200_000  # states among which the worst one is looked for


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        controllers = {law: built(law, Path(folder)) for law in LAWS}
    along = costs(controllers, along_the_path(controllers))
    worst, steps, states = hardest(controllers["barrier"])
    report(
        {
            "machine": machine(),
            "compiler": compiler(),
            "states": STATES,
            "laws": {
                law: {
                    "median": float(np.median(ns)),
                    "p99": float(np.quantile(ns, 0.99)),
                    "largest": float(np.max(ns)),
                    "ratio": float(np.median(ns) / np.median(along["switched"])),
                    "largest_ratio": float(np.max(ns / along["switched"])),
                    "operations": controllers[law].step.info.operations,
                }
                for law, ns in along.items()
            },
            "worst": {"random_states": states, "steps": steps, "at_most": MOST_STEPS, "ns": worst},
        }
    )


def built(law: str, folder: Path) -> CompiledController:
    """Planar5 with all its one-sided tasks acting by `law`."""
    path = {one.stem: one for one in shipped_specs()}["planar5"]
    out = folder / law
    out.mkdir()
    for name, text in generate(with_activation(read_spec(path), law)).items():
        (out / name).write_text(text)
    return CompiledController.load(out)


def along_the_path(controllers: Mapping[str, CompiledController]) -> list[dict[str, Array]]:
    """What the step is fed at moments of the paper's scenario, as the barrier runs it."""
    scenario = read_scenario(find_scenario("paper"))
    known = {signal.name for signal in controllers["barrier"].step.info.inputs}
    kept = {name: value for name, value in scenario.parameters.items() if name in known}
    run = prepare(controllers["barrier"], scenario.model_copy(update={"parameters": kept}), CASES[1])
    rollout = run.in_c()
    shapes = {signal.name: signal.shape for signal in run.controller.step.info.inputs}
    return [
        {
            name: value[k] if value.shape != shapes[name] else value
            for name, value in run.values.items()
            if name in shapes
        }
        | {"q": rollout.q[k]}
        for k in np.linspace(0, run.steps - 1, STATES).astype(int)
    ]


def costs(controllers: Mapping[str, CompiledController], states: list[dict[str, Array]]) -> dict[str, Array]:
    """Nanoseconds per step of every law at every state, (states,): the least of the rounds."""
    found = {law: np.full(len(states), np.inf) for law in controllers}
    for _ in range(ROUNDS):
        for k, state in enumerate(states):
            for law, controller in controllers.items():
                names = {signal.name for signal in controller.step.info.inputs}
                values = {name: value for name, value in state.items() if name in names}
                cost = per_call(lambda step=controller.step, given=values: step.map(REPEATS, given), REPEATS)
                found[law][k] = min(found[law][k], cost)
    return found


def hardest(controller: CompiledController) -> tuple[float, int, int]:
    """The cost [ns] of the random state that takes the most steps, those steps, and how many states were tried."""
    rng = np.random.default_rng(0)
    count = controller.manifest.obstacles
    values = {
        "q": rng.uniform([-0.5, -0.5, -3, -2.8, -2.8], [0.5, 0.5, 3, 2.8, 2.8], (RANDOM, 5)),
        "tool_reference": rng.uniform(-1.5, 1.5, (RANDOM, 2)),
        "tool_reference_velocity": rng.uniform(-1, 1, (RANDOM, 2)),
        "obstacle_center": rng.uniform(-1.5, 1.5, (RANDOM, count, 2)),
        "obstacle_radius": rng.uniform(0, 0.2, (RANDOM, count)),
        "obstacle_velocity": rng.uniform(-0.5, 0.5, (RANDOM, count, 2)),
        "obstacle_count": np.array(float(count)),
    }
    steps = controller.step.map(RANDOM, values)["barrier_steps"]
    k = int(np.argmax(steps))
    state = {name: value[k] if len(value.shape) and len(value) == RANDOM else value for name, value in values.items()}
    return float(costs({"barrier": controller}, [state])["barrier"][0]), int(steps[k]), RANDOM


def report(document: dict) -> None:
    """The document as JSON, or as a table."""
    if "--json" in sys.argv[1:]:
        print(json.dumps(document, indent=2))
        return
    print(f"{document['machine']}\n{document['compiler']}")
    print(f"planar5, {document['states']} states along the paper's scenario\n")
    print(f"{'activation':<12}{'median':>10}{'p99':>10}{'largest':>10}{'median, of switched':>22}{'operations':>14}")
    for law, one in document["laws"].items():
        print(
            f"{law:<12}{one['median']:>7.0f} ns{one['p99']:>7.0f} ns{one['largest']:>7.0f} ns"
            f"{one['ratio']:>20.2f} x{one['operations']:>14}"
        )
    worst = document["worst"]
    print(
        f"\nhardest of {worst['random_states']} random states: {worst['steps']} steps of the quadratic program "
        f"(at most {worst['at_most']}), {worst['ns']:.0f} ns"
    )


if __name__ == "__main__":
    main()
