"""`clikgen inspect`: the tables and the JSON say what the URDF says, and the picture shows something."""

import io
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

ROBOTS = Path(__file__).parents[2] / "symbolic" / "specs" / "robots"

URDF = """<robot name="crane">
  <link name="ground"/><link name="tower"/><link name="jib"/><link name="hook"/><link name="counter"/>
  <link name="lamp"/>
  <joint name="slew" type="continuous">
    <parent link="ground"/><child link="tower"/><origin xyz="0.1 0 2" rpy="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit velocity="0.75" effort="1"/>
  </joint>
  <joint name="luff" type="revolute">
    <parent link="tower"/><child link="jib"/><axis xyz="0 -1 0"/><limit lower="0.25" upper="1.25" effort="1"/>
  </joint>
  <joint name="hoist" type="prismatic">
    <parent link="jib"/><child link="hook"/><origin xyz="3 0 0"/><axis xyz="0 0 -1"/>
    <limit lower="0" upper="1.5" velocity="0.5" effort="1"/>
  </joint>
  <joint name="balance" type="prismatic">
    <parent link="tower"/><child link="counter"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="0" velocity="0.5" effort="1"/><mimic joint="hoist" multiplier="-0.5" offset="0.125"/>
  </joint>
  <joint name="socket" type="fixed"><parent link="hook"/><child link="lamp"/><origin xyz="0 0 -0.2"/></joint>
</robot>
"""


@pytest.fixture
def crane(tmp_path):
    path = tmp_path / "crane.urdf"
    path.write_text(URDF)
    return path


def rows(text):
    """First cell -> the other cells, of every row of the tables on stdout."""
    cells = [[cell.strip() for cell in line.strip("│").split("│")] for line in text.splitlines() if line[0] == "│"]
    return [(first, rest) for first, *rest in cells]


def complaint(run, *arguments):
    outcome = run("inspect", *arguments)
    assert outcome.returncode == 2, outcome.stdout + outcome.stderr
    assert outcome.stdout == ""
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1
    return lines[0]


def test_tables_say_what_the_urdf_says(run_clikgen, crane):
    outcome = run_clikgen("inspect", crane)
    assert outcome.returncode == 0
    summary = outcome.stdout.splitlines()[0]
    assert summary == f"{crane}: 6 links from 'ground', 3 degrees of freedom, 1 fixed joint"
    moving, sitting = rows(outcome.stdout)[:4], rows(outcome.stdout)[4:]
    assert moving == [
        ("slew", ["0", "continuous", "0  0  1", "-", "0.75", "rad, rad/s"]),
        ("luff", ["1", "revolute", "0  -1  0", "0.25 .. 1.25", "-", "rad, rad/s"]),
        ("hoist", ["2", "prismatic", "0  0  -1", "0 .. 1.5", "0.5", "m, m/s"]),
        ("balance", ["-", "= -0.5 hoist +0.125", "1  0  0", "-1 .. 0", "0.5", "m, m/s"]),
    ]
    assert sitting == [
        ("slew", ["ground -> tower", "0.1  0  2", "0  0  0.5"]),
        ("luff", ["tower -> jib", "0  0  0", "0  0  0"]),
        ("hoist", ["jib -> hook", "3  0  0", "0  0  0"]),
        ("socket (fixed)", ["hook -> lamp", "0  0  -0.2", "0  0  0"]),
        ("balance", ["tower -> counter", "0  0  0", "0  0  0"]),
    ]
    assert "where the joints sit: xyz [m] and rpy [rad] in the parent link" in outcome.stdout


def test_document_says_what_the_urdf_says(run_clikgen, crane):
    said = json.loads(run_clikgen("inspect", crane, "--json").stdout)
    assert said["root"] == "ground"
    assert said["links"] == ["ground", "tower", "jib", "hook", "lamp", "counter"]
    assert said["degrees_of_freedom"] == 3
    assert [one["name"] for one in said["inputs"]] == ["slew", "luff", "hoist"]
    assert [one["velocity"] for one in said["inputs"]] == [0.75, None, 0.5]
    joints = {joint.pop("joint"): joint for joint in said["joints"]}
    assert list(joints) == ["slew", "luff", "hoist", "socket", "balance"]
    assert joints["balance"] == {
        "q": None,
        "type": "prismatic",
        "unit": "m",
        "parent": "tower",
        "link": "counter",
        "xyz": [0.0, 0.0, 0.0],
        "rpy": [0.0, 0.0, 0.0],
        "axis": [1.0, 0.0, 0.0],
        "lower": -1.0,
        "upper": 0.0,
        "velocity": 0.5,
        "mimic": {"joint": "hoist", "multiplier": -0.5, "offset": 0.125},
    }
    assert joints["slew"]["rpy"] == [0.0, 0.0, 0.5]
    assert (joints["slew"]["lower"], joints["slew"]["q"]) == (None, 0)
    assert (joints["socket"]["axis"], joints["socket"]["unit"]) == (None, None)


