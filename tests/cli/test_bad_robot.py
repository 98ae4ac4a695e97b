"""Broken and unusual models, as a user meets them: `clikgen generate` and `clikgen simulate` say one line each.

The line names the file, the element or key, what was wanted, what was got and, where there is a choice, the choices.
"""

from pathlib import Path

import pytest

from clikgen.symbolic import tasks
from clikgen.symbolic.generate import difference, generate_file
from clikgen.symbolic.kinds import kinds_in

URDF = """<robot name="arm">
  <link name="base_link"/><link name="upper"/><link name="fore"/><link name="hand"/>
  <joint name="shoulder" type="revolute">
    <parent link="base_link"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1.5" effort="7"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0" rpy="0 0 0"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="2.5" velocity="1.5" effort="7"/>
  </joint>
  <joint name="wrist" type="continuous">
    <parent link="fore"/><child link="hand"/><origin xyz="0.3 0 0" rpy="0 0 0"/>
    <axis xyz="0 0 1"/>
  </joint>
</robot>"""

ARM = """urdf = "arm.urdf"
frames = [{name = "tip", link = "hand", xyz = [0.1, 0, 0]}]
points_of_interest = [{name = "knee", link = "upper", offset = [0.4, 0, 0], influence_radius = 0.1}]
bodies = [
  {name = "column", link = "base_link", radius = 0.1},
  {name = "foot", link = "base_link", radius = 0.2},
  {name = "fist", link = "hand", radius = 0.1},
]"""
PLANAR = """space = "planar"
joints = [
  {name = "one", type = "revolute", link = "a", lower = -2, upper = 2},
  {name = "two", type = "revolute", link = "b", xyz = [1, 0, 0], lower = -2, upper = 2},
]"""
TURNTABLE = 'joints = [{name = "spin", type = "continuous", link = "disc"}]'
DH = 'dh = {convention = "standard", rows = [{name = "one", a = 1, lower = -1, upper = 1}]}'
TIP = 'kind = "frame_position", frame = "tip", gain = 4'
FILTER = '[filter]\nkind = "first_order"\ncutoff = 5.0\n'


def task(text: str, name: str = "hand") -> str:
    return f'{{name = "{name}", {text}}}'


def spec(*tasks: str, robot: str = ARM, law: str = "nsb", more: str = "", filtered: str = FILTER) -> str:
    """The spec of a controller called my_arm; one task that follows the tip unless others are given."""
    listed = ",\n  ".join(tasks or (task(TIP),))
    head = f'name = "my_arm"\ndescription = "three joints"\nperiod = 0.01\nlaw = "{law}"\ntasks = [\n  {listed},\n]\n'
    return f"{head}\n[robot]\n{robot}\n\n{more}\n{filtered}"


def generate(run, folder: Path, urdf: str | None, text: str):
    if urdf is not None:
        (folder / "arm.urdf").write_text(urdf)
    (folder / "my.toml").write_text(text)
    return run("generate", "my.toml", cwd=folder)


def complaint(outcome) -> str:
    assert outcome.returncode == 2, outcome.stdout + outcome.stderr
    assert outcome.stdout == ""
    assert outcome.stderr.startswith("clikgen: error: ")
    assert outcome.stderr.count("\n") == 1, outcome.stderr
    assert outcome.stderr.endswith("\n")
    assert "Traceback" not in outcome.stderr
    return outcome.stderr


TYPES = "valid choices: continuous, fixed, prismatic, revolute"
LINKS = "valid choices: base_link, fore, hand, upper"
JOINTS = "valid choices: elbow, shoulder, wrist"
FRAMES = "valid choices: base_link, fore, hand, tip, upper"
KINDS = f"valid choices: {', '.join(kinds_in(tasks))}"
VECTORS = "valid choices: circle, csv, fixed, line, point_to_point, spline"
ROTATIONS = "valid choices: orientation, orientation_spline, spin, turn"

