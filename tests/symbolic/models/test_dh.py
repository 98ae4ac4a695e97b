"""Both conventions of Denavit-Hartenberg tables, against the textbooks' products of 4 by 4 matrices."""

import numpy as np
import pytest

from clikgen.symbolic.models.snap import random_configurations

# a, alpha, d, theta; the second and last rows have no offset, the third slides
NUMBERS = [(0.3, 0.7, 0.2, -0.4), (0.0, 0.0, 0.1, 0.5), (-0.2, -1.3, 0.4, 0.9), (0.1, 2.0, -0.3, 0.0), (0.0,) * 4]
TYPES = ["revolute", "revolute", "prismatic", "continuous", "revolute"]


def rows():
    """The table as a spec has it."""
    keys = ("a", "alpha", "d", "theta")
    table = [
        {"name": f"j{i}", "type": kind, **dict(zip(keys, NUMBERS[i], strict=True))} for i, kind in enumerate(TYPES)
    ]
    return [row | ({} if row["type"] == "continuous" else {"lower": -2.0, "upper": 2.0}) for row in table]


def standard(a, alpha, d, theta):
    """Denavit & Hartenberg 1955, as in Siciliano et al., Robotics, eq. 2.52."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]],
    )


def modified(a, alpha, d, theta):
    """Craig, Introduction to Robotics, eq. 3.6."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [[c, -s, 0, a], [s * ca, c * ca, -sa, -sa * d], [s * sa, c * sa, ca, ca * d], [0, 0, 0, 1]],
    )


@pytest.mark.parametrize("convention", [standard, modified], ids=lambda convention: convention.__name__)
def test_frame_of_every_row_is_the_textbooks_product(convention, build, poses):
    robot = build(dh={"convention": convention.__name__, "rows": rows()}).robot
    q = random_configurations(robot, 50, seed=5)
    links = [robot.links.index(f"j{i}_link") for i in range(len(TYPES))]
    ours = poses(robot, q)[:, links]
    for k, values in enumerate(q):
        world_T_row = np.eye(4)
        for i, (a, alpha, d, theta) in enumerate(NUMBERS):
            slides = TYPES[i] == "prismatic"
            moved = (d + values[i], theta) if slides else (d, theta + values[i])
            world_T_row = world_T_row @ convention(a, alpha, *moved)
            np.testing.assert_allclose(ours[k, i], world_T_row[:3], rtol=0, atol=1e-14)


@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_every_number_of_the_table_is_a_number_of_a_joint(convention, build):
    joints = build(dh={"convention": convention, "rows": rows()}).robot.joints
    assert [joint.name for joint in joints if joint.independent] == ["j0", "j1", "j2", "j3", "j4"]
    by_name = {joint.name: joint for joint in joints}
    for i, (a, alpha, d, theta) in enumerate(NUMBERS):
        assert (by_name[f"j{i}"].xyz, by_name[f"j{i}"].rpy) == ((0, 0, d), (0, 0, theta))
        if (a, alpha) == (0, 0):
            assert f"j{i}_offset" not in by_name
        else:
            offset = by_name[f"j{i}_offset"]
            assert (offset.type, offset.xyz, offset.rpy) == ("fixed", (a, 0, 0), (alpha, 0, 0))


def test_row_has_the_link_it_names(build):
    table = [rows()[0] | {"link": "upper-arm"}, rows()[1]]
    for convention in ("standard", "modified"):
        robot = build(dh={"convention": convention, "rows": table}, root="floor").robot
        assert robot.root == "floor"
        assert set(robot.links) == {"floor", "upper-arm", "upper-arm_axis", "j1_link"}
