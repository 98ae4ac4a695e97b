"""Steps as a CasADi user writes them from the paper: the baseline of `step.py`.

Homogeneous transforms multiplied out, Jacobians of positions by automatic differentiation, pseudo-inverses with `inv`,
null-space projectors as matrices, eqs. 14-19 as printed. Every number that they give is that of our controllers.

What our expressions do better can be put in, one thing after the other, to see what each is worth.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.symbolic.controller import ControllerFunction
from clikgen.symbolic.damping import ConstantDamping
from clikgen.symbolic.distances import apart, is_nearer
from clikgen.symbolic.least_squares import damped_pseudo_inverse_times
from clikgen.symbolic.robot import Joint
from clikgen.symbolic.spec import ControllerSpec
from clikgen.symbolic.stage import Procedure
from clikgen.symbolic.tree import KinematicTree, Wrench

Signals = dict[str, ca.SX]

SQUARED = "squared distances compared, one root a point"
GEOMETRIC = "Jacobians from axes, contacts summed as wrenches"
SOLVED = "a solve with one right-hand side per pseudo-inverse"
BETTER = {"planar5": (SQUARED, GEOMETRIC, SOLVED), "arm7": (GEOMETRIC, SOLVED)}


def step(spec: ControllerSpec, function: ControllerFunction, better: Collection[str] = ()) -> Procedure:
    """The same inputs and outputs as the step `function` of planar5 or arm7."""
    given = {signal.info.name: ca.SX.sym(signal.info.name, signal.info.size) for signal in function.inputs}
    q, T, n = given["q"], given["period"], given["q"].numel()
    found = LAWS[spec.name](spec, given, better)
    q_raw = q + T * found["dq_law"]  # eq. 13
    x = 2 * ca.pi * T * given["filter_cutoff"]
    A = ca.diag(x / (1 + x))  # eq. 15
    q_filtered = A @ q_raw + (ca.SX.eye(n) - A) @ q  # eq. 16
    lam = ca.if_else(found["active"], given["lam_event"], given["lam_free"]) if "active" in found else given["lam_free"]
    q_next = lam * q_filtered + (1 - lam) * q_raw  # eqs. 17 to 19
    found |= {"q_next": q_next, "dq": (q_next - q) / T, "lam": lam}
    results = ca.cse([ca.densify(found[signal.info.name]) for signal in function.outputs])
    return Procedure(function.procedure.name, tuple(given.values()), tuple(results))


def _tracking_under_avoidance(spec: ControllerSpec, given: Signals, better: Collection[str]) -> Signals:
    q, poses, tree = given["q"], _poses(spec.robot.joints, given["q"]), KinematicTree.at(spec.robot, given["q"])
    tool = spec.robot.frame("tool")
    x = _point(poses[tool.link], tool.xyz)[:2]
    J_g = tree.position_jacobian(tool.link, tool.xyz) if GEOMETRIC in better else ca.jacobian(x, q)
    e = given["tool_reference"] - x
    K_g = ca.reshape(given["tool_gain"], 2, 2).T
    tracking = Level(J_g, given["tool_reference_velocity"] + K_g @ e, given["tool_damping"])  # eq. 4

    distances, wrenches, V, event = [], [], 0, 0
    for i, point in enumerate(spec.robot.points_of_interest):
        r = _point(poses[point.link], point.offset)[:2]
        d, u = (_nearest if SQUARED in better else _least)(r, given)
        s = given["influence_radius"][i]
        V += ca.if_else(d <= s, (s - d) ** 2 / 2, 0)  # eq. 8
        wrenches.append(Wrench.at(point.link, r, ca.fmax(s - d, 0) * u))
        event = ca.logic_or(event, d <= s)
        distances.append(d)
    J_o = tree.pullback(wrenches) if GEOMETRIC in better else ca.jacobian(V, q)  # eq. 9
    avoidance = Level(J_o, -given["obstacles_gain"] * V, given["obstacles_damping"])  # eq. 10
    dq_law = _combined([avoidance, tracking], ca.SX.zeros(5), better)
    d = ca.vertcat(*distances)
    sensed = {"distance": d, "clearance": ca.mmin(d - given["influence_radius"]), "obstacles_potential": V}
    return sensed | {"dq_law": dq_law, "active": event, "tool_position": x, "tool_error": e}


def _pose_above_posture(spec: ControllerSpec, given: Signals, better: Collection[str]) -> Signals:
    q, poses = given["q"], _poses(spec.robot.joints, given["q"])
    moving = [joint for joint in spec.robot.joints if joint.type != "fixed"]
    link = spec.robot.frame("hand_tcp").link
    tcp, tree = poses[link], KinematicTree.at(spec.robot, q)
    x, quaternion = tcp[:3, 3], _quaternion(tcp[:3, :3])
    J_x = tree.position_jacobian(link) if GEOMETRIC in better else ca.jacobian(x, q)
    J = ca.vertcat(J_x, ca.horzcat(*(poses[joint.link][:3, 2] for joint in moving)))  # all turn about z
    reference = given["hand_orientation_reference"]
    e_x = given["hand_reference"] - x
    e_R = _rotation_vector(_product(reference / ca.norm_2(reference), quaternion * ca.DM([1, -1, -1, -1])))
    K = ca.reshape(given["hand_gain"], 6, 6).T
    velocity = ca.vertcat(given["hand_reference_velocity"], given["hand_orientation_reference_velocity"])
    pose = Level(J, velocity + K @ ca.vertcat(e_x, e_R), given["hand_damping"])  # eq. 4
    e_q = given["posture_reference"] - q
    posture = given["posture_reference_velocity"] + given["posture_gain"] * e_q
    dq_law = _combined([pose], posture / (1 + given["posture_damping"] ** 2), better)
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


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A task: its Jacobian, the velocity that it wants, and its damping."""

    J: ca.SX
    velocity: ca.SX
    damping: ca.SX


