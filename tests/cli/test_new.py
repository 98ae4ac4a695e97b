"""`clikgen new`: what it writes generates without a complaint and runs to within a tenth of a millimetre or so."""

import json
import math
import tomllib
from pathlib import Path

import pytest

ROBOTS = Path(__file__).parents[2] / "symbolic" / "specs" / "robots"

FINAL_ERROR = {"1": 1e-6, "2": 1e-3, "3": 1e-6}  # [m] of each case: the filter of case 2 lags
TRACKING = 1e-3  # [m] without the filter, on the whole way
FINISHED = 1e-3  # [m, rad] the joints end where they began


def urdf(*joints):
    """A chain; every joint is (type, xyz, axis, attributes of <limit>)."""
    parts = ["<robot name='made'><link name='base'/>"]
    before = "base"
    for i, (kind, xyz, axis, limit) in enumerate(joints, 1):
        parts.append(
            f"<link name='link{i}'/><joint name='joint{i}' type='{kind}'><parent link='{before}'/>"
            f"<child link='link{i}'/><origin xyz='{xyz}'/><axis xyz='{axis}'/><limit {limit}/></joint>"
        )
        before = f"link{i}"
    return "".join(parts) + "</robot>"


TURN = "lower='-2.5' upper='2.5' velocity='2' effort='9'"
FREE = "velocity='2' effort='9'"
TOOL = ("fixed", "0.3 0 0", "1 0 0", "effort='0'")
SIX = [
    ("revolute", "0 0 0.3", "0 0 1", TURN),
    ("revolute", "0 0 0", "0 1 0", TURN),
    ("revolute", "0.4 0 0", "0 1 0", TURN),
    ("revolute", "0.4 0 0", "1 0 0", TURN),
    ("revolute", "0 0 0", "0 1 0", TURN),
    ("revolute", "0.1 0 0", "1 0 0", TURN),
]
SEVEN = [*SIX[:2], ("revolute", "0.2 0 0", "1 0 0", TURN), *SIX[2:]]
GRIPPER = """<link name='left_finger'/><link name='right_finger'/>
<joint name='grip' type='prismatic'><parent link='link7'/><child link='left_finger'/><axis xyz='0 1 0'/>
<limit lower='0.01' upper='0.04' velocity='0.2' effort='9'/></joint>
<joint name='grip2' type='prismatic'><parent link='link7'/><child link='right_finger'/><axis xyz='0 -1 0'/>
<limit lower='0.01' upper='0.04' velocity='0.2' effort='9'/><mimic joint='grip'/></joint></robot>"""

# kind of robot -> its URDF, and what should be written: the task, its frame, its axes, what is locked
MADE = {
    "six joints": (urdf(*SIX, TOOL), "frame_pose", "link7", None, {}),
    "seven and a gripper": (
        urdf(*SEVEN).replace("</robot>", GRIPPER),
        "frame_pose",
        "link7",
        None,
        {"grip": 0.01},
    ),
    "scara": (
        urdf(
            ("revolute", "0 0 0.3", "0 0 1", TURN),
            ("revolute", "0.3 0 0", "0 0 1", TURN),
            ("prismatic", "0.3 0 0", "0 0 -1", "lower='0' upper='0.2' velocity='0.3' effort='9'"),
            ("revolute", "0 0 0", "0 0 1", TURN),
        ),
        "frame_position",
        "link4",
        None,
        {},
    ),
    "two joints in the plane": (
        urdf(("revolute", "0 0 0.1", "0 0 1", TURN), ("revolute", "0.4 0 0", "0 0 1", TURN), TOOL),
        "frame_position",
        "link3",
        ["x", "y"],
        {},
    ),
    "two joints in the plane, nearly": (  # 1.57 is no right angle: the third direction is there, by 1e-4
        urdf(("revolute", "0 0 0.1", "0 0 1", TURN), ("revolute", "0.4 0 0", "0.0001 0 1", TURN), TOOL),
        "frame_position",
        "link3",
        ["x", "y"],
        {},
    ),
    "one slide": (
        urdf(("prismatic", "0 0 0", "0 1 0", "lower='0' upper='0.5' velocity='0.1' effort='9'")),
        "frame_position",
        "link1",
        ["y"],
        {},
    ),
    "slow slide without end to speak of": (
        urdf(("prismatic", "0 0 0", "1 0 0", "lower='-90' upper='90' velocity='0.5' effort='9'")),
        "frame_position",
        "link1",
        ["x"],
        {},
    ),
    "joints that turn without end": (
        urdf(
            ("continuous", "0 0 0.3", "0 0 1", FREE),
            ("continuous", "0 0 0", "0 1 0", FREE),
            ("continuous", "0.4 0 0", "0 1 0", FREE),
            TOOL,
        ),
        "frame_position",
        "link4",
        None,
        {},
    ),
    "no velocity limits": (urdf(*[(*one[:3], "lower='-2' upper='2'") for one in SIX]), "frame_pose", "link6", None, {}),
    "frame at the origin": (
        urdf(*[("prismatic", "0 0 0", axis, "lower='-1' upper='1'") for axis in ("1 0 0", "0 1 0", "0 0 1")]),
        "frame_position",
        "link3",
        None,
        {},
    ),
    "a small one": (
        urdf(*[(one[0], " ".join(str(0.1 * float(x)) for x in one[1].split()), *one[2:]) for one in SIX]),
        "frame_pose",
        "link6",
        None,
        {},
    ),
    "a joint without room": (
        urdf(*SIX[:3], ("revolute", "0 0 0", "0 0 1", "lower='0.5' upper='0.5' velocity='1'"), TOOL),
        "frame_position",
        "link5",
        None,
        {"joint4": 0.5},
    ),
    "limits far out": (
        urdf(("revolute", "0 0 0", "0 0 1", "lower='-1e16' upper='1e16'"), TOOL),
        "frame_position",
        "link2",
        ["y"],
        {},
    ),
    "frame on its axis": (urdf(("continuous", "0 0 0", "0 0 1", FREE)), None, None, None, {}),
}


