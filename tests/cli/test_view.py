"""`clikgen view`: the film, the viewer on a server of our own making, and the line without viser."""

import sys
from contextlib import contextmanager, nullcontext
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from clikgen.analysis import viewer
from clikgen.analysis.scene import even_steps, scene
from clikgen.analysis.viewer import Viewer, capsule_mesh, play, z_toward
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare


class FakeServer:
    """What the viewer uses of viser's server; keeps what was added by its name."""

    def __init__(self):
        self.nodes, self.controls, self.charts = {}, {}, []
        self.initial_camera = SimpleNamespace()
        self.scene = self.gui = self

    def atomic(self):
        return nullcontext()

    def configure_theme(self, **_):
        pass

    def set_up_direction(self, direction):
        assert direction == "+z"

    def get_port(self):
        return 4321

    def reset(self):
        self.nodes.clear()

    def _node(self, name, *arguments, **properties):
        assert name not in self.nodes
        self.nodes[name] = SimpleNamespace(arguments=arguments, **properties)
        return self.nodes[name]

    add_icosphere = add_cylinder = add_mesh_simple = add_line_segments = add_grid = add_frame = _node

    def _control(self, label, *arguments, initial_value=None):
        self.controls[label] = SimpleNamespace(value=arguments[-1] if initial_value is None else initial_value)
        return self.controls[label]

    add_dropdown = add_slider = add_checkbox = _control

    def add_uplot(self, **properties):
        self.charts.append(SimpleNamespace(**properties))
        return self.charts[-1]


class FakeClock:
    """Time that passes when one waits for it."""

    def __init__(self):
        self.time = 100.0

    def now(self):
        return self.time

    def sleep_until(self, deadline):
        self.time = deadline


@pytest.fixture(scope="module")
def arm(small_arm):
    return small_arm()


@pytest.fixture(scope="module")
def rollouts(arm):
    scenario = Scenario.parse(
        {
            "name": "turn",
            "description": "a quarter turn",
            "controller": "small_arm",
            "duration": 2.0,
            "q0": [0.0, -0.61, 1.88],  # the tip is where the circle starts
            "references": {
                "tip": {"kind": "circle", "center": [0.0, 0.0, 0.4], "radius": 0.5, "period": 8.0},
                "wrist": {"kind": "spin", "start": [0, 0, 0], "axis": [0, 0, 1], "rate": 0.785, "duration": 2.0},
            },
            "obstacles": [{"radius": 0.05, "center": [0.45, 0.45, 0.4]}],
            "capsules": [{"start": [1, 1, 0], "end": [1, 1, 1], "radius": 0.1}],
            "half_spaces": [{"normal": [0, 0, 1], "offset": 0.0}],
        },
        "turn",
    )
    return {number: prepare(arm, scenario, CASES[number]).in_c() for number in (1, 2)}


@pytest.fixture
def server():
    return FakeServer()


@pytest.fixture
def shown(server, arm, rollouts):
    """A viewer of both cases, paused at the start."""
    one = Viewer(server, {number: scene(arm, rollout, even_steps(rollout, 51)) for number, rollout in rollouts.items()})
    one.playing.value = False
    return one


# ---- What stands where ----


def test_everything_there_is_to_see_is_on_the_stage(server, shown):
    assert set(server.nodes) == {
        "/floor",
        "/robot/segment_0",
        "/robot/segment_1",
        "/robot/segment_2",
        "/robot/joint_0",
        "/robot/joint_1",
        "/robot/joint_2",
        "/bodies/forearm",
        "/bodies/shoulder",
        "/regions/elbow",
        "/regions/end",
        "/obstacles/obstacle_0",
        "/obstacles/capsule_0",
        "/walls/half_space_0",
        "/paths/tip/commanded",
        "/paths/tip/traced",
        "/paths/tip/commanded_now",
        "/paths/tip/traced_now",
        "/frames/wrist/actual",
        "/frames/wrist/commanded",
    }
    assert [chart.title for chart in server.charts] == [
        "λ, share of the filter",
        "norm of the error [m]",
        "norm of the error [rad]",
        "clearance [m]: negative is intrusion",
    ]