def _combined(levels: Sequence[Level], dq: ca.SX, better: Collection[str]) -> ca.SX:
    """Eq. 11, the highest priority first; `dq` is below them all."""
    for level in reversed(levels):
        if SOLVED in better:
            rest = level.velocity - level.J @ dq
            dq += damped_pseudo_inverse_times(level.J, rest, ConstantDamping(level.damping))
        else:
            inverse = _pseudo_inverse(level.J, level.damping)
            dq = inverse @ level.velocity + (ca.SX.eye(dq.numel()) - inverse @ level.J) @ dq
    return dq


def _pseudo_inverse(J: ca.SX, damping: ca.SX) -> ca.SX:
    return J.T @ ca.inv(J @ J.T + damping**2 * ca.SX.eye(J.shape[0]))


def _least(point: ca.SX, given: Signals) -> tuple[ca.SX, ca.SX]:
    """The distance to the closest obstacle and the direction there."""
    center, d, u = ca.reshape(given["obstacle_center"], 2, 3), ca.SX(1e6), ca.SX([1, 0])
    for k in range(3):
        toward = center[:, k] - point
        away = ca.if_else(k < given["obstacle_count"], ca.norm_2(toward) - given["obstacle_radius"][k], 1e6)
        d, u = ca.fmin(d, away), ca.if_else(away < d, toward / ca.norm_2(toward), u)
    return d, u


def _nearest(point: ca.SX, given: Signals) -> tuple[ca.SX, ca.SX]:
    """The same with one root."""
    center, best = ca.reshape(given["obstacle_center"], 2, 3), ca.SX()
    for k in range(3):
        there = k < given["obstacle_count"]
        toward = ca.if_else(there, center[:, k], 0) - point
        mine = ca.vertcat(ca.sumsqr(toward), ca.if_else(there, given["obstacle_radius"][k], -1e6), toward)
        best = ca.if_else(is_nearer(*ca.vertsplit(mine[:2]), *ca.vertsplit(best[:2])), mine, best) if k else mine
    root = ca.sqrt(best[0])
    along, length = apart(best[2:], root)
    return ca.fmin(root - best[1], 1e6), along / length


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
