"""`clikgen view`: a scenario to look at, in the browser or as a film."""

from pathlib import Path
from typing import Annotated

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
    from clikgen.cli.freshness import fresh_controller
    from clikgen.cli.terminal import messages, progress_bar
    from clikgen.runtime.documents import BadInput
    from clikgen.runtime.realtime import MonotonicClock
    from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
    from clikgen.runtime.simulation import prepare

    if case is not None and case not in CASES:
        raise BadInput(f"--case: wanted one of {', '.join(map(str, CASES))}, got {case}")
    if not 0 <= port <= 65535:
        raise BadInput(f"--port: wanted 0 to 65535, got {port}")
    if save:
        check_film(save)
    else:
        check_viser()
    path = find_scenario(scenario)
    wanted = read_scenario(path, settings or [])
    controller = fresh_controller(wanted.controller)
    with progress_bar() as progress:
        task = progress.add_task("simulating", total=None)
        chosen = [case] if case else CASES
        rollouts = {number: prepare(controller, wanted, CASES[number], str(path)).in_c() for number in chosen}
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