@pytest.mark.parametrize("name", ["dual_arm", "panda7", "ur6"])
def test_robots_that_ship_fit_in_120_columns_and_no_word_is_cut(run_clikgen, name):
    path = ROBOTS / f"{name}.urdf"
    outcome = run_clikgen("inspect", path)
    lines = outcome.stdout.splitlines()[1:]  # the first one is as long as the path
    assert max(map(len, lines)) <= 120
    assert "…" not in outcome.stdout
    said = json.loads(run_clikgen("inspect", path, "--json").stdout)
    text = path.read_text()
    assert len(said["joints"]) == text.count("<joint ")
    assert len(said["links"]) == text.count("<link ")
    for joint in said["joints"]:
        assert f'<joint name="{joint["joint"]}" type="{joint["type"]}">' in text


def test_long_names_are_not_cut(run_clikgen, crane):
    long = "a_link_with_a_name_that_is_as_long_as_those_of_some_vendors"
    crane.write_text(URDF.replace("tower", long))
    said = run_clikgen("inspect", crane).stdout
    assert f"{long} ->" in said
    assert "…" not in said


def test_base_inputs_points_and_bodies_of_a_spec_are_there(run_clikgen):
    outcome = run_clikgen("inspect", "mobile_panda")
    names = [first for first, _ in rows(outcome.stdout)]
    said = json.loads(run_clikgen("inspect", "mobile_panda", "--json").stdout)
    for kind in ("frames", "points_of_interest", "bodies"):
        assert all(one["name"] in names for one in said[kind])
    assert said["points_of_interest"]
    assert said["bodies"]
    assert "points of interest" in outcome.stdout
    assert "collision bodies" in outcome.stdout


def test_differential_drive_has_an_input_less(run_clikgen, crane, tmp_path):
    (tmp_path / "moved.toml").write_text('[robot]\nurdf = "crane.urdf"\nbase = "differential"\n')
    outcome = run_clikgen("inspect", tmp_path / "moved.toml")
    assert "6 degrees of freedom" in outcome.stdout
    assert "5 inputs: a differential drive has v (at most 1 m/s) in place of the rates of base_x and base_y" in (
        outcome.stdout
    )
    said = json.loads(run_clikgen("inspect", tmp_path / "moved.toml", "--json").stdout)
    assert [one["name"] for one in said["inputs"]] == ["base_forward", "base_yaw", "slew", "luff", "hoist"]
    assert said["drive"] == {"x": "base_x", "y": "base_y", "yaw": "base_yaw", "velocity": 1.0}


