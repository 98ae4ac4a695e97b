"""Forward kinematics (eq. 1) and geometric Jacobians (eq. 2) of a tree of joints, as CasADi expressions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.distances import in_space
from clikgen.symbolic.robot import Frame, Joint, Robot, Vector
from clikgen.symbolic.rotations import cross_matrix

Array = NDArray[np.float64]
ORIGIN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """world_T_link: rotation (3, 3) and position (3, 1) [m]."""

    rotation: ca.SX
    position: ca.SX

    def moved(self, rotation: ca.SX, translation: ca.SX) -> "Pose":
        """The pose after a further `translation` (3, 1) [m] and `rotation` (3, 3), both in this frame."""
        return Pose(self.rotation @ rotation, self.position + self.rotation @ translation)


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """A moving joint in the world: its axis (3, 1) through `origin` (3, 1) [m], moved by `ratio` · q[coordinate]."""

    prismatic: bool
    direction: ca.SX
    origin: ca.SX
    coordinate: int
    ratio: float


@dataclass(frozen=True, slots=True, eq=False)
class Wrench:
    """A force (2 or 3, 1) on a link and its moment about the world's origin, (1 or 3, 1), both in the world."""

    link: str
    force: ca.SX
    moment: ca.SX

    @classmethod
    def at(cls, link: str, point: ca.SX, force: ca.SX) -> Self:
        """Of a force (2 or 3, 1) at a point (2 or 3, 1) [m] of the world."""
        moment = ca.cross(in_space(point), in_space(force))
        return cls(link, force, moment if force.numel() == 3 else moment[2])


