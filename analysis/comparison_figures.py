"""Laws in one picture: a row each, so that chatter and its absence stand above each other; and two, side by side."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from clikgen.analysis import drawing
from clikgen.analysis.comparison import Compared, clearance, deepest
from clikgen.analysis.comparison_film import animate
from clikgen.analysis.drawing import COMMANDED, CONTACT, ERROR, OBSTACLE, QUIET, REGION, STYLE, TRACED
from clikgen.analysis.metrics import encounters, metrics
from clikgen.analysis.plates import Columns, Plate, save_plates
from clikgen.runtime.documents import BadInput
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]
Range = tuple[float, float]

ZOOM = 0.5  # [s] how much of a contact is enlarged
NARROW = 0.2  # the ratio of its sides from which on a rectangle is a strip
LEAST_DEPTH = 5e-3  # [m] clearances are shown in a range made for intrusions of this depth at least
CALM, ALARM = "#117733", ERROR  # of the two words
_DASHED = (0, (5, 3))
_DOTTED = (0, (2, 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """What every law is drawn with, so that they compare at a glance."""

    joints: Sequence[int]  # whose velocities are shown
    enlarged: Mapping[str, slice]  # law -> the steps that are enlarged
    velocity: Range  # of these joints over the run [unit/s]
    velocity_zoom: Range  # and in what is enlarged of it
    clearance: Range | None  # [mm]; None where there is nothing to keep off
    view: Sequence[int]  # the two coordinates in which paths are drawn
    paths: drawing.Extent | None  # None where no path is followed
    influence: float | None  # radius around the tracked frame [m]


def save_comparison(
    compared: Sequence[Compared],
    folder: Path,
    film: bool = True,
    progress: Callable[[str], None] = drawing.ignore,
) -> list[Path]:
    """Write the figure of the laws, its data and, where wanted, their film to `folder`; of two laws a contrast too.

    Laws under which the robot diverged are left out; a robot in the plane is filmed where it follows a path there.
    Returns the files. Raises BadInput when nothing is left, a run
    has a few steps only, or the folder cannot be written to.
    """
    drawn = drawable(compared)
    plates = [comparison_plate(drawn), *([contrast_plate(*drawn)] if len(drawn) == 2 else [])]
    paths = save_plates(plates, folder, progress)
    if film and (_has_path(drawn[0]) or drawn[0].controller.manifest.dimension == 3):
        paths.append(folder / "animation.gif")
        progress(str(paths[-1]))
        animate(drawn, paths[-1])
    return paths


def drawable(compared: Sequence[Compared]) -> list[Compared]:
    """Those that did not diverge; raises BadInput when none is left, or for a few steps only."""
    drawn = [each for each in compared if each.rollout.diverged is None]
    if not drawn:
        raise BadInput(f"{', '.join(each.law.name for each in compared)}: all diverged, nothing to draw")
    steps = len(drawn[0].rollout.t)
    if steps < drawing.SHORTEST:
        raise BadInput(f"wanted {drawing.SHORTEST} steps or more to draw, got {steps}")
    return drawn


def comparison_plate(compared: Sequence[Compared]) -> Plate:
    """A row per law: path, least clearance, the velocities of the joints that tell most, and these enlarged."""
    with mpl.rc_context(STYLE):
        figure = _comparison(compared, _shared(compared, {each.law.name: _window(each.rollout) for each in compared}))
    first = compared[0].rollout
    caption = (
        f"{first.scenario.name} under {len(compared)} laws: path, least distance to a boundary, and joint velocities, "
        f"of each law the {ZOOM:g} s enlarged in which they jump most."
    )
    return Plate("comparison", caption, figure, _data(compared))


def contrast_plate(left: Compared, right: Compared) -> Plate:
    """Two laws side by side: path, joint velocities, and the ZOOM seconds in which the first one's jump most."""
    both, window = (left, right), _window(left.rollout)
    with mpl.rc_context(STYLE):
        figure = _contrast(both, _shared(both, {each.law.name: window for each in both}))
    caption = f"{left.law.title} beside {right.law.title}: path, joint velocities, and {ZOOM:g} s of them enlarged."
    return Plate("contrast", caption, figure, _data(both))


# What the laws have in common.


def _has_path(each: Compared) -> bool:
    """Whether a frame follows a path in the plane, or in space."""
    return bool(each.rollout.position.shape[1] >= 2)


