"""Constants that were meant as π/2 or 0.1273 but are a little off: put back on request, and told."""

import math
from collections.abc import Callable
from fractions import Fraction

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from clikgen.symbolic.robot import Joint, Robot, Vector
from clikgen.symbolic.tree import KinematicTree

Array = NDArray[np.float64]

ANGLE_TOLERANCE = 1e-4  # [rad] 1.5708 is 3.7e-6 off π/2; 1.57 is 8e-4 off and stays
LENGTH_TOLERANCE = 1e-9  # [m]
LENGTH_DECIMALS = 6  # of a metre
AXIS_TOLERANCE = 1e-4


def snapped(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """The robot with the origins and axes of its joints and frames snapped, and what that did, line by line.

    Angles within 1e-4 rad of a multiple of π/12 become that, lengths within 1e-9 m of a whole micrometre become
    that, entries of an axis within 1e-4 of 0 or ±1 become that, and the axis is a unit vector again. The last
    line says how far that moves a frame.
    """
    notes: list[str] = []
    joints = []
    for joint in robot.joints:
        what = f"joint '{joint.name}'"
        changed = {"xyz": _lengths(joint.xyz, what, notes), "rpy": _angles(joint.rpy, what, notes)}
        joints.append(joint.model_copy(update=changed | {"axis": _axis(joint, what, notes)}))
    frames = []
    for frame in robot.frames:
        what = f"frame '{frame.name}'"
        changed = {"xyz": _lengths(frame.xyz, what, notes), "rpy": _angles(frame.rpy, what, notes)}
        frames.append(frame.model_copy(update=changed))
    if not notes:
        return robot, ("snap: nothing to change",)
    result = robot.model_copy(update={"joints": tuple(joints), "frames": tuple(frames)})
    metres, radians = largest_movement(robot, result)
    return result, (*notes, f"snapping moves no frame by more than {metres:.2g} m and {radians:.2g} rad")


def _angles(rpy: Vector, what: str, notes: list[str]) -> Vector:
    return _each(rpy, f"{what} rpy", notes, _nice_angle)


def _lengths(xyz: Vector, what: str, notes: list[str]) -> Vector:
    return _each(xyz, f"{what} xyz", notes, _nice_length)


def _each(values: Vector, what: str, notes: list[str], nice: Callable[[float], tuple[float, str]]) -> Vector:
    """The three values, each put at its `nice` one; a note for each that changes."""
    result = list(values)
    for i, value in enumerate(values):
        exact, name = nice(value)
        if exact != value:
            result[i] = exact
            notes.append(f"snapped {what}[{i}] {value!r} -> {exact:.8g}{name}")
    return result[0], result[1], result[2]


def _nice_angle(angle: float) -> tuple[float, str]:
    share = Fraction(round(angle / (math.pi / 12)), 12)  # of π
    exact = share.numerator * math.pi / share.denominator
    if abs(angle - exact) > ANGLE_TOLERANCE:
        return angle, ""
    times = {1: "pi", -1: "-pi"}.get(share.numerator, f"{share.numerator}pi" if share else "0")
    return exact, f" ({times})" if share.denominator == 1 else f" ({times}/{share.denominator})"


def _nice_length(length: float) -> tuple[float, str]:
    exact = round(length, LENGTH_DECIMALS) + 0.0  # no -0
    return (exact if abs(length - exact) <= LENGTH_TOLERANCE else length), ""


def _axis(joint: Joint, what: str, notes: list[str]) -> Vector:
    """The unit vector along the axis, its entries near 0 or ±1 made so first."""
    if joint.type == "fixed":
        return joint.axis
    near = [round(entry) + 0.0 if abs(entry - round(entry)) <= AXIS_TOLERANCE else entry for entry in joint.axis]
    if tuple(near) == joint.axis:
        return joint.axis
    length = math.hypot(*near)
    axis = near[0] / length, near[1] / length, near[2] / length
    notes.append(f"snapped {what} axis {list(joint.axis)} -> [{', '.join(f'{entry:.8g}' for entry in axis)}]")
    return axis


def largest_movement(before: Robot, after: Robot, count: int = 1000, seed: int = 0) -> tuple[float, float]:
    """How far apart [m], [rad] two robots of the same joints have any link or frame in `count` configurations."""
    q = random_configurations(before, count, seed)
    (rotation, position), (other_rotation, other_position) = (_poses(robot, q) for robot in (before, after))
    # the chord between two rotations is |R − S| = √8 sin(angle / 2), which stays exact for small angles
    chord = np.sqrt(np.square(rotation - other_rotation).sum(axis=(-2, -1))).max()
    metres = np.sqrt(np.square(position - other_position).sum(axis=-1)).max()
    return float(metres), float(2 * np.arcsin(min(chord / math.sqrt(8), 1.0)))


def random_configurations(robot: Robot, count: int, seed: int) -> Array:
    """Joint positions (count, n) evenly between the limits, within one turn or 20 m."""
    joints = robot.coordinates
    reach = np.array([10.0 if joint.type == "prismatic" else math.pi for joint in joints])
    lower = np.array([-math.inf if joint.lower is None else joint.lower for joint in joints])
    upper = np.array([math.inf if joint.upper is None else joint.upper for joint in joints])
    middle = np.clip(0.0, lower, upper)
    low, high = np.maximum(lower, middle - reach), np.minimum(upper, middle + reach)
    return np.random.default_rng(seed).uniform(low, high, (count, len(joints)))


def _poses(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Rotations (N, frames, 3, 3) and positions (N, frames, 3) of all links and frames at q (N, n)."""
    symbol = ca.SX.sym("q", q.shape[1])
    tree = KinematicTree.at(robot, symbol)
    places = [(link, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for link in robot.links]
    places += [(frame.link, frame.xyz, frame.rpy) for frame in robot.frames]
    columns = [
        part
        for link, xyz, rpy in places
        for part in (tree.rotation(link, rpy), tree.poses[link].position + tree.poses[link].rotation @ ca.SX(xyz))
    ]
    function = ca.Function("poses", [symbol], [ca.densify(ca.horzcat(*columns))])
    values = np.array(function.map(len(q))(q.T))  # (3, 4 · frames · N)
    poses = values.reshape(3, len(q), len(places), 4).transpose(1, 2, 0, 3)
    return poses[..., :3], poses[..., 3]
