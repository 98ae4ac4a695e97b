"""`clikgen demo`: the paper's study, end to end."""

from pathlib import Path
from typing import Annotated

import typer


def command(
    out: Annotated[Path, typer.Option(help="Folder for figures, animation and tables.")] = Path("demo"),
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False,
) -> int:
    """Simulate the paper's three cases in compiled C, draw its figures, and judge its claims."""
    from dataclasses import asdict

    from clikgen.analysis.animation import animate
    from clikgen.analysis.claims import claims
    from clikgen.analysis.figures import paper_figures, save
    from clikgen.analysis.summary import metrics_table, simulation_document
    from clikgen.cli.freshness import fresh_controller
    from clikgen.cli.terminal import messages, print_json, print_table, progress_bar
    from clikgen.runtime.documents import json_text, make_folder, write_atomically
    from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
    from clikgen.runtime.simulation import prepare

    make_folder(out)
    scenario = read_scenario(find_scenario("paper"))
    controller = fresh_controller(scenario.controller)
    with progress_bar() as progress:
        task = progress.add_task("simulating", total=None)
        rollouts = {number: prepare(controller, scenario, case).in_c() for number, case in CASES.items()}
        free = scenario.model_copy(update={"obstacles": ()})
        floor = prepare(controller, free, CASES[1]).in_c()
        judged = claims(rollouts, floor)
        document = simulation_document(rollouts, {}) | {"claims": [asdict(claim) for claim in judged]}
        write_atomically(out / "demo.json", json_text(document).encode())
        progress.update(task, description="figures")
        saved = save(paper_figures(rollouts, controller), out)
        progress.update(task, description="animation")
        animate(rollouts, controller, out / "animation.gif")
    if as_json:
        print_json(document)
        return 0
    print_table(*metrics_table(rollouts))
    print_table(
        "What the paper says, what we measured",
        ["case", "claim", "measured", "verdict", "why"],
        [[str(c.case), c.claim, c.measured, c.verdict, c.why] for c in judged],
    )
    messages.print(f"wrote {len(saved)} figures, animation.gif and demo.json to {out}")
    return 0
