"""A differential drive in the loop: the base rolls, whatever law, filter and planner make of its velocity."""

import numpy as np
import pytest

from clikgen.symbolic.models.table import RobotTable

ARM = {
    "space": "planar",
    "base": {"kind": "differential", "mount_xyz": [0.2, 0.0, 0.0]},
    "joints": [
        {"name": "shoulder", "type": "revolute", "link": "upper", "lower": -2.8, "upper": 2.8, "velocity": 2.0},
        {"name": "elbow", "type": "revolute", "link": "lower", "xyz": [0.5, 0, 0]}
        | {"lower": -2.8, "upper": 2.8, "velocity": 2.0},
    ],
    "frames": [{"name": "tool", "link": "lower", "xyz": [0.4, 0, 0]}],
}
TOOL = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0}


@pytest.fixture(params=["nsb", "augmented"])
def rolled(request, evaluated, tmp_path):
    """The loop with the filter half on, from rest to a goal beside and behind the base."""
    robot = RobotTable.parse(ARM, "the test").build(tmp_path, "the test").robot
    controller = evaluated(robot, TOOL, law=request.param, lam=0.5, velocity_limits={"kind": "scale"})
    assert controller.infos()["filter_cutoff"].shape == (4,)  # forward, turn and two joints
    assert controller.infos()["velocity_limit"].default[0] == 1.0  # of the base, forward
    q, outputs = controller.run(3000, [0.0, 0.0, 0.0, 0.6, -1.2], tool_reference=np.array([-0.5, 1.5]))
    return q, outputs


def test_the_base_never_slides_sideways(rolled):
    q, outputs = rolled
    dq, yaw = outputs["dq"], q[:-1, 2]
    sideways = -np.sin(yaw) * dq[:, 0] + np.cos(yaw) * dq[:, 1]
    np.testing.assert_allclose(sideways, 0, rtol=0, atol=1e-12)  # (q_next − q)/T loses the rounding of q over T
    forward = np.cos(yaw) * dq[:, 0] + np.sin(yaw) * dq[:, 1]
    np.testing.assert_allclose(outputs["base_velocity"], np.column_stack([forward, dq[:, 2]]), rtol=0, atol=1e-12)
    assert np.ptp(forward) > 0.05  # it did roll
    assert np.max(np.abs(outputs["base_velocity"][:, 0])) <= 1.0 + 1e-12


def test_the_tool_reaches_its_goal_all_the_same(rolled):
    _, outputs = rolled
    assert np.linalg.norm(outputs["tool_error"][-1]) < 1e-6
