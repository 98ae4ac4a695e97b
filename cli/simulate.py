"""`clikgen simulate`: a scenario on its compiled controller, with the metrics of every case."""

from pathlib import Path
from typing import Annotated, Any

import typer

from clikgen.cli.scenarios import AsJson, CaseNumber, ScenarioName, Settings, chosen_cases, load_scenario


def command(
    scenario: ScenarioName,
    case: CaseNumber = None,
    settings: Settings = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="One step per period of the clock; reports how punctual.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for trajectories (CSV) and metrics.json.")] = None,
    as_json: AsJson = False,
) -> int:
    """Simulate a scenario: all three cases, or one."""
    from clikgen.analysis.summary import metrics_table, simulation_document, trajectory_csv
    from clikgen.cli.terminal import messages, print_json, print_table, progress_bar
    from clikgen.runtime.documents import json_text, write_atomically
    from clikgen.runtime.realtime import MonotonicClock
    from clikgen.runtime.scenario import CASES
    from clikgen.runtime.simulation import prepare

    chosen = chosen_cases(case)
    controller, wanted, source = load_scenario(scenario, settings)
    runs = {number: prepare(controller, wanted, CASES[number], source) for number in chosen}
    rollouts, timings = {}, {}
    with progress_bar() as progress:
        for number, run in progress.track(runs.items(), description="simulating", total=len(runs)):
            if realtime:
                rollouts[number], timings[number] = run.in_real_time(MonotonicClock())
            else:
                rollouts[number] = run.in_c()
    document: dict[str, Any] = simulation_document(rollouts, timings)
    if out:
        for number, rollout in rollouts.items():
            write_atomically(out / f"case{number}.csv", trajectory_csv(rollout).encode())
        write_atomically(out / "metrics.json", json_text(document).encode())
        messages.print(f"wrote {out}: {', '.join(f'case{number}.csv' for number in rollouts)}, metrics.json")
    if as_json:
        print_json(document)
    else:
        print_table(*metrics_table(rollouts))
        for number, timing in timings.items():
            messages.print(f"case {number} in real time: {timing.summary()}")
    return 0
