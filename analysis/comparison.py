"""One scenario under several laws: what each lets its one-sided tasks do, measured by the same metrics."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.metrics import encounters, metrics, outside_limits
from clikgen.analysis.summary import UNITS, simulation_document
from clikgen.runtime.batch import ENCOUNTER_GAP
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, choices
from clikgen.runtime.manifest import FAR, Manifest
from clikgen.runtime.scenario import CASES, Case, Scenario
from clikgen.runtime.simulation import Rollout, prepare

Array = NDArray[np.float64]

ROUNDING = 1e-9  # [m, rad] less beyond a boundary is none
ACTING = ("gain", "damping", "width", "rate")  # what activations call their parameters, after `<task>_`


@dataclass(frozen=True, slots=True)
class Law:
    """A way for one-sided tasks to act: the kind of their activation, a case, and a planner where it matters."""

    name: str
    title: str
    activation: str
    case: Case
    planner: str | None = None  # None: the spec's own, which without filter changes nothing


LAWS = {
    law.name: law
    for law in (
        Law("case1", "paper, Case 1: unfiltered", "switched", CASES[1], "event"),
        Law("case2", "paper, Case 2: filter", "switched", CASES[2], "event"),
        Law("case3", "paper, Case 3: filter + planner", "switched", CASES[3], "event"),
        Law("smooth", "paper's law, smooth planner", "switched", CASES[3], "smooth"),
        Law("hysteresis", "hysteresis", "hysteresis", CASES[1]),
        Law("ramp", "ramp", "ramp", CASES[1]),
        Law("damped", "damped", "damped", CASES[1]),
        Law("barrier", "barrier", "barrier", CASES[1]),
    )
}
"""The laws by their names: the paper's three cases, its planner made smooth, and the activations without a filter."""


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
    """A law, the controller it is compiled to, and what that did."""

    law: Law
    controller: CompiledController
    rollout: Rollout

    @property
    def chatters(self) -> bool | None:
        """Whether contact switched more than on and off once in every encounter; None where nothing says so."""
        if not self._says_when_it_acts:
            return None
        return metrics(self.rollout).switches > 2 * max(1, len(encounters(self.rollout)))

    @property
    def switches(self) -> str:
        """How often contact switched, as in "284 switches"; empty where nothing says so."""
        if not self._says_when_it_acts:
            return ""
        count = metrics(self.rollout).switches
        return f"{count} switch{'' if count == 1 else 'es'}"

    @property
    def _says_when_it_acts(self) -> bool:
        """Whether `Rollout.active` knows: of obstacles and of barriers."""
        return bool({"active", "barrier_steps"} & self.rollout.signals.keys())


@dataclass(frozen=True, slots=True)
class Intrusion:
    """A point that was beyond its boundary by more than ROUNDING: how deep at most [unit] and when [s].

    Intrusions of one point less than ENCOUNTER_GAP apart are one, from its `start` to its `end` [s].
    """

    law: str
    point: str
    depth: float
    unit: str
    at: float
    start: float
    end: float


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """What a point of interest, or a row of another one-sided task, keeps off: its depth beyond it over time."""

    point: str
    unit: str
    depth: Array  # (N,) [unit], positive inside
    signed: bool = True  # whether it says how far off it is outside, by negative numbers; else it is 0 there


def chosen_laws(names: str | None) -> list[Law]:
    """The laws of a list "NAME,...", in its order, or all of them; raises BadInput."""
    if names is None:
        return list(LAWS.values())
    wanted = [name.strip() for name in names.split(",")]
    for name in wanted:
        if name not in LAWS:
            raise BadInput(f"--laws: no law '{name}'; {choices(name, LAWS)}")
    return [LAWS[name] for name in dict.fromkeys(wanted)]


def compare(
    controllers: Mapping[Law, CompiledController],
    own: Manifest,
    scenario: Scenario,
    given: Sequence[str],
    source: str = "scenario",
) -> list[Compared]:
    """The scenario under every law, on the controller that it is compiled to; raises BadInput.

    `own` describes the controller that the scenario is written for, `given` names the parameters that every law that
    has them is to be given, see `parameters_of`.
    """
    _check_parameters(list(controllers.items()), own, scenario, given, source)
    compared = []
    for law, controller in controllers.items():
        parameters = parameters_of(law, controller.manifest, own, scenario.parameters, given)
        run = prepare(controller, scenario.model_copy(update={"parameters": parameters}), law.case, source)
        compared.append(Compared(law, controller, run.in_c()))
    return compared


