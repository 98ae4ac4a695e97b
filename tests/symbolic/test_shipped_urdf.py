"""The shipped URDF files: the vendors' published geometry, the mirrored arms, and limits that make sense.

Pinocchio reads the files; the expected poses are products of Denavit-Hartenberg matrices from the vendors' tables.
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

FOLDER = Path(__file__).parents[2] / "symbolic" / "specs" / "robots"
FILES = sorted(FOLDER.glob("*.urdf"))
HALF_PI = np.pi / 2
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # in the plane y = 0

# Universal Robots, UR5e: a [m], d [m], alpha [rad] of joints 1 to 6, T_i = Rz(θ) Tz(d) Tx(a) Rx(alpha)
UR5E = [
    (0.0, 0.1625, HALF_PI),
    (-0.425, 0.0, 0.0),
    (-0.3922, 0.0, 0.0),
    (0.0, 0.1333, HALF_PI),
    (0.0, 0.0997, -HALF_PI),
    (0.0, 0.0996, 0.0),
]
# Franka Emika, Panda: a [m], d [m], alpha [rad] of joints 1 to 7, T_i = Rx(alpha) Tx(a) Rz(θ) Tz(d)
PANDA = [
    (0.0, 0.333, 0.0),
    (0.0, 0.0, -HALF_PI),
    (0.0, 0.316, HALF_PI),
    (0.0825, 0.0, HALF_PI),
    (-0.0825, 0.384, -HALF_PI),
    (0.0, 0.0, HALF_PI),
    (0.088, 0.0, HALF_PI),
]
PANDA_LOWER = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973]  # [rad]
PANDA_UPPER = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973]  # [rad]
PANDA_VELOCITY = [2.175] * 4 + [2.61] * 3  # [rad/s]
UR_LINKS = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]


def _rot(axis, angle):
    """The homogeneous matrix (4, 4) of a turn about x or z."""
    c, s = np.cos(angle), np.sin(angle)
    T = np.eye(4)
    i, j = {"x": (1, 2), "z": (0, 1)}[axis]
    T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
    return T


def _trans(x=0.0, y=0.0, z=0.0):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def _ur_poses(q):
    """base_T_frame of each of the vendor's frames as the file names them."""
    T, poses = np.eye(4), {"base_link": np.eye(4)}
    for link, (a, d, alpha), angle in zip(UR_LINKS, UR5E, q, strict=True):
        poses[link] = T @ _rot("z", angle) @ _trans(z=d)
        T = poses[link] @ _trans(x=a) @ _rot("x", alpha)
    return poses | {"tool0": T}


def _panda_poses(q):
    T, poses = np.eye(4), {"link0": np.eye(4)}
    for i, ((a, d, alpha), angle) in enumerate(zip(PANDA, q, strict=True), start=1):
        T = T @ _rot("x", alpha) @ _trans(x=a) @ _rot("z", angle) @ _trans(z=d)
        poses[f"link{i}"] = T
    flange = T @ _trans(z=0.107)
    return poses | {"flange": flange, "hand_tcp": flange @ _trans(z=0.1034) @ _rot("z", -np.pi / 4)}


def _model(name):
    return pin.buildModelFromUrdf(str(FOLDER / f"{name}.urdf"), mimic=True)