SHOULDER_LIMIT = '<limit lower="-2" upper="2" velocity="1.5" effort="7"/>'
BACK = '<joint name="back" type="fixed"><parent link="hand"/><child link="base_link"/></joint></robot>'
ISLE = """<link name="x"/><link name="y"/>
  <joint name="xy" type="fixed"><parent link="x"/><child link="y"/></joint>
  <joint name="yx" type="fixed"><parent link="y"/><child link="x"/></joint></robot>"""


def mimicking(joint: str) -> str:
    return f'{SHOULDER_LIMIT}<mimic joint="{joint}"/>'


# kind -> (what is replaced in the URDF, by what, what the line says)
URDF_MISTAKES = {
    "no root": (
        "</robot>",
        BACK,
        ["no root link carries joints 'shoulder', 'elbow', 'wrist', 'back': a ring", "wanted a tree"],
    ),
    "cycle": ("</robot>", ISLE, ["no root link carries joints 'xy', 'yx': a ring", "wanted a tree"]),
    "several roots": (
        "</robot>",
        '<link name="table"/></robot>',
        ["wanted one root link, got 2 that no joint carries: base_link, table"],
    ),
    "unknown joint type": (
        '"continuous"',
        '"continous"',
        ["joint 'wrist' has unknown type 'continous'", "mean 'continuous'?", TYPES],
    ),
    "floating joint": (
        '"continuous"',
        '"floating"',
        ["joint 'wrist' is floating", "valid choices: fixed, prismatic, revolute, continuous", "base = 'holonomic'"],
    ),
    "joint to a missing link": (
        '<child link="fore"',
        '<child link="for"',
        ["joint 'elbow': <child>: no link 'for'", "mean 'fore'?", LINKS],
    ),
    "joint from a missing link": (
        '<parent link="fore"',
        '<parent link="for"',
        ["joint 'wrist': <parent>: no link 'for'", "mean 'fore'?", LINKS],
    ),
    "two parents": (
        '<child link="hand"',
        '<child link="fore"',
        ["link 'fore' has two parents, by joints 'elbow' and 'wrist'", "wanted one"],
    ),
    "duplicate link": (
        '<link name="hand"/>',
        '<link name="fore"/>',
        ["link 'fore' is there twice", "wanted every name once"],
    ),
    "duplicate joint": ('name="wrist"', 'name="elbow"', ["joint 'elbow' is there twice", "wanted every name once"]),
    "zero axis": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 0 0"/>',
        ["joint 'elbow': <axis> xyz: wanted a direction, got '0 0 0'"],
    ),
    "malformed axis": (
        '<axis xyz="0 1 0"/>',
        '<axis xyz="0 1"/>',
        ["joint 'elbow': <axis> xyz: wanted 3 finite numbers, got '0 1'"],
    ),
    "NaN origin": (
        'xyz="0.4 0 0"',
        'xyz="0.4 nan 0"',
        ["joint 'elbow': <origin> xyz: wanted 3 finite numbers, got '0.4 nan 0'"],
    ),
    "unnormalised quaternion": (
        'xyz="0.4 0 0" rpy="0 0 0"',
        'xyz="0.4 0 0" quat_xyzw="0 0 0 2"',
        ["joint 'elbow': <origin> quat_xyzw is not read, wanted rpy"],
    ),
    "revolute without limits": (
        SHOULDER_LIMIT,
        "",
        ["joint 'shoulder' is revolute: wanted <limit> lower and upper, got none", "continuous"],
    ),
    "limits reversed": ('lower="-2"', 'lower="3"', ["joint 'shoulder': <limit>: wanted lower <= upper, got 3 and 2"]),
    "mimic of an unknown joint": (
        SHOULDER_LIMIT,
        mimicking("elbo"),
        ["joint 'shoulder': <mimic>: no joint 'elbo'", "mean 'elbow'?", "valid choices: elbow, wrist"],
    ),
    "mimic of itself": (
        SHOULDER_LIMIT,
        mimicking("shoulder"),
        ["mimics itself: shoulder -> shoulder;", "valid choices: elbow, wrist"],
    ),
    "mimics in a cycle": (
        SHOULDER_LIMIT,
        mimicking("elbow"),
        ["mimics itself: shoulder -> elbow -> shoulder;", "valid choices: wrist"],
    ),
    "no moving joint": (
        URDF,
        URDF.replace('"revolute"', '"fixed"').replace('"continuous"', '"fixed"'),
        ["no joint moves, wanted one at least that is not fixed"],
    ),
    "empty file": (URDF, "", ["the file is empty, wanted a URDF: <robot>"]),
    "not XML": (URDF, "robot: arm", ["not valid XML", "line 1, column 0"]),
    "xacro macro": (
        "<link name=",
        '<xacro:include filename="hand.xacro"/><link name=',
        ["<xacro:include> is a xacro macro, wanted a URDF", "xacro arm.urdf > expanded.urdf"],
    ),
    "xacro expression": (
        'xyz="0.4 0 0"',
        'xyz="${reach} 0 0"',
        ["<origin> xyz='${reach} 0 0' is xacro, wanted a URDF", "xacro arm.urdf > expanded.urdf"],
    ),
}