@pytest.mark.parametrize("time", [0.0, 0.7, 1.99])
def test_the_slider_moves_everything_to_its_moment(server, shown, rollouts, small_arm_by_hand, time):
    shown.time.value = time
    shown.advance(0.0)
    rollout = rollouts[1]
    k = min(even_steps(rollout, 51), key=lambda step: abs(rollout.t[step] - time))
    (shoulder, elbow, tip), wrist = small_arm_by_hand(rollout.q[k], np.zeros(3))
    nodes = server.nodes
    np.testing.assert_allclose(nodes["/robot/joint_1"].position, shoulder, atol=1e-12)
    np.testing.assert_allclose(nodes["/robot/segment_2"].position, 0.5 * (elbow + tip), atol=1e-12)
    np.testing.assert_allclose(nodes["/robot/segment_2"].scale, [1, 1, 0.3], atol=1e-12)
    for name in ("/robot/segment_2", "/bodies/forearm"):
        rotation = Rotation.from_quat(nodes[name].wxyz, scalar_first=True)
        np.testing.assert_allclose(0.3 * rotation.apply([0, 0, 1]), tip - elbow, atol=1e-9)
    np.testing.assert_allclose(nodes["/regions/end"].position, tip, atol=1e-12)
    np.testing.assert_allclose(nodes["/paths/tip/traced_now"].position, tip, atol=1e-12)
    angle = 2 * np.pi * rollout.t[k] / 8
    np.testing.assert_allclose(
        nodes["/paths/tip/commanded_now"].position, [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.4], atol=1e-12
    )
    actual = Rotation.from_quat(nodes["/frames/wrist/actual"].wxyz, scalar_first=True)
    np.testing.assert_allclose(actual.as_matrix(), wrist, atol=1e-9)
    commanded = Rotation.from_quat(nodes["/frames/wrist/commanded"].wxyz, scalar_first=True)
    np.testing.assert_allclose(commanded.as_rotvec(), [0, 0, 0.785 * rollout.t[k]], atol=1e-9)


def test_the_trace_ends_at_the_present(server, shown, rollouts):
    shown.time.value = 1.0
    shown.advance(0.0)
    points = server.nodes["/paths/tip/traced"].points
    k = min(even_steps(rollouts[1], 51), key=lambda step: abs(rollouts[1].t[step] - 1.0))
    present = rollouts[1].signals["tip_position"][k]
    np.testing.assert_allclose(points[0, 0], rollouts[1].signals["tip_position"][0], atol=1e-6)
    np.testing.assert_allclose(points[-1], [present, present], atol=1e-6)
    assert np.all(points[:, :, 1] <= present[1] + 1e-6)


def test_a_region_in_contact_has_another_colour(server, shown, rollouts):
    colours = {}
    for time in (0.0, 1.0):
        shown.time.value = time
        shown.advance(0.0)
        colours[time] = server.nodes["/regions/end"].color
    assert not rollouts[1].active[0]
    assert rollouts[1].active[100]
    assert colours[0.0] != colours[1.0]


def test_another_case_is_shown_when_it_is_chosen(server, shown, rollouts):
    shown.time.value = 1.0
    shown.advance(0.0)
    before = server.nodes["/paths/tip/traced_now"].position
    shown.case.value = f"Case 2: {rollouts[2].title}"
    shown.advance(0.0)
    k = min(even_steps(rollouts[2], 51), key=lambda step: abs(rollouts[2].t[step] - 1.0))
    after = server.nodes["/paths/tip/traced_now"].position
    np.testing.assert_array_equal(after, rollouts[2].signals["tip_position"][k])
    assert np.linalg.norm(after - before) > 1e-3
    np.testing.assert_array_equal(server.charts[0].data[2], rollouts[2].signals["lam"])
    assert server.charts[0].scales["y"]["range"][1] > 1.0  # one range for both cases: λ is 0 in case 1


def test_charts_have_the_signals_and_mark_the_present(server, shown, rollouts):
    shown.time.value = 1.2
    shown.advance(0.0)
    t, present, error = server.charts[1].data
    np.testing.assert_array_equal(t, rollouts[1].t)
    np.testing.assert_allclose(error, np.linalg.norm(rollouts[1].error, axis=1))
    assert t[np.argmax(present)] == pytest.approx(1.2, abs=0.02)
    assert np.count_nonzero(present > present.min()) == 1


# ---- Time ----


def test_play_runs_at_the_chosen_speed_and_once_through(server, shown):
    shown.playing.value, shown.speed.value = True, "2"
    clock = FakeClock()
    play(shown, clock, once=True)
    assert shown.at_the_end
    assert clock.time - 100.0 == pytest.approx(1.99 / 2, abs=0.05)


def test_play_goes_on_until_it_is_interrupted(server, shown):
    shown.playing.value, shown.speed.value = True, "1"
    clock, times = FakeClock(), []

    def interrupt(deadline):
        clock.time = deadline
        times.append(shown.time.value)
        if len(times) == 100:
            raise KeyboardInterrupt

    clock.sleep_until = interrupt
    with pytest.raises(KeyboardInterrupt):
        play(shown, clock)
    assert max(times) == pytest.approx(1.99)
    assert times[-1] < times[50]  # it started again


def test_nothing_moves_while_it_is_paused(server, shown):
    shown.time.value = 0.5
    for _ in range(10):
        shown.advance(0.1)
    assert shown.time.value == 0.5


# ---- Shapes ----