@dataclass(frozen=True, slots=True, eq=False)
class KinematicTree:
    """The robot at joint position q (n, 1): the pose of every link and the axes that carry it."""

    robot: Robot
    q: ca.SX  # (n, 1)
    poses: dict[str, Pose]
    carriers: dict[str, tuple[Axis, ...]]  # link -> the moving joints between the root and it

    @classmethod
    def at(cls, robot: Robot, q: ca.SX) -> Self:
        """Walk the tree once from its root, with one sine and cosine per turning joint."""
        poses = {robot.root: Pose(ca.SX.eye(3), ca.SX.zeros(3))}
        carriers: dict[str, tuple[Axis, ...]] = {robot.root: ()}
        for joint in robot.joints:
            parent = robot.parent(joint)
            pose = poses[parent].moved(ca.SX(rotation_matrix(joint.rpy)), ca.SX(joint.xyz))
            carriers[joint.link] = carriers[parent]
            if joint.type != "fixed":
                axis, position = _axis(robot, joint, pose), _position(robot, joint, q)
                carriers[joint.link] += (axis,)
                if axis.prismatic:
                    pose = pose.moved(ca.SX.eye(3), ca.SX(joint.axis) * position)
                else:
                    pose = pose.moved(_rotation_about(joint.axis, position), ca.SX.zeros(3))
            poses[joint.link] = pose
        return cls(robot, q, poses, carriers)

    @classmethod
    def of(cls, robot: Robot) -> Self:
        """The robot at a new symbol q."""
        return cls.at(robot, ca.SX.sym("q", len(robot.coordinates)))

    def position(self, link: str, offset: Vector = ORIGIN) -> ca.SX:
        """f(q), eq. 1: where a point fixed to `link` at `offset` [m] is, shape (2 or 3, 1) [m]."""
        return self._point(link, offset)[: self.robot.dimension]

    def rotation(self, link: str, rpy: Vector = ORIGIN) -> ca.SX:
        """world_R_frame of a frame fixed to `link`, turned by `rpy` [rad] against it, shape (3, 3)."""
        return self.poses[link].rotation @ ca.SX(rotation_matrix(rpy))

    def position_jacobian(self, link: str, offset: Vector = ORIGIN) -> ca.SX:
        """J(q) = ∂f/∂q, eq. 2, of that point: shape (2 or 3, n).

        The geometric Jacobian: column i is a_i for a prismatic joint and a_i × (p − p_i) for a turning one with
        axis a_i through p_i; zero for a joint that does not carry the link. A mimic adds its ratio times its
        column to the column of the joint it follows.
        """
        return self.jacobian_at(self._point(link, offset), self.carriers[link])

    def jacobian_at(self, point: ca.SX, carriers: Sequence[Axis]) -> ca.SX:
        """∂(point)/∂q, shape (2 or 3, n), of a `point` of the world (2 or 3, 1) [m] that the `carriers` move."""
        columns = [
            (axis, axis.direction if axis.prismatic else ca.cross(axis.direction, in_space(point) - axis.origin))
            for axis in carriers
        ]
        return self._jacobian(columns)[: self.robot.dimension, :]

    def angular_jacobian(self, link: str) -> ca.SX:
        """ω = J_ω q̇, the link's angular velocity in the world: column i is a_i for a turning joint, (3, n)."""
        return self._jacobian([(axis, axis.direction) for axis in self.carriers[link] if not axis.prismatic])

    def seen_from(self, frame: Frame, point: ca.SX, jacobian: ca.SX) -> tuple[ca.SX, ca.SX]:
        """A point p (2 or 3, 1) [m] of the world, ṗ = J q̇, in the axes of `frame`: r = Rᵀ(p − p_f) and ∂r/∂q (., n).

        ∂r/∂q = Rᵀ(J − J_f + [p − p_f]× J_ω). Raises BadInput when the axes of a planar robot's frame leave the plane.
        """
        if self.robot.space == "planar" and frame.rpy[:2] != (0, 0):
            raise BadInput(f"frame '{frame.name}' of a planar robot: wanted no roll or pitch, got {list(frame.rpy)}")
        d = self.robot.dimension
        rotation = self.rotation(frame.link, frame.rpy)[:d, :d]
        away = point - self.position(frame.link, frame.xyz)
        turning = cross_matrix(away) @ self.angular_jacobian(frame.link)
        return rotation.T @ away, rotation.T @ (jacobian - self.position_jacobian(frame.link, frame.xyz) + turning)

    def pullback(self, wrenches: Sequence["Wrench"]) -> ca.SX:
        """Σ fᵀ J_p over all forces f at points p, the joint forces that wrenches amount to: shape (1, n).

        The wrenches are summed from the tips to the root, so that the cost is that of the points plus that of the
        joints, not their product.
        """
        force = {link: ca.SX.zeros(3) for link in self.robot.links}
        moment = {link: ca.SX.zeros(3) for link in self.robot.links}
        for wrench in wrenches:
            m = wrench.moment
            force[wrench.link] += in_space(wrench.force)
            moment[wrench.link] += m if m.numel() == 3 else ca.vertcat(0, 0, m)
        row = ca.SX.zeros(1, self.q.numel())
        for joint in reversed(self.robot.joints):
            F, M, parent = force[joint.link], moment[joint.link], self.robot.parent(joint)
            force[parent] += F
            moment[parent] += M
            if joint.type != "fixed":
                axis = self.carriers[joint.link][-1]
                turning = M - ca.cross(axis.origin, F)
                row[axis.coordinate] += axis.ratio * ca.dot(axis.direction, F if axis.prismatic else turning)
        return row

    def velocity_map(self) -> ca.SX:
        """S(q) with q̇ = S u: the identity (n, n), or (n, n − 1) with the input (v, ω) of a differential drive."""
        n, drive = self.q.numel(), self.robot.drive
        if drive is None:
            return ca.SX.eye(n)
        x, y, yaw = (self.robot.coordinate(name) for name in (drive.x, drive.y, drive.yaw))
        S = ca.SX.eye(n)
        S[x, x], S[y, x] = ca.cos(self.q[yaw]), ca.sin(self.q[yaw])
        return ca.sparsify(ca.horzcat(*(S[:, i] for i in range(n) if i != y)))

    def _point(self, link: str, offset: Vector) -> ca.SX:
        pose = self.poses[link]
        return pose.position + pose.rotation @ ca.SX(offset)

    def _jacobian(self, columns: list[tuple[Axis, ca.SX]]) -> ca.SX:
        """The columns (3, 1) of the moving joints, each added to that of its coordinate, shape (3, n)."""
        jacobian = [ca.SX.zeros(3) for _ in range(self.q.numel())]
        for axis, column in columns:
            jacobian[axis.coordinate] += axis.ratio * column
        return ca.horzcat(*jacobian)


def numeric_poses(robot: Robot, q: Sequence[float]) -> dict[str, Array]:
    """[R | p] of world_T_link (3, 4) of every link at joint positions q (n,) [m, rad]."""
    tree = KinematicTree.at(robot, ca.SX(ca.DM(list(q))))
    return {link: np.array(ca.DM(ca.horzcat(pose.rotation, pose.position))) for link, pose in tree.poses.items()}


def _axis(robot: Robot, joint: Joint, pose: Pose) -> Axis:
    """The axis of a moving joint whose frame is at `pose`."""
    return Axis(
        prismatic=joint.type == "prismatic",
        direction=pose.rotation @ ca.SX(joint.axis),
        origin=pose.position,
        coordinate=robot.coordinate(joint.mimic.joint if joint.mimic else joint.name),
        ratio=joint.mimic.multiplier if joint.mimic else 1.0,
    )


def _position(robot: Robot, joint: Joint, q: ca.SX) -> ca.SX:
    """The joint's position [m, rad]: its coordinate, or what it makes of the one it mimics."""
    if joint.mimic is None:
        return q[robot.coordinate(joint.name)]
    return joint.mimic.multiplier * q[robot.coordinate(joint.mimic.joint)] + joint.mimic.offset


def rotation_matrix(rpy: Vector) -> Array:
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
