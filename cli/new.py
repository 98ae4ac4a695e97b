"""`clikgen new`: a first spec and scenario for a robot from its URDF."""

import re
from pathlib import Path
from typing import Annotated

import typer

LONGEST = 34  # characters of a name: the scenario's is six longer


def command(
    urdf: Annotated[Path, typer.Argument(help="The robot's .urdf file.")],
    name: Annotated[str | None, typer.Option(help="What to call the controller; default: as the file.")] = None,
    frame: Annotated[
        str | None, typer.Option(help="The link to move; default: the one that most joints carry, fingers aside.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the two files.")] = Path(),
) -> int:
    """Write a first spec and a first scenario for a URDF: a place to start from."""
    import os

    from clikgen.cli.terminal import messages
    from clikgen.runtime.documents import BadInput, commit_all
    from clikgen.symbolic.spec import read_robot
    from clikgen.symbolic.starter import starter

    if urdf.suffix != ".urdf":
        raise BadInput(f"{urdf}: wanted a .urdf file")
    called = name if name is not None else re.sub(r"[^a-z0-9]+", "_", urdf.stem.lower()).strip("_")
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", called) or len(called) > LONGEST:
        raise BadInput(
            f"--name: wanted at most {LONGEST} lower-case letters, digits and single underscores, a letter first, "
            f"got '{called}'"
        )
    model = read_robot(urdf)
    made = starter(called, os.path.relpath(urdf, out), model.robot, frame)
    files = {out / f"{called}.toml": made.spec, out / f"{called}_first.toml": made.scenario}
    for path in files:
        if path.exists() or path.is_symlink():
            raise BadInput(f"{path}: is there already; delete it, or give another --name or --out")
    commit_all({path: text.encode() for path, text in files.items()})
    for note in (*model.notes, *made.notes):
        messages.print(f"{urdf}: note: {note}")
    spec, scenario = files
    messages.print(f"wrote {spec} and {scenario}; next: clikgen generate {spec}, clikgen simulate {scenario}")
    return 0
