"""A rollout in the browser, in three dimensions and over time, through viser: the only module that imports it.

All but `open_server` takes the server as an argument and needs no viser.
"""

import io
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.analysis.drawing import (
    COMMANDED,
    CONTACT,
    ERROR,
    LAM,
    OBSTACLE,
    QUIET,
    REGION,
    ROBOT,
    ROBOT_EDGE,
    TRACED,
    value_range,
)
from clikgen.analysis.scene import Capsule, Path, Region, Scene, Segment, Triad, Wall
from clikgen.runtime.documents import BadInput
from clikgen.runtime.realtime import Clock

Array = NDArray[np.float64]
RGB = tuple[int, int, int]
Place = Callable[[int], None]
"""Puts something to where it is at moment k."""

FRAME_RATE = 30.0  # [Hz]
MOMENTS = 2000  # of a rollout, at most
SAMPLES = 500  # of a signal in a chart
CHART_RATE = 6.0  # [Hz] at which the present moves in the charts
PIECES = 300  # of a path
SPEEDS = ("0.1", "0.25", "0.5", "1", "2", "5")


def check_viser() -> None:
    """Raises BadInput, with what to do, where viser is not installed."""
    if find_spec("viser") is None:
        raise BadInput("the viewer needs viser: pip install 'clikgen[view]'; '--save FILE.gif' works without it")


