"""The paper's figures 2-4 and 6-14 from three rollouts, and one picture that tells the whole story."""

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from clikgen.analysis import drawing
from clikgen.analysis.drawing import COMMANDED, CONTACT, ERROR, OBSTACLE, QUIET, REGION, ROBOT, STYLE, TRACED
from clikgen.analysis.metrics import away_from_encounters, encounters, metrics, path_deviation, rms
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, choices, write_atomically
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]

DPI = 120
ZOOM = 0.5  # [s] how much of a contact the zoomed axes show
DOTS = 150  # samples in a zoomed axis that can be told apart as dots
POSES = 6  # robot poses in a path figure
KINDS = {"m": "prismatic", "rad": "revolute"}  # the joints that share axes, by their unit


@dataclass(frozen=True, slots=True, eq=False)
class _Shared:
    """What every case is drawn with, so that the cases compare at a glance."""

    window: slice  # the steps that the zoomed axes show
    velocity: Mapping[str, tuple[float, float]]  # unit of a joint -> range over the whole run
    velocity_zoom: Mapping[str, tuple[float, float]]  # the same within the window
    position: tuple[tuple[float, float], ...]  # range per coordinate [m]
    position_span: tuple[float, ...]  # height of the zoomed axes per coordinate [m]
    error: tuple[float, float]  # range of the norm of the tracking error [m]
    error_span: float  # height of its zoomed axes [m]
    poses: Mapping[int, drawing.Poses]  # case -> the robot in its path figure
    paths: drawing.Extent  # of paths and obstacles
    scene: drawing.Extent  # of these and the robot
    close_up: drawing.Extent | None  # of what was traced in the encounter that the window belongs to
    influence: float | None  # radius around the tracked frame [m]


def paper_figures(rollouts: Mapping[int, Rollout], controller: CompiledController) -> dict[str, Figure]:
    """The counterparts of the paper's figures, and "overview", by the names of their files.

    `rollouts` maps the number of a case to its rollout: one scenario on `controller`, cases in order. Case n
    has the figures 3n+3 (joints), 3n+4 (position) and 3n+5 (path).

    Raises BadInput for a rollout that diverged or has a few steps only.
    """
    drawing.require_drawable(rollouts)
    with mpl.rc_context(STYLE):
        shared = _shared(rollouts, controller)
        first = next(iter(rollouts.values()))
        fastest = float(np.linalg.norm(first.reference_velocity, axis=1).max())
        figures = {
            "figure02_commanded_path": _commanded_path(first, shared),
            "figure03_commanded_position": _commanded_signal(
                first,
                first.reference,
                "{}",
                "m",
                f"Commanded end-effector position (scenario {first.scenario.name})",
            ),
            "figure04_commanded_velocity": _commanded_signal(
                first,
                first.reference_velocity,
                r"\dot{{{}}}",
                "m/s",
                f"Commanded end-effector velocity: at most {fastest:.2g} m/s",
            ),
        }
        for number, rollout in rollouts.items():
            figures[f"figure{3 * number + 3:02d}_case{number}_joints"] = _joints(rollout, shared)
            figures[f"figure{3 * number + 4:02d}_case{number}_position"] = _position(rollout, shared)
            figures[f"figure{3 * number + 5:02d}_case{number}_path"] = _path(number, rollout, shared)
        figures["overview"] = _overview(rollouts, shared)
    return figures


def save(
    figures: Mapping[str, Figure],
    folder: Path,
    formats: Sequence[str] = ("png",),
    progress: Callable[[str], None] = drawing.ignore,
) -> list[Path]:
    """Write every figure to `folder` in every format (png, svg, pdf, ...), each file whole or not at all.

    Returns the files. Raises BadInput for a format that matplotlib does not write, or a folder that cannot be
    written to.
    """
    known = FigureCanvasAgg.get_supported_filetypes()
    for ending in formats:
        if ending not in known:
            raise BadInput(f"figures: no format '{ending}'; {choices(ending, known)}")
    paths = []
    for name, figure in figures.items():
        for ending in formats:
            path = folder / f"{name}.{ending}"
            progress(str(path))
            write_atomically(path, rendered(figure, ending))
            paths.append(path)
    return paths