def _shared(compared: Sequence[Compared], enlarged: Mapping[str, slice]) -> _Shared:
    rollouts = [each.rollout for each in compared]
    joints = drawing.telling_joints(dict(enumerate(rollouts)))
    start = drawing.poses(compared[0].controller, rollouts[0], [0]) if _has_path(compared[0]) else None
    influence = drawing.tracked_radius(rollouts[0], start) if start else None
    view = _view(rollouts)
    return _Shared(
        joints=joints,
        enlarged=enlarged,
        velocity=drawing.value_range([rollout.dq[:, joints] for rollout in rollouts]),
        velocity_zoom=drawing.value_range([each.rollout.dq[enlarged[each.law.name], joints] for each in compared]),
        clearance=_clearance_range(rollouts),
        view=view,
        paths=_paths_extent(rollouts, view, influence or 0.0) if start else None,
        influence=influence,
    )


def _view(rollouts: Sequence[Rollout]) -> list[int]:
    """The two coordinates of the world in which the paths are widest, in their order."""
    spread = np.ptp(np.concatenate([rollout.position for rollout in rollouts]), axis=0)
    return sorted(np.argsort(-spread, kind="stable")[:2].tolist())


def _paths_extent(rollouts: Sequence[Rollout], view: Sequence[int], influence: float) -> drawing.Extent:
    """The rectangle that holds paths and obstacles, with `influence` [m] around these; no narrow strip."""
    places = [path[:, view] for rollout in rollouts for path in (rollout.reference, rollout.position)]
    first = rollouts[0]
    for i, radius in enumerate(first.obstacle_radius):
        places += [first.obstacle_center[:, i, view] + side * (radius + influence) for side in (-1.0, 1.0)]
    around = drawing.around(np.concatenate(places), 0.025)
    return around if NARROW < around.aspect < 1.0 / NARROW else around.square()


def _window(rollout: Rollout) -> slice:
    """The ZOOM seconds in which the velocities jump most, within encounters where there are any."""
    steps = len(rollout.t)
    length = max(2, min(steps, round(ZOOM / rollout.period)))
    jumps = np.zeros(steps)
    for begin, end in encounters(rollout) or [(0, steps)]:
        inside = slice(max(begin - 1, 1), min(end + 1, steps - 1))  # a jump is there on the way in and out too
        jumps[inside] = np.abs(np.diff(rollout.dq, n=2, axis=0)).sum(axis=1)[inside.start - 1 : inside.stop - 1]
    in_the_middle = np.hanning(length + 2)[1:-1]  # rather than at an end
    start = int(np.argmax(np.convolve(jumps, in_the_middle, mode="valid")))
    return slice(start, start + length)


def _clearance_range(rollouts: Sequence[Rollout]) -> Range | None:
    """From below the deepest intrusion to a few times as far outside [mm]."""
    values = [value for value in map(clearance, rollouts) if value is not None]
    if not values:
        return None
    depth = max([LEAST_DEPTH, *(-float(np.min(value)) for value in values)])
    return -1.3e3 * depth, 3e3 * depth


def _data(compared: Sequence[Compared]) -> Columns:
    """Time, reference, and per law position, least clearance and joint velocities."""
    first = compared[0].rollout
    columns: dict[str, NDArray[np.floating]] = {"t [s]": first.t}
    for i in range(first.reference.shape[1]):
        columns[f"reference {i} [m]"] = first.reference[:, i]
    for each in compared:
        rollout, least = each.rollout, clearance(each.rollout)
        for i in range(rollout.position.shape[1]):
            columns[f"{each.law.name}: position {i} [m]"] = rollout.position[:, i]
        if least is not None:
            columns[f"{each.law.name}: clearance [m]"] = least
        for i, joint in enumerate(rollout.manifest.joints):
            columns[f"{each.law.name}: {joint.name} velocity [{joint.unit}/s]"] = rollout.dq[:, i]
    return columns


# A row per law.


def _comparison(compared: Sequence[Compared], shared: _Shared) -> Figure:
    shown = [
        *([(float(np.clip(0.75 * shared.paths.aspect, 1.2, 2.5)), _path)] if shared.paths else []),
        *([(1.9, _clearance)] if shared.clearance else []),
        (2.3, _velocity),
        (1.5, _enlarged),
    ]
    figure = Figure(figsize=(12.0, 1.3 + 1.35 * len(compared)), layout="constrained")
    grid = figure.add_gridspec(len(compared), len(shown), width_ratios=[width for width, _ in shown])
    for row, each in enumerate(compared):
        for column, (_, draw) in enumerate(shown):
            axes = figure.add_subplot(grid[row, column])
            draw(axes, each, shared)
            if column == 0:
                axes.set_title(each.law.title, loc="left", fontweight="bold")
                axes.set_anchor("W")
            if row < len(compared) - 1:
                axes.tick_params(labelbottom=draw is _enlarged)  # which has times of its own
                axes.set_xlabel("")
    first = compared[0].rollout
    entries = [*_path_entries(first, shared), *_clearance_entries(shared), *_velocity_entries(first, shared)]
    figure.legend(handles=entries, loc="outside lower center", ncols=4)
    figure.suptitle(f"{first.scenario.name} on {first.manifest.controller}", x=0.01, ha="left", fontsize=12)
    return figure


