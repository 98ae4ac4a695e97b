"""A first spec and a first scenario for a robot that someone brings: a place to start from, not a design."""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.documents import BadInput, choices
from clikgen.symbolic.models.lock import locked
from clikgen.symbolic.models.snap import random_configurations
from clikgen.symbolic.robot import Joint, Robot
from clikgen.symbolic.task import NEAR_SINGULARITY
from clikgen.symbolic.tree import KinematicTree

Array = NDArray[np.float64]

SAMPLES = 2000  # configurations among which a regular one is looked for
TRIED = 20  # of these, the best ones, from which a way is looked for
INSIDE = 0.8  # the share of every joint's range in which they lie
RANK_TOLERANCE = 1e-3  # singular values below this share of the greatest are imperfections of the URDF's numbers
STRIDES = (0.15, 0.08, 0.04, 0.02)  # how far the first reference leads, as a share of the frame's reach
FARTHEST = 0.3  # [m] and no farther than this
STEPS = 40  # of the way there, followed before it is written down
KEPT = 0.5  # the share of its regularity that the task keeps on the way
AT_MOST = 0.5  # the share of the joints' velocity limits that the way takes
SHORTEST = 3.0  # [s] there, and as long back
REST = 2.0  # [s] at the end
FAR = 1e6  # [m, rad] limits beyond are none
MARGIN = 0.05  # [m, rad] from the joint limits, less where the range is small
SHARE_OF_RANGE = 0.05  # the margin is no more than this share of the range

