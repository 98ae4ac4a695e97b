"""Constants put at what they stand for: which, how they are told, and how far that moves the robot."""

import math

import numpy as np
import pytest

from clikgen.symbolic.models.snap import largest_movement, random_configurations, snapped

JOINT = {"name": "x", "type": "revolute", "link": "arm", "lower": -3, "upper": 3}


@pytest.mark.parametrize(
    ("angle", "exact", "name"),
    [
        (1.5708, math.pi / 2, "(pi/2)"),
        (-1.5708, -math.pi / 2, "(-pi/2)"),
        (3.1416, math.pi, "(pi)"),
        (-3.14159, -math.pi, "(-pi)"),
        (0.7854, math.pi / 4, "(pi/4)"),
        (2.35619, 3 * math.pi / 4, "(3pi/4)"),
        (0.2618, math.pi / 12, "(pi/12)"),
        (-4e-15, 0.0, "(0)"),
    ],
)
def test_angle_near_a_part_of_pi_becomes_that(angle, exact, name, build):
    model = build(joints=[JOINT | {"rpy": [angle, 0, 0]}], snap=True)
    assert model.robot.joints[0].rpy == (exact, 0.0, 0.0)
    assert math.copysign(1, model.robot.joints[0].rpy[0]) == (math.copysign(1, angle) if exact else 1)
    assert model.notes[0] == f"snapped joint 'x' rpy[0] {angle!r} -> {exact:.8g} {name}"


def test_note_reads_as_in_the_documentation(build):
    model = build(joints=[JOINT | {"rpy": [1.5708, 0, 0]}], snap=True)
    assert model.notes[0] == "snapped joint 'x' rpy[0] 1.5708 -> 1.5707963 (pi/2)"


@pytest.mark.parametrize("angle", [1.57, 0.1, 1.5708 + 1e-4, 0.0, math.pi / 2, -math.pi])
def test_angle_that_is_exact_or_no_part_of_pi_stays(angle, build):
    model = build(joints=[JOINT | {"rpy": [0, angle, 0]}], snap=True)
    assert model.robot == build(joints=[JOINT | {"rpy": [0, angle, 0]}]).robot
    assert model.notes == ("snap: nothing to change",)


def test_length_within_rounding_of_a_micrometre_becomes_that(build):
    xyz = [0.33300000000000002, 0.0825000000004, -1e-17]
    robot = build(joints=[JOINT | {"xyz": xyz}], snap=True).robot
    assert robot.joints[0].xyz == (0.333, 0.0825, 0.0)
    for length in (0.0825004, 0.12345678, 1e-8):
        assert build(joints=[JOINT | {"xyz": [length, 0, 0]}], snap=True).robot.joints[0].xyz[0] == length


def test_axis_near_one_of_the_coordinate_axes_becomes_that(build):
    tilt = 5e-5
    axis = [math.sin(tilt), 0.0, -math.cos(tilt)]
    model = build(joints=[JOINT | {"axis": axis}], snap=True)
    assert model.robot.joints[0].axis == (0.0, 0.0, -1.0)
    assert model.notes[0] == f"snapped joint 'x' axis {axis} -> [0, 0, -1]"


def test_slanted_axis_stays_a_unit_vector(build):
    axis = np.array([0.6, 0.8, 1e-6])
    axis /= np.linalg.norm(axis)
    snapped_axis = build(joints=[JOINT | {"axis": axis.tolist()}], snap=True).robot.joints[0].axis
    assert snapped_axis[2] == 0.0
    assert math.isclose(math.hypot(*snapped_axis), 1.0, rel_tol=0, abs_tol=1e-15)


