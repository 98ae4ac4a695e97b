"""`clikgen simulate`: a scenario on its compiled controller, with the metrics of every case."""

from pathlib import Path
from typing import Annotated, Any

import typer


def command(
    scenario: Annotated[str, typer.Argument(help="A scenario that ships, or a .toml file.")],
    case: Annotated[
        int | None, typer.Option(help="1 NSB, 2 with filter, 3 with filter and planner; default: all.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A parameter or a key of the scenario."),
    ] = None,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="One step per period of the clock; reports how punctual.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for trajectories (CSV) and metrics.json.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False,
) -> int:
    """Simulate a scenario: all three cases, or one."""
    from clikgen.analysis.summary import metrics_table, simulation_document, trajectory_csv
    from clikgen.cli.freshness import fresh_controller
    from clikgen.cli.terminal import messages, print_json, print_table, progress_bar
    from clikgen.runtime.documents import BadInput, json_text, write_atomically
    from clikgen.runtime.realtime import MonotonicClock
    from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
    from clikgen.runtime.simulation import prepare

    if case is not None and case not in CASES:
        raise BadInput(f"--case: wanted one of {', '.join(map(str, CASES))}, got {case}")
    path = find_scenario(scenario)
    wanted = read_scenario(path, settings or [])
    controller = fresh_controller(wanted.controller)
    runs = {number: prepare(controller, wanted, CASES[number], str(path)) for number in ([case] if case else CASES)}
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
