"""`clikgen inspect`: what a robot is made of, as tables and as a picture."""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

WIDTH = 120  # characters, where there is no terminal to say


def command(
    robot: Annotated[str, typer.Argument(help="A .urdf file, a spec (.toml), or a controller that ships.")],
    at: Annotated[
        str | None, typer.Option(metavar="Q", help="Joint positions to draw at, 0.1,0.2,...; default: 0, or near it.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Where to draw the robot: a .png, .svg or .pdf file.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")] = False,
) -> int:
    """Show a robot's joints, links and limits as tables, and draw it."""
    from clikgen.cli.terminal import messages, print_json, print_table
    from clikgen.symbolic.spec import read_robot

    path = _file(robot)
    model = read_robot(path)
    q = _configuration(model.robot, at)
    document = _document(path, model)
    if out:
        _draw(model.robot, path, q, out)  # first: nothing is said of a robot when this fails
    if as_json:
        print_json(document)
    else:
        typer.echo(_summary(document))
        for title, columns, rows in _tables(document):
            if _width(columns, rows) > WIDTH:
                rows = [[cell.replace(" -> ", " ->\n") for cell in row] for row in rows]
            width = None if sys.stdout.isatty() else max(WIDTH, _width(columns, rows))
            print_table(title, columns, rows, width=width)
    for note in model.notes:
        messages.print(f"note: {note}")
    if out:
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


def _draw(robot: Any, path: Path, q: Sequence[float], out: Path) -> None:
    """Write a picture of the robot at given joint positions."""
    from clikgen.analysis.figures import save
    from clikgen.analysis.robot_figure import DrawnFrame, DrawnJoint, robot_figure
    from clikgen.symbolic.tree import numeric_poses

    poses = numeric_poses(robot, q)
    numbers = {joint.name: i for i, joint in enumerate(robot.coordinates)}
    joints = [
        DrawnJoint(
            joint.name,
            joint.type,
            numbers.get(joint.name),
            poses[joint.link],
            poses[robot.parent(joint)],
            joint.axis,
            joint.outline,
        )
        for joint in robot.joints
    ]
    frames = [DrawnFrame(name, pose) for name, pose in _drawn_frames(robot, poses)]
    where = "q = 0" if not any(q) else f"q = [{', '.join(f'{value:.3g}' for value in q)}]"
    figure = robot_figure(f"{path.stem}: {_freedom(robot)}, drawn at {where}", joints, robot.dimension, frames)
    save({out.stem: figure}, out.parent, [out.suffix.removeprefix(".")])


