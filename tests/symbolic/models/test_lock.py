"""Joints held at a value, with those that mimic them."""

import math

import numpy as np
import pytest

from clikgen.symbolic.models.snap import random_configurations

ARM = (
    {"name": "a", "type": "revolute", "link": "A", "rpy": (0.3, -0.7, 1.1), "axis": (0.6, 0, 0.8)},
    {"name": "b", "type": "prismatic", "link": "B", "rpy": (1.0, 0.5, 0), "axis": (0, 0.6, -0.8)},
    {"name": "c", "type": "continuous", "link": "C", "xyz": (0.2, 0.1, 0), "rpy": (0, math.pi / 2, 0.4)},
    {"name": "d", "type": "prismatic", "link": "D", "mimic": {"joint": "a", "multiplier": 0.5, "offset": 0.1}},
    {"name": "e", "type": "revolute", "link": "E", "mimic": {"joint": "a", "multiplier": -2, "offset": 1}},
    {"name": "f", "type": "revolute", "link": "F", "axis": (0, 1, 0)},
)
ARM = tuple(joint | ({} if joint["type"] == "continuous" else {"lower": -2.0, "upper": 2.0}) for joint in ARM)


@pytest.mark.parametrize(
    "values", [{"a": 0.8}, {"b": -0.3}, {"c": 2.5}, {"a": 0.0}, {"a": -1.2, "b": 0.4, "c": math.pi / 2}, {"f": 0.1}]
)
def test_locked_robot_is_the_robot_with_that_coordinate_held(values, build, poses):
    free, held = build(joints=ARM).robot, build(joints=ARM, lock=values).robot
    names = [joint.name for joint in free.coordinates]
    assert [joint.name for joint in held.coordinates] == [name for name in names if name not in values]
    assert held.links == free.links
    q = random_configurations(free, 50, seed=4)
    for name, value in values.items():
        q[:, names.index(name)] = value
    moving = [i for i, name in enumerate(names) if name not in values]
    # a locked rotation goes through roll, pitch and yaw: some roundings of 1e-16 over 3 m
    np.testing.assert_allclose(poses(held, q[:, moving]), poses(free, q), rtol=0, atol=1e-14)


def test_mimics_of_a_locked_joint_are_locked_with_it(build):
    robot = build(joints=ARM, lock={"a": 0.5}).robot
    assert [joint.type for joint in robot.joints] == ["fixed", "prismatic", "continuous", "fixed", "fixed", "revolute"]
    assert robot.joints[3].xyz == pytest.approx((0, 0, 0.5 * 0.5 + 0.1), abs=1e-16)


def test_joint_locked_at_zero_keeps_its_numbers(build):
    before, after = build(joints=ARM).robot.joints[2], build(joints=ARM, lock={"c": 0.0}).robot.joints[2]
    assert (after.type, after.xyz, after.rpy) == ("fixed", before.xyz, before.rpy)


def test_lock_is_told(build):
    assert build(joints=ARM, lock={"a": 0.5, "c": 1}).notes == ("joint 'a' locked at 0.5", "joint 'c' locked at 1")