# kind -> (the spec, what the line says)
SPEC_MISTAKES = {
    "missing file": (
        spec(robot=ARM.replace("arm.urdf", "robots/arm.urdf")),
        ["robot: robots/arm.urdf: cannot be read: No such file"],
    ),
    "URDF is a folder": (spec(robot=ARM.replace("arm.urdf", ".")), ["robot: .: cannot be read: Is a directory"]),
    "two sources": (spec(robot=f"{ARM}\n{DH}"), ["robot: wanted exactly one of joints, dh, urdf, got dh and urdf"]),
    "no source": (spec(robot='space = "spatial"'), ["robot: wanted exactly one of joints, dh, urdf, got none"]),
    "no robot": (spec().replace(f"[robot]\n{ARM}\n", ""), ["robot: Field required"]),
    "frame that is not there": (
        spec(task(TIP.replace("tip", "tpi"))),
        ["task 'hand': no frame 'tpi'", "mean 'tip'?", FRAMES],
    ),
    "two tasks of one name": (
        spec(task(TIP), task(TIP)),
        ["tasks.0 and tasks.1 are both called 'hand'", "wanted every name once"],
    ),
    "signals that collide": (
        spec(
            task('kind = "frame_pose", frame = "tip", gain = 4'),
            task('kind = "frame_orientation", frame = "tip", gain = 4', "hand_orientation"),
        ),
        ["two signals are called 'hand_orientation_reference'", "give the task another name"],
    ),
    "posture of the wrong length": (
        spec(task('kind = "posture", posture = [0, 0], gain = 1', "home")),
        ["task 'home': posture", "wanted shape (3,), got (2,)", "shoulder, elbow, wrist"],
    ),
    "posture of an unknown joint": (
        spec(task('kind = "posture", joints = ["elbwo"], posture = [0], gain = 1', "home")),
        ["task 'home': no joint 'elbwo'", "mean 'elbow'?", JOINTS],
    ),
    "posture of a joint twice": (
        spec(task('kind = "posture", joints = ["elbow", "elbow"], posture = [0, 0], gain = 1', "home")),
        ["task 'home': joint 'elbow' is there twice"],
    ),
    "bodies that are not there": (
        spec(task('kind = "self_collision", pairs = [["fist", "colum"]], margin = 0.1', "apart")),
        ["task 'apart': no body 'colum'", "mean 'column'?", "valid choices: column, fist, foot"],
    ),
    "bodies fixed to each other": (
        spec(task('kind = "self_collision", pairs = [["column", "foot"]], margin = 0.1', "apart")),
        ["task 'apart': the bodies 'column' and 'foot' are fixed to each other", "wanted a joint"],
    ),
    "self-collision without bodies": (
        spec(task('kind = "self_collision", margin = 0.1', "apart"), robot='urdf = "arm.urdf"'),
        ["task 'apart': wanted bodies with two joints or more between them, got none"],
    ),
    "body on an unknown link": (
        spec(robot=ARM.replace('"fist", link = "hand"', '"fist", link = "hnad"')),
        ["robot: 'fist': no link 'hnad'", "mean 'hand'?", LINKS],
    ),
    "no limits to keep": (
        spec(task('kind = "joint_limits", margin = 0.1', "limits"), robot=TURNTABLE),
        ["task 'limits': wanted a joint with limits, got none"],
    ),
    "margins that meet": (
        spec(task('kind = "joint_limits", margin = 1.9', "limits")),
        ["task 'limits': joint 'elbow' moves from -1 to 2.5 rad", "at most half of that, got 1.9"],
    ),
    "margins of the wrong number": (
        spec(task('kind = "joint_limits", margin = [0.1, 0.1, 0.1]', "limits")),
        ["limits_margin: wanted shape (2,), got (3,)"],
    ),
    "joint without a velocity limit": (
        spec(more='[velocity_limits]\nkind = "scale"'),
        ["velocity_limits: joint 'wrist' has no velocity limit", "velocity_limits.limit"],
    ),
    "velocity limits of the wrong number": (
        spec(more='[velocity_limits]\nkind = "scale"\nlimit = [1.0, 1.0]'),
        ["velocity_limit: wanted shape (3,), got (2,)"],
    ),
    "velocity limits of an unknown kind": (
        spec(more='[velocity_limits]\nkind = "scaled"'),
        ["velocity_limits: no kind 'scaled'", "mean 'scale'?", "valid choices: clamp, scale"],
    ),
    "base with a link of the arm's": (
        spec(robot=f'{ARM}\nbase = {{kind = "holonomic", name = "upper"}}'),
        ["robot: base: the arm has a link 'upper' too", "base.name"],
    ),
    "base with a joint of the arm's": (
        spec(robot=f"{TURNTABLE}\nbase = 'holonomic'".replace('"spin"', '"base_yaw"')),
        ["robot: base: the arm has a joint 'base_yaw' too", "base.name"],
    ),
    "base of an unknown kind": (
        spec(robot=f'{ARM}\nbase = "holonomc"'),
        ["robot.base.kind", "'fixed', 'holonomic' or 'differential', got 'holonomc'"],
    ),
    "DH of an unknown convention": (
        spec(robot=DH.replace("standard", "classic")),
        ["robot.dh.convention", "'standard' or 'modified', got 'classic'"],
    ),
    "lock of an unknown joint": (
        spec(robot=f"{ARM}\nlock = {{wirst = 0.0}}"),
        ["robot: lock: no joint 'wirst'", "mean 'wrist'?", JOINTS],
    ),
    "lock outside the limits": (
        spec(robot=f"{ARM}\nlock = {{elbow = 3.0}}"),
        ["robot: lock: joint 'elbow': wanted a value in -1 to 2.5 rad, got 3"],
    ),
    "orientation in the plane": (
        spec(task('kind = "frame_orientation", frame = "b", gain = 1'), robot=PLANAR),
        ["task 'hand': in the plane an orientation is one angle", "base_heading"],
    ),
    "pose in the plane": (
        spec(task('kind = "frame_pose", frame = "b", gain = 1'), robot=PLANAR),
        ["task 'hand': a planar robot has no pose", "frame_position and base_heading"],
    ),
    "look along z in the plane": (
        spec(task('kind = "look_at", frame = "b", axis = "z", gain = 1', "eye"), robot=PLANAR),
        ["task 'eye': a planar robot looks along x or y, got axis z"],
    ),
    "position along z in the plane": (
        spec(task('kind = "frame_position", frame = "b", axes = ["z"], gain = 1'), robot=PLANAR),
        ["task 'hand': a planar robot has the axes x and y, got z"],
    ),
    "wall with a normal that is not a unit": (
        spec(task('kind = "workspace_walls", walls = [{normal = [0, 0, 2], offset = 0}], margin = 0.1', "walls")),
        ["tasks.0.workspace_walls.walls.0.normal: wanted a unit vector, got [0, 0, 2]"],
    ),
    "wall of the plane in space": (
        spec(task('kind = "workspace_walls", walls = [{normal = [0, 1], offset = 0}], margin = 0.1', "walls")),
        ["task 'walls': wanted normals of 3 numbers, got [0.0, 1.0]"],
    ),
    "walls without points": (
        spec(
            task('kind = "workspace_walls", walls = [{normal = [0, 0, 1], offset = 0}], margin = 0.1', "walls"),
            robot='urdf = "arm.urdf"',
        ),
        ["task 'walls': wanted frames, or a robot with points of interest"],
    ),
    "relative position of an unknown frame": (
        spec(task('kind = "relative_position", frame = "tip", relative_to = "bse_link", gain = 1')),
        ["task 'hand': no frame 'bse_link'", "mean 'base_link'?", FRAMES],
    ),
    "manipulability that is zero everywhere": (
        spec(task('kind = "manipulability", frame = "tip", of = "pose", gain = 1', "ease")),
        ["task 'ease'", "the pose of frame 'tip' in 3 of 6 directions at most"],
    ),
    "obstacles without room": (
        spec(task('kind = "obstacle_avoidance"', "away")),
        ["task 'away': wanted points of interest and [obstacles] maximum >= 1"],
    ),
    "barrier below a task that holds always": (
        spec(task(f"{TIP}"), task('kind = "joint_limits", margin = 0.05', "limits")),
        ["task 'limits': wanted it above task 'hand': first barriers, then hysteresis, ramp and damped"],
    ),
    "barrier below a ramp": (
        spec(
            task('kind = "joint_limits", margin = 0.05, activation = {kind = "ramp"}', "soft"),
            task('kind = "joint_limits", margin = 0.05', "limits"),
            task(f"{TIP}"),
        ),
        ["task 'limits': wanted it above task 'soft'"],
    ),
    "speed of a barrier": (
        spec(task('kind = "joint_limits", margin = 0.05, speed = 1.0', "limits")),
        ["task 'limits': wanted no speed, its activation has no feedback to limit; got 1"],
    ),
    "unknown activation": (
        spec(task('kind = "joint_limits", margin = 0.05, activation = {kind = "rmap"}', "limits")),
        ["no kind 'rmap'", "mean 'ramp'?", "valid choices: barrier, damped, hysteresis, ramp, switched"],
    ),
    "unknown law": (spec(law="augmentd"), ["no law 'augmentd'", "mean 'augmented'?", "valid choices: augmented, nsb"]),
    "unknown key in a damping table": (
        spec(task(f"{TIP}, damping = {{maximum = 0.05, neer = 0.05}}")),
        ["tasks.0.frame_position.damping", "unknown key 'neer'", "valid choices: maximum, near"],
    ),
    "damping table that lacks a key": (
        spec(task(f"{TIP}, damping = {{maximum = 0.05}}")),
        ["tasks.0.frame_position.damping", "near: Field required"],
    ),
    "gain that is not positive definite": (
        spec(task(TIP.replace("gain = 4", "gain = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]"))),
        ["hand_gain: wanted a symmetric positive definite matrix, got ((1.0, 2.0, 0.0)"],
    ),
    "gain of the wrong size": (
        spec(task(TIP.replace("gain = 4", "gain = [1, 2]"))),
        ["hand_gain: wanted shape (3, 3), got (2,)"],
    ),
    "negative speed": (
        spec(task(f"{TIP}, speed = -0.5")),
        ["tasks.0.frame_position.speed", "greater than 0, got -0.5"],
    ),
    "filter of the wrong number": (
        spec(filtered=FILTER.replace("5.0", "[5.0, 5.0]")),
        ["filter_cutoff: wanted shape (3,), got (2,)"],
    ),
    "task of an unknown kind": (
        spec(task(TIP.replace("frame_position", "frame_positon"))),
        ["tasks.0: no kind 'frame_positon'", "mean 'frame_position'?", KINDS],
    ),
    "task without a kind": (spec(task('frame = "tip", gain = 4')), ["tasks.0: no key 'kind'", KINDS]),
    "no tasks": (spec().replace(f"  {task(TIP)},\n", ""), ["tasks: ", "at least 1", "got []"]),
}