def _path(axes: Axes, each: Compared, shared: _Shared) -> None:
    """The commanded and the traced path, and the obstacles, seen along the coordinate that says least."""
    if shared.paths is None:
        return
    rollout, view = each.rollout, list(shared.view)
    _obstacles(axes, rollout, view, shared.influence)
    axes.plot(*rollout.position[:, view].T, color=TRACED, linewidth=1.2, zorder=4)
    axes.plot(*rollout.reference[:, view].T, color=COMMANDED, linestyle=_DASHED, linewidth=1.0, zorder=5)
    shared.paths.apply(axes)
    axes.xaxis.set_major_locator(MaxNLocator(7 if shared.paths.aspect > 2.5 else 3))
    seen = " from above" if rollout.manifest.dimension == 3 and view == [0, 1] else ""
    axes.set(xlabel=f"${'xyz'[view[0]]}$ [m]{seen}", ylabel=f"${'xyz'[view[1]]}$ [m]")


def _obstacles(axes: Axes, rollout: Rollout, view: list[int], influence: float | None) -> None:
    """Where the obstacles are at the end; of those that move also their way there. Around each the tool's reach."""
    center, radius = rollout.obstacle_center[:, :, view], rollout.obstacle_radius
    axes.plot(*np.moveaxis(center, 2, 0), color=OBSTACLE, linewidth=0.8, linestyle=":")
    drawing.add_obstacles(axes, center[-1], radius)
    if influence:
        rings = list(drawing.circles(center[-1], radius + influence))
        axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=REGION), autolim=False)


def _clearance(axes: Axes, each: Compared, shared: _Shared) -> None:
    """The least distance to a boundary over time, with what lies beyond it filled."""
    values = clearance(each.rollout)
    if values is None or shared.clearance is None:
        return
    t = each.rollout.t
    axes.plot(t, 1e3 * values, color=TRACED, linewidth=1.1)
    axes.fill_between(t, 1e3 * np.minimum(values, 0.0), color=ERROR, linewidth=0, zorder=3)
    axes.axhline(0.0, color=COMMANDED, linewidth=0.9, zorder=4)
    axes.set(xlim=(t[0], t[-1]), ylim=shared.clearance, xlabel="$t$ [s]", ylabel="$d - s$ [mm]")
    axes.set_title(_intrusion(each), loc="right")


def _intrusion(each: Compared) -> str:
    """How deep it went in."""
    depth = deepest(each.rollout)
    return f"{1e3 * depth:.2g} mm intrusion" if depth else "no intrusion"


def _velocity(axes: Axes, each: Compared, shared: _Shared) -> None:
    """The velocities of some joints of one kind over the run, and what is enlarged of them."""
    rollout = each.rollout
    for i in drawing.covering_first(rollout, shared.joints):
        axes.plot(rollout.t, rollout.dq[:, i], color=_joint_colour(i, shared), linewidth=0.9)
    drawing.shade(axes, drawing.encounter_times(rollout))
    t = rollout.t[shared.enlarged[each.law.name]]
    low, high = shared.velocity_zoom
    corner, size = (float(t[0]), low), (float(t[-1] - t[0]), high - low)
    axes.add_patch(Rectangle(corner, *size, fill=False, edgecolor=QUIET, linestyle=_DOTTED, zorder=6))
    axes.set(xlim=(rollout.t[0], rollout.t[-1]), ylim=shared.velocity, xlabel="$t$ [s]", ylabel=_rate(each, shared))
    axes.set_title(_numbers(each), loc="left", fontsize=9)


def _rate(each: Compared, shared: _Shared) -> str:
    """The joint velocity with the unit of the joints shown."""
    return f"$\\dot{{q}}$ [{each.rollout.manifest.joints[shared.joints[0]].unit}/s]"


def _numbers(each: Compared) -> str:
    """Its switches and its total variation."""
    units = ", ".join(sorted({f"{joint.unit}/s" for joint in each.rollout.manifest.joints}))
    total = f"total variation {metrics(each.rollout).total_variation:.3g} {units}"
    return f"{each.switches}, {total}" if each.switches else total


