"""`clikgen analyse chatter` of a barrier: the margin that sampling leaves, term by term, and whether it was kept."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from clikgen.analysis.barrier_figures import Sampled, clearance_plate, period_plate
from clikgen.analysis.barrier_margin import CONFIDENCE, expected
from clikgen.analysis.measured_barrier import ROUNDING, Kept, kept, uncovered
from clikgen.analysis.metrics import Metrics, metrics
from clikgen.analysis.plates import Plate
from clikgen.analysis.study import Study, Table
from clikgen.analysis.summary import UNITS
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.scenario import CASES, Scenario
from clikgen.runtime.simulation import Run, prepare

FACTORS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)  # of the scenario's T, over which the margin is shown
FASTEST = 1.0  # γT up to which it is: beyond, the overshoot hides the rest
TERMS = {
    "curvature": "own path",
    "acceleration": "obstacle's acceleration",
    "velocity": "its velocity",
    "position": "its position",
    "direction": "direction to it",
    "excess": "excess",
    "overshoot": "overshoot",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """A case: what it kept, what was known beforehand, or why the margin does not speak of it."""

    number: int
    period: float  # T [s]
    metrics: Metrics
    kept: tuple[Kept, ...]
    beforehand: Mapping[tuple[str, str], float]  # task and point -> m [m]
    missing: tuple[str, ...]  # tasks that the margin does not speak of
    why_not: str | None

    @property
    def holds(self) -> bool:
        """Whether nothing fell below its margin."""
        return all(each.holds for each in self.kept)

    @property
    def shown(self) -> list[Kept]:
        """Every point, and of the joints of a task the one that came nearest to a limit."""
        joints: dict[str, Kept] = {}
        for each in self.kept:
            if not each.is_point and (each.task not in joints or each.least < joints[each.task].least):
                joints[each.task] = each
        return [each for each in self.kept if each.is_point or each is joints[each.task]]


def guarded_by_barrier(manifest: Manifest) -> bool:
    """Whether a barrier acts, and obstacles are not avoided in another way."""
    acting = {task.kind: task.activation for task in manifest.tasks if not task.equality}
    return "barrier" in acting.values() and acting.get("obstacle_avoidance", "barrier") == "barrier"


def barrier_study(controller: CompiledController, scenario: Scenario, source: str = "scenario") -> Study:
    """Cases 1-3 of a scenario: the margin of every point and joint that the barrier guards, and what was measured.

    Raises BadInput for a scenario that does not fit, that diverges, or without anything that the margin speaks of.
    """
    runs = {number: prepare(controller, scenario, case, source) for number, case in CASES.items()}
    cases = [_case(number, run, source) for number, run in runs.items()]
    missing = cases[0].missing
    if not any(case.kept for case in cases):
        why = [case.why_not for case in cases if case.why_not] or [_missing(missing)]
        raise BadInput(f"{source}: {why[0] if any(why) else 'no obstacle, wall or limit to keep away from'}")
    document = {
        "controller": controller.manifest.controller,
        "spec_sha256": controller.manifest.spec_sha256,
        "scenario": scenario.name,
        "units": UNITS,
        "period": cases[0].period,
        "not_covered": list(missing),
        "cases": {str(case.number): _entry(case) for case in cases},
    }
    return Study(
        title=f"Barrier of {scenario.name} on {controller.manifest.controller}",
        verdicts=[*map(_words, cases), *([f"Tasks {_missing(missing)}."] if missing else [])],
        tables=[_clearance_table(cases), _margin_table(cases)],
        plates=_plates(controller, scenario, cases),
        assumptions=[
            "The robot runs the commanded joint velocity exactly for a period; obstacles are convex, as balls, "
            "capsules, half-spaces and walls are.",
            "m has each term at its greatest in the rollout; m_k follows κ and c of every step and is what the "
            "clearance is held against. Beforehand: any motion within the velocity limits past these obstacles, every "
            f"row kept; with noise, with a probability of {CONFIDENCE:g}.",
            "The position of an obstacle is wrong by noise and delay, its velocity by delay and by the filter, which "
            "follows a moving obstacle late.",
        ],
        document=document,
        holds=all(case.holds for case in cases),
    )


def _case(number: int, run: Run, source: str) -> _Case:
    rollout = run.in_c()
    if rollout.diverged is not None:
        raise BadInput(
            f"{source}: case {number} diverged at t = {rollout.diverged:g} s: no barrier to analyse, "
            "see 'clikgen analyse clik'"
        )
    missing = tuple(uncovered(run, rollout))
    try:
        beforehand = {(each.task, each.point): each.margin.total for each in expected(run)}
        return _Case(number, run.period, metrics(rollout), kept(run, rollout), beforehand, missing, None)
    except BadInput as error:
        return _Case(number, run.period, metrics(rollout), (), {}, missing, str(error))


def _missing(tasks: Sequence[str]) -> str:
    """What to say of tasks that the margin does not speak of."""
    return f"not covered: {', '.join(tasks)}; the margin speaks of points of interest and of joints" if tasks else ""


def _words(case: _Case) -> str:
    """One sentence on a case."""
    calm = f"hf_rms {case.metrics.hf_rms:.3g}, largest velocity step {case.metrics.max_velocity_step:.3g}"
    if case.why_not:
        return f"Case {case.number}: no margin, {case.why_not}; {calm}."
    if not case.kept:
        return f"Case {case.number}: nothing to keep away from; {calm}."
    broken = [each for each in case.kept if not each.holds]
    if broken:
        worst = min(broken, key=lambda each: float(np.min(each.slack)))
        return (
            f"Case {case.number}: VIOLATED by {worst.label}: "
            f"{_thousandths(-float(np.min(worst.slack)))} m{worst.unit} below its margin, "
            f"rows violated by {worst.unreported:.2g} {worst.unit}/s more than reported."
        )
    pressed = max(case.kept, key=lambda each: (each.used, -each.least))
    if not pressed.used:
        return f"Case {case.number}: kept, nothing fell below its boundary; {calm}."
    depth = f"{_thousandths(-pressed.least)} m{pressed.unit}"
    return (
        f"Case {case.number}: kept; {pressed.label} came {depth} below its boundary and used {_share(pressed.used)} "
        f"of its margin m_k at most; {calm}."
    )


def _clearance_table(cases: Sequence[_Case]) -> Table:
    rows = [
        [
            str(case.number),
            each.label,
            _thousandths(each.least),
            _thousandths(-each.bound_there),
            _share(each.used),
            _thousandths(each.margin.total),
            _thousandths(case.beforehand.get((each.task, each.name), np.inf)),
            "kept" if each.holds else "VIOLATED",
        ]
        for case in cases
        for each in case.shown
    ]
    columns = ["case", "guarded", "least h", "−m_k there", "used", "m", "m before", "verdict"]
    return Table("Clearance h = d − s against the margin [mm, mrad]", columns, rows)


def _margin_table(cases: Sequence[_Case]) -> Table:
    """The terms that are not zero for all."""
    rows = [(case, each, asdict(each.margin)) for case in cases for each in case.shown]
    used = [name for name in TERMS if any(terms[name] > ROUNDING for _, _, terms in rows)]
    return Table(
        "Margin m of this run, term by term [mm, mrad]",
        ["case", "guarded", *(TERMS[name] for name in used), "m"],
        [
            [
                str(case.number),
                each.label,
                *(_thousandths(terms[name]) for name in used),
                _thousandths(each.margin.total),
            ]
            for case, each, terms in rows
        ],
    )


def _thousandths(value: float) -> str:
    """A length [m] in mm, or an angle [rad] in mrad; what rounding makes of nothing is 0, what is unbounded -."""
    if not np.isfinite(value):
        return "-"
    return "0" if abs(value) < ROUNDING else f"{1e3 * value:.3g}"


def _share(value: float) -> str:
    return "<1%" if 0 < value < 0.01 else f"{value:.0%}"


def _plates(controller: CompiledController, scenario: Scenario, cases: Sequence[_Case]) -> list[Plate]:
    """The clearances of the points that came nearest to their margin, and the margin of the first over T."""
    points = {case.number: [each for each in case.kept if each.is_point] for case in cases if case.kept}
    if not points.get(1):
        return []
    pressed = sorted(points[1], key=lambda each: (-each.used, each.least))
    plate = clearance_plate([each.label for each in pressed], points, cases[0].period)
    over_period = _over_period(controller, scenario, pressed[0])
    return [plate, period_plate(pressed[0].label, over_period)] if len(over_period) > 1 else [plate]


def _over_period(controller: CompiledController, scenario: Scenario, point: Kept) -> list[Sampled]:
    """Case 1 at other sampling times: the margin of a point, and how far it fell below its boundary."""
    found = []
    for factor in FACTORS:
        run = prepare(controller, _sampled_at(controller, scenario, factor), CASES[1])
        rollout = run.in_c()
        if rollout.diverged is None and run.period * float(run.values[f"{point.task}_rate"]) <= FASTEST:
            same = next(each for each in kept(run, rollout) if (each.task, each.name) == (point.task, point.name))
            most, below = float(np.max(same.bound)), max(0.0, -same.least)
            found.append(Sampled(run.period, same.margin.total, most, same.bound_there, below))
    return found


def _sampled_at(controller: CompiledController, scenario: Scenario, factor: float) -> Scenario:
    """The scenario at a sampling time `factor` times its own."""
    period = float(prepare(controller, scenario, CASES[1]).period)
    return scenario.model_copy(update={"parameters": {**scenario.parameters, "period": factor * period}})


def _entry(case: _Case) -> dict[str, Any]:
    return {
        "metrics": case.metrics.as_dict(),
        "not_covered": case.why_not,
        "holds": case.holds,
        "guarded": [
            {
                "task": each.task,
                "name": each.name,
                "unit": each.unit,
                "least_clearance": each.least,
                "guaranteed_then": -each.bound_there,
                "used": each.used,
                "margin": {**asdict(each.margin), "total": each.margin.total},
                "margin_beforehand": _finite(case.beforehand.get((each.task, each.name), np.inf)),
                "rows_violated_unreported": each.unreported,
                "holds": each.holds,
            }
            for each in case.kept
        ],
    }


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
