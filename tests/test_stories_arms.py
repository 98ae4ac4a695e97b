"""What the scenarios of panda7, mobile_panda and dual_arm are told for, in figures."""

import numpy as np
import pytest

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare


def run(name):
    scenario = read_scenario(find_scenario(name))
    return prepare(CompiledController.load(scenario.controller), scenario, CASES[1]).in_c()


def largest(rollout, signal):
    return np.max(np.linalg.norm(rollout.signals[signal].reshape(len(rollout.t), -1), axis=1))


@pytest.mark.parametrize("name", ["shelf", "corridor", "carry"])
def test_it_starts_on_its_references_ends_on_them_and_never_jumps(name):
    rollout = run(name)
    for signal, values in rollout.signals.items():
        if signal.endswith("_error") and not signal.startswith(("posture", "heading")):
            sizes = np.linalg.norm(values.reshape(len(values), -1), axis=1)
            assert sizes[0] < 1e-3, signal  # q0 and the waypoints have four digits
            assert sizes[-1] < 1e-6, signal
    limits = np.array([joint.velocity for joint in rollout.manifest.joints])
    assert np.all(np.abs(rollout.dq) <= limits * (1 + 1e-12))
    assert np.max(np.abs(np.diff(rollout.dq, axis=0))) < 0.05  # [m/s, rad/s] a step; 0.034 where a contact closes
    assert np.all((rollout.q > rollout.manifest.limits[:, 0]) & (rollout.q < rollout.manifest.limits[:, 1]))


def test_shelf_keeps_its_pose_while_a_ball_pushes_the_elbow():
    rollout = run("shelf")
    assert 0.15 < rollout.active.mean() < 0.5
    assert not rollout.active[rollout.t < 9.5].any()  # neither beam nor table is touched; the ball comes at 10.1 s
    assert np.min(rollout.signals["clearance"]) > -0.007  # where the avoidance has faded in against the pose
    assert largest(rollout, "hand_error") < 1e-4  # [m] the seventh joint is enough to give way
    assert largest(rollout, "hand_orientation_error") < 2e-4  # [rad]
    moved = np.abs(rollout.q[-1] - rollout.q[np.searchsorted(rollout.t, 9.5)])
    assert np.max(moved) > 0.1  # and the arm did give way


def test_corridor_shares_the_motion_between_base_and_arm_past_three_obstacles():
    rollout = run("corridor")
    points = [point.name for point in rollout.manifest.points]
    met = (rollout.signals["distance"] < rollout.parameters["influence_radius"]).any(axis=0)
    assert {name.split("_")[0] for name, touched in zip(points, met, strict=True) if touched} >= {"base", "elbow"}
    pose = CompiledController.load("mobile_panda").kinematics.map(len(rollout.t), {"q": rollout.q[:-1]})
    apart = np.linalg.norm(pose["point_position"][:, None] - rollout.obstacle_center[:, :, None], axis=3)
    gaps = apart - rollout.obstacle_radius[:, None] - rollout.parameters["influence_radius"]
    assert np.all(gaps.min(axis=(0, 2)) < -0.005)  # each of the three is met
    assert 0.2 < rollout.active.mean() < 0.5
    assert np.min(rollout.signals["clearance"]) > -0.03  # [m] of influence radii of 0.15 to 0.45 m
    assert largest(rollout, "hand_error") < 3e-4  # [m] over a way of 3 m: the Euler lag, no more
    assert largest(rollout, "hand_orientation_error") < 2e-4  # [rad]
    assert rollout.q[-1, 0] > 2.9  # [m] the base went along
    assert np.max(np.abs(rollout.dq[:, 2:])) > 0.2  # [rad/s] and the arm moved


def test_carry_keeps_the_hands_together_and_the_arms_apart():
    rollout = run("carry")
    assert largest(rollout, "right_error") < 1e-4  # [m] of the right hand's place beside the left
    assert largest(rollout, "left_error") < 2e-4
    least = np.min(rollout.signals["apart_distance"])
    assert 0.036 < least < 0.04  # [m] 0.0377: into the margin of 40 mm; without the task forearm and torso would meet
    travelled = np.ptp(rollout.position, axis=0)
    assert np.all(travelled > [0.05, 0.1, 0.15])
