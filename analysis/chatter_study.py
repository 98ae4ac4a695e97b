"""`clikgen analyse chatter`: what chatters, why, and whether the normal map says so beforehand, for cases 1-3."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np

from clikgen.analysis.barrier_study import barrier_study, guarded_by_barrier
from clikgen.analysis.chatter import (
    SHORTEST,
    Comparison,
    Measured,
    Span,
    Sticking,
    compare,
    measure,
    sensed_as_it_is,
    sensed_depths,
    sticking,
)
from clikgen.analysis.chatter_figures import chatter_plates
from clikgen.analysis.chatter_map import ChatterMap, chatter_map, chatter_map_plate
from clikgen.analysis.metrics import metrics
from clikgen.analysis.plates import Plate
from clikgen.analysis.study import Study, Table
from clikgen.analysis.summary import UNITS
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario
from clikgen.runtime.simulation import Rollout, prepare

WINDOW = 40  # samples of a stretch, along which v_n and v_t are taken as constant
MAPPED = (2, 3)  # cases with a filter; where there is hardly any, both are Case 1
CYCLES = 5  # that a stretch holds at least: slow chatter is looked at in longer ones


def chatter_study(controller: CompiledController, scenario: Scenario, source: str = "scenario") -> Study:
    """Cases 1-3 of a scenario at its contacts: the chatter of the paper's switched task, or the margin of a barrier.

    Raises BadInput for a scenario that does not fit, without contact, or too short.
    """
    study = barrier_study if guarded_by_barrier(controller.manifest) else _switched_study
    return study(controller, scenario, source)


def _switched_study(controller: CompiledController, scenario: Scenario, source: str) -> Study:
    """Every encounter measured; where one point is in contact, and sensed as it is, also predicted.

    An encounter is compared in stretches of WINDOW samples, along which the normal map hardly changes, or of CYCLES
    cycles where these are longer. The theory speaks of the planner `event`.
    """
    controller.manifest.check_planner("event")
    rollouts = {number: prepare(controller, scenario, case, source).in_c() for number, case in CASES.items()}
    for number, rollout in rollouts.items():
        if rollout.diverged is not None:
            raise BadInput(
                f"{source}: case {number} diverged at t = {rollout.diverged:g} s: no chatter to analyse, "
                "see 'clikgen analyse clik'"
            )
    encounters = {number: _encounters(rollout) for number, rollout in rollouts.items()}
    if not any(encounters.values()):
        raise BadInput(f"{source}: no point of interest met an obstacle in any case: no chatter to analyse")
    compared = {number: _compared(controller, rollout, encounters[number]) for number, rollout in rollouts.items()}
    stuck = {number: _stuck(controller, rollout) for number, rollout in rollouts.items()}
    everything = [each for of_case in compared.values() for each in of_case]
    maps = [chatter_map(controller, scenario, number, CASES[number], source=source) for number in MAPPED]
    document = {
        "controller": controller.manifest.controller,
        "spec_sha256": controller.manifest.spec_sha256,
        "scenario": scenario.name,
        "units": UNITS,
        "cases": {
            str(number): {
                "metrics": metrics(rollouts[number]).as_dict(),
                "encounters": [_measured_entry(each, rollouts[number].period) for each in encounters[number]],
                "stretches": [_compared_entry(each) for each in compared[number]],
                "sticking": _sticking_entry(stuck[number]),
            }
            for number in rollouts
        },
        "map": {str(one.case): _map_entry(one) for one in maps},
    }
    return Study(
        title=f"Chatter of {scenario.name} on {controller.manifest.controller}",
        verdicts=[
            *(_words(rollout, encounters[number], compared[number]) for number, rollout in rollouts.items()),
            *(f"Case {number}: {each.explanation}" for number, each in stuck.items() if each is not None),
            *map(_map_words, maps),
        ],
        tables=[_encounter_table(encounters, rollouts), *([_stretch_table(compared)] if everything else [])],
        plates=[*_plates(everything), chatter_map_plate(maps)],
        assumptions=[
            f"Predictions are of the normal map of one point in contact, averaged over {WINDOW} samples or {CYCLES} "
            "cycles: where v_n and v_t change much within that, or several points are in contact, it does not speak.",
            "The map is made from compiled functions at states of the rollout; regime, period and amplitude are "
            "measured from the depths alone, as they are sensed.",
            "c of the map is exact to O(T³): where a cycle's length hangs on it, the period is a range.",
        ],
        document=document,
    )


def _encounters(rollout: Rollout) -> tuple[Measured, ...]:
    return measure(rollout) if np.any(sensed_depths(rollout) >= 0) else ()


def _compared(controller: CompiledController, rollout: Rollout, encounters: Sequence[Measured]) -> list[Comparison]:
    """Prediction and measurement for every stretch of the encounters in which one point alone is in contact.

    None where distances are sensed wrongly: the normal map knows no noise and no delay.
    """
    found: list[Comparison] = []
    for encounter in encounters if sensed_as_it_is(rollout) else ():
        cycle = 0.0 if encounter.period is None else encounter.period.mean
        stretches = max(1, int((encounter.end - encounter.begin) / max(WINDOW, CYCLES * cycle)))
        edges = np.linspace(encounter.begin, encounter.end, stretches + 1).round().astype(int)
        for begin, end in pairwise(edges):
            if end - begin >= SHORTEST and np.any(sensed_depths(rollout)[begin:end] >= 0):
                found += compare(controller, rollout, (begin * rollout.period, end * rollout.period))
    return found


def _stuck(controller: CompiledController, rollout: Rollout) -> Sticking | None:
    return sticking(controller, rollout) if rollout.tracked is not None else None


def _plates(comparisons: Sequence[Comparison]) -> list[Plate]:
    """The figures of the stretches that cycle; none where none does."""
    cycling = [each for each in comparisons if each.measured.period is not None and each.map.b > 0]
    return chatter_plates(comparisons) if cycling else []


def _words(rollout: Rollout, encounters: Sequence[Measured], compared: Sequence[Comparison]) -> str:
    """One sentence on a case."""
    if not encounters:
        return f"Case {rollout.case.number}: no contact."
    regimes = sorted({each.regime for each in encounters})
    agreed = sum(each.prediction.regime == each.measured.regime for each in compared)
    if compared:
        beforehand = (
            f"the normal map predicts the regime in {agreed} of {len(compared)} stretches with one point in contact"
        )
    elif sensed_as_it_is(rollout):
        beforehand = "several points are in contact at once, which the normal map does not know"
    else:
        beforehand = "by the distances as sensed; the normal map knows no noise and no delay, so nothing is predicted"
    return f"Case {rollout.case.number}: {len(encounters)} encounter(s), {' and '.join(regimes)}; {beforehand}."


def _map_words(one: ChatterMap) -> str:
    entry = _map_entry(one)
    below, between, beyond = (entry[key] for key in ("below_2", "2_to_4", "beyond_4"))
    return (
        f"Case {one.case} over gain and filter, {one.switching.size} rollouts: a point goes in or out "
        f"{below:.2f} times a sample in the median where βK_oT < 2, {between:.2f} times between 2 and 4, "
        f"{beyond:.2f} times beyond."
    )


def _map_entry(one: ChatterMap) -> dict[str, float]:
    """Medians of the switches per sample, parted by βK_oT."""
    return {"below_2": one.median(0.0, 2.0), "2_to_4": one.median(2.0, 4.0), "beyond_4": one.median(4.0, np.inf)}


def _encounter_table(encounters: Mapping[int, Sequence[Measured]], rollouts: Mapping[int, Rollout]) -> Table:
    rows = [
        [
            str(number),
            f"{each.begin * rollouts[number].period:.2f} to {each.end * rollouts[number].period:.2f}",
            ", ".join(each.points),
            each.regime,
            _span(each.period),
            _span(each.amplitude, 1e3),
            "-" if each.frequency is None else f"{each.frequency:.3g}",
        ]
        for number, of_case in encounters.items()
        for each in of_case
    ]
    columns = ["case", "t [s]", "points", "regime", "period [samples]", "amplitude [mm]", "frequency [Hz]"]
    return Table("Encounters, measured", columns, rows)


def _stretch_table(compared: Mapping[int, Sequence[Comparison]]) -> Table:
    rows = [
        [
            str(number),
            f"{each.measured.begin * each.map.period:.2f}",
            f"{each.map.a:.3g}",
            f"{1e3 * each.map.b:.3g}",
            f"{1e3 * each.map.c:.3g}",
            f"{each.prediction.regime} / {each.measured.regime}",
            f"{_span(each.prediction.period)} / {_span(each.measured.period)}",
            f"{_span(each.prediction.amplitude, 1e3)} / {_span(each.measured.amplitude, 1e3)}",
        ]
        for number, of_case in compared.items()
        for each in of_case
    ]
    columns = ["case", "from t [s]", "a", "b [mm]", "c [mm]", "regime", "period [samples]", "amplitude [mm]"]
    return Table("Stretches with one point in contact: predicted / measured", columns, rows)


def _span(span: Span | None, factor: float = 1.0) -> str:
    """Mean and range of what varies from cycle to cycle."""
    if span is None:
        return "-"
    low, mean, high = (factor * value for value in (span.low, span.mean, span.high))
    return f"{mean:.3g}" if np.isclose(low, high, rtol=1e-3) else f"{mean:.3g} ({low:.3g}-{high:.3g})"


def _sticking_entry(stuck: Sticking | None) -> dict[str, Any] | None:
    return None if stuck is None else asdict(stuck)


def _measured_entry(measured: Measured, period: float) -> dict[str, Any]:
    return {
        "points": list(measured.points),
        "begin_s": measured.begin * period,
        "end_s": measured.end * period,
        "regime": measured.regime,
        "period_samples": None if measured.period is None else asdict(measured.period),
        "amplitude_m": None if measured.amplitude is None else asdict(measured.amplitude),
        "frequency_hz": measured.frequency,
    }


def _compared_entry(each: Comparison) -> dict[str, Any]:
    return {
        "map": {"a": each.map.a, "b": each.map.b, "c": each.map.c},
        "predicted": {
            "regime": each.prediction.regime,
            "period_samples": None if each.prediction.period is None else asdict(each.prediction.period),
            "amplitude_m": None if each.prediction.amplitude is None else asdict(each.prediction.amplitude),
            "frequency_hz": each.prediction.frequency,
        },
        "measured": _measured_entry(each.measured, each.map.period),
    }