def test_the_model_that_is_broken_below_is_good_when_whole(run_clikgen, tmp_path):
    outcome = generate(run_clikgen, tmp_path, URDF, spec())
    assert outcome.returncode == 0, outcome.stderr
    assert {path.name for path in (tmp_path / "generated" / "my_arm").iterdir()} == {
        "my_arm.c",
        "my_arm.h",
        "my_arm_lanes.c",
        "manifest.json",
    }


@pytest.mark.parametrize("mistake", URDF_MISTAKES)
def test_broken_urdf_is_one_line(mistake, run_clikgen, tmp_path):
    old, new, wanted = URDF_MISTAKES[mistake]
    assert old in URDF
    text = URDF.replace(old, new, 1)
    if mistake == "mimics in a cycle":
        text = text.replace('<limit lower="-1"', '<mimic joint="shoulder"/><limit lower="-1"')
    line = complaint(generate(run_clikgen, tmp_path, text, spec()))
    for piece in ["my.toml: robot: ", "arm.urdf", *wanted]:
        assert piece in line
    assert not (tmp_path / "generated").exists()


@pytest.mark.parametrize("mistake", SPEC_MISTAKES)
def test_broken_spec_is_one_line(mistake, run_clikgen, tmp_path):
    text, wanted = SPEC_MISTAKES[mistake]
    line = complaint(generate(run_clikgen, tmp_path, URDF, text))
    for piece in ["my.toml: ", *wanted]:
        assert piece in line
    assert not (tmp_path / "generated").exists()


