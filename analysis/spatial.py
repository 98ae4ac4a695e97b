"""A film of all cases in space: robots, obstacles and paths above, λ and the error over time below.

The axes are matplotlib's; what moves in them is drawn here, as flat shapes from the back to the front. Seen from far
away a ball is a disc and a capsule a disc drawn out, so this is exact, and it is ten times as fast as 3-D artists.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

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
from matplotlib.text import Text
from matplotlib.transforms import IdentityTransform
from mpl_toolkits.mplot3d import proj3d
from numpy.typing import NDArray

from clikgen.analysis import animation, drawing
from clikgen.analysis.animation import DPI, Pixels, check_film, write_film
from clikgen.analysis.drawing import COMMANDED, CONTACT, ERROR, LAM, OBSTACLE, REGION, ROBOT_EDGE, STYLE, TRACED
from clikgen.analysis.scene import Capsule, Scene, Triad, even_steps, scene
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]
Colour = tuple[float, float, float, float]  # red, green, blue, opacity

ELEVATION = 22.0  # [deg] of the camera above the horizon
AZIMUTHS = (-150, -120, -60, -30, 30, 60, 120, 150)  # [deg] from where the camera may look: never along an axis
USUAL_AZIMUTH = -60  # [deg] where nothing speaks for another
SMALL = 0.01  # [m, rad] errors below this are drawn in thousandths
LABELS = (0.65, 0.45)  # [inch] across and up, what the labels of axes in space need
DASH, GAP, PIECE = 6.0, 4.0, 6.0  # [px] of the commanded path, and how finely the traced one is sorted by depth
AXES = ("#C0392B", "#27803F", "#2C56B5")  # x, y, z of a frame
NOTHING: Colour = (0.0, 0.0, 0.0, 0.0)
LIGHT = np.array([-0.45, 0.55])  # where light comes from on the page, in radii of a ball
_ARC = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 19)
_UNIT = np.linspace(0.0, 2.0 * np.pi, 49)
_CIRCLE = np.stack([np.cos(_UNIT), np.sin(_UNIT)], axis=1)


def animate(
    rollouts: Mapping[int, Rollout],
    controller: CompiledController,
    path: Path,
    frames: int = 90,
    progress: Callable[[str], None] = drawing.ignore,
) -> None:
    """Write a film (.gif or .mp4) of `frames` (2 or more) even moments, in the plane or in space as the robot is.

    `rollouts` maps the number of a case to its rollout: one scenario on `controller`, cases in order. The whole
    file or none. Raises BadInput for a rollout that diverged or has a few steps only, for another ending, without
    `ffmpeg` for .mp4, and when the folder cannot be written to.
    """
    if controller.manifest.dimension == 2:
        animation.animate(rollouts, controller, path, frames, progress)
        return
    check_film(path)
    drawing.require_drawable(rollouts)
    progress(str(path))
    steps = even_steps(next(iter(rollouts.values())), frames)
    scenes = [scene(controller, rollout, steps) for rollout in rollouts.values()]
    with mpl.rc_context(STYLE):
        write_film(path, painter(scenes), len(steps))


def painter(scenes: Sequence[Scene]) -> Callable[[int], Pixels]:
    """A function that draws a frame of the scenes, beside each other: what rests was drawn once."""
    figure, panels, clock = _stage(scenes)
    canvas: Any = FigureCanvasAgg(figure)  # whose methods matplotlib leaves untyped
    moving = [artist for panel in panels for artist in (panel.shapes, *panel.curtains)] + [clock]
    for artist in moving:
        artist.set_animated(True)
    canvas.draw()
    for panel in panels:
        _fill(panel.axes)
    canvas.draw()
    resting = canvas.copy_from_bbox(figure.bbox)
    views = [_View.of(panel.scene, _Camera.of(panel.axes), panel.floor) for panel in panels]

    def paint(frame: int) -> Pixels:
        canvas.restore_region(resting)
        clock.set_text(f"t = {scenes[0].moments[frame]:.2f} s")
        for panel, view in zip(panels, views, strict=True):
            panel.show(view, frame)
        for artist in moving:
            figure.draw_artist(artist)
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    return paint


# Axes and what is written around them.


@dataclass(frozen=True, slots=True, eq=False)
class _Panel:
    """A case: its axes and the shapes that move."""

    scene: Scene
    axes: Any  # Axes3D, which matplotlib leaves untyped
    floor: float  # [m]
    shapes: PolyCollection
    curtains: tuple[Rectangle, ...]  # what is still to come of the signals over time

    def show(self, view: "_View", frame: int) -> None:
        """Move every shape to where it is at a frame, the farthest first."""
        shapes = sorted(view.shapes(frame), key=lambda shape: shape.depth)
        self.shapes.set_verts([shape.corners for shape in shapes], closed=False)
        self.shapes.set(
            facecolor=[shape.face for shape in shapes],
            edgecolor=[shape.edge for shape in shapes],
            linewidth=[shape.width for shape in shapes],
        )
        for curtain in self.curtains:
            curtain.set_x(self.scene.moments[frame])


def _stage(scenes: Sequence[Scene]) -> tuple[Figure, list[_Panel], Text]:
    """The figure with all that rests, a panel per case, and the text that tells the time."""
    cases = len(scenes)
    low, top = _box(scenes)
    azimuth = _azimuth(scenes)
    width = {1: 7.2, 2: 9.6}.get(cases, 11.8)
    across, up = np.ptp(_Camera.toward(azimuth).pixels(_corners(low, top)), axis=0) / DPI
    high = float(np.clip((0.82 * width / cases - LABELS[0]) * up / across + LABELS[1], 2.6, 5.4))
    entries, columns = _entries(scenes[0]), 4 if cases > 1 else 3
    below = 0.5 + 0.21 * math.ceil(len(entries) / columns)  # inches for the legend
    above = 0.62  # and for the titles
    figure = Figure(figsize=(width, high + 2.1 + below + above), dpi=DPI)
    total = figure.get_figheight()
    grid = figure.add_gridspec(
        3,
        cases,
        height_ratios=[high, 0.9, 0.6],
        left=0.62 / width,
        right=1.0 - 0.12 / width,
        bottom=(below + 0.02) / total,
        top=1.0 - above / total,
        hspace=0.16,
        wspace=0.24,
    )
    error_range = drawing.value_range([np.zeros(1), *(one.norm for each in scenes for one in _shown_errors(each))])
    panels = []
    for i, each in enumerate(scenes):
        axes: Any = figure.add_subplot(grid[0, i], projection="3d", proj_type="ortho")
        _space(axes, low, top, azimuth)
        left = grid[0, i].get_position(figure).x0
        figure.text(left, 1.0 - 0.55 / total, each.title, fontweight="bold", fontsize=10 if cases < 3 else 9)
        error, lam = figure.add_subplot(grid[1, i]), figure.add_subplot(grid[2, i])
        _error_strip(error, each, error_range, labelled=i == 0)
        _lam_strip(lam, each, labelled=i == 0)
        shapes = PolyCollection([], closed=False, transform=IdentityTransform())
        shapes.set_capstyle("round")
        figure.add_artist(shapes)
        curtains = tuple(_curtain(axes_below, each) for axes_below in (error, lam))
        panels.append(_Panel(each, axes, float(low[2]), shapes, curtains))
    clock = figure.text(1.0 - 0.12 / width, 1.0 - 0.25 / total, "", ha="right", fontsize=12)
    figure.legend(handles=entries, loc="lower center", ncols=columns)
    return figure, panels, clock


def _box(scenes: Sequence[Scene]) -> tuple[Array, Array]:
    """Where the axes of all cases start and end, (3,) each [m]; the floor z = 0 among them where it is near."""
    places = np.concatenate([each.places() for each in scenes])
    low, high = places.min(axis=0), places.max(axis=0)
    size = float(np.max(high - low))
    if 0.0 < low[2] < 0.5 * size:
        low[2] = 0.0
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.15 * size)
    margin = 0.03 * size
    on_floor = low[2] == 0.0
    low, high = middle - half - margin, middle + half + margin
    if on_floor:
        low[2] = 0.0
    return low, high


def _space(axes: Any, low: Array, high: Array, azimuth: float) -> None:
    """Limits, labels and camera of axes in space, one metre as long along each of them."""
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low)
    axes.view_init(elev=ELEVATION, azim=azimuth)
    axes.set(xlabel="$x$ [m]", ylabel="$y$ [m]", zlabel="$z$ [m]")
    longest = float(np.max(high - low))
    for axis, size in zip((axes.xaxis, axes.yaxis, axes.zaxis), high - low, strict=True):
        axis.set_major_locator(mpl.ticker.MaxNLocator(max(2, round(5 * size / longest)), steps=[1, 2, 5, 10]))
        axis.pane.set_facecolor("#FAFAFA")
        axis.pane.set_edgecolor("#D5D5D5")
        axis.line.set_color("#D5D5D5")
        axis._axinfo["grid"].update(color="#E6E6E6", linewidth=0.6)
        axis.set_tick_params(pad=1 if axis is axes.zaxis else -2)
        axis.labelpad = -2
    axes.tick_params(labelsize=8)


def _fill(axes: Any) -> None:
    """Enlarge what the axes show until its box fills their place on the page, with room for the labels."""
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
    size = np.ptp(_Camera.of(axes).pixels(_corners(low, high)), axis=0)
    place = axes.get_subplotspec().get_position(axes.figure).transformed(axes.figure.transFigure)
    room = np.array([place.width, place.height]) - DPI * np.array(LABELS)
    axes.set_box_aspect(high - low, zoom=float(np.min(room / size)))


def _corners(low: Array, high: Array) -> Array:
    """The corners of a box, (8, 3)."""
    corners: Array = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
    return corners


def _azimuth(scenes: Sequence[Scene]) -> float:
    """From where the paths and the robot cover most of the page, the path before the robot rather than behind it."""
    places = scenes[0].places()
    paths = np.concatenate([path.traced for path in scenes[0].paths]) if scenes[0].paths else places
    size = float(np.max(np.ptp(places, axis=0)))
    before = (paths.mean(axis=0) - scenes[0].joints[:, :1].mean(axis=(0, 1))) / size

    def score(azimuth: float) -> tuple[float, float]:
        camera = _Camera.toward(azimuth)
        spread = sum(np.sqrt(np.linalg.det(np.cov(camera.pixels(each).T))) for each in (paths, places))
        area = spread / size**2 + 1e-3
        return round(area * (1.0 + 0.6 * float(camera.depth(before))), 4), -abs(
            (azimuth - USUAL_AZIMUTH + 180) % 360 - 180
        )

    return max(AZIMUTHS, key=score)


def _shown_errors(each: Scene) -> list[Any]:
    """The errors in metres or, where there are none, in radians: one axis has one unit."""
    unit = min((error.unit for error in each.errors), default="m")
    return [error for error in each.errors if error.unit == unit]


def _error_strip(axes: Axes, each: Scene, limits: tuple[float, float], labelled: bool) -> None:
    errors = _shown_errors(each)
    prefix, factor = ("m", 1e3) if limits[1] < SMALL else ("", 1.0)  # in mm or mrad, for numbers that fit beside
    for i, error in enumerate(errors):
        axes.plot(each.t, factor * error.norm, **_error_style(i))
    unit = prefix + (errors[0].unit if errors else "m")
    axes.set(xlim=(each.t[0], each.t[-1]), ylim=(0.0, factor * limits[1]))
    axes.tick_params(labelbottom=False, labelsize=8)
    if labelled:
        axes.set_ylabel(f"error [{unit}]")


def _error_style(i: int) -> dict[str, Any]:
    """Several errors have one colour and differ in how strong it is."""
    return {"color": ERROR, "alpha": max(0.3, 1.0 - 0.4 * i), "linewidth": 1.2}


def _lam_strip(axes: Axes, each: Scene, labelled: bool) -> None:
    axes.fill_between(each.t, each.lam, step="post", color=LAM, linewidth=0)
    axes.plot(each.t, each.lam, color=LAM, drawstyle="steps-post", linewidth=1.2)
    axes.set(xlim=(each.t[0], each.t[-1]), ylim=(-0.05, 1.1), yticks=[0, 1], xlabel="$t$ [s]")
    axes.tick_params(labelsize=8)
    if labelled:
        axes.set_ylabel("λ", rotation=0, labelpad=12, va="center")


def _curtain(axes: Axes, each: Scene) -> Rectangle:
    """A veil over the future of axes over time, in which the times of contact are shaded."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], each.active.astype(int), [0]])))
    t = np.append(each.t, each.t[-1])
    drawing.shade(axes, [(float(t[begin]), float(t[end])) for begin, end in edges.reshape(-1, 2)])
    low, high = axes.get_ylim()
    veil = Rectangle((0.0, low), each.t[-1] + 1.0, high - low, facecolor="white", alpha=0.8, linewidth=0)
    axes.add_patch(veil)
    return veil