def rendered(figure: Figure, ending: str) -> bytes:
    """The figure as the content of a file, without the time of day where the format would hold it."""
    dated = {"svg": "Date", "pdf": "CreationDate"}
    buffer = io.BytesIO()
    with mpl.rc_context({**STYLE, "svg.hashsalt": "clikgen"}):
        metadata = {dated[ending]: None} if ending in dated else None
        figure.savefig(buffer, format=ending, dpi=DPI, metadata=metadata)
    return buffer.getvalue()


# What the cases have in common.


def _shared(rollouts: Mapping[int, Rollout], controller: CompiledController) -> _Shared:
    window = _window_of_contact(rollouts)
    every = list(rollouts.values())
    first = every[0]
    steps = np.linspace(0, len(first.t) - 1, POSES).astype(int).tolist()
    poses = {number: drawing.poses(controller, rollout, steps) for number, rollout in rollouts.items()}
    kinds = {unit: _in_unit(first, unit) for unit in KINDS}
    coordinates = range(first.reference.shape[1])
    errors = [_error(rollout) for rollout in every]
    influence = drawing.tracked_radius(first, next(iter(poses.values())))
    robots = [robot.places(np.zeros(0)) for robot in poses.values()]
    scene = drawing.extent(every, influence or 0.0, robots)
    span = drawing.value_range
    return _Shared(
        window=window,
        velocity={unit: span([r.dq[:, which] for r in every]) for unit, which in kinds.items()},
        velocity_zoom={unit: span([r.dq[window, which] for r in every]) for unit, which in kinds.items()},
        position=tuple(span([first.reference[:, i], *(r.position[:, i] for r in every)]) for i in coordinates),
        position_span=tuple(max(float(np.ptp(r.position[window, i])) for r in every) for i in coordinates),
        error=span([np.zeros(1), *errors]),
        error_span=max(float(np.ptp(error[window])) for error in errors),
        poses=poses,
        paths=drawing.extent(every, influence or 0.0),
        scene=scene,
        close_up=_close_up(every, window, scene),
        influence=influence,
    )


def _window_of_contact(rollouts: Mapping[int, Rollout]) -> slice:
    """The ZOOM seconds that lie most within encounters of all cases and, among those, chatter most.

    The middle of the run where there is no contact.
    """
    first = next(iter(rollouts.values()))
    steps = len(first.t)
    length = max(2, min(steps, round(ZOOM / first.period)))
    within, chatter = np.zeros(steps), np.zeros(steps)
    for rollout in rollouts.values():
        for begin, end in encounters(rollout):
            within[begin:end] += 1.0
        chatter[2:] += np.abs(np.diff(rollout.dq, n=2, axis=0)).sum(axis=1)
    if not within.any():
        start = (steps - length) // 2
    else:
        tie_break = _moving_sum(chatter, length) / (chatter.sum() + 1.0)  # below 1, which is one step more within
        start = int(np.argmax(_moving_sum(within, length) + tie_break))
    return slice(start, start + length)


def _moving_sum(values: Array, length: int) -> Array:
    """The sum of the `length` values from each one on, (N − length + 1,)."""
    total: Array = np.concatenate([[0.0], np.cumsum(values)])
    return total[length:] - total[:-length]


def _close_up(rollouts: Sequence[Rollout], window: slice, scene: drawing.Extent) -> drawing.Extent | None:
    """The square that holds what each case traced in its encounter within the window, if it is a small one."""
    traced = [
        rollout.position[begin:end, :2]
        for rollout in rollouts
        for begin, end in encounters(rollout)
        if begin < window.stop and window.start < end
    ]
    square = drawing.around(np.concatenate(traced), 0.12).square() if traced else scene
    return square if 2.0 * (square.right - square.left) < scene.right - scene.left else None