def test_missing_mesh_is_a_note(run_clikgen, tmp_path):
    mesh = '<link name="hand"><visual><geometry><mesh filename="meshes/hand.stl"/></geometry></visual></link>'
    outcome = generate(run_clikgen, tmp_path, URDF.replace('<link name="hand"/>', mesh), spec())
    assert outcome.returncode == 0, outcome.stderr
    (note,) = (line for line in outcome.stderr.splitlines() if "note: " in line)
    for piece in ["my.toml: note: ", "mesh 'meshes/hand.stl' of link 'hand'", "not found"]:
        assert piece in note
    assert (tmp_path / "generated" / "my_arm" / "my_arm.c").is_file()


AVOIDING = spec(
    task('kind = "obstacle_avoidance"', "away"),
    task('kind = "frame_pose", frame = "tip", gain = 4'),
    more="[obstacles]\nmaximum = 1\ncapsules = 1\nhalf_spaces = 1",
)
SCENARIO = """name = "my_scenario"
description = "the hand goes somewhere, past something"
controller = "my_arm"
duration = 0.5
q0 = [0.0, 0.5, 0.0]
references.hand = {kind = "fixed", position = [0.5, 0.2, 0.3]}
references.hand_orientation = {kind = "orientation", rpy = [0, 0, 0]}
obstacles = [{center = [2, 2, 2], radius = 0.1}]
capsules = [{start = [2, 0, 0], end = [2, 0, 1], radius = 0.1}]
half_spaces = [{normal = [0, 0, 1], offset = -1}]
"""
HAND = 'references.hand = {kind = "fixed", position = [0.5, 0.2, 0.3]}\n'
TURN = '{kind = "orientation", rpy = [0, 0, 0]}'
BALL = "{center = [2, 2, 2], radius = 0.1}"
CAPSULE = "{start = [2, 0, 0], end = [2, 0, 1], radius = 0.1}"
FLOOR = "{normal = [0, 0, 1], offset = -1}"

