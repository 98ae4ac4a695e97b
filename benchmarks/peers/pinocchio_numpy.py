"""The laws of planar5 and of arm7 with Pinocchio and numpy: as the formulas stand, and written to be fast.

Fast: data and arrays are made once, what is constant is worked out beforehand, numpy works on all points and obstacles
at once, Jacobians are asked for in contact only, and systems are solved by LAPACK without a check on the way.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from peers.work import HOME, INFLUENCE, RADII, Robot

Array = NDArray[np.float64]
WORLD = pin.LOCAL_WORLD_ALIGNED


def beta(period: float, cutoff: float) -> float:
    """Eq. 15."""
    x = 2 * math.pi * period * cutoff
    return x / (1 + x)


class Planar5:
    """The paper's law: avoidance above tracking, Euler step, filter while in contact."""

    period, gain, damping, tool_gain, tool_damping = 0.01, 250.0, 1e-9, 4.0, 1e-3
    beta = beta(0.01, 4.0)

    def __init__(self, robot: Robot) -> None:
        self.model = pin.buildModelFromUrdf(str(robot.urdf))
        self.data = self.model.createData()
        self.frames = [self.model.getFrameId(f"point_{i + 1}") for i in range(6)]
        self.translations = [self.data.oMf[frame].translation for frame in self.frames]  # views
        self.places = np.zeros((6, 2))
        self.damped = self.tool_damping**2 * np.eye(2)
        self.every = np.arange(6)

    def step(self, q: Array, reference: Array, reference_velocity: Array, centers: Array) -> Array:
        """The next q (5,); what else there is to know stays here."""
        model, data, places = self.model, self.data, self.places
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for row, place in zip(places, self.translations, strict=True):
            row[:] = place[:2]
        self.position = places[5]
        J_g = pin.getFrameJacobian(model, data, self.frames[5], WORLD)[:2]
        self.error = reference - self.position
        wanted = reference_velocity + self.tool_gain * self.error
        dq = J_g.T @ dposv(J_g @ J_g.T + self.damped, wanted)[1]

        toward = centers - places[:, None]  # (points, obstacles, 2)
        length = np.sqrt(np.einsum("ijk,ijk->ij", toward, toward))
        distances = length - RADII
        nearest = distances.argmin(axis=1)
        self.distance = distances[self.every, nearest]
        depth = INFLUENCE - self.distance
        self.clearance = -depth.max()
        self.active = self.clearance <= 0
        self.potential, share = 0.0, 1.0
        if self.active:
            J_o = np.zeros(5)
            for i in np.flatnonzero(depth > 0):
                k = nearest[i]
                J_r = pin.getFrameJacobian(model, data, self.frames[i], WORLD)[:2]
                J_o += (depth[i] / length[i, k]) * (toward[i, k] @ J_r)
                self.potential += 0.5 * depth[i] ** 2
            dq -= J_o * ((self.gain * self.potential + J_o @ dq) / (J_o @ J_o + self.damping**2))
            share = self.beta
        self.dq_law, self.dq = dq, share * dq
        return q + self.period * self.dq

    def results(self) -> Array:
        """Of the last step, in the order of ours.c, after q_next."""
        scalars = [self.potential], self.position, self.error, [self.active, self.active]
        return np.concatenate([self.dq, self.dq_law, *scalars, self.distance, [self.clearance]])


