"""The chatter benchmark: every law on every scenario, from one contact to a mobile manipulator, noise and delay.

Writes the summary page `benchmarks/chatter/README.md` with its figure, the metrics as `results.json` and every
intrusion as `intrusions.csv`. `python benchmarks/chatter.py [--out DIR]`
"""

import csv
import io
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from clikgen.analysis.comparison import LAWS, Compared, Intrusion, Law, barrier_diagnostics, compare, intrusions
from clikgen.analysis.metrics import metrics
from clikgen.analysis.oscillation import ALLOWED, WINDOW, Oscillation, oscillations
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import json_text, write_atomically
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import Rollout, prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs
from clikgen.symbolic.variants import with_activation, with_planner, without_one_sided_tasks

HERE = Path(__file__).parent / "chatter"


@dataclass(frozen=True, slots=True)
class Trial:
    """A scenario of the benchmark: its title, its file or the name it ships under, and what is set."""

    title: str
    scenario: str
    settings: tuple[str, ...] = ()


def here(title: str, name: str, *settings: str) -> Trial:
    """One of this folder's own scenarios."""
    return Trial(title, str(HERE / f"{name}.toml"), settings)


TRIALS = (
    Trial("one contact (the paper's)", "paper"),
    here("several contacts", "two_contacts"),
    here("narrow passage", "narrow_passage"),
    here("opposed obstacles", "opposed"),
    here("goal inside a region", "goal_inside"),
    here("moving obstacle", "moving_obstacle"),
    here("joint limit", "joint_limits"),
    here("beyond reach", "beyond_reach"),
    Trial("10R arm among discs", "snake"),
    Trial("walls, six-axis arm", "inspection"),
    Trial("elbow pushed, seven axes", "shelf"),
    Trial("3-D mobile manipulator", "corridor"),
    Trial("self-collision, two arms", "carry"),
    Trial("noise of 2 mm", "paper", ("sensing.noise=0.002", "metrics.dead_band=0.1")),
    here("delay of 50 ms", "moving_obstacle", "sensing.delay=0.05"),
    Trial("one contact, T = 0.5 ms", "paper", ("period=0.0005",)),
    Trial("one contact, T = 2 ms", "paper", ("period=0.002",)),
    Trial("one contact, T = 5 ms", "paper", ("period=0.005",)),
    Trial("one contact, T = 20 ms", "paper", ("period=0.02",)),
    here("moving obstacle, T = 20 ms", "moving_obstacle", "period=0.02"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What a law did in a trial, the same without anything to keep off, and which joints oscillated."""

    compared: Compared
    free: Rollout
    oscillating: Sequence[Oscillation]
    intrusions: Sequence[Intrusion]


def main() -> None:
    out = Path(sys.argv[sys.argv.index("--out") + 1]) if "--out" in sys.argv else HERE
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        results = {}
        for trial in TRIALS:
            print(trial.title, file=sys.stderr)
            results[trial] = tried(trial, workshop)
    write_atomically(out / "results.json", json_text(document(results)).encode())
    write_atomically(out / "intrusions.csv", intrusion_list(results).encode())
    figure = picture(results)
    figure.savefig(out / "summary.png", dpi=130)
    write_atomically(out / "README.md", page(results).encode())


class Workshop:
    """Controllers by their spec, each generated and compiled once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.done: dict[str, CompiledController] = {}

    def compiled(self, spec: ControllerSpec) -> CompiledController:
        """The controller of a spec."""
        key = spec.sha256()
        if key not in self.done:
            (self.folder / key).mkdir()
            for name, text in generate(spec).items():
                (self.folder / key / name).write_text(text)
            self.done[key] = CompiledController.load(self.folder / key)
        return self.done[key]


def tried(trial: Trial, workshop: Workshop, laws: Sequence[Law] = tuple(LAWS.values())) -> dict[str, Result]:
    """Every law's result, by its name."""
    scenario = read_scenario(find_scenario(trial.scenario), trial.settings)
    spec = read_spec({path.stem: path for path in shipped_specs()}[scenario.controller])
    own = workshop.compiled(spec)
    controllers = {law: workshop.compiled(variant(spec, law)) for law in laws}
    free = free_run(workshop.compiled(without_one_sided_tasks(spec)), scenario)
    compared = compare(controllers, own.manifest, scenario, ())
    found = intrusions(compared)
    return {
        each.law.name: Result(
            each,
            free,
            oscillations(each.rollout.before_divergence(), free, scenario.metrics.dead_band),
            [one for one in found if one.law == each.law.name],
        )
        for each in compared
    }


def variant(spec: ControllerSpec, law: Law) -> ControllerSpec:
    """The spec under a law."""
    acting = with_activation(spec, law.activation)
    return with_planner(acting, law.planner) if law.planner else acting


def free_run(controller: CompiledController, scenario: Scenario) -> Rollout:
    """The scenario without anything to keep off."""
    known = {signal.name for signal in controller.step.info.inputs}
    kept = {name: value for name, value in scenario.parameters.items() if name in known}
    nothing = {"parameters": kept, "obstacles": (), "capsules": (), "half_spaces": ()}
    return prepare(controller, scenario.model_copy(update=nothing), CASES[1]).in_c()


def document(results: Mapping[Trial, Mapping[str, Result]]) -> dict:
    """All metrics of all laws in all trials."""
    return {
        trial.title: {
            name: {
                **metrics(one.compared.rollout).as_dict(),
                "free": {key: metrics(one.free).as_dict()[key] for key in ("hf_rms", "total_variation")},
                "oscillating": [each.joint for each in one.oscillating],
                "deepest_intrusion": max((each.depth for each in one.intrusions), default=0.0),
                "barrier": barrier_diagnostics(one.compared.rollout),
            }
            for name, one in laws.items()
        }
        for trial, laws in results.items()
    }


def intrusion_list(results: Mapping[Trial, Mapping[str, Result]]) -> str:
    """Every intrusion of every law, a line each."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["scenario", "law", "point", "depth", "unit", "at [s]", "from [s]", "to [s]"])
    for trial, laws in results.items():
        for name, one in laws.items():
            for each in one.intrusions:
                place = [f"{value:.6g}" for value in (each.depth, each.at, each.start, each.end)]
                writer.writerow([trial.title, name, each.point, place[0], each.unit, *place[1:]])
    return text.getvalue()


# ---- The page ----


def page(results: Mapping[Trial, Mapping[str, Result]]) -> str:
    """The summary in Markdown."""
    names = list(LAWS)
    head = "| scenario | " + " | ".join(names) + " |\n|---|" + "---|" * len(names) + "\n"

    def table(cell) -> str:
        return head + "".join(
            f"| {trial.title} | " + " | ".join(cell(laws[name]) for name in names) + " |\n"
            for trial, laws in results.items()
        )

    return f"""# The chatter benchmark

{len(TRIALS)} scenarios under {len(names)} laws, by `make chatter`: the paper's three cases (`case1` to `case3`), its
planner made smooth (`smooth`), and four activations without a filter. The shipped numbers and each activation's
defaults; nothing is tuned to a scenario. All figures are in [results.json](results.json), every intrusion of every law
in [intrusions.csv](intrusions.csv).

![hf_rms of every law in every scenario; a ring where a joint oscillates](summary.png)

## Joints that oscillate

Joints with more than {ALLOWED} turning points of their velocity within {WINDOW:g} s, each beyond the scenario's
dead-band, that the same run without anything to keep off does not have.

{table(lambda one: str(len(one.oscillating) or "–"))}
## Deepest intrusion

In mm (mrad at joints); – for none deeper than a micrometre.

{table(lambda one: _deepest(one.intrusions))}
## Tracking error, RMS

In mm.

{table(lambda one: f"{1e3 * metrics(one.compared.rollout).tracking_rms:.3g}")}
## What the barrier adds, and what it says of itself

The free run has the same reference and nothing to keep off: its share is what no law can take away. Then the largest
violation of a row [m/s, rad/s], the periods with one, and the most steps of the quadratic program in a period.

| scenario | total_variation | its share | hf_rms | its share | largest violation | steps with one | most steps |
|---|---|---|---|---|---|---|---|
{"".join(_diagnostics(trial, laws["barrier"]) for trial, laws in results.items())}"""


def _deepest(found: Sequence[Intrusion]) -> str:
    deepest = max((1e3 * each.depth for each in found), default=0.0)
    return f"{deepest:.2g}" if deepest > 1e-3 else "–"


def _diagnostics(trial: Trial, one: Result) -> str:
    says = barrier_diagnostics(one.compared.rollout) or {}
    ours, free = metrics(one.compared.rollout), metrics(one.free)
    return (
        f"| {trial.title} | {ours.total_variation:.3g} | {free.total_variation / ours.total_variation:.0%} "
        f"| {ours.hf_rms:.2g} | {free.hf_rms / ours.hf_rms:.0%} "
        f"| {says['excess']:.2g} | {says['infeasible']} | {says['most_steps']} |\n"
    )


def picture(results: Mapping[Trial, Mapping[str, Result]]) -> Figure:
    """hf_rms by colour, a ring where a joint oscillates: a row a scenario, a column a law."""
    trials, names = list(results), list(LAWS)
    values = np.array([[metrics(results[t][n].compared.rollout).hf_rms for n in names] for t in trials])
    figure, axes = plt.subplots(figsize=(9.5, 8.5), layout="constrained")
    image = axes.pcolormesh(np.maximum(values, 1e-4), norm=LogNorm(1e-4, 1.0), cmap="YlOrRd", edgecolors="white", lw=2)
    for i, trial in enumerate(trials):
        for j, name in enumerate(names):
            shade = "white" if values[i, j] > 0.15 else "black"
            axes.text(j + 0.42, i + 0.5, f"{values[i, j]:.2g}", ha="center", va="center", fontsize=9, color=shade)
            if results[trial][name].oscillating:
                axes.plot(j + 0.85, i + 0.5, "o", mfc="none", mec=shade, mew=1.6, ms=7)
    axes.set_xticks(np.arange(len(names)) + 0.5, names)
    axes.set_yticks(np.arange(len(trials)) + 0.5, [trial.title for trial in trials])
    axes.invert_yaxis()
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.plot([], [], "o", mfc="none", mec="black", mew=1.6, ms=7, label="a joint oscillates")
    axes.legend(loc="upper right", bbox_to_anchor=(1.0, -0.01), frameon=False)
    figure.colorbar(image, ax=axes, label="hf_rms: what of q̇ lies above 5 Hz [m/s, rad/s]", aspect=40, pad=0.01)
    axes.set_title("Chatter of eight laws in twenty scenarios", loc="left", fontsize=13)
    return figure


if __name__ == "__main__":
    main()