def _poses(model, q):
    """base_T_link (4, 4) of every link."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    bodies = [i for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    return {model.frames[i].name: data.oMf[i].homogeneous for i in bodies}


def _coordinates(model):
    """The names of the joints that have a coordinate, in its order."""
    free = [i for i in range(1, model.njoints) if model.joints[i].nv and "Mimic" not in model.joints[i].shortname()]
    return [model.names[i] for i in sorted(free, key=lambda i: model.joints[i].idx_q)]


def _samples(model, count=100):
    rng = np.random.default_rng(5)
    return rng.uniform(model.lowerPositionLimit, model.upperPositionLimit, (count, model.nq))


# ---- What the vendors publish ----


@pytest.mark.parametrize(("name", "published"), [("ur6", _ur_poses), ("panda7", _panda_poses)])
def test_every_link_frame_is_the_vendors(name, published):
    model = _model(name)
    for q in [np.zeros(model.nq), *_samples(model)]:
        poses, expected = _poses(model, q), published(q)
        assert poses.keys() == expected.keys()
        for link, T in expected.items():  # at most eight products of matrices of size 1
            np.testing.assert_allclose(poses[link], T, rtol=0, atol=1e-12, err_msg=link)


def test_limits_of_the_panda_are_the_published_ones():
    model = _model("panda7")
    np.testing.assert_array_equal(model.lowerPositionLimit, PANDA_LOWER)
    np.testing.assert_array_equal(model.upperPositionLimit, PANDA_UPPER)
    np.testing.assert_array_equal(model.velocityLimit, PANDA_VELOCITY)


def test_limits_of_the_ur_are_exact_multiples_of_pi():
    model = _model("ur6")
    turns = np.pi * np.array([2, 2, 1, 2, 2, 2])
    np.testing.assert_array_equal(model.lowerPositionLimit, -turns)
    np.testing.assert_array_equal(model.upperPositionLimit, turns)
    np.testing.assert_array_equal(model.velocityLimit, np.full(6, np.pi))


# ---- Two arms ----


def test_equal_angles_of_both_arms_are_mirror_images():
    """With the waist turned the other way, the left link's pose M T M is the right link's."""
    model = _model("dual_arm")
    names = _coordinates(model)
    other_side = {"left": "right", "right": "left"}
    swapped = [names.index("_".join(other_side.get(word, word) for word in name.split("_"))) for name in names]
    waist = names.index("waist")
    for q in _samples(model):
        mirrored = q[swapped]
        mirrored[waist] = -q[waist]
        poses, reflected = _poses(model, q), _poses(model, mirrored)
        left = [link for link in poses if link.startswith("left_")]
        assert len(left) == 10
        for link in left:
            expected = MIRROR @ poses[link] @ MIRROR
            twin = link.replace("left", "right")
            np.testing.assert_allclose(reflected[twin], expected, rtol=0, atol=1e-12, err_msg=link)


def test_two_arms_reach_as_far_as_documented():
    """Hanging arms: shoulder 0.7 + 0.05 + 0.45 m high, 0.2 m aside, then 0.28 + 0.25 + 0.12 m down to the hand."""
    model = _model("dual_arm")
    poses = _poses(model, np.zeros(model.nq))
    for side, y in (("left", 0.2), ("right", -0.2)):
        np.testing.assert_allclose(poses[f"{side}_hand"], _trans(0, y, 0.55), rtol=0, atol=1e-12)
        np.testing.assert_allclose(poses[f"{side}_forearm"], _trans(0, y, 0.92), rtol=0, atol=1e-12)


def test_positive_angles_raise_the_arm_ahead_and_aside_and_bend_the_elbow():
    model = _model("dual_arm")
    names = _coordinates(model)

    def hand(side, joint):
        q = np.zeros(model.nq)
        q[names.index(f"{side}_{joint}")] = HALF_PI
        return _poses(model, q)[f"{side}_hand"][:3, 3]

    for side, out in (("left", 1.0), ("right", -1.0)):
        np.testing.assert_allclose(hand(side, "shoulder_pitch"), [0.65, 0.2 * out, 1.2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(hand(side, "shoulder_roll"), [0, 0.85 * out, 1.2], rtol=0, atol=1e-12)
        np.testing.assert_allclose(hand(side, "elbow"), [0.37, 0.2 * out, 0.92], rtol=0, atol=1e-12)


@pytest.mark.parametrize("side", ["left", "right"])
def test_second_finger_moves_against_the_first(side):
    """And the hand's frame stays between the two."""
    model = _model("dual_arm")
    q = np.zeros(model.nq)
    q[_coordinates(model).index(f"{side}_gripper")] = 0.03
    poses = _poses(model, q)
    first, second = (poses[f"{side}_finger_{i}"][:3, 3] for i in (1, 2))
    palm = poses[f"{side}_palm"][:3, 3]
    out = 1 if side == "left" else -1
    np.testing.assert_allclose(first - palm, [0, 0.03 * out, -0.07], rtol=0, atol=1e-12)
    np.testing.assert_allclose(second - palm, [0, -0.03 * out, -0.07], rtol=0, atol=1e-12)


def test_two_arms_have_eighteen_coordinates():
    """Lift and waist, seven joints and a gripper a side; neither second finger has its own."""
    names = _coordinates(_model("dual_arm"))
    assert len(names) == 18
    assert not [name for name in names if name.endswith("_mimic")]


# ---- All files ----


def test_three_robots_are_shipped():
    assert [file.stem for file in FILES] == ["dual_arm", "panda7", "ur6"]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_file_opens_with_its_source_its_licence_and_what_it_leaves_out(file):
    opening, _, _ = file.read_text(encoding="ascii").partition("-->")
    assert opening.startswith("<!--")
    for words in (file.stem, "MIT licence", "Source of the dimensions", "Left out: meshes, mass and inertia"):
        assert words in opening


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_limits_enclose_a_range_and_velocities_are_those_of_a_robot(file):
    """Every moving joint: lower < upper, and 1 cm/s to 1 m/s or 1 to 4 rad/s."""
    moving = [joint for joint in ET.parse(file).getroot().iter("joint") if joint.get("type") != "fixed"]
    assert len(moving) >= 6
    for joint in moving:
        limit = {key: float(value) for key, value in joint.find("limit").items()}
        slow, fast = {"prismatic": (0.01, 1.0), "revolute": (1.0, 4.0)}[joint.get("type")]
        assert limit["lower"] < limit["upper"], joint.get("name")
        assert slow <= limit["velocity"] <= fast, joint.get("name")


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_right_angles_are_exact(file):
    """A turn written with fewer digits than a float holds would tilt every link after it."""
    origins = [origin for origin in ET.parse(file).getroot().iter("origin") if origin.get("rpy")]
    assert origins
    for origin in origins:
        angles = np.array([float(angle) for angle in origin.get("rpy").split()])
        np.testing.assert_array_equal(angles, np.round(angles / (np.pi / 4)) * (np.pi / 4))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_file_needs_no_other_file(file):
    root = ET.parse(file).getroot()
    assert not list(root.iter("mesh"))
    assert len(list(root.iter("visual"))) >= 6