@pytest.fixture
def first_run(run_clikgen, tmp_path):
    """new -> generate -> simulate of a URDF file in tmp_path: the spec, the scenario, the metrics of every case."""

    def run(name, *options):
        made = run_clikgen("new", f"{name}.urdf", *options, cwd=tmp_path)
        assert made.returncode == 0, made.stderr
        spec = tomllib.loads((tmp_path / f"{name}.toml").read_text())
        scenario = tomllib.loads((tmp_path / f"{name}_first.toml").read_text())
        generated = run_clikgen("generate", f"{name}.toml", cwd=tmp_path)
        assert generated.returncode == 0, generated.stderr
        notes = [line for line in generated.stderr.splitlines() if "note:" in line]
        assert all("locked at" in line or "mesh" in line for line in notes), notes
        simulated = run_clikgen("simulate", f"{name}_first.toml", "--json", "--out", "runs", cwd=tmp_path)
        assert simulated.returncode == 0, simulated.stderr
        return spec, scenario, json.loads(simulated.stdout)["cases"]

    return run


def check_run(folder, scenario, cases):
    """Nothing diverges, the error is small, no limit is met, and the joints are back where they began."""
    for number, case in cases.items():
        assert case["diverged_s"] is None
        assert case["final_error"] < FINAL_ERROR[number]
        assert not case.get("outside_limits")
    assert cases["1"]["tracking_max"] < TRACKING
    lines = (folder / "runs" / "case1.csv").read_text().splitlines()
    names, last = lines[0].split(","), [float(value) for value in lines[-1].split(",")]
    q = [value for name, value in zip(names, last, strict=True) if name.startswith("q_") and name[2:].isdigit()]
    assert q == pytest.approx(scenario["q0"], abs=FINISHED)


@pytest.mark.parametrize("kind", MADE)
def test_first_run_of(kind, first_run, tmp_path):
    text, task, frame, axes, lock = MADE[kind]
    (tmp_path / "made.urdf").write_text(text)
    spec, scenario, cases = first_run("made")
    tool = {one["name"]: one for one in spec["tasks"]}.get("tool", {})
    assert (tool.get("kind"), tool.get("frame"), tool.get("axes")) == (task, frame, axes)
    assert spec["robot"].get("lock", {}) == lock
    assert ("velocity_limits" in spec) == ("velocity" in text)
    check_run(tmp_path, scenario, cases)
    waypoints = next(iter(scenario["references"].values()))["waypoints"]
    assert math.dist(waypoints[0], waypoints[1]) > 1e-3  # it moves
    assert waypoints[0] == waypoints[2]


@pytest.mark.parametrize(("name", "frame"), [("ur6", "tool0"), ("panda7", "hand_tcp"), ("dual_arm", "left_palm")])
def test_first_run_of_a_robot_that_ships(name, frame, first_run, tmp_path):
    (tmp_path / "mine.urdf").write_text((ROBOTS / f"{name}.urdf").read_text())
    spec, scenario, cases = first_run("mine", *(("--frame", frame) if name == "dual_arm" else ()))
    tool = next(task for task in spec["tasks"] if task["name"] == "tool")
    assert (tool["kind"], tool["frame"]) == ("frame_pose", frame)
    check_run(tmp_path, scenario, cases)


def test_finger_is_moved_when_asked_for(first_run, tmp_path):
    (tmp_path / "made.urdf").write_text(MADE["seven and a gripper"][0])
    spec, scenario, cases = first_run("made", "--frame", "left_finger")
    assert "lock" not in spec["robot"]
    assert len(scenario["q0"]) == 8
    check_run(tmp_path, scenario, cases)


