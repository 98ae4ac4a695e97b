"""A robot as a picture: its links as lines, its joints numbered as in q, their names in a list beside."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from clikgen.analysis.drawing import JOINTS, QUIET, ROBOT, ROBOT_EDGE, STYLE

Array = NDArray[np.float64]

COLOURS = {"revolute": JOINTS[0], "continuous": JOINTS[2], "prismatic": JOINTS[1], "fixed": QUIET}
MARKERS = {"revolute": "o", "continuous": "o", "prismatic": "s", "fixed": "."}
SIZE = (11.0, 7.5)  # [inch]
DRAWING = (0.0, 0.0, 0.62, 0.93)  # left, bottom, width, height, as shares of the picture
LIST = (0.67, 0.90)  # where the list of joints starts
LINES = 32  # of the list, in a column
ARROW = 0.16  # how long a joint's axis is drawn, as a share of half the box
SLIMMEST = 0.5  # the box's shortest side, as a share of its longest
LONGEST_NAME = 38  # characters; in two columns half of that
TRIAD = ("#D55E00", "#009E73", "#0072B2")  # x, y, z
TRIAD_LENGTH = 0.11  # as a share of half the box
LABEL = 11.0  # [points] how high a label is, and how much of it a character takes
CHARACTER = 5.5
NEAR = 4.0  # [points] joints that are seen nearer share a label
TOGETHER = 4  # numbers in a label, else "0..5"


@dataclass(frozen=True, slots=True, eq=False)
class DrawnJoint:
    """A joint, where its link and the link that carries it are, [R | p] (3, 4), and its axis in its own frame.

    `number` is its place in q, None for a fixed joint or a mimic; `outline` is its link's, in the link's frame.
    """

    name: str
    type: str
    number: int | None
    pose: Array
    parent: Array
    axis: tuple[float, float, float]
    outline: tuple[tuple[float, float, float], ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DrawnFrame:
    """A named frame, drawn by its axes, and where it is, [R | p] (3, 4)."""

    name: str
    pose: Array


def robot_figure(title: str, joints: Sequence[DrawnJoint], dimension: int, frames: Sequence[DrawnFrame] = ()) -> Figure:
    """The robot seen from the side, or from above where it is planar (dimension 2), and the axes of `frames`."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=SIZE)
        axes = (_in_space if dimension == 3 else _in_the_plane)(figure, joints, frames)
        _label(figure, axes, joints, frames, dimension)
        _list(figure, [joint for joint in joints if joint.number is not None])
        figure.suptitle(_broken(title), fontsize=10, x=0.02, y=0.975, ha="left", va="top")
        present = [kind for kind in COLOURS if kind in {joint.type for joint in joints}]
        figure.legend(
            handles=[
                Line2D([], [], color=COLOURS[kind], marker=MARKERS[kind], linestyle="", label=f"{kind} joint")
                for kind in present
            ]
            + [
                Line2D([], [], color=colour, label=f"{name} axis")
                for name, colour in zip("xyz"[:dimension], TRIAD, strict=False)
                if frames
            ],
            loc="lower left",
            bbox_to_anchor=(LIST[0] - 0.03, 0.0),
            ncols=3,
            columnspacing=1.2,
            handlelength=1.2,
        )
    return figure


def _broken(title: str) -> str:
    """The title in lines of 130 characters at most."""
    lines = [""]
    for word in title.split(" "):
        if len(lines[-1]) + len(word) > 130:
            lines.append("")
        lines[-1] += f"{word} "
    return "\n".join(line.rstrip() for line in lines[:3])


def _box(joints: Sequence[DrawnJoint], frames: Sequence[DrawnFrame]) -> tuple[Array, Array]:
    """The middle (3,) and half the sides (3,) of a box about the robot, none much shorter than the longest [m]."""
    corners = [joint.pose[:, :3] @ corner + joint.pose[:, 3] for joint in joints for corner in joint.outline]
    corners += [frame.pose[:, 3] for frame in frames]
    places = np.array([*corners, *(one[:, 3] for joint in joints for one in (joint.parent, joint.pose))])
    low, high = places.min(axis=0), places.max(axis=0)
    longest = max(float(np.max(high - low)), 1e-3)
    return (low + high) / 2, 0.5 * np.maximum(high - low, SLIMMEST * longest) + 0.08 * longest


