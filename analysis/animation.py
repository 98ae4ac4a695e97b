"""A film of some rollouts side by side: the robots, their influence regions, what they trace, and signals over time."""

import io
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from clikgen.analysis import drawing
from clikgen.analysis.drawing import COMMANDED, CONTACT, LAM, OBSTACLE, REGION, STYLE, TRACED
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput, choices, write_atomically
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]  # (..., 3)

DPI = 100
FRAME_TIME = 80  # [ms]
LAST_FRAME_TIME = 1500  # [ms] before it starts again
COLOURS = 255
FILMS = (".gif", ".mp4")
_FIVE_BITS = np.array([1 << 10, 1 << 5, 1], dtype=np.uint16)
_BUCKETS = 8 * np.stack(np.unravel_index(np.arange(1 << 15), (32, 32, 32)), axis=1) + 4  # middles, (32768, 3)
_TARGET: dict[str, Any] = {"color": COMMANDED, "marker": "o", "markersize": 5.0, "markerfacecolor": "white"}
WIDE = 2.5  # scenes at least this much wider than high stand above each other, others beside each other


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    """A rollout in a film, the controller that made it, and its title."""

    title: str
    controller: CompiledController
    rollout: Rollout


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    """A rollout: what is known of it at every frame, and the shapes that move."""

    rollout: Rollout
    steps: Sequence[int]  # frame -> step
    poses: drawing.Poses
    contact: NDArray[np.bool_]  # (frames, points), see _contact
    radii: Array  # (points,) [m]
    robot: PolyCollection
    joints: Line2D
    regions: PolyCollection
    obstacles: PolyCollection
    trace: Line2D
    target: Line2D  # the commanded position
    curtains: tuple[Rectangle, ...]  # what is still to come of the signals over time

    @property
    def artists(self) -> tuple[Artist, ...]:
        """The shapes that move, in the order to draw them in."""
        return (self.regions, self.robot, self.joints, self.obstacles, self.trace, self.target, *self.curtains)

    def show(self, frame: int) -> None:
        """Move every shape to where it is at a frame."""
        k = self.steps[frame]
        self.robot.set_verts(self.poses.polygons(frame))
        self.joints.set_data(*self.poses.joints[frame].T)
        if self.radii.size:
            self.regions.set_verts(list(drawing.circles(self.poses.points[frame], self.radii)))
            colours = [CONTACT if touched else REGION for touched in self.contact[frame]]
            self.regions.set_facecolor([to_rgba(colour, 0.35) for colour in colours])
            self.regions.set_edgecolor(colours)
        self.obstacles.set_verts(list(drawing.discs(self.rollout.obstacle_center[k], self.rollout.obstacle_radius)))
        self.trace.set_data(*self.rollout.position[: k + 1, :2].T)
        self.target.set_data(*self.rollout.reference[[k], :2].T)
        for curtain in self.curtains:
            curtain.set_x(self.rollout.t[k])


def animate(
    rollouts: Mapping[int, Rollout],
    controller: CompiledController,
    path: Path,
    frames: int = 90,
    progress: Callable[[str], None] = drawing.ignore,
) -> None:
    """Write a film (.gif or .mp4) of `frames` (2 or more) even moments of the rollouts, the whole file or none.

    `rollouts` maps the number of a case to its rollout: one scenario on `controller`, cases in order. Raises
    BadInput for a rollout that diverged or has a few steps only, and where `write_film` does.
    """
    check_film(path)
    drawing.require_drawable(rollouts)
    progress(str(path))
    cases = [Shown(f"Case {n}: {rollout.title}", controller, rollout) for n, rollout in rollouts.items()]
    with mpl.rc_context(STYLE):
        film(cases, path, frames, lam=True)


def film(shown: Sequence[Shown], path: Path, frames: int, *, lam: bool) -> None:
    """Write a film of rollouts of one scenario, with their velocities, and with λ over time where `lam` says so."""
    steps = np.unique(np.linspace(0, len(shown[0].rollout.t) - 1, max(frames, 2)).astype(int)).tolist()
    figure, panels, clock = _stage(shown, steps, lam)
    write_film(path, _painter(figure, panels, clock), len(steps))