def drawn(path):
    """The colours of a picture's pixels, (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(path.read_bytes())).convert("RGB")).astype(int)


@pytest.mark.parametrize("robot", ["panda7", "planar5", "dual_arm", "crane"])
def test_picture_shows_the_robot(run_clikgen, robot, crane, tmp_path):
    out = tmp_path / "pictures" / "it.png"
    assert run_clikgen("inspect", crane if robot == "crane" else robot, "--out", out).returncode == 0
    pixels = drawn(out)
    share = np.mean(np.abs(pixels - 255).sum(axis=2) > 60)
    assert 0.005 < share < 0.5  # neither blank nor covered
    left = np.abs(pixels[:, : pixels.shape[1] // 2] - np.array([0x87, 0x94, 0xA1])).sum(axis=2) < 12
    assert left.any()  # links


def test_picture_depends_on_the_joint_positions(run_clikgen, crane, tmp_path):
    for name, at in (("a", "0,0.25,0"), ("b", "0,1.25,0")):
        assert run_clikgen("inspect", crane, "--at", at, "--out", tmp_path / f"{name}.png").returncode == 0
    assert not np.array_equal(drawn(tmp_path / "a.png"), drawn(tmp_path / "b.png"))


def test_labels_overlap_no_other():
    """Thirty joints at places that project close to one another."""
    from clikgen.analysis.robot_figure import DrawnJoint, robot_figure

    rng = np.random.default_rng(0)
    places = [np.column_stack([np.eye(3), 0.2 * rng.standard_normal(3)]) for _ in range(31)]
    joints = [
        DrawnJoint(f"joint_{i}", "revolute", i, end, start, (0.0, 0.0, 1.0))
        for i, (start, end) in enumerate(pairwise(places))
    ]
    figure = robot_figure("thirty", joints, 3)
    figure.draw_without_rendering()
    labels = [text for text in figure.axes[0].texts if text.get_text()[:1].isdigit()]
    boxes = [Text.get_window_extent(text) for text in labels]  # without the line to the joint
    assert sorted(int(n) for text in labels for n in text.get_text().split(",")) == list(range(30))
    over = sum(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])
    assert over == 0


def test_planar_robot_is_seen_from_above_at_one_scale():
    from clikgen.analysis.robot_figure import DrawnJoint, robot_figure

    pose = np.column_stack([np.eye(3), [2.0, 0.5, 0.0]])
    root = np.column_stack([np.eye(3), np.zeros(3)])
    (axes,) = robot_figure("one", [DrawnJoint("j", "revolute", 0, pose, root, (0.0, 0.0, 1.0))], 2).axes
    assert axes.name == "rectilinear"  # no z axis
    assert axes.get_aspect() == 1.0
    (spatial,) = robot_figure("one", [DrawnJoint("j", "revolute", 0, pose, root, (0.0, 0.0, 1.0))], 3).axes
    sides = [np.ptp(limits) for limits in (spatial.get_xlim(), spatial.get_ylim(), spatial.get_zlim())]
    assert np.ptp(spatial._box_aspect / sides) < 1e-9  # there is no public way to ask


def test_unknown_name_lists_what_ships(run_clikgen):
    line = complaint(run_clikgen, "pandas7")
    assert "did you mean 'panda7'" in line
    assert "planar5" in line


MISTAKES = {
    "missing": ("nowhere.urdf", None, ["nowhere.urdf", "No such file"]),
    "another kind of file": ("robot.xml", URDF, ["robot.xml", ".urdf or .toml"]),
    "not XML": ("robot.urdf", "robot: crane", ["robot.urdf", "not valid XML"]),
    "not a URDF": ("robot.urdf", "<sdf/>", ["robot.urdf", "wanted <robot>"]),
    "nothing moves": ("robot.urdf", '<robot name="a"><link name="b"/></robot>', ["no joint moves"]),
    "no robot in the spec": ("robot.toml", 'name = "a"', ["robot.toml", "[robot]"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_is_no_robot_is_one_line(run_clikgen, mistake, tmp_path):
    name, text, wanted = MISTAKES[mistake]
    if text is not None:
        (tmp_path / name).write_text(text)
    line = complaint(run_clikgen, tmp_path / name, "--out", tmp_path / "it.png")
    for piece in wanted:
        assert piece in line
    assert not (tmp_path / "it.png").exists()


@pytest.mark.parametrize("at", ["1,2", "1,2,3,4", "1,2,x", "1,2,nan", "", "1;2;3"])
def test_bad_joint_positions_are_one_line(run_clikgen, crane, at, tmp_path):
    line = complaint(run_clikgen, crane, "--at", at, "--out", tmp_path / "it.png")
    assert "--at: wanted 3 numbers" in line
    assert repr(at) in line
    assert not (tmp_path / "it.png").exists()


def test_picture_of_an_unknown_kind_or_place_is_one_line(run_clikgen, crane, tmp_path):
    assert "no format 'gifs'" in complaint(run_clikgen, crane, "--out", tmp_path / "it.gifs")
    (tmp_path / "taken").write_text("mine")
    assert "taken" in complaint(run_clikgen, crane, "--out", tmp_path / "taken" / "it.png")
    assert {path.name for path in tmp_path.iterdir()} == {"crane.urdf", "taken"}


def test_root_and_tool_are_named_in_the_picture():
    from clikgen.analysis.robot_figure import DrawnFrame, DrawnJoint, robot_figure

    root, pose = (np.column_stack([np.eye(3), place]) for place in ([0.0, 0.0, 0.0], [0.5, 0.2, 0.0]))
    joints = [DrawnJoint("j", "revolute", 0, pose, root, (0.0, 0.0, 1.0))]
    for dimension in (2, 3):
        (axes,) = robot_figure("one", joints, dimension, [DrawnFrame("floor", root), DrawnFrame("gripper", pose)]).axes
        assert {"0", "floor", "gripper"} == {text.get_text() for text in axes.texts if text.get_text()}