def test_z_is_turned_into_any_direction():
    rng = np.random.default_rng(0)
    for direction in [*rng.normal(size=(50, 3)), [0, 0, 1], [0, 0, -1], [1e-9, 0, -1], [1, 0, 0]]:
        unit = np.array(direction) / np.linalg.norm(direction)
        turned = Rotation.from_quat(z_toward(unit), scalar_first=True).apply([0, 0, 1])
        np.testing.assert_allclose(turned, unit, atol=1e-8)


def test_a_capsule_mesh_is_closed_and_lies_on_the_capsule():
    vertices, faces = capsule_mesh(0.6, 0.1)
    nearest = np.clip(vertices[:, 2], -0.3, 0.3)
    distance = np.linalg.norm(vertices - np.column_stack([0 * nearest, 0 * nearest, nearest]), axis=1)
    np.testing.assert_allclose(distance, 0.1, atol=1e-6)
    assert np.ptp(vertices[:, 2]) == pytest.approx(0.8, abs=1e-6)
    corners = vertices[faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = np.sum(np.einsum("ij,ij->i", corners[:, 0], normals)) / 6
    exact = np.pi * 0.1**2 * 0.6 + 4 / 3 * np.pi * 0.1**3
    assert 0.95 * exact < volume < exact  # positive: every triangle faces outward


# ---- The command ----


@pytest.fixture
def served(monkeypatch, server):
    """The command with our server and clock; returns the ports it asked for."""
    ports = []

    @contextmanager
    def open_fake(port):
        ports.append(port)
        yield server

    monkeypatch.setattr(viewer, "check_viser", lambda: None)
    monkeypatch.setattr(viewer, "open_server", open_fake)
    monkeypatch.setattr("clikgen.runtime.realtime.MonotonicClock", FakeClock)
    return ports


def test_view_serves_the_scenario_and_says_where(run_clikgen, served, server):
    outcome = run_clikgen("view", "paper", "--set", "duration=2.0", "--port", "9000", "--once")
    assert (outcome.returncode, outcome.stdout) == (0, "")
    assert "http://localhost:4321" in outcome.stderr
    assert served == [9000]
    assert server.controls["case"].value.startswith("Case 1")
    assert "/robot/outline_0" in server.nodes


def test_interrupting_the_viewer_ends_with_130(run_clikgen, served, monkeypatch):
    ticks = count()

    def interrupted(self, deadline):
        self.time = deadline
        if next(ticks) == 5:
            raise KeyboardInterrupt

    monkeypatch.setattr(FakeClock, "sleep_until", interrupted)
    assert run_clikgen("view", "paper", "--case", "3", "--set", "duration=2.0").returncode == 130


def test_without_viser_one_line_says_how_to_get_it_and_what_works_without(run_clikgen, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(BadInput), viewer.open_server(0):
        pass
    outcome = run_clikgen("view", "paper")
    assert outcome.returncode == 2
    assert outcome.stdout == ""
    (line,) = outcome.stderr.strip().splitlines()
    assert line.startswith("clikgen: error: ")
    assert "pip install 'clikgen[view]'" in line
    assert "--save FILE.gif" in line


def test_a_film_is_saved_without_viser(run_clikgen, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    path = tmp_path / "paper.gif"
    outcome = run_clikgen("view", "paper", "--case", "1", "--set", "duration=1.0", "--save", path)
    assert (outcome.returncode, outcome.stdout) == (0, "")
    assert str(path) in outcome.stderr
    with Image.open(path) as film:
        assert film.n_frames == 90


MISTAKES = {
    "no such case": (["--case", "4"], ["--case", "1, 2, 3", "got 4"]),
    "no such port": (["--port", "70000"], ["--port", "65535", "got 70000"]),
    "no such film": (["--save", "film.avi"], ["film.avi", ".gif, .mp4"]),
    "diverged": (["--set", "tool_gain=400", "--save", "film.gif"], ["case 1", "diverged"]),
    "folder that is a file": (["--set", "duration=0.2", "--save", "/dev/null/film.gif"], ["/dev/null"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_one_line(mistake, run_clikgen, tmp_path):
    arguments, wanted = MISTAKES[mistake]
    outcome = run_clikgen("view", "paper", *arguments)
    assert outcome.returncode == 2
    (line,) = outcome.stderr.strip().splitlines()
    assert all(piece in line for piece in wanted)


def test_shipped_paper_is_seen_in_the_plane(server):
    controller = CompiledController.load("planar5")
    wanted = read_scenario(find_scenario("paper"), ["duration=1.0"])
    each = scene(controller, prepare(controller, wanted, CASES[1]).in_c(), [0, 50, 99])
    Viewer(server, {1: each})
    vertices = server.nodes["/robot/outline_0"].vertices
    np.testing.assert_allclose(vertices, each.outlines[0].corners[0], atol=1e-6)
    assert not vertices[:, 2].any()
