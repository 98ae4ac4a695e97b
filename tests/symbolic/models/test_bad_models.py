"""Every kind of broken model: one line that names the file or table, the element, what was got and the choices."""

import pytest

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.models.table import RobotTable

GOOD = """<robot name="arm">
  <link name="base_link"/><link name="upper"/><link name="fore"/>
  <joint name="shoulder" type="revolute">
    <parent link="base_link"/><child link="upper"/><origin xyz="0 0 0.2" rpy="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="2" velocity="1.5" effort="7"/>
  </joint>
  <joint name="elbow" type="prismatic">
    <parent link="upper"/><child link="fore"/><axis xyz="1 0 0"/><limit lower="0" upper="1" velocity="1" effort="7"/>
  </joint>
</robot>"""

SHOULDER_LIMIT = '<limit lower="-1" upper="2" velocity="1.5" effort="7"/>'
TYPES = "fixed, prismatic, revolute, continuous"
CHOICE_OF_TYPES = "valid choices: continuous, fixed, prismatic, revolute"
LINKS = "valid choices: base_link, fore, upper"
FIXED = GOOD.replace('"revolute"', '"fixed"').replace('"prismatic"', '"fixed"')
RING = """<joint name="back" type="fixed"><parent link="fore"/><child link="base_link"/></joint></robot>"""
ISLAND = """<link name="x"/><link name="y"/>
  <joint name="xy" type="fixed"><parent link="x"/><child link="y"/></joint>
  <joint name="yx" type="fixed"><parent link="y"/><child link="x"/></joint></robot>"""


def mimicking(joint):
    return SHOULDER_LIMIT, f'{SHOULDER_LIMIT}<mimic joint="{joint}"/>'


