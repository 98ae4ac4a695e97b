"""The compiled kinematics of every controller that ships against Pinocchio, its model built joint by joint."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from clikgen.runtime.controller import CompiledController
from clikgen.symbolic.spec import read_spec, shipped_specs

SPECS = {path.stem: path for path in shipped_specs()}
COUNT = 1_000
EXACT = 1e-12  # [1, m] rounding of a dozen transforms of metres is a hundred times less


def pinocchio_of(robot):
    """The model, and for every link the joint that carries it and where it sits on it."""
    model, carried = pin.Model(), {robot.root: (0, pin.SE3.Identity())}
    for joint in robot.joints:
        parent, place = carried[robot.parent(joint)]
        place = place * pin.SE3(Rotation.from_euler("xyz", joint.rpy).as_matrix(), np.array(joint.xyz))
        assert joint.mimic is None
        if joint.type == "fixed":
            carried[joint.link] = parent, place
            continue
        axis = np.array(joint.axis, dtype=float)
        kind = pin.JointModelPrismaticUnaligned if joint.type == "prismatic" else pin.JointModelRevoluteUnaligned
        carried[joint.link] = model.addJoint(parent, kind(axis), place, joint.name), pin.SE3.Identity()
    return model, carried


@pytest.fixture(params=SPECS)
def case(request):
    robot = read_spec(SPECS[request.param]).robot
    controller = CompiledController.load(request.param)
    low, high = np.clip(controller.manifest.limits, -3, 3).T
    q = np.random.default_rng(0).uniform(low, high, (COUNT, len(low)))
    return robot, controller, q, *pinocchio_of(robot)


def columns(robot, model):
    """Where Pinocchio has the coordinates of q."""
    return [model.idx_qs[model.getJointId(joint.name)] for joint in robot.coordinates]


def test_every_link_is_where_pinocchio_has_it(case):
    robot, controller, q, model, carried = case
    pose = controller.kinematics.map(COUNT, {"q": q})["link_pose"]
    data, order = model.createData(), columns(robot, model)
    for k in range(COUNT):
        theirs = np.zeros(model.nq)
        theirs[order] = q[k]
        pin.forwardKinematics(model, data, theirs)
        for i, joint in enumerate(robot.joints):
            parent, place = carried[joint.link]
            expected = (data.oMi[parent] * place).homogeneous[:3]
            np.testing.assert_allclose(pose[k, i], expected, rtol=0, atol=EXACT, err_msg=joint.link)


def test_every_task_s_frame_moves_as_pinocchio_says(case):
    """Position, orientation or both, of the tasks that hold a frame in the world."""
    robot, controller, q, model, carried = case
    rows = {"frame_position": slice(0, 3), "frame_orientation": slice(3, 6), "frame_pose": slice(0, 6)}
    tasks = [task for task in controller.manifest.tasks if task.kind in rows]
    assert tasks
    jacobians = controller.jacobians.map(COUNT, {"q": q})
    order = columns(robot, model)
    for task in tasks:
        frame = robot.frame(task.frame.name)
        parent, place = carried[frame.link]
        own = pin.SE3(Rotation.from_euler("xyz", frame.rpy).as_matrix(), np.array(frame.xyz))
        index = model.addFrame(pin.Frame(f"{task.name}_frame", parent, 0, place * own, pin.OP_FRAME))
        data = model.createData()
        for k in range(COUNT):
            theirs = np.zeros(model.nq)
            theirs[order] = q[k]
            J = pin.computeFrameJacobian(model, data, theirs, index, pin.LOCAL_WORLD_ALIGNED)[:, order]
            ours = jacobians[f"{task.name}_jacobian"][k].reshape(-1, len(order))
            expected = J[rows[task.kind]][: len(ours)]  # a planar task has x and y
            np.testing.assert_allclose(ours, expected, rtol=0, atol=EXACT, err_msg=task.name)