def _in_space(figure: Figure, joints: Sequence[DrawnJoint], frames: Sequence[DrawnFrame]) -> Any:
    """Axes with the robot from the side, a metre as long along x as along y and z."""
    axes: Any = figure.add_axes(DRAWING, projection="3d")
    middle, half = _box(joints, frames)
    for joint in joints:
        start, end = joint.parent[:, 3], joint.pose[:, 3]
        axes.plot(*np.array([start, end]).T, color=ROBOT_EDGE, linewidth=4.0, solid_capstyle="round", zorder=1)
        if joint.number is not None:
            arrow = ARROW * half.max() * joint.pose[:, :3] @ joint.axis
            axes.quiver(*end, *arrow, color=COLOURS[joint.type], linewidth=1.4, arrow_length_ratio=0.25)
        axes.plot(*end, marker=MARKERS[joint.type], color=COLOURS[joint.type], markersize=5)
    for frame in frames:
        for direction, colour in zip(frame.pose[:, :3].T, TRIAD, strict=True):
            ends = frame.pose[:, 3] + np.outer([0.0, TRIAD_LENGTH * half.max()], direction)
            axes.plot(*ends.T, color=colour, linewidth=3.0, zorder=1.5)
    axes.set(**{f"{name}lim": (m - h, m + h) for name, m, h in zip("xyz", middle, half, strict=True)})
    axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axes.set_box_aspect(tuple(half), zoom=0.88)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(5))
    axes.tick_params(labelsize=8)
    return axes


def _in_the_plane(figure: Figure, joints: Sequence[DrawnJoint], frames: Sequence[DrawnFrame]) -> Any:
    """Axes with the robot from above, a metre as long along x as along y."""
    axes: Any = figure.add_axes((0.07, 0.09, 0.54, 0.8))
    middle, halves = _box(joints, frames)
    half = float(halves.max())
    for joint in joints:
        corners = [(joint.pose[:, :3] @ corner + joint.pose[:, 3])[:2] for corner in joint.outline]
        if corners:
            axes.add_patch(Polygon(np.array(corners), facecolor=ROBOT, edgecolor=ROBOT_EDGE, zorder=1))
    for joint in joints:
        start, end = joint.parent[:2, 3], joint.pose[:2, 3]
        axes.plot(*np.array([start, end]).T, color=ROBOT_EDGE, linewidth=4.0, solid_capstyle="round", zorder=2)
        if joint.type == "prismatic":
            tip = end + ARROW * half * (joint.pose[:, :3] @ joint.axis)[:2]
            arrow = {"arrowstyle": "->", "color": COLOURS["prismatic"], "linewidth": 1.4}
            axes.annotate("", xy=tip, xytext=end, arrowprops=arrow, zorder=3)
        axes.plot(*end, marker=MARKERS[joint.type], color=COLOURS[joint.type], markersize=6, zorder=4)
    for frame in frames:
        for direction, colour in zip(frame.pose[:, :2].T, TRIAD, strict=False):
            ends = frame.pose[:2, 3] + np.outer([0.0, TRIAD_LENGTH * half], direction[:2])
            axes.plot(*ends.T, color=colour, linewidth=3.0, zorder=2.5)
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
    return axes


