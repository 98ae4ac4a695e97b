"""A film of some laws beside each other: the robots, what they trace, and their joint velocities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from numpy.typing import NDArray

from clikgen.analysis import drawing, spatial
from clikgen.analysis.animation import DPI, Pixels, write_film
from clikgen.analysis.comparison import Compared
from clikgen.analysis.drawing import COMMANDED, CONTACT, OBSTACLE, REGION, STYLE, TRACED
from clikgen.analysis.scene import even_steps, scene
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]

FRAMES = 90
PLANAR, SPATIAL = 4, 3  # laws that a film shows at most
WIDE = 2.5  # scenes at least this much wider than high stand above each other, others beside each other
_TARGET: dict[str, Any] = {"color": COMMANDED, "marker": "o", "markersize": 5.0, "markerfacecolor": "white"}


def animate(compared: Sequence[Compared], path: Path, frames: int = FRAMES) -> None:
    """Write a film (.gif or .mp4) of `frames` even moments, the whole file or none.

    Of many laws it shows PLANAR or, of a robot in space, SPATIAL, evenly from the first to the last. Raises BadInput
    where `write_film` does.
    """
    in_space = compared[0].controller.manifest.dimension == 3
    shown = filmed(compared, SPATIAL if in_space else PLANAR)
    steps = even_steps(shown[0].rollout, frames)
    with mpl.rc_context(STYLE):
        paint = _painter_in_space(shown, steps) if in_space else _painter(shown, steps)
        write_film(path, paint, len(steps))


def filmed(compared: Sequence[Compared], most: int) -> list[Compared]:
    """`most` of the laws, evenly from the first to the last; all of them where there are no more."""
    places = np.linspace(0, len(compared) - 1, min(most, len(compared))).round().astype(int)
    return [compared[i] for i in places]


def _painter_in_space(shown: Sequence[Compared], steps: NDArray[np.intp]) -> Callable[[int], Pixels]:
    scenes = [scene(each.controller, each.rollout, steps) for each in shown]
    named = zip(scenes, shown, strict=True)
    return spatial.painter([replace(one, title=", ".join(_title(each))) for one, each in named])


def _title(each: Compared) -> list[str]:
    """The law and, where the controller says so, how often its contact switched."""
    return [each.law.title, *([each.switches] if each.switches else [])]


# In the plane.


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    """A law: what is known of it at every frame, and the shapes that move."""

    rollout: Rollout
    steps: NDArray[np.intp]  # frame -> step
    poses: drawing.Poses
    touched: NDArray[np.bool_]  # (frames, points), see _touched
    radii: Array  # (points,) [m]
    robot: PolyCollection
    regions: PolyCollection
    obstacles: PolyCollection
    trace: Line2D
    target: Line2D  # the commanded position
    curtain: Rectangle  # what is still to come of the velocities

    @property
    def artists(self) -> tuple[Artist, ...]:
        """The shapes that move, in the order to draw them in."""
        return (self.regions, self.robot, self.obstacles, self.trace, self.target, self.curtain)

    def show(self, frame: int) -> None:
        """Move every shape to where it is at a frame."""
        k = int(self.steps[frame])
        self.robot.set_verts(self.poses.polygons(frame))
        if self.radii.size:
            self.regions.set_verts(list(drawing.circles(self.poses.points[frame], self.radii)))
            colours = [CONTACT if touched else REGION for touched in self.touched[frame]]
            self.regions.set_facecolor([to_rgba(colour, 0.35) for colour in colours])
            self.regions.set_edgecolor(colours)
        self.obstacles.set_verts(list(drawing.discs(self.rollout.obstacle_center[k], self.rollout.obstacle_radius)))
        self.trace.set_data(*self.rollout.position[: k + 1, :2].T)
        self.target.set_data(*self.rollout.reference[[k], :2].T)
        self.curtain.set_x(self.rollout.t[k])


def _painter(shown: Sequence[Compared], steps: NDArray[np.intp]) -> Callable[[int], Pixels]:
    """A function that draws a frame: what rests was drawn once, only what moves is drawn again."""
    figure, panels = _stage(shown, steps)
    clock = figure.suptitle("t = 0.00 s", x=0.99, ha="right", fontsize=12)
    canvas: Any = FigureCanvasAgg(figure)  # whose methods matplotlib leaves untyped
    moving = [artist for panel in panels for artist in panel.artists] + [clock]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    resting = canvas.copy_from_bbox(figure.bbox)

    def paint(frame: int) -> Pixels:
        canvas.restore_region(resting)
        clock.set_text(f"t = {panels[0].rollout.t[steps[frame]]:.2f} s")
        for panel in panels:
            panel.show(frame)
        for artist in moving:
            figure.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    return paint


def _stage(shown: Sequence[Compared], steps: NDArray[np.intp]) -> tuple[Figure, list[_Panel]]:
    """The figure with all that rests, and a panel per law."""
    rollouts = [each.rollout for each in shown]
    poses = [drawing.poses(each.controller, each.rollout, steps.tolist()) for each in shown]
    radii = drawing.influence_radii(rollouts[0])
    extent = drawing.extent(rollouts, places=[robot.places(radii) for robot in poses])
    joints = drawing.telling_joints(dict(enumerate(rollouts)))
    velocities = drawing.value_range([rollout.dq[:, joints] for rollout in rollouts])
    figure, places = _layout(len(shown), extent.aspect)
    panels = []
    for each, robot, (scene_axes, strip) in zip(shown, poses, places, strict=True):
        extent.apply(scene_axes)
        scene_axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
        scene_axes.set_title("\n".join(_title(each)), loc="left", fontweight="bold")
        _velocities(strip, each.rollout, joints, velocities)
        panels.append(_panel(scene_axes, strip, each.rollout, steps, robot))
    for column in zip(*places[:-1], strict=True) if extent.aspect > WIDE else ():
        for axes in column:
            axes.tick_params(labelbottom=False)
            axes.set_xlabel("")
    figure.legend(handles=_entries(rollouts[0], joints), loc="outside lower center", ncols=4)
    return figure, panels


def _layout(count: int, aspect: float) -> tuple[Figure, list[tuple[Axes, Axes]]]:
    """An empty figure, and per law its scene and its velocities, the latter beside or below the scene."""
    if aspect > WIDE:
        figure = Figure(figsize=(9.6, 1.3 + count * (0.4 + 5.6 / aspect)), dpi=DPI, layout="constrained")
        grid = figure.add_gridspec(count, 2, width_ratios=[5.6, 3.4])
        parts = [(grid[i, 0], grid[i, 1]) for i in range(count)]
    else:
        high = min(10.0 / count / aspect, 5.0)
        figure = Figure(figsize=(10.8, 2.8 + high), dpi=DPI, layout="constrained")
        grid = figure.add_gridspec(2, count, height_ratios=[high, 1.1])
        parts = [(grid[0, i], grid[1, i]) for i in range(count)]
    return figure, [(figure.add_subplot(one), figure.add_subplot(other)) for one, other in parts]


def _velocities(axes: Axes, rollout: Rollout, joints: Sequence[int], limits: tuple[float, float]) -> None:
    for i in drawing.covering_first(rollout, joints):
        colour = drawing.joint_colour(list(joints).index(i))  # one for each joint shown, of which there may be many
        axes.plot(rollout.t, rollout.dq[:, i], color=colour, linewidth=0.8)
    drawing.shade(axes, drawing.encounter_times(rollout))
    unit = rollout.manifest.joints[joints[0]].unit
    axes.set(xlim=(rollout.t[0], rollout.t[-1]), ylim=limits, xlabel="$t$ [s]", ylabel=f"velocity [{unit}/s]")


def _panel(axes: Axes, strip: Axes, rollout: Rollout, steps: NDArray[np.intp], poses: drawing.Poses) -> _Panel:
    """A law in its axes, with the shapes that will move."""
    radii = drawing.influence_radii(rollout)
    axes.plot(*rollout.reference[:, :2].T, color=COMMANDED, linestyle=(0, (5, 3)), linewidth=1.0)
    regions = PolyCollection([], linewidths=0.8)
    axes.add_collection(regions, autolim=False)
    low, high = strip.get_ylim()
    veil = Rectangle((0.0, low), rollout.t[-1] + 1.0, high - low, facecolor="white", alpha=0.8, linewidth=0)
    strip.add_patch(veil)
    return _Panel(
        rollout=rollout,
        steps=steps,
        poses=poses,
        touched=_touched(rollout, radii, steps),
        radii=radii,
        robot=drawing.add_robot(axes),
        regions=regions,
        obstacles=drawing.add_obstacles(axes, rollout.obstacle_center[0], rollout.obstacle_radius),
        trace=axes.plot([], [], color=TRACED, linewidth=1.6)[0],
        target=axes.plot([], [], **_TARGET)[0],
        curtain=veil,
    )


def _touched(rollout: Rollout, radii: Array, steps: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Whether each point of interest met an obstacle at a frame or since the one before, (frames, points).

    Contact may switch from sample to sample: to look only at the frames' own samples would draw lots.
    """
    if not radii.size:
        return np.zeros((len(steps), 0), dtype=bool)
    touching = rollout.signals["distance"] <= radii  # (N, points)
    before = [-1, *steps[:-1]]
    return np.array([touching[b + 1 : k + 1].any(axis=0) for b, k in zip(before, steps, strict=True)])


def _entries(rollout: Rollout, joints: Sequence[int]) -> list[Artist]:
    regions = [
        Patch(facecolor=to_rgba(REGION, 0.35), edgecolor=REGION, label="influence region"),
        Patch(facecolor=to_rgba(CONTACT, 0.35), edgecolor=CONTACT, label="in contact"),
    ]
    obstacle = Patch(facecolor=OBSTACLE, edgecolor="black", label="obstacle")
    names = [rollout.manifest.joints[i].name.replace("_", " ") for i in joints]
    return [
        Line2D([], [], linestyle=(0, (5, 3)), label="commanded", **_TARGET),
        Line2D([], [], color=TRACED, label="traced"),
        *(regions if drawing.influence_radii(rollout).size else []),
        *([obstacle] if rollout.obstacle_radius.size else []),
        *(Line2D([], [], color=drawing.joint_colour(i), label=f"velocity of {name}") for i, name in enumerate(names)),
        Patch(facecolor=CONTACT, alpha=0.25, label="inside, or the barrier acts"),
    ]