def _error(rollout: Rollout) -> Array:
    """Norm of the tracking error, (N,) [m]."""
    norm: Array = np.linalg.norm(rollout.error, axis=1)
    return norm


def _in_unit(rollout: Rollout, unit: str) -> list[int]:
    return [i for i, joint in enumerate(rollout.manifest.joints) if joint.unit == unit]


# Figures 2-4: what is commanded.


def _commanded_path(rollout: Rollout, shared: _Shared) -> Figure:
    """Figure 2: the commanded path in the plane, its direction, and the obstacles."""
    figure = Figure(figsize=(9.0, 1.05 + 8.3 / max(shared.paths.aspect, 1.6)), layout="constrained")
    axes = figure.add_subplot()
    path = rollout.reference[:, :2]
    _draw_commanded(axes, path[:, 0], path[:, 1])
    _direction_arrows(axes, path)
    near = max(1, len(path) // 20)
    _name_place(axes, "start", "o", path[0], falls=path[near, 1] < path[0, 1])
    _name_place(axes, "end", "s", path[-1], falls=path[-4 * near, 1] < path[-1, 1])
    _draw_obstacles(axes, rollout)
    _plane(axes, rollout, shared.paths)
    length = float(np.sum(np.linalg.norm(np.diff(rollout.reference, axis=0), axis=1)))
    _title(figure, f"Commanded path: {length:.2f} m in {len(rollout.t) * rollout.period:g} s")
    _legend(figure, [_COMMANDED, *_obstacle_entries(rollout)])
    return figure


def _name_place(axes: Axes, name: str, marker: str, place: Array, falls: bool) -> None:
    """Mark an end of the path with its name: above where the path falls away from it, else below."""
    axes.plot(*place, marker, color=COMMANDED, markersize=6, zorder=6)
    above = 14 if falls else -14
    axes.annotate(name, tuple(place), (0, above), "data", "offset points", ha="center", va="center")


def _direction_arrows(axes: Axes, path: Array, count: int = 5) -> None:
    """Arrow heads along a path, evenly spaced over its length."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    if along[-1] == 0.0:
        return
    arrow = {"arrowstyle": "-|>", "color": COMMANDED, "mutation_scale": 16, "linewidth": 0.0}
    for share in (np.arange(count) + 0.5) / count:
        k = max(1, int(np.searchsorted(along, share * along[-1])))
        axes.annotate("", tuple(path[k]), tuple(path[k - 1]), arrowprops=arrow, zorder=6)


def _commanded_signal(rollout: Rollout, values: Array, symbol: str, unit: str, title: str) -> Figure:
    """Figures 3 and 4: each coordinate of a commanded quantity over time."""
    coordinates = values.shape[1]
    figure = Figure(figsize=(9.0, 1.0 + 1.7 * coordinates), layout="constrained")
    grid = figure.add_gridspec(coordinates, 1)
    for i in range(coordinates):
        axes = figure.add_subplot(grid[i, 0])
        _draw_commanded(axes, rollout.t, values[:, i])
        _label_value(axes, f"${symbol.format('xyz'[i])}_c$ [{unit}]")
        _time_axis(axes, rollout.t, labelled=i == coordinates - 1)
    _title(figure, title)
    _legend(figure, [_COMMANDED])
    return figure


# Figures 6, 9, 12: the joints.


def _joints(rollout: Rollout, shared: _Shared) -> Figure:
    """Joint positions and, below, joint velocities over time, with some contact enlarged."""
    units = [unit for unit in KINDS if _in_unit(rollout, unit)]
    rows = 2 * len(units)
    figure = Figure(figsize=(10.0, 1.2 + 1.7 * rows), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=[2.0, 1.0])
    for row, unit in enumerate(units):
        _joint_positions(figure, grid, row, rollout, unit)
        _joint_velocities(figure, grid, len(units) + row, rollout, unit, shared)
    _title(figure, f"{_case(rollout)}: joint motion, {_switches(rollout)}")
    _legend(figure, [*_contact_entries([rollout]), _ENLARGED])
    return figure


def _joint_positions(figure: Figure, grid: GridSpec, row: int, rollout: Rollout, unit: str) -> None:
    """One row: positions of the joints in one unit, and their legend beside."""
    axes, beside = figure.add_subplot(grid[row, 0]), figure.add_subplot(grid[row, 1])
    for i in _in_unit(rollout, unit):
        axes.plot(rollout.t, rollout.q[:-1, i], color=drawing.joint_colour(i))
    _label_value(axes, f"$q$ [{unit}]")
    drawing.shade(axes, drawing.encounter_times(rollout))
    _time_axis(axes, rollout.t, labelled=False)
    beside.axis("off")
    entries = [_joint_entry(rollout, i) for i in _in_unit(rollout, unit)]
    columns = 1 + len(entries) // 6
    beside.legend(handles=entries, loc="center left", title=f"{KINDS[unit]} joints", alignment="left", ncols=columns)


def _joint_velocities(figure: Figure, grid: GridSpec, row: int, rollout: Rollout, unit: str, shared: _Shared) -> None:
    """One row: velocities of the joints in one unit, over the whole run and in the window of contact."""
    last = row == grid.nrows - 1
    axes, zoom = figure.add_subplot(grid[row, 0]), figure.add_subplot(grid[row, 1])
    for i in drawing.covering_first(rollout, _in_unit(rollout, unit)):
        axes.plot(rollout.t, rollout.dq[:, i], color=drawing.joint_colour(i), linewidth=1.0)
        _draw_samples(zoom, rollout, rollout.dq[:, i], shared.window, drawing.joint_colour(i))
    _label_value(axes, f"$\\dot{{q}}$ [{unit}/s]")
    axes.set_ylim(shared.velocity[unit])
    drawing.shade(axes, drawing.encounter_times(rollout))
    _time_axis(axes, rollout.t, labelled=last)
    _enlarge(axes, zoom, rollout, shared.window, shared.velocity_zoom[unit], labelled=last)


# Figures 7, 10, 13: the end effector over time.


def _position(rollout: Rollout, shared: _Shared) -> Figure:
    """Each coordinate of the end effector against the commanded one, and the error; enlarged in contact."""
    coordinates = rollout.reference.shape[1]
    figure = Figure(figsize=(10.0, 2.6 + 2.0 * coordinates), layout="constrained")
    heights = [2.0] * coordinates + [1.2]
    grid = figure.add_gridspec(coordinates + 1, 2, width_ratios=[2.0, 1.0], height_ratios=heights)
    for i in range(coordinates):
        axes, zoom = figure.add_subplot(grid[i, 0]), figure.add_subplot(grid[i, 1])
        for each in (axes, zoom):
            _draw_commanded(each, rollout.t, rollout.reference[:, i])
        _against_time(axes, zoom, rollout, rollout.position[:, i], shared, shared.position_span[i], TRACED)
        _label_value(axes, f"${'xyz'[i]}$ [m]")
        axes.set_ylim(shared.position[i])
    axes, zoom = figure.add_subplot(grid[coordinates, 0]), figure.add_subplot(grid[coordinates, 1])
    _against_time(axes, zoom, rollout, _error(rollout), shared, shared.error_span, ERROR, labelled=True)
    _label_value(axes, "error [m]")
    axes.set_ylim(shared.error)
    m = metrics(rollout)
    fact = f"tracking error {m.tracking_rms:.3f} m rms, at most {m.tracking_max:.3f} m"
    _title(figure, f"{_case(rollout)}: end effector, {fact}")
    _legend(figure, [_COMMANDED, _TRACED, _ERROR, *_contact_entries([rollout]), _ENLARGED])
    return figure


def _against_time(
    axes: Axes,
    zoom: Axes,
    rollout: Rollout,
    values: Array,
    shared: _Shared,
    span: float,
    colour: str,
    labelled: bool = False,
) -> None:
    """A signal over the whole run and, in axes that are `span` high in every case, sample by sample."""
    axes.plot(rollout.t, values, color=colour)
    _draw_samples(zoom, rollout, values, shared.window, colour, held=False)
    part = values[shared.window]
    middle, half = 0.5 * float(part.min() + part.max()), 0.6 * span + 1e-6
    drawing.shade(axes, drawing.encounter_times(rollout))
    _time_axis(axes, rollout.t, labelled)
    _enlarge(axes, zoom, rollout, shared.window, (middle - half, middle + half), labelled)


# Figures 8, 11, 14: the end effector in the plane.


def _path(number: int, rollout: Rollout, shared: _Shared) -> Figure:
    """The commanded and the traced path, the obstacles and some poses of the robot; enlarged in contact."""
    wide = 6.6 if shared.close_up else 10.0
    high = min(wide / shared.scene.aspect, 5.0)
    wide = max(high * shared.scene.aspect, 4.0)
    right = 4.0 if shared.close_up else 0.0
    size = (max(wide + right + 0.6, 8.5), max(high + 1.9, 4.65 if right else 0.0))
    figure = Figure(figsize=size, layout="constrained")
    columns = [wide, right] if right else [wide]
    grid = figure.add_gridspec(2, len(columns), width_ratios=columns, height_ratios=[high + 0.4, 1.0])
    axes = figure.add_subplot(grid[0, 0])
    _draw_path(axes, rollout, shared, shared.poses[number])
    _plane(axes, rollout, shared.scene)
    if shared.close_up:
        zoom = figure.add_subplot(grid[:, 1])
        _draw_path(zoom, rollout, shared)
        _plane(zoom, rollout, shared.close_up)
        _frame_zoom(zoom)
        axes.add_patch(_frame(shared.close_up))
    off = rms(path_deviation(rollout)[away_from_encounters(rollout)])
    where = " away from contact" if rollout.active.any() else ""
    _title(figure, f"{_case(rollout)}: path, {1000.0 * off:.1f} mm rms off the commanded one{where}")
    below = figure.add_subplot(grid[1, 0])
    below.axis("off")
    ring = [_RING] if shared.influence and rollout.obstacle_radius.size else []
    entries = [_COMMANDED, _TRACED, _robot_entry(rollout), *_obstacle_entries(rollout), *ring]
    below.legend(handles=[*entries, *([_ENLARGED] if right else [])], loc="center", ncols=2)
    return figure


def _draw_path(axes: Axes, rollout: Rollout, shared: _Shared, robot: drawing.Poses | None = None) -> None:
    """The paths, the obstacles and the robot, without limits and labels."""
    if robot:
        links = drawing.add_robot(axes, alpha=0.6)
        links.set_verts([polygon for k in range(len(robot.tip)) for polygon in robot.polygons(k)])
    _draw_obstacles(axes, rollout, shared.influence)
    axes.plot(rollout.position[:, 0], rollout.position[:, 1], color=TRACED, linewidth=1.2, zorder=4)
    _draw_commanded(axes, rollout.reference[:, 0], rollout.reference[:, 1])
    axes.plot(*rollout.reference[-1, :2], "s", color=COMMANDED, markersize=3.5, zorder=5)


# The overview.


def _overview(rollouts: Mapping[int, Rollout], shared: _Shared) -> Figure:
    """A column per case: its path, the velocities of the joints that tell most, and these enlarged."""
    joints, first = drawing.telling_joints(rollouts), next(iter(rollouts.values()))
    columns = len(rollouts)
    path_height = min(9.4 / columns / shared.paths.aspect, 4.0)
    figure = Figure(figsize=(10.0, 5.1 + path_height), layout="constrained")
    grid = figure.add_gridspec(3, columns, height_ratios=[path_height + 0.1, 1.5, 1.5])
    for column, rollout in enumerate(rollouts.values()):
        path, whole, zoom = (figure.add_subplot(grid[row, column]) for row in range(3))
        _overview_path(path, rollout, shared)
        _overview_velocity(whole, zoom, rollout, joints, shared)
        if column:
            for axes in (path, whole, zoom):
                axes.set_ylabel("")
                axes.tick_params(labelleft=False)
    velocities = [_joint_entry(first, i, "velocity of ") for i in joints]
    _legend(figure, [_COMMANDED, _TRACED, *_obstacle_entries(first), *velocities, *_contact_entries(rollouts.values())])
    return figure


def _overview_path(axes: Axes, rollout: Rollout, shared: _Shared) -> None:
    """The path under the name of the case and the two numbers that the cases trade against each other."""
    _draw_path(axes, rollout, shared)
    _plane(axes, rollout, shared.paths)
    _label_value(axes, "$y$ [m]")
    fact = f"{_switches(rollout)}\ntracking error {metrics(rollout).tracking_rms:.3f} m rms"
    axes.set_title(f"Case {rollout.case.number}: {rollout.title}", fontweight="bold", fontsize=11.5, pad=34)
    axes.annotate(fact, (0.5, 1.0), (0, 8), "axes fraction", "offset points", ha="center")


def _overview_velocity(whole: Axes, zoom: Axes, rollout: Rollout, joints: Sequence[int], shared: _Shared) -> None:
    """The velocities of some joints of one kind over the run, and sample by sample in the window of contact."""
    info = rollout.manifest.joints[joints[0]]
    for i in drawing.covering_first(rollout, joints):
        whole.plot(rollout.t, rollout.dq[:, i], color=drawing.joint_colour(i), linewidth=1.0)
        _draw_samples(zoom, rollout, rollout.dq[:, i], shared.window, drawing.joint_colour(i))
    for axes, name in ((whole, "velocity"), (zoom, "enlarged")):
        _label_value(axes, f"{name} [{info.unit}/s]")
    whole.set_ylim(shared.velocity[info.unit])
    drawing.shade(whole, drawing.encounter_times(rollout))
    _time_axis(whole, rollout.t, labelled=True)
    _enlarge(whole, zoom, rollout, shared.window, shared.velocity_zoom[info.unit], labelled=True)


# Pieces that several figures are made of.

_DASHED = (0, (5, 3))
_DOTTED = (0, (2, 2))
_COMMANDED = Line2D([], [], color=COMMANDED, linestyle=_DASHED, label="commanded")
_TRACED = Line2D([], [], color=TRACED, label="traced by the end effector")
_ERROR = Line2D([], [], color=ERROR, label="norm of the tracking error")
_RING = Line2D([], [], color=REGION, label="reach of the end effector's influence region")
_OBSTACLE = Patch(facecolor=OBSTACLE, edgecolor="black", label="obstacle")
_CONTACT = Patch(facecolor=CONTACT, alpha=0.25, label="contact")
_ENLARGED = Patch(facecolor="none", edgecolor=QUIET, linestyle=_DOTTED, label="enlarged")


def _joint_entry(rollout: Rollout, i: int, prefix: str = "") -> Line2D:
    label = prefix + rollout.manifest.joints[i].name.replace("_", " ")
    return Line2D([], [], color=drawing.joint_colour(i), label=label)


def _robot_entry(rollout: Rollout) -> Patch:
    label = f"robot every {rollout.t[-1] / (POSES - 1):.2g} s"
    return Patch(facecolor=ROBOT, edgecolor=drawing.ROBOT_EDGE, label=label)


def _obstacle_entries(rollout: Rollout) -> list[Artist]:
    return [_OBSTACLE] if rollout.obstacle_radius.size else []


def _contact_entries(rollouts: Iterable[Rollout]) -> list[Artist]:
    return [_CONTACT] if any(rollout.active.any() for rollout in rollouts) else []


def _case(rollout: Rollout) -> str:
    return f"Case {rollout.case.number} ({rollout.title})"


def _switches(rollout: Rollout) -> str:
    if not rollout.active.any():
        return "no contact"
    count = metrics(rollout).switches
    often = {0: "never", 1: "once", 2: "twice"}.get(count, f"{count} times")
    return f"contact switches {often}"


def _title(figure: Figure, text: str) -> None:
    figure.suptitle(text, x=0.01, ha="left", fontsize=12)


def _legend(figure: Figure, entries: Sequence[Artist]) -> None:
    """Below everything, where it hides nothing."""
    figure.legend(handles=list(entries), loc="outside lower center", ncols=len(entries))


def _label_value(axes: Axes, text: str) -> None:
    """The label of a vertical axis, as far left in every row: cheaper than aligning the labels."""
    shift = ScaledTranslation(-0.52, 0.0, axes.figure.dpi_scale_trans)
    axes.set_ylabel(text)
    axes.yaxis.set_label_coords(0.0, 0.5, transform=axes.transAxes + shift)


def _draw_commanded(axes: Axes, x: Array, y: Array) -> None:
    axes.plot(x, y, color=COMMANDED, linestyle=_DASHED, linewidth=1.1, zorder=5)


def _draw_samples(axes: Axes, rollout: Rollout, values: Array, window: slice, colour: str, held: bool = True) -> None:
    """Every sample of a window as a dot; `held` draws it as constant over its period, as a velocity is."""
    style: Literal["steps-post", "default"] = "steps-post" if held else "default"
    t = rollout.t[window]
    dot = "." if len(t) <= DOTS else ""
    axes.plot(t, values[window], color=colour, drawstyle=style, linewidth=1.0, marker=dot, markersize=3.0)


def _draw_obstacles(axes: Axes, rollout: Rollout, influence: float | None = None) -> None:
    """Where the obstacles are; of those that move their path, and where they are when the robot is drawn.

    Around each a circle, `influence` [m] off its surface: what the tracked frame keeps out of.
    """
    times = np.linspace(0, len(rollout.t) - 1, POSES).astype(int)
    for i, radius in enumerate(rollout.obstacle_radius):
        center = rollout.obstacle_center[:, i, :2]
        moves = bool(np.ptp(center, axis=0).any())
        axes.plot(*center.T, color=OBSTACLE, linewidth=0.8, linestyle=":")
        center = center[times] if moves else center[:1]
        drawing.add_obstacles(axes, center, np.full(len(center), radius), alpha=0.5 if moves else 1.0)
        if influence:
            rings = list(drawing.circles(center, np.full(len(center), radius + influence)))
            axes.add_collection(PolyCollection(rings, facecolors="none", edgecolors=REGION), autolim=False)


def _plane(axes: Axes, rollout: Rollout, shown: drawing.Extent) -> None:
    """Limits and labels of axes that show the plane; a spatial robot is seen from above."""
    shown.apply(axes)
    seen = " (from above)" if rollout.manifest.dimension == 3 else ""
    axes.set(xlabel=f"$x$ [m]{seen}", ylabel="$y$ [m]")


def _time_axis(axes: Axes, t: Array, labelled: bool) -> None:
    axes.set_xlim(t[0], t[-1])
    axes.tick_params(labelbottom=labelled)
    if labelled:
        axes.set_xlabel("$t$ [s]")


def _enlarge(
    axes: Axes, zoom: Axes, rollout: Rollout, window: slice, limits: tuple[float, float], labelled: bool
) -> None:
    """Let `zoom` show the window and the limits, framed alike in both axes, with each sample in contact shaded."""
    t = rollout.t[window]
    contact = np.arange(len(rollout.t))[window][rollout.active[window]]
    drawing.shade(zoom, [(k * rollout.period, (k + 1) * rollout.period) for k in contact])
    zoom.set_ylim(limits)
    _time_axis(zoom, t, labelled)
    _frame_zoom(zoom)
    axes.add_patch(_frame(drawing.Extent(float(t[0]), float(t[-1]), *limits)))


def _frame_zoom(axes: Axes) -> None:
    """Frame axes that enlarge a part of others, as that part is framed there."""
    for spine in axes.spines.values():
        spine.set(visible=True, color=QUIET, linestyle=_DOTTED)


def _frame(part: drawing.Extent) -> Rectangle:
    corner, width, height = (part.left, part.bottom), part.right - part.left, part.top - part.bottom
    return Rectangle(corner, width, height, fill=False, edgecolor=QUIET, linestyle=_DOTTED, zorder=6)