def _entries(each: Scene) -> list[Artist]:
    dot: dict[str, Any] = {"marker": "o", "markersize": 5.0, "markerfacecolor": "white"}
    errors = _shown_errors(each)
    regions = [
        Patch(facecolor=to_rgba(REGION, 0.25), edgecolor=REGION, label="influence region"),
        Patch(facecolor=to_rgba(CONTACT, 0.45), edgecolor=CONTACT, label="in contact"),
    ]
    axes = Line2D([], [], color=AXES[2], label="axes of a frame (dashed: commanded)")
    target = Line2D([], [], color=COMMANDED, marker="x", linestyle="", label="looked at")
    return [
        *([Line2D([], [], color=COMMANDED, linestyle=(0, (5, 3)), label="commanded", **dot)] if each.paths else []),
        *([Line2D([], [], color=TRACED, label="traced")] if each.paths else []),
        *([axes] if each.triads else []),
        *([target] if each.targets else []),
        *([Patch(facecolor=OBSTACLE, edgecolor="black", label="obstacle")] if each.obstacles or each.walls else []),
        *(regions if each.regions else []),
        *(
            Line2D([], [], label=f"error of {error.name.replace('_', ' ')}", **_error_style(i))
            for i, error in enumerate(errors)
        ),
        Patch(facecolor=LAM, label="λ, share of the filter"),
    ]