def _label(
    figure: Figure, axes: Any, joints: Sequence[DrawnJoint], frames: Sequence[DrawnFrame], dimension: int
) -> None:
    """Numbers of joints and names of frames, none over another: joints seen at one place share a label."""
    from mpl_toolkits.mplot3d import proj3d

    if dimension == 3:
        axes.apply_aspect()
    figure.draw_without_rendering()  # so that the axes know where they are

    def seen(place: Array) -> Array:
        flat = proj3d.proj_transform(*place, axes.get_proj())[:2] if dimension == 3 else place[:2]
        return np.asarray(axes.transData.transform(flat)) * 72 / figure.dpi  # [points]

    groups: list[tuple[Array, Array, list[int]]] = []  # in points, in metres, numbers
    for joint in joints:
        if joint.number is None:
            continue
        point = seen(joint.pose[:, 3])
        here = next((numbers for other, _, numbers in groups if np.linalg.norm(other - point) < NEAR), None)
        if here is None:
            groups.append((point, joint.pose[:, 3], [joint.number]))
        else:
            here.append(joint.number)
    tip = ARROW * float(_box(joints, frames)[1].max())
    axles = [(0.0,) if joint.number is None else (0.0, tip / 2, tip) for joint in joints]
    dots = [
        seen(joint.pose[:, 3] + along * joint.pose[:, :3] @ joint.axis)
        for joint, axle in zip(joints, axles, strict=True)
        for along in axle
    ]
    taken: list[Array] = []
    named = [(seen(frame.pose[:, 3]), frame.pose[:, 3], frame.name) for frame in frames]
    dots += [point for point, _, _ in named]
    for point, place, text in [*((one, other, _numbers(numbers)) for one, other, numbers in groups), *named]:
        size = np.array([CHARACTER * len(text) + 4, LABEL])
        offset = _free_offset(point, size, taken, dots)
        taken.append(np.array([point + offset - size / 2, point + offset + size / 2]))
        flat = proj3d.proj_transform(*place, axes.get_proj())[:2] if dimension == 3 else place[:2]
        axes.annotate(
            text,
            xy=flat,
            xytext=tuple(offset),
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=8.5,
            color="#111111",
            bbox={"boxstyle": "round,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
            arrowprops={"arrowstyle": "-", "color": QUIET, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 2},
            zorder=10,
        )


def _free_offset(point: Array, size: Array, taken: Iterable[Array], dots: Sequence[Array]) -> Array:
    """Where beside a point a label overlaps no other and hides no joint: the nearest such place [points]."""
    taken = list(taken)
    best, fewest = np.array([14.0, 10.0]), math.inf
    for radius in (14.0, 20.0, 28.0, 38.0, 50.0, 64.0):
        for angle in np.radians((30, 150, -30, -150, 0, 180, 60, 120, -60, -120, 90, -90)):
            offset = radius * np.array([math.cos(angle), math.sin(angle)])
            low, high = point + offset - size / 2, point + offset + size / 2
            over = sum(bool(np.all(low < other[1]) and np.all(high > other[0])) for other in taken)
            hidden = sum(bool(np.all(low - 2 < dot) and np.all(high + 2 > dot)) for dot in dots)
            if 10 * over + hidden < fewest:
                best, fewest = offset, 10 * over + hidden
            if fewest == 0:
                return best
    return best


def _numbers(numbers: Sequence[int]) -> str:
    """The numbers in a row, those that follow one another as "3..9" where they are many."""
    ordered = sorted(numbers)
    if len(ordered) > TOGETHER and ordered[-1] - ordered[0] == len(ordered) - 1:
        return f"{ordered[0]}..{ordered[-1]}"
    return ", ".join(map(str, ordered))


def _list(figure: Figure, joints: Sequence[DrawnJoint]) -> None:
    """Numbers and names, in as many columns as it takes."""
    columns = max(1, math.ceil(len(joints) / LINES))
    longest = LONGEST_NAME // columns
    for column in range(columns):
        for line, joint in enumerate(joints[column * LINES : (column + 1) * LINES]):
            name = joint.name if len(joint.name) <= longest else joint.name[: longest - 1] + "…"
            x, y = LIST[0] + column * (1 - LIST[0]) / columns, LIST[1] - 0.0255 * line
            figure.text(x, y, f"{joint.number}", fontsize=8, ha="right", color=COLOURS[joint.type], weight="bold")
            figure.text(x + 0.008, y, name, fontsize=8 if columns < 3 else 6, color="#222222")
