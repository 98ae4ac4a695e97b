"""The stories that `snake` and `inspection` tell: who gives way to whom, and that all else is in order."""

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import shipped_folder

SETTLED = 1.0  # [s] ten time constants of the tool's gain 10/s: e^-10 of a conflict's 6 mm is 0.3 um
CONTINUOUS = 0.55  # of the largest step of the velocity is left at half the period; 0.5 but for where the samples lie


def rollout(name, **parameters):
    scenario = read_scenario(find_scenario(name))
    scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, **parameters}})
    controller = CompiledController.load(shipped_folder() / scenario.controller)
    return prepare(controller, scenario, CASES[1]).in_c()


@pytest.fixture(scope="module")
def snake():
    return rollout("snake")


@pytest.fixture(scope="module")
def inspection():
    return rollout("inspection")


def norms(run, name):
    return np.linalg.norm(run.signals[name], axis=1)


def largest_velocity_step(run):
    return np.abs(np.diff(run.dq, axis=0)).max()


def clear_of(held, run):
    """Steps at which nothing has been held for SETTLED, (N,)."""
    memory = np.ones(round(SETTLED / run.period) + 1)
    return np.convolve(held, memory)[: held.size] < 0.5


def spells(held):
    """How often it begins; what chatters does many times."""
    return int(np.sum(np.diff(held.astype(int), prepend=0) == 1))


def gaps(run):
    """From each point of interest to each obstacle, (N, obstacles, points) [m]."""
    controller = CompiledController.load(shipped_folder() / run.scenario.controller)
    points = controller.kinematics.map(len(run.t), {"q": run.q[:-1]})["point_position"]
    way = points[:, None] - run.obstacle_center[:, :, None]
    return np.linalg.norm(way, axis=3) - run.obstacle_radius[:, None]


def test_snake_follows_its_loop_to_a_tenth_of_a_millimetre_wherever_no_obstacle_is_in_the_way(snake):
    error, free = norms(snake, "tool_error"), clear_of(snake.active, snake)
    assert error[0] < 1e-4  # q0 is on the path, to the four digits of its waypoints
    assert free.mean() > 0.5
    assert error[free].max() < 2e-4  # an Euler step lags by T |q̈| of the path, 0.07 mm here
    assert error[-1] < 1e-6
    assert np.abs(snake.dq[-1]).max() < 0.02  # the joints only drift on toward a dexterous shape


def test_snake_gives_way_to_each_of_its_obstacles_once_and_never_enters_an_influence_region(snake):
    depth = 0.12 - gaps(snake)  # of each point of interest in each influence region of 12 cm, (N, obstacles, points)
    for obstacle, point in ((0, 1), (1, 3)):  # the one beside the body, and the one that comes down on its back
        assert spells(depth[:, obstacle, point] > -0.001) == 1
        # [m] the region is met, and a sample beyond it only by the curvature of the way to it, 0.2 um
        assert -1e-4 < depth[:, obstacle, point].max() < 1e-6
    assert depth.max() < 1e-6
    assert spells(snake.signals["barrier_steps"] > 0) == 2
    assert not snake.active[0]
    assert 0.1 < snake.active.mean() < 0.5
    assert np.ptp(snake.obstacle_center[:, 1, 1]) > 0.2
    assert norms(snake, "tool_error").max() < 0.006  # [m] of what the obstacles take the tool loses the share ε²


def test_snake_s_velocity_is_continuous(snake):
    """0.030 rad/s a step at most, where the barrier begins to act: the half of it at half the period."""
    assert largest_velocity_step(snake) < 0.04
    finer = rollout("snake", period=snake.period / 2)
    assert largest_velocity_step(finer) < CONTINUOUS * largest_velocity_step(snake)


def test_inspection_keeps_tool_and_camera_on_target_until_the_table_pushes(inspection):
    free = clear_of(inspection.active, inspection)
    assert free.mean() > 0.6
    assert norms(inspection, "tool_error")[free].max() < 1e-4  # the Euler lag, 0.04 mm
    assert norms(inspection, "camera_error").max() < 1e-3  # [rad] looks at the part all the time; 0.2 mrad
    assert np.abs(inspection.dq).max() < 1.0  # a third of the limit: far from singular


def test_inspection_is_held_off_the_table_at_the_end_without_a_jump(inspection):
    distance = inspection.signals["walls_distance"][:, 0]  # of each point from the table (N, points) [m]
    margin, held = inspection.parameters["walls_margin"][0], inspection.active
    asked = inspection.reference[-1, 2] - inspection.parameters["walls_offset"][0]  # above the table [m]
    assert asked < margin - 0.005
    assert -1e-9 < distance.min() - margin < 1e-6  # [m] the table is flat: nothing of the margin is lost to a sample
    assert held[-1]
    assert spells(held) == 1
    assert held.mean() > 0.2
    assert norms(inspection, "tool_error").max() < 0.0063  # the 6 mm that the table takes, no more
    assert largest_velocity_step(inspection) < 0.01  # [rad/s] 0.0045, on the free way: the table takes over smoothly
    assert np.abs(inspection.dq[-1]).max() < 1e-6