# The camera.


@dataclass(frozen=True, slots=True, eq=False)
class _Camera:
    """Parallel rays onto the page: place (3,) [m] -> pixel (2,), right and up."""

    matrix: Array  # (2, 3) [px/m]
    origin: Array  # (2,) [px]
    view: Array  # (3,), the unit vector toward the camera

    @classmethod
    def of(cls, axes: Any) -> "_Camera":
        """The camera of axes in space with parallel rays, once they are drawn."""
        corners = np.vstack([np.zeros(3), np.eye(3)])
        x, y, _ = proj3d.proj_transform(*corners.T, axes.get_proj())
        pixels = axes.transData.transform(np.column_stack([x, y]))
        return cls((pixels[1:] - pixels[0]).T, pixels[0], _direction(axes.elev, axes.azim))

    @classmethod
    def toward(cls, azimuth: float) -> "_Camera":
        """One pixel a metre, from where the azimuth [deg] says."""
        view = _direction(ELEVATION, azimuth)
        right = np.cross([0.0, 0.0, 1.0], view)
        right /= np.linalg.norm(right)
        return cls(np.stack([right, np.cross(view, right)]), np.zeros(2), view)

    @property
    def scale(self) -> float:
        """How many pixels a metre across the view is [px/m]."""
        return float(np.linalg.norm(self.matrix) / np.sqrt(2.0))

    def pixels(self, places: Array) -> Array:
        """(..., 3) [m] -> (..., 2) [px]."""
        seen: Array = places @ self.matrix.T + self.origin
        return seen

    def depth(self, places: Array) -> Array:
        """How near to the camera, (..., 3) -> (...) [m]; larger is nearer."""
        near: Array = places @ self.view
        return near


