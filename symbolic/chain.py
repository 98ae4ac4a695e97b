"""Forward kinematics (eq. 1) and geometric Jacobians (eq. 2) of a serial chain, as CasADi expressions."""

from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from clikgen.symbolic.robot import Robot, Vector

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """world_T_link: rotation (3, 3) and position (3, 1) [m]."""

    rotation: ca.SX
    position: ca.SX

    def moved(self, rotation: ca.SX, translation: ca.SX) -> "Pose":
        """The pose after a further `translation` (3, 1) [m] and `rotation` (3, 3), both in this frame."""
        return Pose(self.rotation @ rotation, self.position + self.rotation @ translation)


@dataclass(frozen=True, slots=True, eq=False)
class SerialChain:
    """The robot at joint position q (n, 1): the pose of every link and the world axis of every joint."""

    robot: Robot
    q: ca.SX  # (n, 1)
    poses: dict[str, Pose]
    axes: tuple[ca.SX, ...]  # n of (3, 1), unit vectors in the world
    origins: tuple[ca.SX, ...]  # n of (3, 1) [m], a point on each axis

    @classmethod
    def at(cls, robot: Robot, q: ca.SX) -> Self:
        """Walk the chain once from its root, with one sine and cosine per revolute joint."""
        pose = Pose(ca.SX.eye(3), ca.SX.zeros(3))
        poses = {robot.root: pose}
        axes, origins = [], []
        for i, joint in enumerate(robot.joints):
            pose = pose.moved(ca.SX(_rotation_matrix(joint.rpy)), ca.SX(joint.xyz))
            axes.append(pose.rotation @ ca.SX(joint.axis))
            origins.append(pose.position)
            if joint.type == "prismatic":
                pose = pose.moved(ca.SX.eye(3), ca.SX(joint.axis) * q[i])
            else:
                pose = pose.moved(_rotation_about(joint.axis, q[i]), ca.SX.zeros(3))
            poses[joint.link] = pose
        return cls(robot, q, poses, tuple(axes), tuple(origins))

    def position(self, link: str, offset: Vector) -> ca.SX:
        """f(q), eq. 1: where a point fixed to `link` at `offset` [m] is, shape (2 or 3, 1) [m]."""
        pose = self.poses[link]
        return (pose.position + pose.rotation @ ca.SX(offset))[: self.robot.dimension]

    def position_jacobian(self, link: str, offset: Vector) -> ca.SX:
        """J(q) = ∂f/∂q, eq. 2, of that point: shape (2 or 3, n).

        The geometric Jacobian: column i is a_i for a prismatic joint and a_i × (p − p_i) for a revolute one
        with axis a_i through p_i; zero for a joint that does not carry the link.
        """
        pose = self.poses[link]
        point = pose.position + pose.rotation @ ca.SX(offset)
        carrying = list(self.poses).index(link)  # joints 0 .. carrying-1 lie between the root and the link
        columns = [
            axis if joint.type == "prismatic" else ca.cross(axis, point - origin)
            for joint, axis, origin in zip(self.robot.joints, self.axes, self.origins, strict=True)
        ]
        columns[carrying:] = [ca.SX.zeros(3)] * (len(columns) - carrying)
        return ca.horzcat(*columns)[: self.robot.dimension, :]


def _rotation_matrix(rpy: Vector) -> Array:
    """R_z(yaw) R_y(pitch) R_x(roll), entries that are rounding noise of a right angle set to 0, ±1."""
    x, y, z = np.eye(3)
    matrix = np.eye(3)
    for axis, angle in zip((z, y, x), reversed(rpy), strict=True):
        along, cross = _axis_matrices(axis)
        matrix = matrix @ (along + np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * cross)
    rounded: Array = np.round(matrix)
    return np.where(np.abs(matrix - rounded) < 1e-15, rounded, matrix)


def _rotation_about(axis: Vector, angle: ca.SX) -> ca.SX:
    """Rodrigues: R = a aᵀ + cos(angle) (I − a aᵀ) + sin(angle) [a]×, shape (3, 3)."""
    along, cross = _axis_matrices(np.asarray(axis))
    return ca.SX(along) + ca.cos(angle) * ca.SX(np.eye(3) - along) + ca.sin(angle) * ca.SX(cross)


def _axis_matrices(a: Array) -> tuple[Array, Array]:
    """A aᵀ and [a]× of a unit vector a (3,), with [a]× v = a × v."""
    return np.outer(a, a), np.cross(np.eye(3), a)