def parameters_of(
    law: Law, manifest: Manifest, own: Manifest, parameters: Mapping[str, Any], given: Sequence[str]
) -> dict[str, Any]:
    """The parameters of a scenario for `own` that are meant for a law.

    One of an activation (`<task>_gain`, ...) is meant for laws with the activation that the task has in `own`: the
    other laws, in which the same name may stand for something else, keep their defaults unless it is `given`.
    """
    foreign = {
        f"{task.name}_{key}" for task in own.tasks if task.activation not in (None, law.activation) for key in ACTING
    }
    has = _parameter_names(manifest)
    return {name: value for name, value in parameters.items() if name in has and (name in given or name not in foreign)}


def _check_parameters(
    laws: Sequence[tuple[Law, CompiledController]],
    own: Manifest,
    scenario: Scenario,
    given: Sequence[str],
    source: str,
) -> None:
    """Raises BadInput for a parameter that nobody has, or a given one that none of the laws has."""
    known = set().union(*(_parameter_names(controller.manifest) for _, controller in laws))
    for name in scenario.parameters:
        wanted = known if name in given else known | _parameter_names(own)
        if name not in wanted:
            of = ", ".join(law.name for law, _ in laws)
            raise BadInput(f"{source}: parameters: no parameter '{name}' of {of}; {choices(name, wanted)}")


def _parameter_names(manifest: Manifest) -> set[str]:
    return {signal.name for signal in manifest.function("step").inputs if signal.role == "parameter"}


# What they did.


def boundaries(rollout: Rollout) -> Iterator[Boundary]:
    """What the rollout had to keep off: obstacles by the points of interest, and every row of the other tasks."""
    signals, parameters = rollout.signals, rollout.parameters
    if "distance" in signals and "influence_radius" in parameters and np.min(signals["distance"]) < FAR / 2:
        depth = parameters["influence_radius"] - signals["distance"]  # (N, points)
        for point, column in zip(rollout.manifest.points, depth.T, strict=True):
            yield Boundary(point.name, "m", column)
    outputs = {signal.name: signal for signal in rollout.manifest.function("step").outputs}
    for task in rollout.manifest.tasks:
        if task.activation is None:
            continue
        name, margin = f"{task.name}_distance", parameters.get(f"{task.name}_margin")
        if signed := name in outputs and margin is not None:
            depth = margin.reshape(-1, *(1,) * (signals[name].ndim - 2)) - signals[name]  # (N, rows, ...)
        elif (name := f"{task.name}_depth") in outputs:
            depth = signals[name]
        else:
            continue
        units = outputs[name].unit.split(", ")
        for index in np.ndindex(depth.shape[1:]):
            unit = units[index[0]] if len(units) > 1 else units[0]
            yield Boundary(f"{task.name}[{', '.join(map(str, index))}]", unit, depth[:, *index], signed)


def clearance(rollout: Rollout) -> Array | None:
    """The least d − s over all whose distance is known, (N,) [m]; None where there is nothing to keep off."""
    depths = [each.depth for each in boundaries(rollout) if each.signed and each.unit == "m"]
    return -np.max(depths, axis=0) if depths else None


def deepest(rollout: Rollout) -> float:
    """How far beyond a boundary it was at most [m]; 0 for less than ROUNDING."""
    values = clearance(rollout.before_divergence())
    depth = 0.0 if values is None else -float(np.min(values))
    return depth if depth > ROUNDING else 0.0


def intrusions(compared: Sequence[Compared]) -> list[Intrusion]:
    """Every intrusion under every law, in the order of time."""
    found = []
    for each in compared:
        rollout = each.rollout.before_divergence()
        in_law = [
            Intrusion(
                law=each.law.name,
                point=one.point,
                depth=float(np.max(one.depth[begin:end])),
                unit=one.unit,
                at=float(rollout.t[begin + np.argmax(one.depth[begin:end])]),
                start=float(rollout.t[begin]),
                end=float(rollout.t[end - 1]),
            )
            for one in boundaries(rollout)
            for begin, end in _spans(one.depth > ROUNDING, round(ENCOUNTER_GAP / rollout.period))
        ]
        found += sorted(in_law, key=lambda one: one.start)
    return found


def _spans(flags: NDArray[np.bool_], gap: int) -> list[tuple[int, int]]:
    """First step and step after the last of every stretch of true flags, those with gaps of `gap` or less joined."""
    true = np.flatnonzero(flags)
    if not true.size:
        return []
    breaks = np.flatnonzero(np.diff(true) > gap)
    return [(int(a), int(b) + 1) for a, b in zip(true[[0, *(breaks + 1)]], true[[*breaks, -1]], strict=True)]


