"""`clikgen list`: controllers and scenarios, what is stale, what is compiled."""

from typing import Annotated, Any

import typer


def command(as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False) -> int:
    """List controllers and scenarios."""
    from clikgen.cli.terminal import print_json, print_table
    from clikgen.runtime.controller import controller_folders, find_controller, is_compiled
    from clikgen.runtime.manifest import load_manifest
    from clikgen.runtime.scenario import read_scenario, shipped_scenarios

    names = sorted({path.parent.name for folder in controller_folders() for path in folder.glob("*/manifest.json")})
    controllers: list[dict[str, Any]] = []
    for name in names:
        folder = find_controller(name)
        manifest = load_manifest(folder)
        controllers.append(
            {
                "name": name,
                "joints": len(manifest.joints),
                "tasks": [task.name for task in manifest.tasks],
                "state": _state(name),
                "compiled": is_compiled(folder),
                "folder": str(folder),
            }
        )
    scenarios = [
        {"name": s.name, "controller": s.controller, "description": s.description}
        for s in map(read_scenario, shipped_scenarios())
    ]
    if as_json:
        print_json({"controllers": controllers, "scenarios": scenarios})
        return 0
    print_table(
        "Controllers",
        ["name", "joints", "tasks", "generated code", "compiled", "folder"],
        [
            [
                str(c["name"]),
                str(c["joints"]),
                " > ".join(c["tasks"]),
                str(c["state"]),
                "yes" if c["compiled"] else "no",
                str(c["folder"]),
            ]
            for c in controllers
        ],
    )
    print_table(
        "Scenarios",
        ["name", "controller", "what it is"],
        [[s["name"], s["controller"], s["description"]] for s in scenarios],
    )
    return 0


def _state(controller: str) -> str:
    """Whether the generated code still is what its spec says, as far as that is known."""
    from clikgen.cli.freshness import is_stale, spec_of
    from clikgen.runtime.documents import BadInput

    try:
        return "stale" if is_stale(controller) else "fresh" if spec_of(controller) else "spec unknown"
    except BadInput:
        return "spec in error"
