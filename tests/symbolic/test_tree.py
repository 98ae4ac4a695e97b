"""Kinematics and Jacobians against models that share no code with them."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.symbolic.robot import Robot
from clikgen.symbolic.tree import KinematicTree

# A position of size 10 m has a rounding unit of 1.8e-15 m, an angle of 20 rad one of 3.6e-15 rad; each result
# adds some ten such terms.
ROUNDING = 2e-14


@pytest.fixture
def joint_positions():
    """200 positions of planar5, (200, 5)."""
    return np.random.default_rng(1).uniform(-6, 6, (200, 5))


def test_planar5_positions_equal_the_model_by_hand(evaluate_many, planar_model, joint_positions):
    seen = evaluate_many("kinematics", {"q": joint_positions})
    for i, q in enumerate(joint_positions):
        points = [planar_model.position(q, point) for point in planar_model.POINTS]
        np.testing.assert_allclose(seen["point_position"][i], points, rtol=0, atol=ROUNDING)
        tool = planar_model.position(q, planar_model.TOOL)
        np.testing.assert_allclose(seen["tool_position"][i], tool, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(seen["link_pose"][i], planar_model.link_poses(q), rtol=0, atol=ROUNDING)


def test_planar5_jacobians_equal_the_model_by_hand(evaluate_many, planar_model, joint_positions, states_near_contact):
    seen = evaluate_many("jacobians", states_near_contact(200, 0) | {"q": joint_positions})
    for i, q in enumerate(joint_positions):
        points = [planar_model.jacobian(q, point) for point in planar_model.POINTS]
        np.testing.assert_allclose(seen["point_jacobian"][i], points, rtol=0, atol=ROUNDING)
        tool = planar_model.jacobian(q, planar_model.TOOL)
        np.testing.assert_allclose(seen["tool_jacobian"][i], tool, rtol=0, atol=ROUNDING)


def test_planar5_jacobians_equal_central_differences(evaluate_many, joint_positions, states_near_contact):
    seen = evaluate_many("jacobians", states_near_contact(200, 0) | {"q": joint_positions})
    h = 1e-5
    for j in range(5):
        forward = evaluate_many("kinematics", {"q": joint_positions + h * np.eye(5)[j]})
        backward = evaluate_many("kinematics", {"q": joint_positions - h * np.eye(5)[j]})
        for jacobian, position in (("tool_jacobian", "tool_position"), ("point_jacobian", "point_position")):
            difference = (forward[position] - backward[position]) / (2 * h)
            # h²/6 of a third derivative below 1.1 m is 2e-11; rounding of 4e-15 m over 2h is 2e-10
            np.testing.assert_allclose(seen[jacobian][..., j], difference, rtol=0, atol=1e-9)


def test_planar5_geometric_jacobians_equal_casadis_derivatives(planar5_spec, joint_positions):
    robot = planar5_spec.robot
    _expect_jacobians_equal_derivatives(
        robot,
        [(frame.link, frame.xyz) for frame in robot.frames]
        + [(point.link, point.offset) for point in robot.points_of_interest]
        + [(joint.link, (0.3, -0.2, 0.0)) for joint in robot.joints]
        + [(robot.root, (1.0, 2.0, 0.0))],
        joint_positions[:20],
    )


def _expect_jacobians_equal_derivatives(robot, points, joint_positions):
    q = ca.SX.sym("q", len(robot.joints))
    tree = KinematicTree.at(robot, q)
    for link, offset in points:
        geometric = tree.position_jacobian(link, offset)
        derivative = ca.jacobian(tree.position(link, offset), q)
        assert geometric.shape == (robot.dimension, len(robot.joints))
        both = ca.Function("both", [q], [geometric, ca.densify(derivative)])
        for value in joint_positions:
            np.testing.assert_allclose(*map(np.array, both(value)), rtol=0, atol=ROUNDING)


def _random_robot(seed):
    """A spatial chain of both joint types with arbitrary axes, offsets and rotations, as a spec would say it."""
    rng = np.random.default_rng(seed)
    joints = []
    for i in range(rng.integers(3, 8)):
        axis = rng.normal(size=3)
        joints.append(
            {
                "name": f"joint{i}",
                "type": str(rng.choice(["prismatic", "revolute"])),
                "link": f"link{i}",
                "axis": (axis / np.linalg.norm(axis)).tolist(),
                "xyz": rng.uniform(-1, 1, 3).tolist(),
                "rpy": rng.uniform(-np.pi, np.pi, 3).tolist(),
                "lower": -3.0,
                "upper": 3.0,
                "velocity": 1.0,
            }
        )
    return Robot.parse({"joints": joints}, "a random robot")


def _pose_by_scipy(robot, q, count):
    """Rotation and position of the link behind the first `count` joints, from homogeneous transforms."""
    world_T_link = np.eye(4)
    for joint, value in zip(robot.joints[:count], q, strict=False):
        fixed, moving = np.eye(4), np.eye(4)
        fixed[:3, :3] = Rotation.from_euler("xyz", joint.rpy).as_matrix()  # lower case: about fixed axes, as URDF
        fixed[:3, 3] = joint.xyz
        if joint.type == "revolute":
            moving[:3, :3] = Rotation.from_rotvec(value * np.array(joint.axis)).as_matrix()
        else:
            moving[:3, 3] = value * np.array(joint.axis)
        world_T_link = world_T_link @ fixed @ moving
    return world_T_link


@pytest.mark.parametrize("seed", range(8))
def test_spatial_chain_poses_equal_scipys_rotations(seed):
    robot = _random_robot(seed)
    n = len(robot.joints)
    q = ca.SX.sym("q", n)
    tree = KinematicTree.at(robot, q)
    offset = (0.3, -0.7, 0.2)
    for count, link in enumerate([robot.root, *(joint.link for joint in robot.joints)]):
        pose = tree.poses[link]
        both = ca.Function("both", [q], [pose.rotation, pose.position, tree.position(link, offset)])
        for value in np.random.default_rng(seed).uniform(-3, 3, (10, n)):
            rotation, position, point = (np.array(ca.densify(part)) for part in both(value))
            expected = _pose_by_scipy(robot, value, count)
            np.testing.assert_allclose(rotation, expected[:3, :3], rtol=0, atol=ROUNDING)
            np.testing.assert_allclose(position[:, 0], expected[:3, 3], rtol=0, atol=ROUNDING)
            np.testing.assert_allclose(point[:, 0], (expected @ [*offset, 1])[:3], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("seed", range(8))
def test_spatial_chain_jacobians_equal_derivatives_and_differences(seed):
    robot = _random_robot(seed)
    n = len(robot.joints)
    offset = (0.3, -0.7, 0.2)
    links = [robot.root, *(joint.link for joint in robot.joints)]
    joint_positions = np.random.default_rng(seed).uniform(-3, 3, (5, n))
    _expect_jacobians_equal_derivatives(robot, [(link, offset) for link in links], joint_positions)
    q = ca.SX.sym("q", n)
    tree = KinematicTree.at(robot, q)
    h = 1e-5
    for count, link in enumerate(links):
        jacobian = ca.Function("jacobian", [q], [ca.densify(tree.position_jacobian(link, offset))])
        for value in joint_positions:
            ends = [
                [_pose_by_scipy(robot, value + sign * h * np.eye(n)[j], count) @ [*offset, 1] for j in range(n)]
                for sign in (1, -1)
            ]
            difference = (np.subtract(*ends) / (2 * h))[:, :3].T
            # h²/6 of a third derivative below 20 m is 4e-10; rounding of 1e-14 m over 2h is 5e-10
            np.testing.assert_allclose(np.array(jacobian(value)), difference, rtol=0, atol=2e-9)


def test_joint_behind_a_point_has_a_column_of_exact_zeros(planar5_spec):
    q = ca.SX.sym("q", 5)
    jacobian = KinematicTree.at(planar5_spec.robot, q).position_jacobian("base", (0.15, 0.15, 0.0))
    assert not ca.depends_on(jacobian, q[3:])
    assert jacobian[:, 3:].is_zero()
    assert not jacobian[:, 2].is_zero()


def test_right_angles_in_rpy_give_exact_zeros_and_ones():
    joint = {
        "name": "a",
        "type": "prismatic",
        "link": "b",
        "axis": [0, 0, 1],
        "lower": 0,
        "upper": 1,
        "velocity": 1,
    }
    robot = Robot.parse({"joints": [joint | {"rpy": [np.pi / 2, -np.pi / 2, np.pi]}]}, "a robot")
    rotation = np.array(ca.DM(KinematicTree.at(robot, ca.SX.sym("q", 1)).poses["b"].rotation))
    # By hand: x, y and z of the frame are mapped to +z, −x and −y.
    expected = Rotation.from_euler("xyz", [90, -90, 180], degrees=True).as_matrix()
    np.testing.assert_array_equal(rotation, np.round(expected))
    assert np.linalg.det(rotation) == 1


def test_a_revolute_joint_costs_one_sine_and_one_cosine(planar5_casadi):
    operations = planar5_casadi.function("step")
    codes = [operations.instruction_id(k) for k in range(operations.n_instructions())]
    assert codes.count(ca.OP_SIN) == codes.count(ca.OP_COS) == 3