ARM = 3  # joints that an arm has at least before what it carries can be a gripper
FINGER = re.compile(r"finger|gripper|jaw|thumb|knuckle", re.IGNORECASE)
TOOL = re.compile(r"tool|tcp|(^|_)ee($|_)|end_?eff|grasp|grip|hand|palm", re.IGNORECASE)
ASIDE = re.compile(r"finger|(^|_)led|camera|optical|imu|sensor|laser|lidar|sonar|range|accel|cable", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Starter:
    """The texts of a spec and of a scenario for it, and what to say of the choices in them, a line each."""

    spec: str
    scenario: str
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Goal:
    """What the first task holds: the position of a frame along some axes, its pose, or only the joints."""

    frame: str
    kind: str  # frame_pose, frame_position or posture
    axes: tuple[int, ...]  # of the position


@dataclass(frozen=True, slots=True, eq=False)
class _Way:
    """Where a run starts, and how its reference leads there and back."""

    q: Array  # (n,)
    start: Array  # what the reference starts from: a position along the goal's axes, or joint positions
    there: Array
    rpy: tuple[float, float, float]  # how the frame is turned at the start
    regularity: float  # the least s on the way, see _regularity
    rate: Array  # (n,) the greatest |dq| for the whole way in one unit of time


def starter(name: str, urdf: str, robot: Robot, frame: str | None) -> Starter:
    """A spec called `name` for the robot in the file `urdf`: joint limits, then a pose or position, then a posture.

    `frame` is the link to move; by default the one that most joints carry, grippers and fingers left aside: they
    are locked unless they carry it. Raises BadInput for an unknown one.
    """
    if frame is not None and frame not in robot.links:
        raise BadInput(f"--frame: no link '{frame}'; {choices(frame, robot.links)}")
    if frame is not None and not _chain(robot, frame):
        raise BadInput(f"--frame: no joint moves '{frame}', wanted a link that one moves")
    stuck = {joint.name: float(joint.lower or 0.0) for joint in robot.coordinates if _is_stuck(joint)}
    if len(stuck) == len(robot.coordinates):
        raise BadInput(f"{urdf}: the limits of every joint leave it no room to move, wanted lower < upper")
    fingers = _fingers(robot)
    ends = _ends(robot, fingers, stuck)
    moved = frame or ends[0]
    kept = {_leader(joint) for joint in _chain(robot, moved)}
    held = stuck | {joint.name: _nearest_to_zero(joint) for joint in fingers if joint.name not in kept | stuck.keys()}
    free = robot.model_copy(update={"joints": locked(robot, held)}) if held else robot
    goal, way = _goal_and_way(free, moved)
    others = [end for end in ends if end != moved][:8]
    notes = [
        f"first task: {goal.kind} of '{moved}'" if goal.kind != "posture" else f"'{moved}' stays in place: no tool"
    ]
    if others and frame is None:
        notes[0] += f"; --frame for another link, as {', '.join(others)}"
    return Starter(_spec(name, urdf, free, held, goal, way), _scenario(name, goal, way, free), tuple(notes))


def _is_stuck(joint: Joint) -> bool:
    return joint.lower is not None and joint.lower == joint.upper


def _nearest_to_zero(joint: Joint) -> float:
    return 0.0 if joint.lower is None or joint.upper is None else min(max(0.0, joint.lower), joint.upper)


def _leader(joint: Joint) -> str:
    """The joint whose coordinate moves this one."""
    return joint.mimic.joint if joint.mimic else joint.name


def _chain(robot: Robot, link: str) -> list[Joint]:
    """The moving joints between the root and a link, the root's first."""
    carrier = {joint.link: joint for joint in robot.joints}
    chain: list[Joint] = []
    while link != robot.root:
        chain.insert(0, carrier[link])
        link = robot.parent(carrier[link])
    return [joint for joint in chain if joint.type != "fixed"]


def _fingers(robot: Robot) -> list[Joint]:
    """The joints with a coordinate that move fingers, as far as names, mimics and the shape of the tree tell.

    A finger joint carries no others than finger joints, comes after three joints or more, and has a name that
    says so, mimics or is mimicked, or is one of several short branches at the end of a longer chain.
    """
    moving = [joint for joint in robot.joints if joint.type != "fixed"]
    chains = {joint.name: [one.name for one in _chain(robot, joint.link)] for joint in moving}
    behind: dict[str, list[Joint]] = {joint.name: [] for joint in moving}  # directly
    for joint in moving:
        for carrier in chains[joint.name][-2:-1]:
            behind[carrier].append(joint)
    length: dict[str, int] = {}  # of the longest chain from a joint on
    for joint in reversed(moving):
        length[joint.name] = 1 + max((length[one.name] for one in behind[joint.name]), default=0)
    led = {joint.mimic.joint for joint in moving if joint.mimic}
    branches: set[str] = set()
    for joint in moving:
        on, before = behind[joint.name], len(chains[joint.name])
        longest = max((length[one.name] for one in on), default=0)
        if len(on) > 1 and before >= ARM and longest < before:
            branches.update(one.name for one in moving if joint.name in chains[one.name][:-1])
    found: set[str] = set()
    for joint in reversed(moving):
        marked = joint.mimic or joint.name in led | branches or FINGER.search(joint.name)
        alone = all(one.name in found for one in behind[joint.name])
        if marked and alone and len(chains[joint.name]) > ARM:
            found.add(joint.name)
    return [joint for joint in moving if joint.name in found and joint.independent]


def _ends(robot: Robot, fingers: Iterable[Joint], stuck: Iterable[str]) -> list[str]:
    """The links that carry no other but fingers, those that most joints move first, then the likeliest tools."""
    closed = {joint.name for joint in fingers}
    chains = {link: [_leader(joint) for joint in _chain(robot, link)] for link in robot.links}
    kept = [link for link in robot.links if not closed & set(chains[link])]
    carrying = {robot.parent(joint) for joint in robot.joints if joint.link in kept}

    def rank(link: str) -> tuple[int, bool, bool]:
        return (
            -len(set(chains[link]) - set(stuck)),
            bool(ASIDE.search(link)) and len(chains[link]) > ARM,
            not TOOL.search(link),
        )

    return sorted((link for link in kept if link not in carrying and chains[link]), key=rank)


class _Frame:
    """A frame as a function of q: its Jacobians (3, n), where it is, how it is turned, and its chain's lowest link."""

    def __init__(self, robot: Robot, link: str) -> None:
        q = ca.SX.sym("q", len(robot.coordinates))
        tree = KinematicTree.at(robot, q)
        d, n = robot.dimension, q.numel()
        self.shapes = ((d, n), (3, n), (d, 1), (3, 3), (1, 1))
        heights = [tree.poses[joint.link].position[2] for joint in _chain(robot, link)] or [ca.SX(0)]
        parts = [tree.position_jacobian(link), tree.angular_jacobian(link), tree.position(link), tree.rotation(link)]
        lowest = ca.mmin(ca.vertcat(*heights, tree.poses[link].position[2]))
        columns = [ca.densify(ca.vec(part.T)) for part in (*parts, lowest)]
        self._function = ca.Function("frame", [q], [ca.vertcat(*columns)])

    def at(self, q: Array) -> list[Array]:
        """All of it at q (N, n): each array with N in front."""
        values = np.array(self._function.map(len(q))(q.T)).T
        cuts = np.cumsum([math.prod(shape) for shape in self.shapes])[:-1]
        return [
            part.reshape(-1, *shape) for part, shape in zip(np.split(values, cuts, axis=1), self.shapes, strict=True)
        ]


def _regularity(jacobian: Array) -> Array:
    """How far from singular the Jacobians (..., m, n) are: s = (Σ 1/σ²)^-½, by which their inverse is damped."""
    sigma = np.maximum(np.linalg.svd(jacobian, compute_uv=False), 1e-12)
    s: Array = (1 / sigma**2).sum(axis=-1) ** -0.5
    return s


def _rank(jacobians: Array) -> int:
    """The rank of the Jacobians (N, m, n) in most configurations, imperfections of the numbers left aside."""
    sigma = np.linalg.svd(jacobians, compute_uv=False)
    if sigma.max(initial=0.0) < 1e-9:
        return 0
    return int(np.median((sigma > RANK_TOLERANCE * sigma.max()).sum(axis=1)))


def _goal_and_way(robot: Robot, link: str) -> tuple[_Goal, _Way]:
    """A goal of as many rows as the frame can follow, and the first run of it."""
    frame = _Frame(robot, link)
    q = _inside(robot, random_configurations(robot, SAMPLES, seed=0))
    aside = [joint.name not in {_leader(one) for one in _chain(robot, link)} for joint in robot.coordinates]
    q[:, aside] = np.clip(0.0, *_bounds(robot))[aside]  # legs and head stand as they would by themselves
    position, angular, place, _, lowest = frame.at(q)
    both = np.concatenate([position, angular], axis=1)
    rank = _rank(position)
    goals = [_Goal(link, "frame_position", axes) for axes in combinations(range(position.shape[1]), rank)]
    if robot.dimension == 3 and rank == 3 and _rank(both) == 6:
        goals = [_Goal(link, "frame_pose", (0, 1, 2)), *goals]
    reach = float(np.linalg.norm(place - place.mean(axis=0), axis=(1, 2)).max())
    upright = np.where(lowest[:, 0, 0] >= -1e-9, 1.0, KEPT)
    seen = [(goal, _regularity(_rows(goal, position, angular)) * upright) for goal in goals if rank]
    seen.sort(key=lambda one: (one[0].kind != "frame_pose", -one[1].max()))  # a pose first, then the best axes
    for goal, regularity in seen:
        way = _first_way(robot, frame, goal, q[np.argsort(-regularity)[:TRIED]], reach)
        if way:
            return goal, way
    return _Goal(link, "posture", ()), _joint_way(robot)


def _rows(goal: _Goal, position: Array, angular: Array) -> Array:
    """The Jacobian of what a goal holds, (..., m, n)."""
    rows = position[..., list(goal.axes), :]
    return np.concatenate([rows, angular], axis=-2) if goal.kind == "frame_pose" else rows


def _inside(robot: Robot, q: Array) -> Array:
    """Configurations brought toward the middle of the limits, with few digits."""
    middle = [0.0 if j.lower is None or j.upper is None else (j.lower + j.upper) / 2 for j in robot.coordinates]
    share = [1.0 if j.lower is None else INSIDE for j in robot.coordinates]
    closer = middle + (q - middle) * np.array(share)
    rounded: Array = np.where(np.abs(closer) > 0.1, np.round(closer, 3), np.round(closer, 6))
    return rounded


def _margin(joint: Joint) -> float:
    """The margin from the limits of a joint [m, rad], one digit where it is smaller than usual."""
    if joint.lower is None or joint.upper is None:
        return 0.0
    return min(MARGIN, float(f"{SHARE_OF_RANGE * (joint.upper - joint.lower):.1g}"))


def _bounds(robot: Robot) -> tuple[Array, Array]:
    """Between which joint positions no limit acts, (n,) each."""
    inner = [
        (-math.inf, math.inf)
        if joint.lower is None or joint.upper is None
        else (joint.lower + _margin(joint), joint.upper - _margin(joint))
        for joint in robot.coordinates
    ]
    low, high = np.array(inner).T
    return low, high


def _first_way(robot: Robot, frame: _Frame, goal: _Goal, starts: Array, reach: float) -> _Way | None:
    """A straight way along an axis that stays regular and within the limits: the longest, then the most regular."""
    for stride in STRIDES:
        for q in starts:
            moves = [
                sign * min(stride * reach, FARTHEST) * np.eye(3)[axis] for axis in goal.axes for sign in (1.0, -1.0)
            ]
            ways = [way for move in moves if (way := _followed(robot, frame, goal, q, move))]
            if ways:
                return max(ways, key=lambda way: way.regularity)
    return None


def _followed(robot: Robot, frame: _Frame, goal: _Goal, start: Array, move: Array) -> _Way | None:
    """The way from a configuration by `move` (3,) [m], the frame turned as it was; None where it cannot be gone."""
    d, axes = robot.dimension, list(goal.axes)
    low, high = _bounds(robot)
    _, _, place, turned, _ = (part[0] for part in frame.at(start[None]))
    q, places, seen, rate = start, place[:, 0], list[float](), np.zeros(len(start))
    for step in range(STEPS + 1):
        position, angular, now, rotation, _ = (part[0] for part in frame.at(q[None]))
        J = _rows(goal, position, angular)
        error = (places + move[:d] * step / STEPS - now[:, 0])[axes]
        if goal.kind == "frame_pose":
            error = np.concatenate([error, _turn(turned, rotation)])
        correction = np.linalg.pinv(J, rcond=1e-6) @ error
        q, rate = q + correction, np.maximum(rate, np.abs(correction) * STEPS)
        seen.append(float(_regularity(J)))
        if seen[-1] < KEPT * seen[0] or np.any(q < low) or np.any(q > high):
            return None
    if min(seen) < 1e-6 or np.linalg.norm(error) > 0.1 * np.linalg.norm(move):  # one step behind: 1/STEPS
        return None
    return _Way(start, places[axes], (places + move[:d])[axes], _rpy(turned), min(seen), rate)


def _turn(wanted: Array, rotation: Array) -> Array:
    """The small turn from a rotation to the wanted one, in the world [rad]."""
    difference = wanted @ rotation.T
    skew = (difference - difference.T) / 2
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def _joint_way(robot: Robot) -> _Way:
    """Every joint from the middle of its range a little up."""
    ranges = [
        1.0 if joint.lower is None or joint.upper is None else min(joint.upper - joint.lower, 2.0)
        for joint in robot.coordinates
    ]
    middle = [_nearest_to_zero(j) if j.lower is None else (j.lower + (j.upper or 0.0)) / 2 for j in robot.coordinates]
    q = np.round(np.array(middle), 6)
    move = STRIDES[0] * np.array(ranges)
    return _Way(q, q, q + move, (0.0, 0.0, 0.0), math.inf, move)


def _rpy(R: Array) -> tuple[float, float, float]:
    """Roll, pitch, yaw of R = R_z(yaw) R_y(pitch) R_x(roll)."""
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def _spec(name: str, urdf: str, robot: Robot, held: Mapping[str, float], goal: _Goal, way: _Way) -> str:
    joints = [joint.name for joint in robot.coordinates]
    text = f"""# A first controller for {" ".join(Path(urdf).name.split())}. Every number is a starting point:
# `clikgen analyse` says how far gains, sampling time and filter may go. The joints, as lists below order them:
{_wrapped(joints)}

name = "{name}"
description = {_string(f"first controller of {Path(urdf).name}")}
period = 0.005          # T [s]
law = "augmented"       # or "nsb", the paper's (eq. 11)

[robot]
urdf = {_string(urdf)}
# base = "holonomic"    # a mobile base under it: "holonomic" or "differential"
"""
    if held:
        text += "\n[robot.lock]            # [m, rad] joints that this controller leaves where they are\n"
        text += "".join(f"{_string(joint)} = {value!r}\n" for joint, value in held.items())
    text += "\n# Tasks, the highest priority first.\n" + _limits(robot) + _tool(goal, way)
    text += f"""[[tasks]]
name = "posture"
kind = "posture"
posture = {_numbers(way.q)}     # [m, rad]
gain = {10.0 if goal.kind == "posture" else 1.0}              # [1/s]
"""
    if all(moved.velocity for moved in robot.inputs):
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


def _limits(robot: Robot) -> str:
    """The task that keeps the joints within their limits, where there are any."""
    limited = [joint for joint in robot.coordinates if joint.lower is not None]
    margins = [_margin(joint) for joint in limited]
    if not margins or any(abs(end or 0.0) > FAR for joint in limited for end in (joint.lower, joint.upper)):
        return ""
    margin = f"{MARGIN}  " if min(margins) == MARGIN else _numbers(margins)
    return f"""[[tasks]]
name = "limits"
kind = "joint_limits"
margin = {margin}         # [m, rad]

[tasks.activation]      # how the task begins and ends to act
kind = "barrier"        # the default: a joint nears its margin ever slower, never faster than γ times the way left
rate = 10.0             # γ [1/s]

"""


def _tool(goal: _Goal, way: _Way) -> str:
    """The task that moves the frame, if any."""
    if goal.kind == "posture":
        return ""
    axes = ""
    if goal.kind == "frame_position" and len(goal.axes) < 3:
        axes = (
            f"axes = {json.dumps(['xyz'[axis] for axis in goal.axes])}          # of the world: it cannot follow all\n"
        )
    damping = ""
    if KEPT * way.regularity < NEAR_SINGULARITY.near:
        near = float(f"{KEPT * way.regularity:.1g}")
        damping = (
            f"damping = {{ maximum = {near!r}, near = {near!r} }}     # acts where the least singular value is less\n"
        )
    return f"""[[tasks]]
name = "tool"
kind = "{goal.kind}"
frame = {_string(goal.frame)}
{axes}gain = 10.0             # K [1/s]
speed = 1.0             # [1/s of the error] the feedback asks for no more than this
{damping}
"""


def _scenario(name: str, goal: _Goal, way: _Way, robot: Robot) -> str:
    limits = np.array([joint.velocity or math.inf for joint in robot.coordinates])
    peak = 15 / 8  # of the spline's velocity, over its mean
    there = max(SHORTEST, math.ceil(peak * float((way.rate / (AT_MOST * limits)).max())))
    waypoints = ", ".join(_numbers(place) for place in (way.start, way.there, way.start))
    text = f"""# A first run of {name}: there and back.

name = "{name}_first"
description = "{name} leads its {"joints" if goal.kind == "posture" else "tool"} there and back"
controller = "{name}"
duration = {2 * there + REST}          # [s]
q0 = {_numbers(way.q)}     # [m, rad]

[references.{"posture" if goal.kind == "posture" else "tool"}]
kind = "spline"
waypoints = [{waypoints}]     # [m{", rad" if goal.kind == "posture" else ""}]
times = [0.0, {float(there)}, {2.0 * there}]
"""
    if goal.kind == "frame_pose":
        text += f"""
[references.tool_orientation]
kind = "orientation"
rpy = {_numbers(way.rpy)}   # [rad] as it starts
"""
    return text


def _wrapped(names: Sequence[str]) -> str:
    """Names in lines of comments."""
    lines = ["#"]
    for i, joint in enumerate(names):
        word = " ".join(joint.split()) + ("," if i + 1 < len(names) else "")
        if len(lines[-1]) + len(word) > 110:
            lines.append("#")
        lines[-1] += f" {word}"
    return "\n".join(lines)


def _string(text: str) -> str:
    """A TOML string."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _numbers(values: Sequence[float] | Array) -> str:
    return "[" + ", ".join(f"{value:.6g}" if value else "0.0" for value in map(float, values)) + "]"
