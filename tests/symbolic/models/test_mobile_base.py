"""An arm on a base: one line in the spec, the same as the joints written out by hand."""

import casadi as ca
import numpy as np
import pytest

from clikgen.symbolic.models.snap import random_configurations
from clikgen.symbolic.tree import KinematicTree, rotation_matrix

MOUNT = {"mount_xyz": (0.2, -0.1, 0.4), "mount_rpy": (0.3, -0.2, 1.1)}
ARM = (
    {"name": "shoulder", "type": "revolute", "link": "upper", "axis": (0, 1, 0), "xyz": (0, 0, 0.1)},
    {"name": "elbow", "type": "revolute", "link": "fore", "axis": (0, 0.6, 0.8), "xyz": (0.3, 0, 0)},
)
ARM = tuple(joint | {"lower": -2.0, "upper": 2.0, "velocity": 1.0} for joint in ARM)


@pytest.mark.parametrize("kind", ["holonomic", "differential"])
def test_base_moves_the_arm_as_the_product_by_hand_says(kind, build, poses):
    alone, carried = build(joints=ARM).robot, build(joints=ARM, base={"kind": kind} | MOUNT).robot
    q = random_configurations(carried, 50, seed=1)
    arm_T_links = poses(alone, q[:, 3:])
    world_T_links = poses(carried, q)
    base_R_arm, base_p_arm = rotation_matrix(MOUNT["mount_rpy"]), np.array(MOUNT["mount_xyz"])
    for k, (x, y, yaw) in enumerate(q[:, :3]):
        world_R_base = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        for link in ("upper", "fore"):
            pose = arm_T_links[k, alone.links.index(link)]
            expected_rotation = world_R_base @ base_R_arm @ pose[:, :3]
            expected_position = [x, y, 0] + world_R_base @ (base_p_arm + base_R_arm @ pose[:, 3])
            ours = world_T_links[k, carried.links.index(link)]
            np.testing.assert_allclose(ours[:, :3], expected_rotation, rtol=0, atol=1e-14)
            np.testing.assert_allclose(ours[:, 3], expected_position, rtol=0, atol=1e-14)


def test_base_is_three_joints_and_a_mount(build):
    robot = build(joints=ARM, base="holonomic").robot
    assert robot.links == ("world", "slide_x", "slide_y", "base", "arm_root", "upper", "fore")
    x, y, yaw, mount = robot.joints[:4]
    assert [joint.name for joint in (x, y, yaw, mount)] == ["base_x", "base_y", "base_yaw", "base_mount"]
    assert [joint.type for joint in (x, y, yaw, mount)] == ["prismatic", "prismatic", "continuous", "fixed"]
    assert (x.lower, x.upper, x.velocity, yaw.velocity) == (-100.0, 100.0, 1.0, 1.0)
    assert robot.drive is None


def test_base_says_limits_speeds_name_and_outline(build):
    outline = [[0.3, 0.2, 0], [-0.3, 0.2, 0], [-0.3, -0.2, 0]]
    base = {"kind": "differential", "name": "cart", "lower": [-1, -2, -3], "upper": [4, 5, 6]}
    base |= {"velocity": 0.7, "yaw_velocity": 2.5, "outline": outline}
    robot = build(joints=ARM, base=base, root="floor").robot
    x, y, yaw = robot.coordinates[:3]
    assert robot.links[:5] == ("floor", "slide_x", "slide_y", "cart", "arm_root")
    assert [(joint.lower, joint.upper) for joint in (x, y, yaw)] == [(-1, 4), (-2, 5), (-3, 6)]
    assert [joint.velocity for joint in (x, y, yaw)] == [0.7, 0.7, 2.5]
    assert (yaw.type, yaw.outline) == ("revolute", tuple(map(tuple, outline)))
    drive = robot.drive
    assert (drive.x, drive.y, drive.yaw, drive.velocity) == ("cart_x", "cart_y", "cart_yaw", 0.7)


def test_fixed_base_bolts_the_arm_where_it_says_and_no_base_adds_no_joint(build, poses):
    assert [joint.name for joint in build(joints=ARM).robot.joints] == ["shoulder", "elbow"]
    assert build(joints=ARM, base="fixed") == build(joints=ARM)
    robot = build(joints=ARM, base={"kind": "fixed"} | MOUNT).robot
    assert [joint.name for joint in robot.joints] == ["base_mount", "shoulder", "elbow"]
    place = poses(robot, np.zeros((1, 2)))[0, robot.links.index("arm_root")]
    np.testing.assert_allclose(place[:, 3], MOUNT["mount_xyz"], rtol=0, atol=0)
    np.testing.assert_allclose(place[:, :3], rotation_matrix(MOUNT["mount_rpy"]), rtol=0, atol=1e-15)


def test_joint_of_the_arm_may_stand_in_the_world(build):
    table = {"name": "lift", "type": "prismatic", "link": "table", "parent": "world", "lower": 0, "upper": 1}
    robot = build(joints=(*ARM, table), base="holonomic").robot
    tree = KinematicTree.at(robot, ca.SX.zeros(6))
    assert tree.carriers["table"][0].coordinate == 5
    assert len(tree.carriers["table"]) == 1


def test_frames_and_points_may_sit_on_the_base(build):
    frame = {"name": "corner", "link": "base", "xyz": (0.3, 0.2, 0)}
    point = {"name": "side", "link": "slide_x", "influence_radius": 0.1}
    robot = build(joints=ARM, base="holonomic", frames=[frame], points_of_interest=[point]).robot
    assert robot.frame("corner").link == "base"
    assert robot.points_of_interest[0].link == "slide_x"


def test_differential_drive_moves_the_base_along_its_own_x_axis_only(build):
    robot = build(joints=ARM, base="differential").robot
    for q in random_configurations(robot, 20, seed=2):
        S = np.array(ca.DM(KinematicTree.at(robot, ca.SX(q)).velocity_map()))
        assert S.shape == (5, 4)
        v, w, arm = 0.8, -0.3, [0.5, -0.7]
        rates = S @ [v, w, *arm]
        forward, sideways = np.array([np.cos(q[2]), np.sin(q[2])]), np.array([-np.sin(q[2]), np.cos(q[2])])
        np.testing.assert_allclose(rates[:2] @ forward, v, rtol=0, atol=1e-15)
        np.testing.assert_allclose(rates[:2] @ sideways, 0, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(rates[2:], [w, *arm])


def test_holonomic_base_maps_velocities_to_themselves(build):
    robot = build(joints=ARM, base="holonomic").robot
    S = KinematicTree.at(robot, ca.SX.sym("q", 5)).velocity_map()
    np.testing.assert_array_equal(np.array(ca.DM(S)), np.eye(5))