def test_numbers_of_a_dh_table_and_of_frames_are_snapped_too(build):
    row = {"name": "x", "a": 0.1 + 1e-12, "alpha": -1.5708, "d": 0.2 + 1e-12, "theta": 0.7854, "lower": -1, "upper": 1}
    frame = {"name": "tool", "link": "x_link", "rpy": [0, 3.1416, 0], "xyz": [0.1 + 1e-12, 0, 0]}
    robot = build(dh={"convention": "standard", "rows": [row]}, frames=[frame], snap=True).robot
    moving, offset = robot.joints
    assert (moving.xyz[2], moving.rpy[2]) == (0.2, math.pi / 4)
    assert (offset.xyz[0], offset.rpy[0]) == (0.1, -math.pi / 2)
    assert (robot.frames[0].xyz[0], robot.frames[0].rpy[1]) == (0.1, math.pi)


def test_limits_are_left_alone(build):
    joint = JOINT | {"lower": -1.5708, "upper": 3.1416, "velocity": 1.5708, "rpy": [1.5708, 0, 0]}
    moved = build(joints=[joint], snap=True).robot.joints[0]
    assert (moved.lower, moved.upper, moved.velocity) == (-1.5708, 3.1416, 1.5708)


ARM = [
    JOINT | {"rpy": [1.5708, 0, 0]},
    JOINT | {"name": "y", "link": "hand", "xyz": [0.8, 0, 0], "rpy": [0, -1.5708, 0.3]},
]
FRAME = {"name": "tool", "link": "hand", "xyz": [0, 0.5, 0.1], "rpy": [0.7854, 0, 0]}


def test_movement_that_is_told_is_the_largest_of_a_thousand_configurations(build, poses):
    before, model = build(joints=ARM, frames=[FRAME]), build(joints=ARM, frames=[FRAME], snap=True)
    metres, radians = largest_movement(before.robot, model.robot)
    assert model.notes[-1] == f"snapping moves no frame by more than {metres:.2g} m and {radians:.2g} rad"

    q = random_configurations(before.robot, 1000, seed=0)
    a, b = poses(before.robot, q), poses(model.robot, q)
    tool_a, tool_b = (at[:, 2, :, :3] @ FRAME["xyz"] + at[:, 2, :, 3] for at in (a, b))
    links = np.linalg.norm(a[..., 3] - b[..., 3], axis=-1).max()
    assert metres == pytest.approx(max(links, np.linalg.norm(tool_a - tool_b, axis=-1).max()), rel=1e-9)
    assert 1e-6 < metres < 2 * 3.7e-6 * 1.4  # two angles 3.7e-6 off, with 1.4 m of arm behind them
    # 3.7e-6 twice and π/4 − 0.7854 = 1.8e-6
    assert 3e-6 < radians < 9.2e-6


def test_turning_one_joint_is_measured_as_that_turn(build):
    """By hand: 1e-3 rad about z moves what is 1 m away by 2 sin(0.5e-3) m."""
    link = {"name": "tip", "type": "fixed", "link": "tip", "xyz": [1, 0, 0]}
    one, other = (build(joints=[JOINT | {"rpy": [0, 0, yaw]}, link]).robot for yaw in (0.0, 1e-3))
    metres, radians = largest_movement(one, other)
    assert metres == pytest.approx(2 * math.sin(0.5e-3), rel=1e-9)
    assert radians == pytest.approx(1e-3, rel=1e-9)


def test_snapping_twice_changes_nothing_more(build):
    once, _ = snapped(build(joints=ARM, frames=[FRAME]).robot)
    assert snapped(once) == (once, ("snap: nothing to change",))


def test_random_configurations_keep_limits_and_one_turn(build):
    joints = [
        JOINT | {"lower": 1.0, "upper": 1.5},
        {"name": "turn", "type": "continuous", "link": "b"},
        {"name": "slide", "type": "prismatic", "link": "c", "lower": -1000, "upper": 0.5},
    ]
    q = random_configurations(build(joints=joints).robot, 1000, seed=0)
    assert q.shape == (1000, 3)
    for column, (low, high) in zip(q.T, [(1.0, 1.5), (-math.pi, math.pi), (-10.0, 0.5)], strict=True):
        assert low <= column.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < column.max() <= high