@contextmanager
def open_server(port: int) -> Iterator[Any]:
    """A server for the browsers of this machine, on `port` or the next one that is free (0: any).

    Raises BadInput where viser is not installed.
    """
    check_viser()
    import viser

    with redirect_stdout(io.StringIO()):  # what viser says of itself belongs to no output of ours
        server = viser.ViserServer(host="127.0.0.1", port=port, label="clikgen", verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


class Viewer:
    """Some cases of one scenario on a server, one shown at a time.

    What the visitor wants stands in the controls and nowhere else; `advance` makes what is shown follow them.
    """

    def __init__(self, server: Any, scenes: Mapping[int, Scene]) -> None:
        self._server = server
        self._scenes = {each.title: each for each in scenes.values()}
        first = next(iter(scenes.values()))
        end = float(first.moments[-1])
        server.gui.configure_theme(control_width="large", show_share_button=False)
        server.scene.set_up_direction("+z")
        _look(server, first)
        self.case = server.gui.add_dropdown("case", tuple(self._scenes), initial_value=first.title)
        self.time = server.gui.add_slider("t [s]", 0.0, end, end / (len(first.steps) - 1), 0.0)
        self.playing = server.gui.add_checkbox("play", initial_value=True)
        self.speed = server.gui.add_dropdown("speed", SPEEDS, initial_value="1")
        every = [_charts(each) for each in scenes.values()]
        self._charts = [
            _Chart(server.gui, same[0], value_range([values for one in same for values in one.values]))
            for same in zip(*every, strict=True)  # one range for all cases, so that they compare
        ]
        self._case = first.title
        self._stage = build_stage(server.scene, first)
        self._moment, self._marked = -1, -np.inf
        self.advance(0.0)

    @property
    def at_the_end(self) -> bool:
        """Whether the last moment is shown."""
        return self._moment == len(self._scenes[self._case].steps) - 1

    def advance(self, elapsed: float) -> None:
        """Show what the controls say, after `elapsed` [s] more of the visitor's time; from the end it starts again."""
        if self.playing.value and elapsed:
            end = float(self._scenes[self._case].moments[-1])
            later = self.time.value + elapsed * float(self.speed.value)
            self.time.value = 0.0 if self.at_the_end else min(later, end)
        if self.case.value != self._case:
            self._change()
        moments = self._scenes[self._case].moments
        k = int(np.argmin(np.abs(moments - self.time.value)))
        if k != self._moment:
            self._moment = k
            with self._server.atomic():
                for place in self._stage:
                    place(k)
        paused = not self.playing.value and self._marked != moments[k]
        if paused or abs(moments[k] - self._marked) * CHART_RATE > float(self.speed.value):
            self._marked = float(moments[k])
            for chart in self._charts:
                chart.mark(self._marked)

    def _change(self) -> None:
        """Clear the stage for another case."""
        self._case = self.case.value
        self._moment, self._marked = -1, -np.inf
        with self._server.atomic():
            self._server.scene.reset()
            self._stage = build_stage(self._server.scene, self._scenes[self._case])
        for chart, signals in zip(self._charts, _charts(self._scenes[self._case]), strict=True):
            chart.give(signals)


def play(viewer: Viewer, clock: Clock, once: bool = False) -> None:
    """Keep what is shown in step with the clock: to the end where it plays `once`, else until it is interrupted."""
    before = clock.now()
    while not (once and viewer.at_the_end):
        clock.sleep_until(before + 1.0 / FRAME_RATE)
        now = clock.now()
        viewer.advance(now - before)
        before = now


def _look(server: Any, each: Scene) -> None:
    """Let the camera start where everything is in view."""
    places = each.places()
    low, high = places.min(axis=0), places.max(axis=0)
    middle = 0.5 * (low + high)
    server.initial_camera.look_at = middle
    server.initial_camera.position = middle + float(np.linalg.norm(high - low)) * np.array([0.4, -0.66, 0.35])
    server.initial_camera.up = (0.0, 0.0, 1.0)


# Signals over time.


@dataclass(frozen=True, slots=True, eq=False)
class _Signals:
    """What one chart shows: names, colours and values (N,) over the times t (N,) [s]."""

    title: str
    t: Array
    names: tuple[str, ...]
    colours: tuple[str, ...]
    values: tuple[Array, ...]


def _charts(each: Scene) -> list[_Signals]:
    """λ, the errors in each unit, and the clearance, sampled for a chart."""
    chosen = np.unique(np.linspace(0, len(each.t) - 1, SAMPLES).astype(int))
    charts = [("λ, share of the filter", [("λ", LAM, each.lam)])]
    for unit in ("m", "rad"):
        errors = [error for error in each.errors if error.unit == unit]
        shades = (ERROR, "#F0A868", "#F7D3AF")
        lines = [(one.name.replace("_", " "), shades[i % 3], one.norm) for i, one in enumerate(errors)]
        charts += [(f"norm of the error [{unit}]", lines)] if lines else []
    if each.clearance is not None:
        charts.append(("clearance [m]: negative is intrusion", [("clearance", TRACED, each.clearance)]))
    return [
        _Signals(title, each.t[chosen], names, colours, tuple(one[chosen] for one in values))
        for title, lines in charts
        for names, colours, values in [tuple(zip(*lines, strict=True))]
    ]


class _Chart:
    """Signals over time in the control panel, with an upright line at the present."""

    def __init__(self, gui: Any, signals: _Signals, limits: tuple[float, float]) -> None:
        self._signals, self._limits = signals, limits
        lines = zip(signals.names, signals.colours, strict=True)
        self.handle = gui.add_uplot(
            data=self._data(0),
            series=(
                {"label": "t [s]"},
                {"label": "now", "stroke": QUIET, "width": 1.5},
                *({"label": name, "stroke": colour, "width": 1.5} for name, colour in lines),
            ),
            title=signals.title,
            scales={"x": {"time": False}, "y": {"range": limits}},
            axes=({"label": "t [s]", "labelSize": 18, "size": 34}, {"size": 56}),
            legend={"show": len(signals.names) > 1},
            height=150,
        )

    def give(self, signals: _Signals) -> None:
        """Show other values of the same signals."""
        self._signals = signals
        self.handle.data = self._data(0)

    def mark(self, t: float) -> None:
        """Set the present to t [s]."""
        self.handle.data = self._data(int(np.argmin(np.abs(self._signals.t - t))))

    def _data(self, present: int) -> tuple[Array, ...]:
        line = np.full(len(self._signals.t), self._limits[0])
        line[present] = self._limits[1]
        return (self._signals.t, line, *self._signals.values)


# What stands in space.


def build_stage(space: Any, each: Scene) -> list[Place]:
    """Put everything that a scene holds into viser's scene `space`; returns what moves it."""
    places = each.places()
    low, high = places.min(axis=0), places.max(axis=0)
    size = float(np.max(high - low))
    _floor(space, low, high)
    for wall in each.walls:
        _wall(space, wall, 0.5 * (low + high), 0.5 * size)
    stage = [_segment(space, f"/robot/segment_{i}", one, each.thickness) for i, one in enumerate(each.segments)]
    stage += [
        _ball(space, f"/robot/joint_{i}", each.joints[:, i], 1.15 * each.thickness, ROBOT_EDGE)
        for i in range(each.joints.shape[1])
    ]
    stage += [_outline(space, f"/robot/outline_{i}", one.corners) for i, one in enumerate(each.outlines)]
    stage += [_capsule(space, f"/bodies/{body.name}", body, ROBOT_EDGE, 0.35) for body in each.bodies]
    stage += [_region(space, region) for region in each.regions]
    stage += [_capsule(space, f"/obstacles/{one.name}", one, OBSTACLE, None) for one in each.obstacles]
    for path in each.paths:
        stage += _path(space, path, each)
    for triad in each.triads:
        stage += _triad(space, triad, each.thickness)
    stage += [
        _ball(space, f"/targets/{target.task}", target.place, 0.8 * each.thickness, COMMANDED)
        for target in each.targets
    ]
    return stage


def _rgb(colour: str) -> RGB:
    red, green, blue = (round(255 * channel) for channel in to_rgb(colour))
    return red, green, blue


def _floor(space: Any, low: Array, high: Array) -> None:
    """A grid with cells of 0.1 m, and sections of 1 m, below everything."""
    size = float(np.ceil(1.6 * np.max((high - low)[:2]))) + 1.0
    middle = 0.5 * (low + high)
    place = (float(np.round(middle[0])), float(np.round(middle[1])), min(0.0, float(low[2])))
    space.add_grid(
        "/floor", width=size, height=size, cell_size=0.1, section_size=1.0, cell_color=(228, 228, 228), position=place
    )


def _wall(space: Any, wall: Wall, center: Array, half: float) -> None:
    corners = wall.patch(center, half).astype(np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    space.add_mesh_simple(f"/walls/{wall.name}", corners, faces, color=_rgb(OBSTACLE), opacity=0.3, side="double")


def _ball(space: Any, name: str, center: Array, radius: float, colour: str, opacity: float | None = None) -> Place:
    """A ball whose centre is (K, 3)."""
    handle = space.add_icosphere(name, radius=radius, color=_rgb(colour), opacity=opacity, subdivisions=3)

    def place(k: int) -> None:
        handle.position = center[k]

    return place


def _segment(space: Any, name: str, segment: Segment, thickness: float) -> Place:
    """A cylinder along z of unit height, turned and drawn out."""
    handle = space.add_cylinder(name, radius=thickness, height=1.0, color=_rgb(ROBOT))

    def place(k: int) -> None:
        along = segment.end[k] - segment.start[k]
        length = max(float(np.linalg.norm(along)), 1e-6)
        handle.position = 0.5 * (segment.start[k] + segment.end[k])
        handle.wxyz = z_toward(along / length)
        handle.scale = (1.0, 1.0, length)

    return place


def _capsule(space: Any, name: str, capsule: Capsule, colour: str, opacity: float | None) -> Place:
    radius = max(capsule.radius, 6e-3)  # a point would vanish
    if capsule.is_ball:
        return _ball(space, name, capsule.start, radius, colour, opacity)
    along = capsule.end - capsule.start  # (K, 3), always as long
    length = float(np.linalg.norm(along[0]))
    vertices, faces = capsule_mesh(length, radius)
    handle = space.add_mesh_simple(name, vertices, faces, color=_rgb(colour), opacity=opacity)

    def place(k: int) -> None:
        handle.position = 0.5 * (capsule.start[k] + capsule.end[k])
        handle.wxyz = z_toward(along[k] / length)

    return place


def _outline(space: Any, name: str, corners: Array) -> Place:
    """A polygon (K, vertices, 3), as a fan of triangles from its first corner."""
    last = np.arange(2, corners.shape[1], dtype=np.uint32)
    faces = np.column_stack([np.zeros_like(last), last - 1, last])
    handle = space.add_mesh_simple(name, corners[0].astype(np.float32), faces, color=_rgb(ROBOT), side="double")

    def place(k: int) -> None:
        handle.vertices = corners[k].astype(np.float32)

    return place


def _region(space: Any, region: Region) -> Place:
    """Seen through, and of another colour while it meets an obstacle."""
    handle = space.add_icosphere(
        f"/regions/{region.name}", radius=region.radius, color=_rgb(REGION), opacity=0.12, cast_shadow=False
    )

    def place(k: int) -> None:
        touched = bool(region.touched[k])
        handle.position = region.center[k]
        handle.color = _rgb(CONTACT if touched else REGION)
        handle.opacity = 0.4 if touched else 0.12

    return place


def _path(space: Any, path: Path, each: Scene) -> Iterator[Place]:
    """Commanded, dashed and whole; traced, up to now; and where both are now."""
    chosen = np.linspace(0, len(each.t) - 1, PIECES + 1).astype(int)
    commanded, traced = path.commanded[chosen], path.traced[chosen]
    dashes = np.stack([commanded[:-1], commanded[1:]], axis=1)[np.arange(PIECES) % 6 < 3]
    name = f"/paths/{path.task}"
    pixels: dict[str, Any] = {"thickness_units": "screen"}
    space.add_line_segments(f"{name}/commanded", dashes.astype(np.float32), _rgb(COMMANDED), thickness=2.0, **pixels)
    still = np.repeat(traced[:1, None], PIECES, axis=0).repeat(2, axis=1).astype(np.float32)  # (PIECES, 2, 3)
    line = space.add_line_segments(f"{name}/traced", still, _rgb(TRACED), thickness=4.0, **pixels)
    yield _ball(space, f"{name}/commanded_now", path.commanded[each.steps], 0.7 * each.thickness, COMMANDED)
    yield _ball(space, f"{name}/traced_now", path.traced[each.steps], 0.8 * each.thickness, TRACED)

    def trace(k: int) -> None:
        step = each.steps[k]
        until = np.where((chosen <= step)[:, None], traced, path.traced[step])  # what is to come waits at the present
        line.points = np.stack([until[:-1], until[1:]], axis=1).astype(np.float32)

    yield trace


def _triad(space: Any, triad: Triad, thickness: float) -> Iterator[Place]:
    """The axes of a frame as they are and, thinner and longer, as they should be."""
    for kind, rotations, length, wide in (
        ("actual", triad.actual, 3.0, 0.16),
        ("commanded", triad.commanded, 4.5, 0.07),
    ):
        handle = space.add_frame(
            f"/frames/{triad.task}/{kind}", axes_length=length * thickness, axes_radius=wide * thickness
        )
        yield _turned(handle, triad.origin, rotations)


def _turned(handle: Any, origin: Array, rotations: Array) -> Place:
    quaternions = Rotation.from_matrix(rotations).as_quat(scalar_first=True)

    def place(k: int) -> None:
        handle.position = origin[k]
        handle.wxyz = quaternions[k]

    return place


def z_toward(direction: Array) -> Array:
    """The unit quaternion (w, x, y, z) of a rotation that takes the z axis to the unit vector `direction` (3,)."""
    x, y, z = direction
    if z < -1.0 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    quaternion = np.array([1.0 + z, -y, x, 0.0])
    unit: Array = quaternion / np.linalg.norm(quaternion)
    return unit


def capsule_mesh(length: float, radius: float, around: int = 24, caps: int = 8) -> tuple[Any, Any]:
    """Vertices (n, 3) [m] and triangles (m, 3) of a capsule along z, whose axis of `length` [m] has its middle at 0."""
    up = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 2 * caps)
    height = radius * np.sin(up) + np.where(np.arange(2 * caps) < caps, -0.5, 0.5) * length
    turn = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    flat = radius * np.cos(up)[:, None, None] * ring  # (rings, around, 2)
    vertices = np.concatenate([flat, np.broadcast_to(height[:, None, None], (2 * caps, around, 1))], axis=2)
    row, column = np.divmod(np.arange((2 * caps - 1) * around), around)
    a, b = row * around + column, row * around + (column + 1) % around
    faces = np.concatenate([np.column_stack([a, b, b + around]), np.column_stack([a, b + around, a + around])])
    return vertices.reshape(-1, 3).astype(np.float32), faces.astype(np.uint32)