class PlainPlanar5(Planar5):
    """The same as the formulas stand: pseudo-inverses, projectors, a loop over the points."""

    def step(self, q: Array, reference: Array, reference_velocity: Array, centers: Array) -> Array:
        """The next q (5,); what else there is to know stays here."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, q)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        self.position = data.oMf[self.frames[5]].translation[:2]
        J_g = pin.getFrameJacobian(model, data, self.frames[5], WORLD)[:2]
        self.error = reference - self.position
        dq_g = damped_inverse(J_g, self.tool_damping) @ (reference_velocity + self.tool_gain * self.error)

        self.distance, self.potential, J_o = np.zeros(6), 0.0, np.zeros((1, 5))
        for i, frame in enumerate(self.frames):
            toward = centers - data.oMf[frame].translation[:2]
            distances = np.linalg.norm(toward, axis=1) - RADII
            k = int(np.argmin(distances))
            self.distance[i] = distances[k]
            depth = INFLUENCE[i] - distances[k]
            if depth > 0:
                normal = toward[k] / np.linalg.norm(toward[k])
                J_o += depth * normal @ pin.getFrameJacobian(model, data, frame, WORLD)[:2]
                self.potential += 0.5 * depth**2
        self.clearance = float(np.min(self.distance - INFLUENCE))
        self.active = self.clearance <= 0
        inverse = damped_inverse(J_o, self.damping)
        projector = np.eye(5) - inverse @ J_o
        self.dq_law = inverse @ np.array([-self.gain * self.potential]) + projector @ dq_g
        self.dq = (self.beta if self.active else 1.0) * self.dq_law
        return q + self.period * self.dq


def damped_inverse(J: Array, damping: float) -> Array:
    """Jᵀ (J Jᵀ + damping² I)⁻¹."""
    return J.T @ np.linalg.inv(J @ J.T + damping**2 * np.eye(len(J)))


class Arm7:
    """The pose of the hand above a posture, Euler step."""

    period, hand_gain, hand_damping = 0.002, 20.0, 1e-2
    posture_gain = 1.0 / (1 + 1e-2**2)  # its own damping taken in

    def __init__(self, robot: Robot) -> None:
        self.model = pin.buildModelFromUrdf(str(robot.urdf))
        self.data = self.model.createData()
        self.frame = self.model.getFrameId(robot.tool)
        self.pose = self.data.oMf[self.frame]  # a view, as are these
        self.position, self.rotation = self.pose.translation, self.pose.rotation
        self.damped = self.hand_damping**2 * np.eye(6)
        self.wanted = np.zeros(6)

    def step(self, q: Array, reference: Array, velocity: Array, orientation: Array, angular_velocity: Array) -> Array:
        """The next q (7,); what else there is to know stays here."""
        model, data, wanted = self.model, self.data, self.wanted
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacement(model, data, self.frame)
        J = pin.getFrameJacobian(model, data, self.frame, WORLD)
        w, x, y, z = orientation
        turned = pin.Quaternion(w, x, y, z)
        turned.normalize()
        self.error = reference - self.position
        self.turn = pin.log3(turned.matrix() @ self.rotation.T)
        wanted[:3] = velocity + self.hand_gain * self.error
        wanted[3:] = angular_velocity + self.hand_gain * self.turn
        dq = self.posture_gain * (HOME - q)
        dq += J.T @ dposv(J @ J.T + self.damped, wanted - J @ dq)[1]
        self.dq_law = self.dq = dq
        return q + self.period * self.dq

    def results(self) -> Array:
        """Of the last step, in the order of ours.c, after q_next."""
        x, y, z, w = pin.Quaternion(self.rotation).coeffs()
        quaternion = np.array([w, x, y, z]) * (-1 if w < 0 else 1)
        return np.concatenate([self.dq, self.dq_law, self.position, quaternion, self.error, self.turn])


class PlainArm7(Arm7):
    """The same as the formulas stand."""

    def step(self, q: Array, reference: Array, velocity: Array, orientation: Array, angular_velocity: Array) -> Array:
        """The next q (7,); what else there is to know stays here."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, q)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacements(model, data)
        pose = data.oMf[self.frame]
        J = pin.getFrameJacobian(model, data, self.frame, WORLD)
        w, x, y, z = orientation
        self.error = reference - pose.translation
        self.turn = pin.log3(pin.Quaternion(w, x, y, z).normalized().matrix() @ pose.rotation.T)
        wanted = np.concatenate([velocity, angular_velocity])
        wanted = wanted + self.hand_gain * np.concatenate([self.error, self.turn])
        inverse = damped_inverse(J, self.hand_damping)
        self.dq = inverse @ wanted + (np.eye(7) - inverse @ J) @ (self.posture_gain * (HOME - q))
        self.dq_law = self.dq
        return q + self.period * self.dq


LAWS = {
    "planar5": {"Pinocchio + numpy as written": PlainPlanar5, "Pinocchio + numpy made fast": Planar5},
    "arm7": {"Pinocchio + numpy as written": PlainArm7, "Pinocchio + numpy made fast": Arm7},
}
