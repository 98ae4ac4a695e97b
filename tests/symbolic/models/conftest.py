"""What our kinematics makes of a robot, as arrays over many configurations."""

import casadi as ca
import numpy as np
import pytest

from clikgen.symbolic.models.table import RobotTable
from clikgen.symbolic.tree import KinematicTree


def link_poses(robot, q):
    """World pose of every link at q (N, n), shape (N, links, 3, 4): rotation and position."""
    symbol = ca.SX.sym("q", q.shape[1])
    tree = KinematicTree.at(robot, symbol)
    columns = [part for link in robot.links for part in (tree.poses[link].rotation, tree.poses[link].position)]
    function = ca.Function("poses", [symbol], [ca.densify(ca.horzcat(*columns))])
    return np.array(function.map(len(q))(q.T)).reshape(3, len(q), len(robot.links), 4).transpose(1, 2, 0, 3)


def link_jacobians(robot, q):
    """Jacobian of every link at q (N, n), shape (N, links, 6, n): linear, then angular velocity in the world."""
    n = q.shape[1]
    symbol = ca.SX.sym("q", n)
    tree = KinematicTree.at(robot, symbol)
    stacked = [ca.vertcat(tree.position_jacobian(link), tree.angular_jacobian(link)) for link in robot.links]
    function = ca.Function("jacobians", [symbol], [ca.densify(ca.horzcat(*stacked))])
    return np.array(function.map(len(q))(q.T)).reshape(6, len(q), len(robot.links), n).transpose(1, 2, 0, 3)


@pytest.fixture(scope="session")
def poses():
    return link_poses


@pytest.fixture(scope="session")
def jacobians():
    return link_jacobians


@pytest.fixture
def build(tmp_path):
    """The model of a [robot] table whose files lie in tmp_path."""
    return lambda **table: RobotTable.parse(table, "spec.toml").build(tmp_path, "spec.toml")
