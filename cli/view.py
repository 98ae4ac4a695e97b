"""`clikgen view`: a scenario to look at, in the browser or as a film."""

from pathlib import Path
from typing import Annotated

import typer

from clikgen.cli.scenarios import CaseNumber, ScenarioName, Settings, chosen_cases, load_scenario


def command(
    scenario: ScenarioName,
    case: CaseNumber = None,
    settings: Settings = None,
    port: Annotated[int, typer.Option(help="Port of the page, or the next one that is free; 0: any.")] = 8080,
    save: Annotated[Path | None, typer.Option(metavar="FILE", help="A film instead: .gif, or .mp4 by ffmpeg.")] = None,
    once: Annotated[bool, typer.Option("--once", help="Play once and end; else until Ctrl-C.")] = False,
) -> int:
    """Watch a scenario in the browser, in three dimensions, or save it as a film."""
    from clikgen.analysis.animation import check_film
    from clikgen.analysis.drawing import require_drawable
    from clikgen.analysis.scene import even_steps, scene
    from clikgen.analysis.spatial import animate
    from clikgen.analysis.viewer import MOMENTS, Viewer, check_viser, open_server, play
    from clikgen.cli.terminal import messages, progress_bar
    from clikgen.runtime.documents import BadInput
    from clikgen.runtime.realtime import MonotonicClock
    from clikgen.runtime.scenario import CASES
    from clikgen.runtime.simulation import prepare

    chosen = chosen_cases(case)
    if not 0 <= port <= 65535:
        raise BadInput(f"--port: wanted 0 to 65535, got {port}")
    if save:
        check_film(save)
    else:
        check_viser()
    controller, wanted, source = load_scenario(scenario, settings)
    with progress_bar() as progress:
        task = progress.add_task("simulating", total=None)
        rollouts = {number: prepare(controller, wanted, CASES[number], source).in_c() for number in chosen}
        if save:
            progress.update(task, description="drawing")
            animate(rollouts, controller, save)
            messages.print(f"wrote {save}")
            return 0
        require_drawable(rollouts)
        scenes = {
            number: scene(controller, rollout, even_steps(rollout, MOMENTS)) for number, rollout in rollouts.items()
        }
    with open_server(port) as server:
        viewer = Viewer(server, scenes)
        messages.print(f"http://localhost:{server.get_port()} shows {wanted.name}; Ctrl-C ends")
        play(viewer, MonotonicClock(), once)
    return 0