def _stage(shown: Sequence[Shown], steps: Sequence[int], lam: bool) -> tuple[Figure, list[_Panel], Text]:
    """The figure with all that rests, a panel per rollout, and the text that tells the time."""
    every = [one.rollout for one in shown]
    poses = [drawing.poses(one.controller, one.rollout, list(steps)) for one in shown]
    radii = drawing.influence_radii(every[0])
    extent = drawing.extent(every, places=[robot.places(radii) for robot in poses])
    figure, places = _layout(len(shown), extent.aspect, lam)
    joints = drawing.telling_joints(dict(enumerate(every)))
    limits = drawing.value_range([each.dq[:, joints] for each in every])
    panels = []
    for (scene, velocity, *below), one, robot in zip(places, shown, poses, strict=True):
        extent.apply(scene)
        scene.set(xlabel="$x$ [m]", ylabel="$y$ [m]")
        scene.set_title(one.title, loc="left", fontweight="bold")
        _velocities(velocity, one.rollout, joints, limits)
        for axes in below:
            velocity.tick_params(labelbottom=False)
            _lam(axes, one.rollout)
        (below[0] if below else velocity).set_xlabel("$t$ [s]")
        panels.append(_panel(scene, [velocity, *below], one.rollout, steps, robot))
    for axes in (axes for above in places[:-1] for axes in above if extent.aspect > WIDE):
        axes.tick_params(labelbottom=False)
        axes.set_xlabel("")
    clock = figure.suptitle("t = 0.00 s", x=0.99, ha="right", fontsize=12)
    figure.legend(handles=_entries(every[0], joints, lam), loc="outside lower center", ncols=4)
    return figure, panels, clock


def _layout(count: int, aspect: float, lam: bool) -> tuple[Figure, list[list[Axes]]]:
    """An empty figure, and per rollout its axes: scene, velocity and maybe λ, the latter beside or below the scene."""
    strips = [2.0, 1.0] if lam else [1.0]
    if aspect > WIDE:
        figure = Figure(figsize=(9.6, 1.3 + count * (0.35 + 6.0 / aspect)), dpi=DPI, layout="constrained")
        k = len(strips)
        grid = figure.add_gridspec(k * count, 2, width_ratios=[6.0, 3.2], height_ratios=strips * count)
        parts = [[grid[k * i : k * i + k, 0], *(grid[k * i + j, 1] for j in range(k))] for i in range(count)]
    else:
        scene = min(10.0 / count / aspect, 5.0)
        figure = Figure(figsize=(10.8, 2.75 + 0.45 * len(strips) / 2 + scene), dpi=DPI, layout="constrained")
        heights = [scene, *(0.45 * strip for strip in strips)] if lam else [scene, 1.0]
        grid = figure.add_gridspec(len(heights), count, height_ratios=heights)
        parts = [[grid[j, i] for j in range(len(heights))] for i in range(count)]
    return figure, [[figure.add_subplot(part) for part in one] for one in parts]


def _panel(scene: Axes, strips: Sequence[Axes], rollout: Rollout, steps: Sequence[int], poses: drawing.Poses) -> _Panel:
    """The shapes that will move, in the scene and over the strips of signals."""
    scene.plot(*rollout.reference[:, :2].T, color=COMMANDED, linestyle=(0, (5, 3)), linewidth=1.0)
    radii = drawing.influence_radii(rollout)
    regions = PolyCollection([], linewidths=0.8)
    scene.add_collection(regions, autolim=False)
    return _Panel(
        rollout=rollout,
        steps=steps,
        poses=poses,
        contact=_contact(rollout, radii, steps),
        radii=radii,
        robot=drawing.add_robot(scene),
        joints=scene.plot([], [], "o", color=drawing.ROBOT_EDGE, markersize=3.5)[0],
        regions=regions,
        obstacles=drawing.add_obstacles(scene, rollout.obstacle_center[0], rollout.obstacle_radius),
        trace=scene.plot([], [], color=TRACED, linewidth=1.6)[0],
        target=scene.plot([], [], **_TARGET)[0],
        curtains=tuple(_curtain(axes, rollout) for axes in strips),
    )