def barrier_diagnostics(rollout: Rollout) -> dict[str, float | int] | None:
    """What the quadratic program of a barrier says of itself over the run; None without one.

    `excess` is the largest violation of a row [m/s, rad/s], `infeasible` and `unsolved` count the steps in which not
    all rows could be kept, or the program did not come to its end, and `most_steps` are those it took in one period.
    """
    if "barrier_steps" not in rollout.signals:
        return None
    signals = rollout.before_divergence().signals
    return {
        "excess": float(np.max(signals["barrier_excess"])),
        "infeasible": int(np.count_nonzero(signals["barrier_row"] >= 0)),
        "unsolved": int(np.count_nonzero(signals["barrier_solved"] < 1)),
        "most_steps": int(np.max(signals["barrier_steps"])),
    }


# Tables and document.


def comparison_table(compared: Sequence[Compared]) -> tuple[str, list[str], list[list[str]]]:
    """Title, column heads and rows: a law a row, a metric a column, under its name and its unit."""
    rows = [_row(each) for each in compared]
    units = {**UNITS, "diverged_at": "s", "barrier_excess": "m/s, rad/s"}
    shown = [name for name in rows[0] if name in UNITS or any(row[name] != "-" for row in rows)]
    first = compared[0].rollout
    title = (
        f"{first.scenario.name} on {first.manifest.controller}: {len(first.t)} steps of {first.period:g} s, "
        f"f_h = {first.scenario.metrics.f_h:g} Hz"
    )
    return title, [_head(name, units.get(name, "")) for name in shown], [[row[name] for name in shown] for row in rows]


def _row(each: Compared) -> dict[str, str]:
    """Everything that the table says of a law, "-" for nothing."""
    barrier = barrier_diagnostics(each.rollout) or {}
    return {
        "law": each.law.name,
        **{name: _number(value) for name, value in metrics(each.rollout).as_dict().items()},
        "outside_limits": "\n".join(outside_limits(each.rollout)) or "-",
        "diverged_at": _number(each.rollout.diverged),
        "barrier_excess": _number(barrier.get("excess")),
        "barrier_infeasible": _number(barrier.get("infeasible")),
        "barrier_steps": _number(barrier.get("most_steps")),
    }


def _head(name: str, unit: str) -> str:
    """A name broken at its underscores, for a column as narrow as its numbers, with the unit below."""
    return name.replace("_", "_\n") + (f"\n({unit})".replace(", ", ",\n") if unit else "")


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def intrusion_table(compared: Sequence[Compared]) -> tuple[str, list[str], list[list[str]]]:
    """Title, column heads and rows: an intrusion a row."""
    found = intrusions(compared)
    rows = [
        [one.law, one.point, f"{1e3 * one.depth:.3g} m{one.unit}", f"{one.at:g} s", f"{one.start:g} to {one.end:g} s"]
        for one in found
    ]
    free = [each.law.name for each in compared if each.law.name not in {one.law for one in found}]
    title = "intrusions, each at its deepest" + (f"; none under {', '.join(free)}" if free else "")
    return title, ["law", "point", "depth", "at", "from, to"], rows


def comparison_document(compared: Sequence[Compared], own: Manifest) -> dict[str, Any]:
    """What was run, with every metric of every law: as `clikgen simulate` says it, by the names of the laws."""
    numbered = dict(enumerate(each.rollout for each in compared))
    document = simulation_document(numbered, {})
    measured = document.pop("cases")
    del document["realtime"]
    found = intrusions(compared)
    laws = {
        each.law.name: {
            **measured[str(i)],
            "title": each.law.title,
            "activation": each.law.activation,
            "case": each.law.case.number,
            "planner": each.rollout.manifest.planner,
            "spec_sha256": each.rollout.manifest.spec_sha256,
            "parameters": dict(each.rollout.scenario.parameters),
            "barrier": barrier_diagnostics(each.rollout),
            "intrusions": [_as_dict(one) for one in found if one.law == each.law.name],
        }
        for i, each in enumerate(compared)
    }
    return document | {"spec_sha256": own.spec_sha256, "laws": laws}


def _as_dict(one: Intrusion) -> dict[str, Any]:
    return {"point": one.point, "depth": one.depth, "unit": one.unit, "at": one.at, "start": one.start, "end": one.end}
