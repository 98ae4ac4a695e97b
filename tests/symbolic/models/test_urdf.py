"""What a URDF says, and how we say it."""

import logging
import subprocess
import sys

import numpy as np
import pytest

from clikgen.symbolic.models.snap import random_configurations
from clikgen.symbolic.models.urdf import read_urdf

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="Base-Link"/><link name="upper"/><link name="tool"/><link name="slider"/><link name="finger"/>
  <joint name="to-tool" type="fixed"><parent link="upper"/><child link="tool"/><origin xyz="0 0 0.3"/></joint>
  <joint name="Shoulder" type="revolute">
    <parent link="Base-Link"/><child link="upper"/><origin xyz="0.1 0 0.2" rpy="1.5708 0 -0.1"/>
    <axis xyz="0 3 4"/><limit lower="-1" upper="2" velocity="1.5" effort="7"/>
  </joint>
  <joint name="rail" type="prismatic">
    <parent link="upper"/><child link="slider"/><limit upper="0.5" velocity="0" effort="0"/>
  </joint>
  <joint name="spin" type="continuous">
    <parent link="slider"/><child link="finger"/><limit velocity="2" effort="0" lower="-1" upper="1"/>
  </joint>
</robot>
"""


@pytest.fixture
def read(tmp_path):
    def read(text):
        path = tmp_path / "robot.urdf"
        path.write_text(text)
        return read_urdf(path)

    return read


def test_names_stay_and_joints_come_depth_first_in_the_files_order(read):
    model = read(ARM)
    assert model.root == "Base-Link"
    assert [joint.name for joint in model.joints] == ["Shoulder", "to-tool", "rail", "spin"]
    assert [joint.parent for joint in model.joints] == ["Base-Link", "upper", "upper", "slider"]


def test_numbers_stay_as_the_file_has_them_and_the_axis_is_a_unit_vector(read):
    shoulder, tool, rail, spin = read(ARM).joints
    assert shoulder.rpy == (1.5708, 0.0, -0.1)
    assert shoulder.xyz == (0.1, 0.0, 0.2)
    assert shoulder.axis == (0.0, 0.6, 0.8)
    assert (shoulder.lower, shoulder.upper, shoulder.velocity) == (-1.0, 2.0, 1.5)
    assert tool.xyz == (0.0, 0.0, 0.3)
    assert rail.axis == (1.0, 0.0, 0.0)  # the format's default
    assert (rail.lower, rail.upper) == (0.0, 0.5)  # one limit that is absent is 0
    assert (spin.type, spin.lower, spin.upper, spin.velocity) == ("continuous", None, None, 2.0)


def test_velocity_limit_of_zero_is_none_and_a_note_says_so(read):
    model = read(ARM)
    assert model.joints[2].velocity is None
    assert model.notes == ("velocity limit 0 of joint 'rail' read as none",)
    assert read(ARM.replace('velocity="0" ', "")).notes == ()


MIMICS = """<robot name="hand">
  <link name="palm"/><link name="a"/><link name="b"/><link name="c"/>
  <joint name="third" type="prismatic"><parent link="palm"/><child link="c"/>
    <limit lower="0" upper="1" velocity="1"/><mimic joint="second" multiplier="0.5" offset="0.1"/></joint>
  <joint name="second" type="revolute"><parent link="palm"/><child link="b"/>
    <limit lower="0" upper="1" velocity="1"/><mimic joint="first" multiplier="-3" offset="2"/></joint>
  <joint name="first" type="revolute"><parent link="palm"/><child link="a"/>
    <limit lower="0" upper="1" velocity="1"/></joint>
</robot>"""


def test_mimic_of_a_mimic_follows_the_joint_that_moves_by_itself(read):
    third, second, first = read(MIMICS).joints
    assert first.mimic is None
    assert (second.mimic.joint, second.mimic.multiplier, second.mimic.offset) == ("first", -3.0, 2.0)
    # 0.5 (−3 q + 2) + 0.1
    assert (third.mimic.joint, third.mimic.multiplier, third.mimic.offset) == ("first", -1.5, 1.1)


def test_mimic_that_is_fixed_is_just_fixed(read):
    fixed = MIMICS.replace('name="third" type="prismatic"', 'name="third" type="fixed"')
    assert read(fixed).joints[0].mimic is None


def test_prefixes_that_are_declared_nowhere_are_no_obstacle(read):
    foreign = ARM.replace("<limit ", '<limit drake:acceleration="2" ').replace("</robot>", "<gz:x y='1'/></robot>")
    assert read(foreign) == read(ARM)


def test_what_does_not_move_the_robot_is_not_looked_at(read):
    link = '<link name="tool"><inertial><mass/></inertial><visual><geometry><box size="?"/></geometry></visual></link>'
    assert read(ARM.replace('<link name="tool"/>', link)) == read(ARM)


def mesh(name):
    return f'<link name="tool"><visual><geometry><mesh filename="{name}"/></geometry></visual></link>'


@pytest.mark.parametrize("name", ["package://a/b.stl", "model://b.dae", "here.stl"])
def test_mesh_that_is_there_or_somewhere_in_a_package_is_no_matter(name, read, tmp_path):
    (tmp_path / "here.stl").touch()
    assert read(ARM.replace('<link name="tool"/>', mesh(name))).notes == read(ARM).notes


@pytest.mark.parametrize("name", ["gone.stl", "/nowhere/gone.stl", "file:///nowhere/gone.stl"])
def test_mesh_that_is_not_there_is_a_note_not_an_error(name, read):
    (note,) = set(read(ARM.replace('<link name="tool"/>', mesh(name))).notes) - set(read(ARM).notes)
    path = name.removeprefix("file://")
    assert note == f"mesh '{path}' of link 'tool' not found: not needed for the controller, drawn without"


def test_reading_says_nothing_on_its_own(read, capfd, caplog):
    with caplog.at_level(logging.DEBUG):
        read(ARM.replace("<limit ", '<limit drake:acceleration="2" ').replace('<link name="tool"/>', mesh("gone.stl")))
    assert capfd.readouterr() == ("", "")
    assert caplog.records == []


def test_a_robot_without_urdf_does_not_wait_for_the_urdf_reader():
    code = "import sys, clikgen.symbolic.models.table; sys.exit('yourdfpy' in sys.modules or 'lxml' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_jacobians_are_the_differences_of_poses_mimics_among_them(build, tmp_path, poses, jacobians):
    for text in (ARM, MIMICS):
        (tmp_path / "robot.urdf").write_text(text)
        robot = build(urdf="robot.urdf", base="holonomic").robot
        q = random_configurations(robot, 5, seed=3)
        n, h = q.shape[1], 1e-5
        for i, columns in enumerate(np.moveaxis(jacobians(robot, q), -1, 0)):
            step = h * np.eye(n)[i]
            change = (poses(robot, q + step) - poses(robot, q - step)) / (2 * h)
            spin = change[..., :3] @ np.swapaxes(poses(robot, q)[..., :3], -1, -2)  # [ω]×
            omega = np.stack([spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]], axis=-1)
            # h²/6 of a third derivative below 30 is 5e-10; rounding of 1e-15 · 10 m over 2h is 5e-10
            np.testing.assert_allclose(columns, np.concatenate([change[..., 3], omega], axis=-1), rtol=0, atol=2e-9)
