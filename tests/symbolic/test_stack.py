"""A stack of tasks of which some can never move is told so when it is generated."""

import pytest

TOOL = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 1.0}
LAST = {"name": "rest", "kind": "posture", "joints": ["j0"], "posture": [0.0], "gain": 1.0}


def notes(evaluated, robot, *tasks, law="augmented"):
    return evaluated(robot, *tasks, law=law).controller.notes


def test_a_sound_stack_has_nothing_to_note(evaluated, plane_arm, space_arm):
    assert notes(evaluated, plane_arm([0.5, 0.4, 0.3]), TOOL, LAST) == ()
    pose = {"name": "hand", "kind": "frame_pose", "frame": "tool", "gain": 1.0}
    lift = LAST | {"joints": ["lift"]}
    assert notes(evaluated, space_arm(), pose, lift) == ()


def test_a_task_that_is_singular_everywhere_is_named_with_its_rank(evaluated, plane_arm):
    flat = plane_arm([0.5, 0.4, 0.3]) | {"space": "spatial"}  # three coordinates, of which z never moves
    (note,) = notes(evaluated, flat, TOOL, LAST)
    assert note.startswith("task 'tool', of 3 rows, has rank 2")
    assert notes(evaluated, flat, TOOL | {"axes": ["x", "y"]}, LAST) == ()
    assert notes(evaluated, flat, TOOL | {"damping": 0.05}, LAST) == ()
    assert notes(evaluated, flat, TOOL, LAST, law="nsb") == ()


def test_the_last_task_may_be_singular(evaluated, plane_arm):
    assert notes(evaluated, plane_arm([0.5, 0.4, 0.3]) | {"space": "spatial"}, TOOL) == ()


@pytest.mark.parametrize("rows", [1, 3])
def test_a_task_in_conflict_with_those_above_is_named_with_what_is_left(evaluated, plane_arm, rows):
    posture = {"name": "pose", "kind": "posture", "gain": 1.0, "posture": [0.0] * rows}
    posture |= {"joints": ["j0", "j1", "j2"][:rows]}
    found = notes(evaluated, plane_arm([0.5, 0.4, 0.3]), TOOL, posture, LAST | {"name": "never", "joints": ["j2"]})
    if rows == 1:
        assert found == ()
    else:
        assert found[0].startswith("task 'pose', of 3 rows, keeps 1 beside the tasks above it")
