"""`clikgen inspect`: what a robot is made of, as a table and as a picture."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

WIDTH = 200  # characters: numbers that are cut off say nothing


def command(
    robot: Annotated[str, typer.Argument(help="A .urdf file, a spec (.toml), or a controller that ships.")],
    at: Annotated[
        str | None, typer.Option(metavar="Q", help="Joint positions to draw at, 0.1,0.2,...; default: 0, or near it.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where to draw the robot: a .png, .svg or .pdf file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False,
) -> int:
    """Show a robot's joints, links and limits as a table, and draw it."""
    from clikgen.cli.terminal import messages, print_json, print_table
    from clikgen.symbolic.spec import read_robot

    path = _file(robot)
    model = read_robot(path)
    rows = [_row(model.robot, joint) for joint in model.robot.joints]
    if as_json:
        print_json({"robot": str(path), "root": model.robot.root, "joints": rows, "notes": list(model.notes)})
    else:
        n = len(model.robot.coordinates)
        moved = "" if len(model.robot.inputs) == n else f", {len(model.robot.inputs)} inputs"
        print_table(
            f"{path}: {len(model.robot.links)} links from '{model.robot.root}', {n} degrees of freedom{moved}",
            ["joint", "q", "type", "link", "on", "xyz [m]", "rpy [rad]", "axis", "from", "to", "at most"],
            [[_text(value) for value in row.values()] for row in rows],
            width=WIDTH,
        )
    for note in model.notes:
        messages.print(f"note: {note}")
    if out:
        _draw(model.robot, at, out)
        messages.print(f"wrote {out}")
    return 0


def _file(robot: str) -> Path:
    """The file meant by a path or by the name of a controller that ships; raises BadInput."""
    from clikgen.runtime.documents import BadInput, choices
    from clikgen.symbolic.spec import shipped_specs

    shipped = {path.stem: path for path in shipped_specs()}
    if robot in shipped:
        return shipped[robot]
    if Path(robot).suffix not in (".urdf", ".toml"):
        raise BadInput(f"{robot}: wanted a .urdf or .toml file, or a controller that ships; {choices(robot, shipped)}")
    return Path(robot)


def _draw(robot: Any, at: str | None, out: Path) -> None:
    """Write a picture of the robot at given joint positions, or at the ones nearest to zero."""
    from clikgen.analysis.figures import save
    from clikgen.analysis.robot_figure import DrawnJoint, robot_figure
    from clikgen.symbolic.tree import numeric_poses

    q = _configuration(robot, at)
    poses = numeric_poses(robot, q)
    joints = [
        DrawnJoint(joint.name, joint.type, poses[joint.link], poses[robot.parent(joint)], joint.axis)
        for joint in robot.joints
    ]
    places = ", ".join(f"{value:.3g}" for value in q)
    figure = robot_figure(f"{out.stem}: {len(q)} degrees of freedom, at q = [{places}]", joints, robot.dimension)
    save({out.stem: figure}, out.parent, [out.suffix.removeprefix(".")])


def _configuration(robot: Any, at: str | None) -> list[float]:
    """The joint positions [m, rad] in `at`, or zero brought within the limits; raises BadInput."""
    from clikgen.runtime.documents import BadInput

    n = len(robot.coordinates)
    if at is None:
        inside = [(joint.lower, joint.upper) for joint in robot.coordinates]
        return [0.0 if low is None else min(max(0.0, low), high) for low, high in inside]
    try:
        q = [float(value) for value in at.split(",")]
    except ValueError:
        q = []
    if len(q) != n or not all(map(math.isfinite, q)):
        raise BadInput(f"--at: wanted {n} numbers with commas between them, got {at!r}")
    return q


def _row(robot: Any, joint: Any) -> dict[str, Any]:
    """One joint, key by key; what it does not have is None."""
    moves = joint.type != "fixed"
    names = [one.name for one in robot.coordinates]
    kind = joint.type if joint.mimic is None else f"mimics {joint.mimic.joint}"
    return {
        "joint": joint.name,
        "q": names.index(joint.name) if joint.independent else None,
        "type": kind,
        "link": joint.link,
        "parent": robot.parent(joint),
        "xyz": list(joint.xyz),
        "rpy": list(joint.rpy),
        "axis": list(joint.axis) if moves else None,
        "lower": joint.lower,
        "upper": joint.upper,
        "velocity": joint.velocity,
    }


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        return "  ".join(f"{entry:.4g}" for entry in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)
