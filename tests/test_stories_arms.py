"""What the scenarios of panda7, mobile_panda and dual_arm are told for, in figures."""

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare

CONTINUOUS = 0.55  # of the largest step of the velocity is left at half the period; 0.5 but for where the samples lie
KEPT = 1e-6  # [m] by which a sample may be beyond a boundary; the barrier holds to rounding where nothing curves
MET = 1e-4  # [m] so near a boundary the barrier takes nearly all motion toward it
ENDS = {  # [m, rad] the error at the end, where the contacts of shelf and corridor still take their share
    "shelf": 1e-4,
    "corridor": 2e-4,
    "carry": 1e-6,
}


def run(name, **parameters):
    scenario = read_scenario(find_scenario(name))
    scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, **parameters}})
    return prepare(CompiledController.load(scenario.controller), scenario, CASES[1]).in_c()


def largest(rollout, signal):
    return np.max(np.linalg.norm(rollout.signals[signal].reshape(len(rollout.t), -1), axis=1))


def largest_step(rollout):
    """Of the velocity, from one period to the next [m/s, rad/s]."""
    return np.max(np.abs(np.diff(rollout.dq, axis=0)))


@pytest.mark.parametrize("name", ENDS)
def test_it_starts_on_its_references_ends_on_them_and_never_jumps(name):
    rollout = run(name)
    for signal, values in rollout.signals.items():
        if signal.endswith("_error") and not signal.startswith(("posture", "heading")):
            sizes = np.linalg.norm(values.reshape(len(values), -1), axis=1)
            assert sizes[0] < 1e-3, signal  # q0 and the waypoints have four digits
            assert sizes[-1] < ENDS[name], signal
    limits = np.array([joint.velocity for joint in rollout.manifest.joints])
    assert np.all(np.abs(rollout.dq) <= limits * (1 + 1e-12))
    assert largest_step(rollout) < 0.05  # [m/s, rad/s]; 0.048 in corridor, where a second contact joins the first
    finer = run(name, period=rollout.period / 2)
    assert largest_step(finer) < CONTINUOUS * largest_step(rollout)
    assert np.all((rollout.q > rollout.manifest.limits[:, 0]) & (rollout.q < rollout.manifest.limits[:, 1]))


@pytest.mark.parametrize("name", ENDS)
def test_the_barrier_can_keep_every_contact_and_says_so(name):
    rollout = run(name)
    assert np.all(rollout.signals["barrier_solved"] == 1)
    assert np.all(rollout.signals["barrier_row"] == -1)
    assert 1 <= np.max(rollout.signals["barrier_steps"]) <= 2  # one contact at a time, in corridor two


def test_shelf_keeps_its_pose_while_a_ball_pushes_the_elbow():
    rollout = run("shelf")
    assert 0.15 < rollout.active.mean() < 0.5
    assert not rollout.active[rollout.t < 9.5].any()  # neither beam nor table is touched; the ball comes at 10.1 s
    assert -KEPT < np.min(rollout.signals["clearance"]) < KEPT  # the ball comes to rest at the influence region
    assert largest(rollout, "hand_error") < 1e-4  # [m] the seventh joint is enough to give way
    assert largest(rollout, "hand_orientation_error") < 2e-4  # [rad]
    moved = np.abs(rollout.q[-1] - rollout.q[np.searchsorted(rollout.t, 9.5)])
    assert np.max(moved) > 0.1  # and the arm did give way


def test_corridor_shares_the_motion_between_base_and_arm_past_three_obstacles():
    rollout = run("corridor")
    points = [point.name for point in rollout.manifest.points]
    depth = rollout.signals["distance"] - rollout.parameters["influence_radius"]
    met = (depth < MET).any(axis=0)
    assert {name.split("_")[0] for name, touched in zip(points, met, strict=True) if touched} >= {"base", "elbow"}
    pose = CompiledController.load("mobile_panda").kinematics.map(len(rollout.t), {"q": rollout.q[:-1]})
    apart = np.linalg.norm(pose["point_position"][:, None] - rollout.obstacle_center[:, :, None], axis=3)
    gaps = apart - rollout.obstacle_radius[:, None] - rollout.parameters["influence_radius"]
    assert np.all(gaps.min(axis=(0, 2)) < MET)  # each of the three is met
    assert 0.2 < rollout.active.mean() < 0.5
    assert np.min(rollout.signals["clearance"]) > -KEPT  # and none is entered
    assert largest(rollout, "hand_error") < 3e-4  # [m] over a way of 3 m: the Euler lag, no more
    assert largest(rollout, "hand_orientation_error") < 1e-4  # [rad]
    assert rollout.q[-1, 0] > 2.9  # [m] the base went along
    assert np.max(np.abs(rollout.dq[:, 2:])) > 0.2  # [rad/s] and the arm moved


def test_carry_keeps_the_arms_apart_and_the_hands_together():
    rollout = run("carry")
    # ε² of what the barrier takes, and the Euler lag
    assert largest(rollout, "left_error") < 2e-4  # [m]
    assert largest(rollout, "left_turn_error") < 3e-4  # [rad]
    assert largest(rollout, "right_error") < 1e-4  # [m] the right hand's place beside the left
    assert 0.1 < rollout.active.mean() < 0.5
    least = np.min(rollout.signals["apart_distance"])
    # [m] the margin but for the curvature of a sample's way, 3 um; without the task forearm and torso would meet
    assert 0.04 - 5e-6 < least < 0.04 + KEPT
    travelled = np.ptp(rollout.position, axis=0)
    assert np.all(travelled > [0.05, 0.1, 0.15])