def _enlarged(axes: Axes, each: Compared, shared: _Shared) -> None:
    """The same velocities, sample by sample, and each sample shaded in which a one-sided task acts."""
    rollout, window = each.rollout, shared.enlarged[each.law.name]
    t = rollout.t[window]
    style: dict[str, Any] = {"drawstyle": "steps-post", "linewidth": 1.0, "marker": ".", "markersize": 3.0}
    for i in drawing.covering_first(rollout, shared.joints):
        axes.plot(t, rollout.dq[window, i], color=_joint_colour(i, shared), **style)
    acts = t[rollout.active[window]]
    drawing.shade(axes, [(float(at), float(at) + rollout.period) for at in acts])
    axes.set(xlim=(t[0], t[-1]), ylim=shared.velocity_zoom, xlabel="$t$ [s]", ylabel=_rate(each, shared))
    axes.xaxis.set_major_locator(MaxNLocator(4))
    for spine in axes.spines.values():
        spine.set(visible=True, color=QUIET, linestyle=_DOTTED)


def _path_entries(rollout: Rollout, shared: _Shared) -> list[Artist]:
    """The legend of a path."""
    if shared.paths is None:
        return []
    there: list[Artist] = [
        Patch(facecolor=OBSTACLE, edgecolor="black", label="obstacle, at the end"),
        *([Line2D([], [], color=REGION, label="reach of the tool's influence region")] if shared.influence else []),
    ]
    return [
        Line2D([], [], color=COMMANDED, linestyle=_DASHED, label="commanded path"),
        Line2D([], [], color=TRACED, label="traced path"),
        *(there if rollout.obstacle_radius.size else []),
    ]


def _clearance_entries(shared: _Shared) -> list[Artist]:
    """The legend of a clearance."""
    if shared.clearance is None:
        return []
    return [
        Line2D([], [], color=TRACED, linewidth=1.1, label="least clearance $d - s$"),
        Line2D([], [], color=COMMANDED, linewidth=0.9, label="boundary, $d = s$"),
        Patch(facecolor=ERROR, label="intrusion"),
    ]


def _velocity_entries(rollout: Rollout, shared: _Shared) -> list[Artist]:
    """The legend of the velocities."""
    return [
        *(_joint_entry(rollout, i, shared) for i in shared.joints),
        Patch(facecolor=CONTACT, alpha=0.25, label="inside, or the barrier acts"),
        Patch(facecolor="none", edgecolor=QUIET, linestyle=_DOTTED, label="enlarged"),
    ]


def _joint_entry(rollout: Rollout, i: int, shared: _Shared) -> Line2D:
    name = rollout.manifest.joints[i].name.replace("_", " ")
    return Line2D([], [], color=_joint_colour(i, shared), label=f"velocity of {name}")


def _joint_colour(i: int, shared: _Shared) -> str:
    """One for each of the joints shown, of which there may be more than colours."""
    return drawing.joint_colour(list(shared.joints).index(i))


# Two laws, a column each.


def _contrast(compared: Sequence[Compared], shared: _Shared) -> Figure:
    """The word for it, then path, velocities, and these enlarged, all in the same axes."""
    wide, left, apart = 4.4, 0.75, 4.68  # [inch] the axes, where the first column begins, and from column to column
    high = min(wide / shared.paths.aspect, 3.2) if shared.paths else 0.0
    parts = [*([(high, _path)] if shared.paths else []), (1.35, _velocity), (1.35, _enlarged)]
    above, gap, below = 1.1, 0.55, 1.05  # [inch] for the words, for labels, and for the legend
    total = above + sum(height for height, _ in parts) + gap * (len(parts) - 1) + below
    figure = Figure(figsize=(10.0, total))
    for column, each in enumerate(compared):
        bottom = total - above + gap
        for row, (height, draw) in enumerate(parts):
            bottom -= height + gap
            place = (left + apart * column, bottom, wide, height)
            axes = figure.add_axes((place[0] / 10.0, place[1] / total, place[2] / 10.0, place[3] / total))
            draw(axes, each, shared)
            axes.set_title("", loc="left")
            if row == 0:
                _headline(axes, each)
            if column:
                axes.tick_params(labelleft=False)
                axes.set_ylabel("")
    first = compared[0].rollout
    entries = [*_path_entries(first, shared), *_velocity_entries(first, shared)]
    figure.legend(handles=entries, loc="lower center", ncols=4)
    return figure


def _headline(axes: Axes, each: Compared) -> None:
    """Whether it chatters, in a word that is read first, above what says so; the law's name where nothing says so."""
    words = {True: ("chatter", ALARM), False: ("none", CALM), None: (each.law.name, COMMANDED)}
    word, colour = words[each.chatters]
    axes.set_title(word, fontsize=28, fontweight="bold", color=colour, pad=40)
    facts = f"{each.law.title}: {_intrusion(each)}\n{_numbers(each)}"
    axes.annotate(facts, (0.5, 1.0), (0, 8), "axes fraction", "offset points", ha="center", linespacing=1.5)
