"""A robot as a picture: its links as lines, its joints by their axes, with their names."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from clikgen.analysis.drawing import JOINTS, QUIET, ROBOT_EDGE, STYLE

Array = NDArray[np.float64]

COLOURS = {"revolute": JOINTS[0], "continuous": JOINTS[2], "prismatic": JOINTS[1], "fixed": QUIET}
MARKERS = {"revolute": "o", "continuous": "o", "prismatic": "s", "fixed": "."}
SHORT = 1e-6  # [m] joints nearer than this stand at one place, and share a label
MOST_LABELS = 24


@dataclass(frozen=True, slots=True, eq=False)
class DrawnJoint:
    """A joint, where its link and the link that carries it are, [R | p] (3, 4), and its axis in its own frame."""

    name: str
    type: str
    pose: Array
    parent: Array
    axis: tuple[float, float, float]


def robot_figure(title: str, joints: Sequence[DrawnJoint], dimension: int) -> Figure:
    """The robot seen from the side, or from above where it is planar (dimension 2)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 8.0), layout="constrained")
        axes: Any = figure.add_subplot(projection="3d")
        places = np.array([[joint.parent[:, 3], joint.pose[:, 3]] for joint in joints])  # (joints, 2, 3)
        low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
        half = 0.55 * float(np.max(high - low)) + 1e-3
        for joint, (start, end) in zip(joints, places, strict=True):
            axes.plot(*np.array([start, end]).T, color=ROBOT_EDGE, linewidth=4.0, solid_capstyle="round", zorder=1)
            if joint.type != "fixed":
                arrow = 0.18 * half * joint.pose[:, :3] @ joint.axis
                axes.quiver(*end, *arrow, color=COLOURS[joint.type], linewidth=1.4, arrow_length_ratio=0.25)
            axes.plot(*end, marker=MARKERS[joint.type], color=COLOURS[joint.type], markersize=5)
        if len(joints) <= MOST_LABELS:
            _label(axes, joints, 0.05 * half)
        middle = (low + high) / 2
        axes.set(**{f"{name}lim": (m - half, m + half) for name, m in zip("xyz", middle, strict=True)})
        axes.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]" if dimension == 3 else "")
        axes.set_box_aspect((1, 1, 1))
        if dimension == 2:
            axes.view_init(elev=90, azim=-90)
            axes.set_zticks([])
        figure.suptitle(title, fontsize=10)
        present = [kind for kind in COLOURS if kind in {joint.type for joint in joints}]
        figure.legend(
            handles=[
                Line2D([], [], color=COLOURS[kind], marker=MARKERS[kind], linestyle="", label=f"{kind} joint")
                for kind in present
            ],
            loc="outside lower center",
            ncols=len(present),
        )
    return figure


def _label(axes: Any, joints: Sequence[DrawnJoint], lift: float) -> None:
    """The names of the joints, those at one place on one label."""
    named: list[tuple[Array, list[str]]] = []
    for joint in joints:
        place = joint.pose[:, 3]
        here = next((names for other, names in named if np.linalg.norm(other - place) < SHORT), None)
        if here is None:
            named.append((place, [joint.name]))
        else:
            here.append(joint.name)
    for place, names in named:
        axes.text(*(place + lift), ", ".join(names), fontsize=8, color="#222222", zorder=5)