def _direction(elevation: float, azimuth: float) -> Array:
    up, around = np.deg2rad(elevation), np.deg2rad(azimuth)
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


# Shapes.


class _Shape(NamedTuple):
    """A polygon or a line on the page, and how near to the camera it is."""

    depth: float
    corners: Array  # (any, 2) [px]
    face: Colour
    edge: Colour
    width: float


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """A scene through a camera."""

    scene: Scene
    camera: _Camera
    floor: float  # [m]
    resting: tuple[_Shape, ...]
    traces: tuple[tuple[int, _Shape], ...]  # a piece of a traced path, and the step it is complete at

    @classmethod
    def of(cls, each: Scene, camera: _Camera, floor: float) -> "_View":
        """What rests is made once, the traced paths in pieces."""
        lift = 2.0 * each.thickness  # a path is drawn before the hand that follows it
        resting = [*_walls(each, camera)]
        traces = []
        for path in each.paths:
            dashes = _pieces(path.commanded, camera, lift, _rgba(COMMANDED), 1.1, DASH, GAP)
            resting += [shape for _, shape in dashes]
            traces += list(_pieces(path.traced, camera, lift, _rgba(TRACED), 1.8, PIECE))
        return cls(each, camera, floor, tuple(resting), tuple(traces))

    def shapes(self, k: int) -> Iterator[_Shape]:
        """Everything at moment k, in no order."""
        each, camera = self.scene, self.camera
        yield from self.resting
        yield from self._shadows(k)
        for segment in each.segments:
            yield from _link(camera, segment.start[k], segment.end[k], each.thickness)
        for joint in each.joints[k]:
            yield _disc(camera, joint, 1.12 * each.thickness, _rgba("#A9B5C0"), _rgba(ROBOT_EDGE), each.thickness)
        for outline in each.outlines:
            yield _polygon(camera, outline.corners[k], _rgba("#C3CED8", 0.9), _rgba(ROBOT_EDGE))
        for body in each.bodies:
            yield _flat_capsule(camera, body, k, _rgba("#8794A1", 0.28), _rgba(ROBOT_EDGE, 0.8))
        for region in each.regions:
            colour, fill, line = (CONTACT, 0.32, 1.0) if region.touched[k] else (REGION, 0.10, 0.45)
            yield _disc(camera, region.center[k], region.radius, _rgba(colour, fill), _rgba(colour, line))
        for obstacle in each.obstacles:
            yield from _shaded(camera, obstacle, k)
        for triad in each.triads:
            yield from _axes(camera, triad, k, 3.5 * each.thickness)
        for target in each.targets:
            yield from _cross(camera, target.place[k])
        step = int(each.steps[k])
        yield from (shape for last, shape in self.traces if last <= step)
        for path in each.paths:
            yield _dot(camera, path.commanded[step], 4.0, _rgba("white"), _rgba(COMMANDED), 3.0 * each.thickness)
            yield _dot(camera, path.traced[step], 3.0, _rgba(TRACED), _rgba(TRACED), 3.1 * each.thickness)

    def _shadows(self, k: int) -> Iterator[_Shape]:
        """Where things are above the floor, as their shadows under a light from straight above."""
        each = self.scene
        lines = [(one.start[k], one.end[k], each.thickness) for one in each.segments]
        lines += [(one.start[k], one.end[k], one.radius) for one in each.obstacles]
        for start, end, radius in lines:
            flat = _stadium(start[:2], end[:2], radius)
            places = np.column_stack([flat, np.full(len(flat), self.floor)])
            yield _Shape(-np.inf, self.camera.pixels(places), _rgba("#D8DBDF"), NOTHING, 0.0)


