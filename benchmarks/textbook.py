"""The step of planar5 as a CasADi user writes it from the paper: the baseline of `step.py`.

Homogeneous transforms multiplied out, Jacobians by automatic differentiation, pseudo-inverses with `inv`, null-space
projectors as matrices, eqs. 14-19 as printed. Every number that it gives is that of the shipped controller.
"""

import casadi as ca

from clikgen.symbolic.controller import ControllerFunction
from clikgen.symbolic.robot import Joint
from clikgen.symbolic.spec import ControllerSpec


def step(spec: ControllerSpec, function: ControllerFunction) -> ca.Function:
    """The same inputs and outputs as the step `function` of planar5's `spec`."""
    given = {signal.info.name: ca.SX.sym(signal.info.name, signal.info.size) for signal in function.inputs}
    q, T = given["q"], given["period"]
    poses = _poses(spec.robot.joints, q)
    tool = spec.robot.frame("tool")
    x = _point(poses[tool.link], tool.xyz)
    J_g = ca.jacobian(x, q)
    e = given["tool_reference"] - x
    K_g = ca.reshape(given["tool_gain"], 2, 2).T
    dq_g = _pseudo_inverse(J_g, given["tool_damping"]) @ (given["tool_reference_velocity"] + K_g @ e)  # eq. 4

    distances, V, event = [], 0, 0
    for i, point in enumerate(spec.robot.points_of_interest):
        d = _distance(_point(poses[point.link], point.offset), given)
        s = given["influence_radius"][i]
        V += ca.if_else(d <= s, (s - d) ** 2 / 2, 0)  # eq. 8
        event = ca.logic_or(event, d <= s)
        distances.append(d)
    J_o = ca.jacobian(V, q)  # eq. 9
    J_o_inverse = _pseudo_inverse(J_o, given["obstacles_damping"])
    dq_o = J_o_inverse @ (-given["obstacles_gain"] * V)  # eq. 10
    dq_law = dq_o + (ca.SX.eye(5) - J_o_inverse @ J_o) @ dq_g  # eq. 11

    q_raw = q + T * dq_law  # eq. 13
    beta = 2 * ca.pi * T * given["filter_cutoff"] / (1 + 2 * ca.pi * T * given["filter_cutoff"])  # eq. 15
    q_filtered = ca.diag(beta) @ q_raw + (ca.SX.eye(5) - ca.diag(beta)) @ q  # eq. 16
    lam = ca.if_else(event, given["lam_event"], given["lam_free"])  # eq. 18
    q_next = lam * q_filtered + (1 - lam) * q_raw  # eqs. 17, 19
    d = ca.vertcat(*distances)
    least = ca.mmin(d - given["influence_radius"])
    results = [q_next, (q_next - q) / T, dq_law, V, x, e, lam, event, d, least]
    return ca.Function(function.procedure.name, list(given.values()), ca.cse(results))


def _poses(joints: tuple[Joint, ...], q: ca.SX) -> dict[str, ca.SX]:
    """world_T_link (4, 4) of every link of a planar chain."""
    poses, pose = {}, ca.SX.eye(4)
    for i, joint in enumerate(joints):
        step = ca.SX.eye(4)
        step[:3, 3] = ca.SX(joint.xyz)
        if joint.type == "prismatic":
            step[:3, 3] += ca.SX(joint.axis) * q[i]
        else:
            cosine, sine = ca.cos(q[i]), ca.sin(q[i])
            step[:2, :2] = ca.blockcat([[cosine, -sine], [sine, cosine]])
        poses[joint.link] = pose = pose @ step
    return poses


def _point(pose: ca.SX, offset: tuple[float, float, float]) -> ca.SX:
    return (pose @ ca.vertcat(ca.SX(offset), 1))[:2]


def _pseudo_inverse(J: ca.SX, damping: ca.SX) -> ca.SX:
    return J.T @ ca.inv(J @ J.T + damping**2 * ca.SX.eye(J.shape[0]))


def _distance(point: ca.SX, given: dict[str, ca.SX]) -> ca.SX:
    """To the closest obstacle."""
    center, d = ca.reshape(given["obstacle_center"], 2, 3), ca.SX(1e6)
    for k in range(3):
        away = ca.norm_2(center[:, k] - point) - given["obstacle_radius"][k]
        d = ca.fmin(d, ca.if_else(k < given["obstacle_count"], away, 1e6))
    return d