# kind -> (what is replaced in the scenario, by what, what the line says)
SCENARIO_MISTAKES = {
    "reference that is missing": (
        HAND,
        "",
        ["references.hand: missing; task 'hand' wants a reference, a vector of 3 coordinates"],
    ),
    "rotation that is missing": (
        f"references.hand_orientation = {TURN}\n",
        "",
        ["references.hand_orientation: missing; task 'hand' wants a reference, a rotation"],
    ),
    "rotation given for a vector": (
        '{kind = "fixed", position = [0.5, 0.2, 0.3]}',
        TURN,
        ["references.hand: wanted a vector, got the rotation 'orientation'", VECTORS],
    ),
    "vector given for a rotation": (
        TURN,
        '{kind = "fixed", position = [0, 0, 0]}',
        ["references.hand_orientation: wanted a rotation, got the vector 'fixed'", ROTATIONS],
    ),
    "reference of the wrong dimension": (
        "[0.5, 0.2, 0.3]",
        "[0.5, 0.2]",
        ["references.hand: wanted 3 coordinates, got 2"],
    ),
    "reference of an unknown kind": ('"fixed"', '"fixd"', ["references.hand", "'fixd'", "'fixed', 'line'"]),
    "reference that no task has": (
        "references.hand =",
        "references.hnd =",
        ["references: no reference 'hnd'", "mean 'hand'?", "valid choices: hand, hand_orientation"],
    ),
    "rotation of two angles": (
        "rpy = [0, 0, 0]",
        "rpy = [0, 0]",
        ["references.hand_orientation", "rpy", "3 items", "got [0, 0]"],
    ),
    "too many obstacles": (BALL, f"{BALL}, {BALL}", ["obstacles: wanted at most 1 for my_arm, got 2"]),
    "too many capsules": (CAPSULE, f"{CAPSULE}, {CAPSULE}", ["capsules: wanted at most 1 for my_arm, got 2"]),
    "too many half-spaces": (FLOOR, f"{FLOOR}, {FLOOR}", ["half_spaces: wanted at most 1 for my_arm, got 2"]),
    "obstacle in the plane": ("[2, 2, 2]", "[2, 2]", ["obstacles.0: wanted 3 coordinates, got 2"]),
    "capsule in the plane": ("end = [2, 0, 1]", "end = [2, 0]", ["capsules.0.end: wanted 3 coordinates, got 2"]),
    "capsule without an end": ("end = [2, 0, 1], ", "", ["capsules.0.end: Field required"]),
    "half-space in the plane": (
        "normal = [0, 0, 1]",
        "normal = [0, 1]",
        ["half_spaces.0.normal: wanted 3 coordinates, got 2"],
    ),
    "half-space with a normal that is not a unit": (
        "normal = [0, 0, 1]",
        "normal = [0, 1, 1]",
        ["half_spaces.0.normal: wanted a unit vector, got [0, 1, 1]"],
    ),
    "start of the wrong length": (
        "q0 = [0.0, 0.5, 0.0]",
        "q0 = [0.0, 0.5]",
        ["q0: wanted 3 numbers for my_arm, got 2"],
    ),
}