def _contact(rollout: Rollout, radii: Array, steps: Sequence[int]) -> NDArray[np.bool_]:
    """Whether each point of interest met an obstacle at a frame or since the one before, (frames, points).

    Contact may switch from sample to sample: to look only at the frames' own samples would draw lots.
    """
    if not radii.size:
        return np.zeros((len(steps), 0), dtype=bool)
    touching = rollout.signals["distance"] <= radii  # (N, points)
    before = [-1, *steps[:-1]]
    return np.array([touching[b + 1 : k + 1].any(axis=0) for b, k in zip(before, steps, strict=True)])


def _velocities(axes: Axes, rollout: Rollout, joints: Sequence[int], limits: tuple[float, float]) -> None:
    for i in drawing.covering_first(rollout, joints):
        axes.plot(rollout.t, rollout.dq[:, i], color=drawing.joint_colour(i), linewidth=0.8)
    axes.set(ylim=limits, ylabel=f"$\\dot{{q}}$ [{rollout.manifest.joints[joints[0]].unit}/s]")


def _lam(axes: Axes, rollout: Rollout) -> None:
    axes.fill_between(rollout.t, rollout.signals["lam"], step="post", color=LAM, linewidth=0)
    axes.plot(rollout.t, rollout.signals["lam"], color=LAM, drawstyle="steps-post", linewidth=1.5)
    axes.set(ylim=(-0.05, 1.1), yticks=[0, 1], ylabel="λ")


def _curtain(axes: Axes, rollout: Rollout) -> Rectangle:
    """A veil over the future of axes over time."""
    drawing.shade(axes, drawing.encounter_times(rollout))
    axes.set_xlim(rollout.t[0], rollout.t[-1])
    low, high = axes.get_ylim()
    veil = Rectangle((0.0, low), rollout.t[-1] + 1.0, high - low, facecolor="white", alpha=0.8, linewidth=0)
    axes.add_patch(veil)
    return veil


def _entries(rollout: Rollout, joints: Sequence[int], lam: bool) -> list[Artist]:
    names = [rollout.manifest.joints[i].name.replace("_", " ") for i in joints]
    regions = [
        Patch(facecolor=to_rgba(REGION, 0.35), edgecolor=REGION, label="influence region"),
        Patch(facecolor=to_rgba(CONTACT, 0.35), edgecolor=CONTACT, label="in contact"),
    ]
    obstacle = Patch(facecolor=OBSTACLE, edgecolor="black", label="obstacle")
    return [
        Line2D([], [], linestyle=(0, (5, 3)), label="commanded", **_TARGET),
        Line2D([], [], color=TRACED, label="traced"),
        *(regions if drawing.influence_radii(rollout).size else []),
        *([obstacle] if rollout.obstacle_radius.size else []),
        *(
            Line2D([], [], color=drawing.joint_colour(i), label=f"velocity of {name}")
            for i, name in zip(joints, names, strict=True)
        ),
        Patch(facecolor=LAM, label="λ, share of the filter")
        if lam
        else Patch(facecolor=CONTACT, alpha=0.25, label="inside, or the barrier acts"),
    ]


def _painter(figure: Figure, panels: Sequence[_Panel], clock: Text) -> Callable[[int], Pixels]:
    """A function that draws a frame: what rests was drawn once, only what moves is drawn again."""
    canvas: Any = FigureCanvasAgg(figure)  # whose methods matplotlib leaves untyped
    moving = [artist for panel in panels for artist in panel.artists] + [clock]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    resting = canvas.copy_from_bbox(figure.bbox)

    def paint(frame: int) -> Pixels:
        canvas.restore_region(resting)
        clock.set_text(f"t = {panels[0].rollout.t[panels[0].steps[frame]]:.2f} s")
        for panel in panels:
            panel.show(frame)
        for artist in moving:
            figure.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    return paint


