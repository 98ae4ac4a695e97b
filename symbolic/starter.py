"""A first spec and a first scenario for a robot that someone brings: a place to start from, not a design."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.documents import BadInput, choices
from clikgen.symbolic.models.snap import random_configurations
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.tree import KinematicTree

Array = NDArray[np.float64]

SAMPLES = 2000  # configurations among which the most regular is looked for
STRIDE = 0.15  # how far the first reference leads, as a share of the robot's reach
DURATION = 3.0  # [s] there, and as long back


@dataclass(frozen=True, slots=True)
class Starter:
    """The texts of a spec and of a scenario for it."""

    spec: str
    scenario: str


@dataclass(frozen=True, slots=True, eq=False)
class _Start:
    """A regular configuration: the joints (n,), where the frame is there, and how it is turned (rpy)."""

    q: Array
    position: Array  # (2 or 3,)
    rpy: tuple[float, float, float]


def starter(name: str, urdf: str, robot: Robot, frame: str | None) -> Starter:
    """A spec called `name` for the robot in the file `urdf`: joint limits, then a pose or position, then a posture.

    `frame` is the link to move; by default the link farthest from the root. Raises BadInput for an unknown one.
    """
    ends = _ends(robot)
    if frame is not None and frame not in robot.links:
        raise BadInput(f"--frame: no link '{frame}'; {choices(frame, robot.links)}")
    moved = frame or ends[0]
    kind = "frame_pose" if len(_carrying(robot, moved)) >= 6 else "frame_position"
    start = _start(robot, moved, kind)
    return Starter(_spec(name, urdf, robot, moved, kind, start), _scenario(name, kind, start))


def _carrying(robot: Robot, link: str) -> tuple[int, ...]:
    """The coordinates that move a link."""
    tree = KinematicTree.at(robot, ca.SX.sym("q", len(robot.coordinates)))
    return tuple(sorted({axis.coordinate for axis in tree.carriers[link]}))


def _ends(robot: Robot) -> list[str]:
    """The links that carry no other, those that most joints move first."""
    parents = {robot.parent(joint) for joint in robot.joints}
    return sorted((link for link in robot.links if link not in parents), key=lambda link: -len(_carrying(robot, link)))


def _start(robot: Robot, link: str, kind: str) -> _Start:
    """Where the task's Jacobian is farthest from singular, of many configurations within the limits."""
    q = ca.SX.sym("q", len(robot.coordinates))
    tree = KinematicTree.at(robot, q)
    rows = [tree.position_jacobian(link)] + ([tree.angular_jacobian(link)] if kind == "frame_pose" else [])
    seen = [ca.densify(ca.vertcat(*rows)), ca.densify(tree.rotation(link)), ca.densify(tree.position(link))]
    function = ca.Function("seen", [q], seen)
    configurations = random_configurations(robot, SAMPLES, seed=0)
    jacobians = np.array(function.map(SAMPLES)(configurations.T)[0])
    m, n = seen[0].shape
    sigma = np.linalg.svd(jacobians.reshape(m, SAMPLES, n).transpose(1, 0, 2), compute_uv=False)[:, -1]
    best = np.round(configurations[int(np.argmax(sigma))], 3)
    _, rotation, position = (np.array(value) for value in function(best))
    return _Start(best, position[:, 0], _rpy(rotation))


def _rpy(R: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw of R = R_z(yaw) R_y(pitch) R_x(roll)."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _spec(name: str, urdf: str, robot: Robot, frame: str, kind: str, start: _Start) -> str:
    limited = any(joint.lower is not None for joint in robot.coordinates)
    fast = all(moved.velocity for moved in robot.inputs)
    joints = ", ".join(joint.name for joint in robot.coordinates)
    text = f'''# A first controller for {urdf}. Every number is a starting point: `clikgen analyse` says how far gains,
# sampling time and filter may go. Joints: {joints}.

name = "{name}"
description = "first controller of {urdf}"
period = 0.005          # T [s]
law = "augmented"       # or "nsb", the paper's (eq. 11)

[robot]
urdf = "{urdf}"
# base = "holonomic"    # a mobile base under it: "holonomic" or "differential"
'''
    if limited:
        text += """
# Tasks, the highest priority first.
[[tasks]]
name = "limits"
kind = "joint_limits"
margin = 0.05           # [m, rad]
gain = 50.0             # [1/s]
damping = 1e-3
"""
    text += f'''
[[tasks]]
name = "tool"
kind = "{kind}"
frame = "{frame}"
gain = 10.0             # K [1/s]
speed = 1.0             # [m/s] the feedback asks for no more than this

[[tasks]]
name = "posture"
kind = "posture"
posture = {_numbers(start.q)}     # [m, rad]
gain = 1.0              # [1/s]
'''
    if fast:
        text += """
[velocity_limits]
kind = "scale"          # every task keeps its direction; or "clamp", joint by joint
"""
    return (
        text
        + """
[filter]
kind = "first_order"
cutoff = 10.0           # f_c [Hz]
"""
    )


def _scenario(name: str, kind: str, start: _Start) -> str:
    reach = float(np.linalg.norm(start.position)) or 1.0
    there = start.position * (1 - STRIDE) + np.eye(len(start.position))[1] * STRIDE * reach
    waypoints = ", ".join(_numbers(place) for place in (start.position, there, start.position))
    text = f'''# A first run of {name}: there and back.

name = "{name}_first"
description = "{name} leads its tool there and back"
controller = "{name}"
duration = {2 * DURATION + 1}          # [s]
q0 = {_numbers(start.q)}     # [m, rad]

[references.tool]
kind = "spline"
waypoints = [{waypoints}]     # [m]
times = [0.0, {DURATION}, {2 * DURATION}]
'''
    if kind == "frame_pose":
        text += f"""
[references.tool_orientation]
kind = "orientation"
rpy = {_numbers(start.rpy)}   # [rad] as it starts
"""
    return text


def _numbers(values: Sequence[float] | Array) -> str:
    return "[" + ", ".join(f"{value:.6g}" if value else "0.0" for value in map(float, values)) + "]"
