"""Joints held at a value: gripper fingers, a torso that stays where it is."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.documents import BadInput, choices
from clikgen.symbolic.robot import Joint, Robot, Vector
from clikgen.symbolic.tree import rotation_matrix

Array = NDArray[np.float64]


def locked(robot: Robot, values: Mapping[str, float]) -> tuple[Joint, ...]:
    """The joints of `robot` with those named in `values` [m, rad], and all that mimic them, fixed there.

    Raises BadInput when a name is no joint with a coordinate of its own, or a value is outside its limits.
    """
    names = [joint.name for joint in robot.coordinates]
    for name, value in values.items():
        if name not in names:
            raise BadInput(f"lock: no joint '{name}' that moves by itself; {choices(name, names)}")
        _check_limits(robot.coordinates[names.index(name)], value)
    return tuple(_held(joint, values) for joint in robot.joints)


def _check_limits(joint: Joint, value: float) -> None:
    if joint.lower is not None and joint.upper is not None and not joint.lower <= value <= joint.upper:
        limits = f"{joint.lower:g} to {joint.upper:g} {joint.unit}"
        raise BadInput(f"lock: joint '{joint.name}': wanted a value in {limits}, got {value:g}")


def _held(joint: Joint, values: Mapping[str, float]) -> Joint:
    """The joint, fixed where `values` puts it if they do."""
    leader = joint.mimic.joint if joint.mimic else joint.name
    if joint.type == "fixed" or leader not in values:
        return joint
    value = values[leader]
    if joint.mimic:
        value = joint.mimic.multiplier * value + joint.mimic.offset
    xyz, rpy = _origin(joint, value)
    return Joint(
        name=joint.name,
        type="fixed",
        link=joint.link,
        parent=joint.parent,
        xyz=xyz,
        rpy=rpy,
        outline=joint.outline,
    )


def _origin(joint: Joint, value: float) -> tuple[Vector, Vector]:
    """Where the link is when the joint is at `value`: xyz [m] and rpy [rad]."""
    if value == 0:
        return joint.xyz, joint.rpy
    rotation, axis = rotation_matrix(joint.rpy), np.array(joint.axis)
    if joint.type == "prismatic":
        x, y, z = (joint.xyz + rotation @ axis * value).tolist()
        return (x, y, z), joint.rpy
    return joint.xyz, _angles(rotation @ _turn(axis, value))


def _turn(axis: Array, angle: float) -> Array:
    """Rodrigues: the rotation by `angle` about a unit vector."""
    along = np.outer(axis, axis)
    turned: Array = along + math.cos(angle) * (np.eye(3) - along) + math.sin(angle) * np.cross(np.eye(3), axis)
    return turned


def _angles(rotation: Array) -> Vector:
    """Roll, pitch and yaw of a rotation matrix, to rounding even where the pitch is a right angle.

    The yaw is any that fits; the roll is what it leaves of the rotation, so that an arbitrary yaw costs nothing.
    """
    R = rotation
    yaw = math.atan2(R[1, 0], R[0, 0])
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    c, s = math.cos(yaw), math.sin(yaw)
    roll = math.atan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1])
    return roll, pitch, yaw