def check_film(path: Path) -> None:
    """Raises BadInput for a film that cannot be written: another ending than those of FILMS, or .mp4 without ffmpeg."""
    ending = path.suffix.lower()
    if ending not in FILMS:
        raise BadInput(f"{path}: no film ends in '{path.suffix}'; {choices(ending, FILMS)}")
    if ending == ".mp4" and not FFMpegWriter.isAvailable():
        raise BadInput(f"{path}: .mp4 needs the program 'ffmpeg': install it, or write a .gif")


def write_film(path: Path, paint: Callable[[int], Pixels], frames: int) -> None:
    """Write frames 0 .. `frames` - 1 as a GIF that repeats or an MP4, as the file ends; the whole file or none.

    Raises BadInput where `check_film` does, when ffmpeg fails, and when the folder cannot be written to.
    """
    check_film(path)
    write_atomically(path, {".gif": _gif, ".mp4": _mp4}[path.suffix.lower()](paint, frames))


def _mp4(paint: Callable[[int], Pixels], frames: int) -> bytes:
    """All frames as an MP4, the last one held: a figure that shows nothing but the image of a frame."""
    image = paint(0)
    figure = Figure(figsize=(image.shape[1] / DPI, image.shape[0] / DPI), dpi=DPI)
    FigureCanvasAgg(figure)
    shown = figure.figimage(image)
    writer = FFMpegWriter(fps=round(1000 / FRAME_TIME))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "film.mp4"
        try:
            with writer.saving(figure, str(file), DPI):
                for frame in [*range(frames), *[frames - 1] * (LAST_FRAME_TIME // FRAME_TIME)]:
                    shown.set_data(paint(frame))
                    writer.grab_frame()
            return file.read_bytes()
        except (OSError, subprocess.CalledProcessError) as error:
            raise BadInput(f"ffmpeg failed: {error}") from None


def _gif(paint: Callable[[int], Pixels], frames: int) -> bytes:
    """All frames as a GIF that repeats, with one palette, found first from a few of them."""
    colours = _common_colours([paint(frame) for frame in range(0, frames, max(1, frames // 6))])
    nearest = np.asarray(KDTree(colours).query(_BUCKETS)[1], dtype=np.uint8)  # bucket -> colour
    nearest[_bucket(colours)] = np.arange(len(colours))
    first, *rest = [Image.fromarray(nearest[_bucket(paint(frame))]) for frame in range(frames)]
    for image in (first, *rest):
        image.putpalette(colours.tobytes())
    durations = [FRAME_TIME] * len(rest) + [LAST_FRAME_TIME]
    buffer = io.BytesIO()
    first.save(buffer, "GIF", save_all=True, append_images=rest, duration=durations, loop=0, disposal=1)
    return buffer.getvalue()


def _common_colours(images: Sequence[Pixels]) -> Pixels:
    """The most common colours of some images, at most one in every bucket, (COLOURS or fewer, 3).

    Flat areas keep their colours exactly; white stays white.
    """
    pixels = np.concatenate([image[::2, ::2].reshape(-1, 3) for image in images]).astype(np.uint32)
    packed, counts = np.unique(pixels @ np.array([1 << 16, 1 << 8, 1], dtype=np.uint32), return_counts=True)
    packed = packed[np.argsort(-counts, kind="stable")]
    colours = np.stack([packed >> 16, packed >> 8 & 255, packed & 255], axis=1).astype(np.uint8)
    first_of_bucket = np.sort(np.unique(_bucket(colours), return_index=True)[1])
    return colours[first_of_bucket[:COLOURS]]


def _bucket(pixels: Pixels) -> NDArray[np.uint16]:
    """Five bits of every channel in one number: (..., 3) -> (...)."""
    number: NDArray[np.uint16] = (pixels >> 3).astype(np.uint16) @ _FIVE_BITS
    return number