# kind -> (what is replaced in the good file, by what, what the line says) or (the whole file, what it says)
BROKEN = {
    "empty file": ("", ["the file is empty", "<robot>"]),
    "blank file": (" \n\n ", ["the file is empty", "<robot>"]),
    "not XML": ("link: base", ["not valid XML", "line 1"]),
    "cut short": (GOOD[:300], ["not valid XML", "line"]),
    "tags crossed": ("</joint>\n</robot>", "</robot>", ["not valid XML: mismatched tag", "line"]),
    "not a robot": ("<sdf version='1.6'><model/></sdf>", ["wanted <robot>", "got <sdf>"]),
    "no links": ("<robot name='a'/>", ["no <link>"]),
    "nothing but a link": ("<robot name='a'><link name='b'/></robot>", ["no joint moves"]),
    "nothing moves": (FIXED, ["bad.urdf: no joint moves", "not fixed"]),
    "xacro macro": ("<link name=", "<xacro:arm prefix='l'/><link name=", ["<xacro:arm>", "xacro bad.urdf >"]),
    "xacro expression": ('"0 0 0.2"', '"0 0 ${height}"', ["<origin> xyz='0 0 ${height}'", "xacro bad.urdf >"]),
    "xacro argument": ('"fore"', '"$(arg tool)"', ["<link> name='$(arg tool)'", "expand"]),
    "link without a name": ('<link name="upper"/>', "<link/>", ["<link> number 2 has no name"]),
    "joint without a name": ('name="elbow" ', "", ["<joint> number 2 has no name"]),
    "link twice": ('name="fore"', 'name="upper"', ["link 'upper' is there twice"]),
    "joint twice": ('name="elbow"', 'name="shoulder"', ["joint 'shoulder' is there twice"]),
    "no type": (' type="revolute"', "", ["joint 'shoulder' has no type", CHOICE_OF_TYPES]),
    "unknown type": ('"revolute"', '"revolut"', ["'shoulder'", "'revolut'", "mean 'revolute'", CHOICE_OF_TYPES]),
    "floating": ('"revolute"', '"floating"', ["joint 'shoulder' is floating", TYPES, "base = 'holonomic'"]),
    "planar": ('"prismatic"', '"planar"', ["joint 'elbow' is planar", TYPES, "base = 'holonomic'"]),
    "no parent": ('<parent link="upper"/>', "", ["joint 'elbow'", "<parent link='...'/>", LINKS]),
    "no child": ('<child link="fore"/>', "", ["joint 'elbow'", "<child link='...'/>", LINKS]),
    "child without link": ('<child link="fore"/>', "<child/>", ["joint 'elbow'", "<child link='...'/>", LINKS]),
    "parent that is not there": (
        '<parent link="upper"',
        '<parent link="uper"',
        ["joint 'elbow'", "<parent>: no link 'uper'", "did you mean 'upper'", LINKS],
    ),
    "child that is not there": (
        '<child link="fore"',
        '<child link="hand"',
        ["joint 'elbow'", "<child>: no link 'hand'", LINKS],
    ),
    "two parents": (
        '<child link="fore"',
        '<child link="upper"',
        ["link 'upper' has two parents", "'shoulder'", "'elbow'"],
    ),
    "its own parent": (
        '<parent link="upper"/>',
        '<parent link="fore"/>',
        ["no root link carries joint 'elbow': a ring", "wanted a tree"],
    ),
    "several roots": ("</robot>", "<link name='table'/></robot>", ["one root link", "base_link, table"]),
    "ring": ("</robot>", RING, ["'shoulder', 'elbow', 'back': a ring", "wanted a tree"]),
    "ring apart": ("</robot>", ISLAND, ["no root link carries joints 'xy', 'yx': a ring", "wanted a tree"]),
    "axis of zeros": ('"0 0 1"', '"0 0 0"', ["joint 'shoulder': <axis> xyz", "wanted a direction"]),
    "axis of two": ('"0 0 1"', '"0 1"', ["joint 'shoulder': <axis> xyz", "3 finite numbers", "'0 1'"]),
    "axis not finite": ('"0 0 1"', '"0 0 nan"', ["joint 'shoulder': <axis> xyz", "finite", "'0 0 nan'"]),
    "origin in words": ('"0 0 0.2"', '"0 0 up"', ["joint 'shoulder': <origin> xyz", "finite", "'0 0 up'"]),
    "origin with commas": ('"0 0 0.2"', '"0, 0, 0.2"', ["joint 'shoulder': <origin> xyz", "'0, 0, 0.2'"]),
    "origin not finite": ('rpy="0 0 0"', 'rpy="0 inf 0"', ["joint 'shoulder': <origin> rpy", "'0 inf 0'"]),
    "origin empty": ('rpy="0 0 0"', 'rpy=""', ["joint 'shoulder': <origin> rpy", "got ''"]),
    "quaternion": ('rpy="0 0 0"', 'quat_xyzw="0 0 0 2"', ["joint 'shoulder'", "quat_xyzw is not read", "rpy"]),
    "no limits": (SHOULDER_LIMIT, "", ["joint 'shoulder' is revolute", "lower and upper", "continuous"]),
    "limit without numbers": (SHOULDER_LIMIT, "<limit/>", ["joint 'shoulder'", "<limit> lower and upper"]),
    "prismatic without limits": ('<limit lower="0" upper="1" ', "<limit ", ["joint 'elbow' is prismatic"]),
    "limits reversed": ('lower="-1"', 'lower="3"', ["joint 'shoulder'", "lower <= upper", "got 3 and 2"]),
    "limit not finite": ('upper="2"', 'upper="inf"', ["joint 'shoulder': <limit> upper", "finite", "'inf'"]),
    "limit in words": ('lower="-1"', 'lower="-pi"', ["joint 'shoulder': <limit> lower", "'-pi'"]),
    "velocity negative": ('"1.5"', '"-1.5"', ["joint 'shoulder': <limit> velocity", "at least 0", "-1.5"]),
    "velocity not finite": ('"1.5"', '"nan"', ["joint 'shoulder': <limit> velocity", "'nan'"]),
    "mimic of nothing": (*mimicking("elbo"), ["'shoulder': <mimic>", "'elbo'", "mean 'elbow'", "choices: elbow"]),
    "mimic without joint": (
        SHOULDER_LIMIT,
        f"{SHOULDER_LIMIT}<mimic/>",
        ["'shoulder': <mimic>: no joint ''", "choices: elbow"],
    ),
    "mimic of itself": (*mimicking("shoulder"), ["mimics itself: shoulder -> shoulder", "choices: elbow"]),
    "mimic multiplier": (
        SHOULDER_LIMIT,
        f'{SHOULDER_LIMIT}<mimic joint="elbow" multiplier="x"/>',
        ["joint 'shoulder': <mimic> multiplier", "'x'"],
    ),
    "mimic of a fixed joint": (
        GOOD.replace('"prismatic"', '"fixed"').replace(*mimicking("elbow")),
        ["'shoulder': <mimic>: 'elbow', which is fixed", "valid choices: (none)"],
    ),
    "mimics in a ring": (
        GOOD.replace(*mimicking("elbow")).replace('velocity="1" effort="7"/>', '/><mimic joint="shoulder"/>'),
        ["mimics itself: ", "shoulder -> elbow -> shoulder"],
    ),
    "name too long": ('name="elbow"', f'name="{"e" * 101}"', ["name", "100 characters"]),
    "name over two lines": ('name="elbow"', 'name="el&#10;bow"', ["joint 'el bow'", "name"]),
}