def _rgba(colour: str, opacity: float = 1.0) -> Colour:
    return to_rgba(colour, opacity)


def _stadium(start: Array, end: Array, radius: float) -> Array:
    """The outline of all points of the plane within `radius` of the line from start to end, closed, (any, 2)."""
    along = end - start
    if not along.any():
        circle: Array = start + radius * _CIRCLE
        return circle
    angle = np.arctan2(along[1], along[0])
    front, back = angle + _ARC, angle + np.pi + _ARC
    caps = [place + radius * np.column_stack([np.cos(a), np.sin(a)]) for place, a in ((end, front), (start, back))]
    return np.concatenate([*caps, caps[0][:1]])


def _disc(camera: _Camera, center: Array, radius: float, face: Colour, edge: Colour, lift: float = 0.0) -> _Shape:
    corners = camera.pixels(center) + camera.scale * radius * _CIRCLE
    return _Shape(float(camera.depth(center)) + lift, corners, face, edge, 0.8)


def _dot(camera: _Camera, place: Array, radius: float, face: Colour, edge: Colour, lift: float) -> _Shape:
    """A disc of `radius` pixels."""
    return _Shape(float(camera.depth(place)) + lift, camera.pixels(place) + radius * _CIRCLE, face, edge, 1.0)


def _polygon(camera: _Camera, corners: Array, face: Colour, edge: Colour) -> _Shape:
    closed = np.concatenate([corners, corners[:1]])
    return _Shape(float(np.mean(camera.depth(corners))), camera.pixels(closed), face, edge, 0.8)


def _line(camera: _Camera, places: Array, colour: Colour, width: float, lift: float = 0.0) -> _Shape:
    depth = float(np.mean(camera.depth(places[[0, -1]]))) + lift
    return _Shape(depth, camera.pixels(places), NOTHING, colour, width)