def test_other_ends_are_told(run_clikgen, tmp_path):
    outcome = run_clikgen("new", ROBOTS / "dual_arm.urdf", "--out", tmp_path)
    assert "--frame for another link" in outcome.stderr
    assert "right_" in outcome.stderr
    assert "left_" in outcome.stderr


def test_two_runs_write_the_same(run_clikgen, tmp_path):
    for folder in ("a", "b"):
        assert run_clikgen("new", ROBOTS / "ur6.urdf", "--out", tmp_path / folder).returncode == 0
    for name in ("ur6.toml", "ur6_first.toml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_names_with_quotes_and_folders_are_written_as_they_are(run_clikgen, tmp_path):
    folder = tmp_path / 'a "b" ü'
    folder.mkdir()
    (folder / "My Robot-2.urdf").write_text(MADE["six joints"][0].replace("link7", "the &quot;tool&quot;"))
    outcome = run_clikgen("new", folder / "My Robot-2.urdf", "--out", tmp_path / "out", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    spec = tomllib.loads((tmp_path / "out" / "my_robot_2.toml").read_text())
    assert spec["robot"]["urdf"] == '../a "b" ü/My Robot-2.urdf'
    assert spec["tasks"][1]["frame"] == 'the "tool"'
    assert run_clikgen("generate", tmp_path / "out" / "my_robot_2.toml", cwd=tmp_path).returncode == 0


def complaint(run, *arguments, cwd):
    """The one line that `clikgen new ARGUMENTS` complains with; nothing is written."""
    before = {path: path.read_bytes() for path in cwd.rglob("*") if path.is_file()}
    outcome = run("new", *arguments, cwd=cwd)
    assert outcome.returncode == 2, outcome.stderr
    lines = outcome.stderr.strip().splitlines()
    assert len(lines) == 1, outcome.stderr
    assert lines[0].startswith("clikgen: error: ")
    assert {path: path.read_bytes() for path in cwd.rglob("*") if path.is_file()} == before
    return lines[0]


MISTAKES = {
    "unknown link": (["--frame", "lnik7"], ["no link 'lnik7'", "did you mean 'link7'", "link3"]),
    "link that stays": (["--frame", "base"], ["no joint moves 'base'"]),
    "name in capitals": (["--name", "Mine"], ["--name", "'Mine'"]),
    "empty name": (["--name", ""], ["--name", "''"]),
    "name that starts with a digit": (["--name", "7dof"], ["--name", "'7dof'"]),
    "name with two underscores": (["--name", "my__arm"], ["--name", "'my__arm'"]),
    "name that is too long": (["--name", "a" * 35], ["--name", "34"]),
    "folder that is a file": (["--out", "made.urdf"], ["made.urdf"]),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistake_is_one_line_and_nothing_is_written(run_clikgen, mistake, tmp_path):
    options, wanted = MISTAKES[mistake]
    (tmp_path / "made.urdf").write_text(MADE["six joints"][0])
    line = complaint(run_clikgen, "made.urdf", *options, cwd=tmp_path)
    for piece in wanted:
        assert piece in line


NO_ROBOT = {
    "missing": ("nowhere.urdf", None, ["nowhere.urdf", "No such file"]),
    "another kind of file": ("robot.toml", "", ["robot.toml", ".urdf"]),
    "not XML": ("robot.urdf", "robot", ["robot.urdf", "not valid XML"]),
    "nothing moves": ("robot.urdf", "<robot name='a'><link name='b'/></robot>", ["no joint moves"]),
    "no room": ("robot.urdf", urdf(("revolute", "0 0 0", "0 0 1", "lower='0' upper='0'")), ["no room to move"]),
}


@pytest.mark.parametrize("mistake", NO_ROBOT)
def test_what_is_no_robot_is_one_line(run_clikgen, mistake, tmp_path):
    name, text, wanted = NO_ROBOT[mistake]
    if text is not None:
        (tmp_path / name).write_text(text)
    line = complaint(run_clikgen, name, cwd=tmp_path)
    for piece in wanted:
        assert piece in line


@pytest.mark.parametrize("taken", ["made.toml", "made_first.toml"])
def test_nothing_is_overwritten(run_clikgen, taken, tmp_path):
    (tmp_path / "made.urdf").write_text(MADE["six joints"][0])
    (tmp_path / taken).write_text("mine")
    assert f"{taken}: is there already" in complaint(run_clikgen, "made.urdf", cwd=tmp_path)
    assert run_clikgen("new", "made.urdf", "--name", "other", cwd=tmp_path).returncode == 0
    assert (tmp_path / taken).read_text() == "mine"


def test_link_that_leads_nowhere_is_not_replaced(run_clikgen, tmp_path):
    (tmp_path / "made.urdf").write_text(MADE["six joints"][0])
    (tmp_path / "made.toml").symlink_to("nowhere.toml")
    assert "made.toml: is there already" in complaint(run_clikgen, "made.urdf", cwd=tmp_path)
    assert (tmp_path / "made.toml").is_symlink()
