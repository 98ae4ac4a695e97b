"""Steps as a CasADi user writes them from the paper: the baseline of `step.py`.

Homogeneous transforms multiplied out, Jacobians of positions by automatic differentiation, pseudo-inverses with `inv`,
null-space projectors as matrices, eqs. 14-19 as printed. Every number that they give is that of our controllers.
"""

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.symbolic.controller import ControllerFunction
from clikgen.symbolic.robot import Joint
from clikgen.symbolic.spec import ControllerSpec

Signals = dict[str, ca.SX]


def step(spec: ControllerSpec, function: ControllerFunction) -> ca.Function:
    """The same inputs and outputs as the step `function` of planar5 or arm7."""
    given = {signal.info.name: ca.SX.sym(signal.info.name, signal.info.size) for signal in function.inputs}
    q, T, n = given["q"], given["period"], given["q"].numel()
    found = LAWS[spec.name](spec, given)
    q_raw = q + T * found["dq_law"]  # eq. 13
    x = 2 * ca.pi * T * given["filter_cutoff"]
    A = ca.diag(x / (1 + x))  # eq. 15
    q_filtered = A @ q_raw + (ca.SX.eye(n) - A) @ q  # eq. 16
    lam = ca.if_else(found["active"], given["lam_event"], given["lam_free"]) if "active" in found else given["lam_free"]
    q_next = lam * q_filtered + (1 - lam) * q_raw  # eqs. 17 to 19
    found |= {"q_next": q_next, "dq": (q_next - q) / T, "lam": lam}
    results = [found[signal.info.name] for signal in function.outputs]
    return ca.Function(function.procedure.name, list(given.values()), ca.cse(results))


def _tracking_under_avoidance(spec: ControllerSpec, given: Signals) -> Signals:
    q, poses = given["q"], _poses(spec.robot.joints, given["q"])
    tool = spec.robot.frame("tool")
    x = _point(poses[tool.link], tool.xyz)[:2]
    J_g = ca.jacobian(x, q)
    e = given["tool_reference"] - x
    K_g = ca.reshape(given["tool_gain"], 2, 2).T
    dq_g = _pseudo_inverse(J_g, given["tool_damping"]) @ (given["tool_reference_velocity"] + K_g @ e)  # eq. 4

    distances, V, event = [], 0, 0
    for i, point in enumerate(spec.robot.points_of_interest):
        d = _distance(_point(poses[point.link], point.offset)[:2], given)
        s = given["influence_radius"][i]
        V += ca.if_else(d <= s, (s - d) ** 2 / 2, 0)  # eq. 8
        event = ca.logic_or(event, d <= s)
        distances.append(d)
    J_o = ca.jacobian(V, q)  # eq. 9
    J_o_inverse = _pseudo_inverse(J_o, given["obstacles_damping"])
    dq_o = J_o_inverse @ (-given["obstacles_gain"] * V)  # eq. 10
    dq_law = dq_o + (ca.SX.eye(5) - J_o_inverse @ J_o) @ dq_g  # eq. 11
    d = ca.vertcat(*distances)
    sensed = {"distance": d, "clearance": ca.mmin(d - given["influence_radius"]), "obstacles_potential": V}
    return sensed | {"dq_law": dq_law, "active": event, "tool_position": x, "tool_error": e}


def _pose_above_posture(spec: ControllerSpec, given: Signals) -> Signals:
    q, poses = given["q"], _poses(spec.robot.joints, given["q"])
    moving = [joint for joint in spec.robot.joints if joint.type != "fixed"]
    tcp = poses[spec.robot.frame("hand_tcp").link]
    x, quaternion = tcp[:3, 3], _quaternion(tcp[:3, :3])
    J = ca.vertcat(ca.jacobian(x, q), ca.horzcat(*(poses[joint.link][:3, 2] for joint in moving)))  # all about z
    reference = given["hand_orientation_reference"]
    e_x = given["hand_reference"] - x
    e_R = _rotation_vector(_product(reference / ca.norm_2(reference), quaternion * ca.DM([1, -1, -1, -1])))
    K = ca.reshape(given["hand_gain"], 6, 6).T
    velocity = ca.vertcat(given["hand_reference_velocity"], given["hand_orientation_reference_velocity"])
    J_inverse = _pseudo_inverse(J, given["hand_damping"])
    dq_hand = J_inverse @ (velocity + K @ ca.vertcat(e_x, e_R))  # eq. 4
    e_q = given["posture_reference"] - q
    posture = given["posture_reference_velocity"] + given["posture_gain"] * e_q
    dq_posture = posture / (1 + given["posture_damping"] ** 2)
    dq_law = dq_hand + (ca.SX.eye(7) - J_inverse @ J) @ dq_posture  # eq. 11
    hand = {"hand_position": x, "hand_orientation": quaternion, "hand_error": e_x, "hand_orientation_error": e_R}
    return hand | {"dq_law": dq_law, "posture_value": q, "posture_error": e_q}


LAWS = {"planar5": _tracking_under_avoidance, "arm7": _pose_above_posture}


def _poses(joints: tuple[Joint, ...], q: ca.SX) -> dict[str, ca.SX]:
    """world_T_link (4, 4) of every link of a chain."""
    poses, pose, angles = {}, ca.SX.eye(4), iter(ca.vertsplit(q))
    for joint in joints:
        pose = pose @ _transform(joint.xyz, Rotation.from_euler("xyz", joint.rpy).as_matrix().round(15))
        if joint.type == "prismatic":
            pose = pose @ _transform(ca.SX(joint.axis) * next(angles), np.eye(3))
        elif joint.type != "fixed":
            angle = next(angles)
            cosine, sine = ca.cos(angle), ca.sin(angle)
            turn = ca.blockcat([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
            pose = pose @ _transform((0, 0, 0), turn)
        poses[joint.link] = pose
    return poses


def _transform(xyz: Sequence[float] | ca.SX, R: NDArray[np.float64] | ca.SX) -> ca.SX:
    return ca.blockcat([[ca.SX(R), ca.SX(xyz)], [ca.SX.zeros(1, 3), 1]])


def _point(pose: ca.SX, offset: tuple[float, float, float]) -> ca.SX:
    return (pose @ ca.vertcat(ca.SX(offset), 1))[:3]


def _pseudo_inverse(J: ca.SX, damping: ca.SX) -> ca.SX:
    return J.T @ ca.inv(J @ J.T + damping**2 * ca.SX.eye(J.shape[0]))


def _distance(point: ca.SX, given: Signals) -> ca.SX:
    """To the closest obstacle."""
    center, d = ca.reshape(given["obstacle_center"], 2, 3), ca.SX(1e6)
    for k in range(3):
        away = ca.norm_2(center[:, k] - point) - given["obstacle_radius"][k]
        d = ca.fmin(d, ca.if_else(k < given["obstacle_count"], away, 1e6))
    return d


def _quaternion(R: ca.SX) -> ca.SX:
    w = ca.sqrt(1 + ca.trace(R)) / 2
    return ca.vertcat(w, ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]) / (4 * w))


def _product(p: ca.SX, q: ca.SX) -> ca.SX:
    v, u = p[1:], q[1:]
    return ca.vertcat(p[0] * q[0] - ca.dot(v, u), p[0] * u + q[0] * v + ca.cross(v, u))


def _rotation_vector(quaternion: ca.SX) -> ca.SX:
    w, v = quaternion[0], quaternion[1:]
    w, v = ca.fabs(w), ca.if_else(w < 0, -v, v)
    return 2 * ca.atan2(ca.norm_2(v), w) / ca.norm_2(v) * v