def _link(camera: _Camera, start: Array, end: Array, thickness: float) -> Iterator[_Shape]:
    """A round bar, brighter where the light falls."""
    depth = 0.5 * float(camera.depth(start) + camera.depth(end))
    radius = camera.scale * thickness
    first, last = camera.pixels(start), camera.pixels(end)
    yield _Shape(depth, _stadium(first, last, radius), _rgba("#C3CED8"), _rgba(ROBOT_EDGE), 0.9)
    shift = 0.5 * radius * LIGHT
    yield _Shape(depth, _stadium(first + shift, last + shift, 0.35 * radius), _rgba("#EEF2F5"), NOTHING, 0.0)


def _flat_capsule(camera: _Camera, capsule: Capsule, k: int, face: Colour, edge: Colour) -> _Shape:
    depth = 0.5 * float(camera.depth(capsule.start[k]) + camera.depth(capsule.end[k]))
    corners = _stadium(camera.pixels(capsule.start[k]), camera.pixels(capsule.end[k]), camera.scale * capsule.radius)
    return _Shape(depth, corners, face, edge, 0.8)


def _shaded(camera: _Camera, capsule: Capsule, k: int, rings: int = 14) -> Iterator[_Shape]:
    """A solid ball or capsule: rings from dark to bright, closing in on where the light falls."""
    depth = 0.5 * float(camera.depth(capsule.start[k]) + camera.depth(capsule.end[k]))
    start, end = camera.pixels(capsule.start[k]), camera.pixels(capsule.end[k])
    radius = max(camera.scale * capsule.radius, 3.0)  # a point would vanish
    dark, bright = 0.82 * np.array(to_rgba(OBSTACLE)[:3]), np.array([0.84, 0.84, 0.84])
    for i in range(rings):
        share = i / rings
        red, green, blue = dark + share * (bright - dark)
        corners = _stadium(start, end, (1.0 - share) * radius) + 0.75 * share * radius * LIGHT
        edge = _rgba("black", 0.7) if i == 0 else NOTHING
        yield _Shape(depth, corners, (red, green, blue, 1.0), edge, 0.8 if i == 0 else 0.0)


def _axes(camera: _Camera, triad: Triad, k: int, length: float) -> Iterator[_Shape]:
    """Three axes of a frame as they are, and dashed, longer and thinner, as they should be."""
    for axis, colour in enumerate(AXES):
        end = triad.origin[k] + length * triad.actual[k, :, axis]
        yield _line(camera, np.stack([triad.origin[k], end]), _rgba(colour), 2.0, length)
        way = np.linspace(0.0, 1.5 * length, 8)[:, None] * triad.commanded[k, :, axis]
        for piece in (triad.origin[k] + way).reshape(4, 2, 3):
            yield _line(camera, piece, _rgba(colour), 1.0, length)


def _cross(camera: _Camera, place: Array) -> Iterator[_Shape]:
    """What a frame looks at."""
    depth, middle = float(camera.depth(place)), camera.pixels(place)
    for way in (np.array([5.0, 5.0]), np.array([5.0, -5.0])):
        yield _Shape(depth, np.stack([middle - way, middle + way]), NOTHING, _rgba(COMMANDED), 2.0)


def _walls(each: Scene, camera: _Camera) -> Iterator[_Shape]:
    """Half-spaces as squares that are seen through, behind everything."""
    places = each.places()
    low, high = places.min(axis=0), places.max(axis=0)
    for wall in each.walls:
        corners = wall.patch(0.5 * (low + high), 0.5 * float(np.max(high - low)))
        yield _polygon(camera, corners, _rgba(OBSTACLE, 0.18), _rgba(OBSTACLE, 0.8))._replace(depth=-np.inf)


def _pieces(
    path: Array, camera: _Camera, lift: float, colour: Colour, width: float, length: float, gap: float = 0.0
) -> Iterator[tuple[int, _Shape]]:
    """A path (N, 3) in pieces of `length` and gaps [px], each with the step that it ends at."""
    pixels = camera.pixels(path)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    starts = np.arange(0.0, along[-1], length + gap)
    begins, ends = np.searchsorted(along, starts), np.searchsorted(along, starts + length)
    for begin, end in zip(begins, np.minimum(ends, len(path) - 1), strict=True):
        if end > begin:
            chosen = np.unique(np.linspace(begin, end, min(int(end - begin) + 1, 6)).astype(int))
            yield int(end), _line(camera, path[chosen], colour, width, lift)