def complaint(build, **table):
    with pytest.raises(BadInput) as error:
        build(**table)
    line = str(error.value)
    assert line.startswith("spec.toml: robot")
    assert "\n" not in line
    return line


@pytest.mark.parametrize("kind", BROKEN)
def test_broken_urdf_is_one_line_that_names_file_element_and_choices(kind, build, tmp_path):
    *replaced, wanted = BROKEN[kind]
    if len(replaced) == 2:
        old, new = replaced
        assert old in GOOD
        text = GOOD.replace(old, new, 1)
    else:
        (text,) = replaced
    (tmp_path / "bad.urdf").write_text(text)
    line = complaint(build, urdf="bad.urdf")
    for piece in ["bad.urdf", *wanted]:
        assert piece in line


def test_the_file_that_is_broken_above_is_good_when_whole(build, tmp_path):
    (tmp_path / "good.urdf").write_text(GOOD)
    assert [joint.name for joint in build(urdf="good.urdf").robot.coordinates] == ["shoulder", "elbow"]


@pytest.mark.parametrize(("name", "wanted"), [("gone.urdf", "No such file"), (".", "directory")])
def test_file_that_cannot_be_read_is_named(name, wanted, build):
    line = complaint(build, urdf=name)
    assert "cannot be read" in line
    assert wanted in line


JOINT = {"name": "turn", "type": "revolute", "link": "arm", "lower": -1, "upper": 1}
ROW = {"name": "turn", "lower": -1, "upper": 1}
DH = {"convention": "standard", "rows": [ROW]}