def _drawn_frames(robot: Any, poses: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    """Name and [R | p] (3, 4) of the root and of the spec's frames, or of the link that most joints carry."""
    import numpy as np

    from clikgen.symbolic.tree import rotation_matrix

    yield robot.root, poses[robot.root]
    if robot.frames:
        for frame in robot.frames:
            rotation, position = poses[frame.link][:, :3], poses[frame.link][:, 3]
            yield frame.name, np.column_stack([rotation @ rotation_matrix(frame.rpy), rotation @ frame.xyz + position])
        return
    depth = {robot.root: 0}
    for joint in robot.joints:
        depth[joint.link] = depth[robot.parent(joint)] + joint.independent
    tip = max(reversed(depth), key=lambda link: depth[link])
    yield tip, poses[tip]


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


def _freedom(robot: Any) -> str:
    n, inputs = len(robot.coordinates), len(robot.inputs)
    text = f"{n} degree{'s' if n > 1 else ''} of freedom"
    return text if inputs == n else f"{text}, {inputs} inputs"


def _document(path: Path, model: Any) -> dict[str, Any]:
    """All that is known of the robot; what a part does not have is None."""
    robot = model.robot
    return {
        "robot": str(path),
        "space": robot.space,
        "root": robot.root,
        "links": list(robot.links),
        "degrees_of_freedom": len(robot.coordinates),
        "inputs": [{"name": one.name, "unit": f"{one.unit}/s", "velocity": one.velocity} for one in robot.inputs],
        "drive": robot.drive.model_dump() if robot.drive else None,
        "joints": [_joint(robot, joint) for joint in robot.joints],
        "frames": [frame.model_dump(mode="json") for frame in robot.frames],
        "points_of_interest": [point.model_dump(mode="json") for point in robot.points_of_interest],
        "bodies": [body.model_dump(mode="json") for body in robot.bodies],
        "notes": list(model.notes),
    }


def _joint(robot: Any, joint: Any) -> dict[str, Any]:
    """One joint, key by key; what it does not have is None."""
    moves = joint.type != "fixed"
    names = [one.name for one in robot.coordinates]
    return {
        "joint": joint.name,
        "q": names.index(joint.name) if joint.independent else None,
        "type": joint.type,
        "unit": joint.unit if moves else None,
        "parent": robot.parent(joint),
        "link": joint.link,
        "xyz": list(joint.xyz),
        "rpy": list(joint.rpy),
        "axis": list(joint.axis) if moves else None,
        "lower": joint.lower,
        "upper": joint.upper,
        "velocity": joint.velocity,
        "mimic": joint.mimic.model_dump() if joint.mimic else None,
    }


Table = tuple[str, list[str], list[list[str]]]


def _tables(document: Mapping[str, Any]) -> Iterable[Table]:
    """Title, columns and rows: the moving joints, where every joint sits, and what is fixed to the links."""
    joints = document["joints"]
    moving = [joint for joint in joints if joint["type"] != "fixed"]
    columns = ["joint", "q", "type", "axis", "limits", "velocity", "unit"]
    rows = [
        [
            joint["joint"],
            _text(joint["q"]),
            _type(joint),
            _vector(joint["axis"]),
            _limits(joint),
            _text(joint["velocity"]),
            f"{joint['unit']}, {joint['unit']}/s",
        ]
        for joint in moving
    ]
    yield "joints that move", columns, rows
    yield (
        "where the joints sit: xyz [m] and rpy [rad] in the parent link",
        ["joint", "parent -> link", "xyz", "rpy"],
        [
            [
                joint["joint"] + (" (fixed)" if joint["type"] == "fixed" else ""),
                f"{joint['parent']} -> {joint['link']}",
                _vector(joint["xyz"]),
                _vector(joint["rpy"]),
            ]
            for joint in joints
        ],
    )
    if document["frames"]:
        rows = [[one["name"], one["link"], _vector(one["xyz"]), _vector(one["rpy"])] for one in document["frames"]]
        yield "frames", ["frame", "on link", "xyz [m]", "rpy [rad]"], rows
    if document["points_of_interest"]:
        points = document["points_of_interest"]
        rows = [[one["name"], one["link"], _vector(one["offset"]), _text(one["influence_radius"])] for one in points]
        yield "points of interest", ["point", "on link", "offset [m]", "influence radius [m]"], rows
    if document["bodies"]:
        rows = [
            [
                one["name"],
                one["link"],
                "capsule" if one["end"] else "ball",
                _vector(one["start"]),
                _vector(one["end"]),
                _text(one["radius"]),
            ]
            for one in document["bodies"]
        ]
        yield "collision bodies", ["body", "on link", "shape", "from [m]", "to [m]", "radius [m]"], rows


def _width(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """How wide a table is in which no word is cut and no line is wrapped."""
    longest = [
        max(len(line) for cell in column for line in cell.split("\n")) for column in zip(columns, *rows, strict=True)
    ]
    return sum(longest) + 3 * len(columns) + 1


def _summary(document: Mapping[str, Any]) -> str:
    """What the robot is, in a line or two."""
    fixed = sum(joint["type"] == "fixed" for joint in document["joints"])
    n, inputs = document["degrees_of_freedom"], document["inputs"]
    text = f"{document['robot']}: {len(document['links'])} links from '{document['root']}'"
    text += f", {n} degree{'s' if n > 1 else ''} of freedom"
    if fixed:
        text += f", {fixed} fixed joint{'s' if fixed > 1 else ''}"
    if document["space"] == "planar":
        text += ", planar"
    drive = document["drive"]
    if drive:
        text += (
            f"\n{len(inputs)} inputs: a differential drive has v (at most {drive['velocity']:g} m/s) in place of the "
            f"rates of {drive['x']} and {drive['y']}"
        )
    return text


def _type(joint: Mapping[str, Any]) -> str:
    """The type, and what a mimic follows."""
    mimic = joint["mimic"]
    if mimic is None:
        return str(joint["type"])
    times = "" if mimic["multiplier"] == 1 else "-" if mimic["multiplier"] == -1 else f"{mimic['multiplier']:.4g} "
    offset = f" {mimic['offset']:+.4g}" if mimic["offset"] else ""
    return f"= {times}{mimic['joint']}{offset}"


def _limits(joint: Mapping[str, Any]) -> str:
    if joint["lower"] is None:
        return "-"
    return f"{joint['lower']:.4g} .. {joint['upper']:.4g}"


def _vector(values: Sequence[float] | None) -> str:
    """Numbers beside one another; what is rounding of a right angle's sine, below a nanometre, is 0."""
    return "-" if values is None else "  ".join(f"{0.0 if abs(v) < 1e-9 else v:.4g}" for v in values)


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
