"""The first spec: which link it moves, what it locks, and that nothing else of the robot is led astray."""

import tomllib

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.starter import starter

TURN = {"type": "revolute", "lower": -2.5, "upper": 2.5, "velocity": 2.0}
AXES = ([0, 0, 1], [0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0])
PLACES = ([0, 0, 0.3], [0, 0, 0], [0.4, 0, 0], [0.4, 0, 0], [0, 0, 0], [0.1, 0, 0])


def limb(name, parent, count=6, **more):
    """A chain of `count` turning joints NAME_1, NAME_2, ... from the link `parent`, links NAME_link_1, ..."""
    links = [parent, *(f"{name}_link_{i}" for i in range(1, count + 1))]
    return [
        TURN
        | {"name": f"{name}_{i + 1}", "link": links[i + 1], "parent": links[i]}
        | {"axis": AXES[i], "xyz": PLACES[i]}
        | more
        for i in range(count)
    ]


def fixed(link, parent):
    return {"name": f"{link}_mount", "type": "fixed", "link": link, "parent": parent, "xyz": [0.1, 0, 0]}


def first(*joints, frame=None, urdf="arm.urdf"):
    """The spec and the scenario, as their readers see them, and the notes."""
    robot = Robot.parse({"root": "base", "joints": joints}, "the test")
    made = starter("mine", urdf, robot, frame)
    return tomllib.loads(made.spec), tomllib.loads(made.scenario), made.notes


def moved(spec):
    return next(task["frame"] for task in spec["tasks"] if task["name"] == "tool")


def test_tool_is_preferred_to_what_hangs_beside_it():
    arm = limb("arm", "base")
    ends = [fixed("camera_optical", "arm_link_6"), fixed("tool0", "arm_link_6")]
    for order in (ends, ends[::-1]):
        assert moved(first(*arm, *order)[0]) == "tool0"


def test_arm_is_preferred_to_a_leg_with_fewer_joints():
    spec, _, notes = first(*limb("leg", "base", 3), *limb("arm", "base"))
    assert moved(spec) == "arm_link_6"
    assert "leg_link_3" in notes[0]  # could be chosen


def test_joints_that_do_not_carry_the_tool_stay_at_zero_or_near_it():
    leg = limb("leg", "base", 3, lower=0.5, upper=2.0)
    spec, scenario, _ = first(*leg, *limb("arm", "base"))
    assert scenario["q0"] == next(task["posture"] for task in spec["tasks"] if task["name"] == "posture")
    np.testing.assert_allclose(scenario["q0"][:3], 0.55, atol=1e-9)  # the lower limit and its margin
    assert all(-2.5 < value < 2.5 for value in scenario["q0"][3:])


def test_joint_without_room_is_locked_where_it_is():
    spec, scenario, _ = first(*limb("arm", "base"), *limb("lid", "base", 1, lower=0.2, upper=0.2))
    assert spec["robot"]["lock"] == {"lid_1": 0.2}
    assert len(scenario["q0"]) == 6


def test_arm_of_six_moves_a_pose_and_one_of_three_a_position():
    kinds = [first(*limb("arm", "base", count))[0]["tasks"][1]["kind"] for count in (6, 3)]
    assert kinds == ["frame_pose", "frame_position"]


def test_path_is_the_robots_and_texts_say_its_name_only():
    spec, _, _ = first(*limb("arm", "base"), urdf="../../far/away/arm.urdf")
    assert spec["robot"]["urdf"] == "../../far/away/arm.urdf"
    assert spec["description"] == "first controller of arm.urdf"


@pytest.mark.parametrize(("frame", "wanted"), [("arm_link_7", "did you mean 'arm_link_"), ("base", "no joint moves")])
def test_frame_that_cannot_be_moved_is_refused(frame, wanted):
    with pytest.raises(BadInput, match=wanted):
        first(*limb("arm", "base"), frame=frame)