TABLES = {
    "no source": ({}, ["exactly one of joints, dh, urdf", "got none"]),
    "two sources": ({"joints": [JOINT], "urdf": "a.urdf"}, ["exactly one of joints, dh, urdf", "joints and urdf"]),
    "misspelt key": ({"joint": [JOINT]}, ["joint", "did you mean 'joints'"]),
    "misspelt base": ({"joints": [JOINT], "base": "holonomc"}, ["base.kind", "'holonomic'", "'holonomc'"]),
    "misspelt key of the base": ({"joints": [JOINT], "base": {"kind": "fixed", "mount": 1}}, ["base", "mount_xyz"]),
    "fixed base that moves": (
        {"joints": [JOINT], "base": {"kind": "fixed", "velocity": 1.0}},
        ["base: a fixed base has no 'velocity'", "kind, mount_rpy, mount_xyz, name"],
    ),
    "base limits of two lengths": (
        {"joints": [JOINT], "base": {"kind": "holonomic", "lower": [0, 0, 0]}},
        ["base", "as many lower as upper limits", "3 and 2"],
    ),
    "base limits reversed": (
        {"joints": [JOINT], "base": {"kind": "holonomic", "lower": [200, 0]}},
        ["base", "lower <= upper", "200"],
    ),
    "base without speed": ({"joints": [JOINT], "base": {"kind": "differential", "velocity": 0.0}}, ["base.velocity"]),
    "base and arm with a link of one name": (
        {"joints": [JOINT | {"link": "base"}], "base": "holonomic"},
        ["base: the arm has a link 'base' too", "base.name"],
    ),
    "base and arm with a joint of one name": (
        {"joints": [JOINT | {"name": "base_x"}], "base": "differential"},
        ["base: the arm has a joint 'base_x' too", "base.name"],
    ),
    "world twice": (
        {"joints": [JOINT | {"link": "world"}], "base": "holonomic"},
        ["base: the arm has a link 'world' too", "root"],
    ),
    "slide twice": (
        {"joints": [JOINT | {"link": "slide_x"}], "base": "holonomic"},
        ["base: the arm has a link 'slide_x' too"],
    ),
    "locked joint that is not there": ({"joints": [JOINT], "lock": {"trn": 0.0}}, ["lock", "'trn'", "mean 'turn'"]),
    "locked out of limits": ({"joints": [JOINT], "lock": {"turn": 2.0}}, ["lock", "'turn'", "-1 to 1 rad", "got 2"]),
    "all locked": ({"joints": [JOINT], "lock": {"turn": 0.0}}, ["no joint moves"]),
    "locked wheel": ({"joints": [JOINT], "base": "differential", "lock": {"base_y": 0.0}}, ["drive", "'base_y'"]),
    "no convention": ({"dh": {"rows": [ROW]}}, ["dh.convention", "required"]),
    "unknown convention": ({"dh": DH | {"convention": "craig"}}, ["dh.convention", "'modified'", "'craig'"]),
    "no rows": ({"dh": DH | {"rows": []}}, ["dh.rows", "at least 1"]),
    "misspelt key of a row": ({"dh": DH | {"rows": [ROW | {"alfa": 1}]}}, ["dh.rows.0", "mean 'alpha'"]),
    "row without limits": ({"dh": DH | {"rows": [{"name": "turn"}]}}, ["dh.rows.0", "'turn'", "lower and upper"]),
    "row with limits reversed": ({"dh": DH | {"rows": [ROW | {"lower": 5}]}}, ["dh.rows.0", "lower <= upper"]),
    "row twice": ({"dh": DH | {"rows": [ROW, ROW]}}, ["joint 'turn' is there twice"]),
    "frame on no link": ({"joints": [JOINT], "frames": [{"name": "tool", "link": "am"}]}, ["'am'", "mean 'arm'"]),
    "leaves the plane": ({"joints": [JOINT | {"axis": [1, 0, 0]}], "space": "planar"}, ["'turn'", "plane"]),
    "mount leaves the plane": (
        {"joints": [JOINT], "space": "planar", "base": {"kind": "holonomic", "mount_xyz": [0, 0, 1]}},
        ["'base_mount'", "plane"],
    ),
    "not finite": ({"joints": [JOINT | {"xyz": [0, 0, float("nan")]}]}, ["joints.0.xyz.2", "finite"]),
}


@pytest.mark.parametrize("kind", TABLES)
def test_mistake_in_the_table_is_one_line_that_names_key_and_choices(kind, tmp_path):
    table, wanted = TABLES[kind]
    with pytest.raises(BadInput) as error:
        RobotTable.parse(table, "spec.toml").build(tmp_path, "spec.toml")
    line = str(error.value)
    assert "\n" not in line
    for piece in ["spec.toml", *wanted]:
        assert piece in line


def test_root_of_a_urdf_is_not_for_the_spec_to_say(build, tmp_path):
    (tmp_path / "good.urdf").write_text(GOOD)
    assert build(urdf="good.urdf", root="base_link").robot.root == "base_link"
    line = complaint(build, urdf="good.urdf", root="world")
    assert "the URDF's root link is 'base_link', got 'world'" in line