@pytest.fixture(scope="module")
def avoiding(tmp_path_factory) -> Path:
    """A folder with a generated controller that follows a pose past obstacles."""
    folder = tmp_path_factory.mktemp("avoiding")
    (folder / "arm.urdf").write_text(URDF)
    (folder / "my.toml").write_text(AVOIDING)
    made = generate_file(folder / "my.toml")
    difference({made.name: made.files}, folder / "generated", complete=False).apply()
    return folder


def test_the_scenario_that_is_broken_below_is_good_when_whole(run_clikgen, avoiding):
    (avoiding / "my_scenario.toml").write_text(SCENARIO)
    outcome = run_clikgen("simulate", "my_scenario.toml", "--json", cwd=avoiding)
    assert outcome.returncode == 0, outcome.stderr


@pytest.mark.parametrize("mistake", SCENARIO_MISTAKES)
def test_broken_scenario_is_one_line(mistake, run_clikgen, avoiding):
    old, new, wanted = SCENARIO_MISTAKES[mistake]
    assert old in SCENARIO
    (avoiding / "my_scenario.toml").write_text(SCENARIO.replace(old, new, 1))
    line = complaint(run_clikgen("simulate", "my_scenario.toml", cwd=avoiding))
    for piece in ["my_scenario.toml: ", *wanted]:
        assert piece in line
