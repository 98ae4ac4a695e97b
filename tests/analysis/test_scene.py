"""What a scene says is where, against the forward kinematics of a small arm by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from clikgen.analysis.scene import Wall, even_steps, scene
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare

SCENARIO = {
    "name": "small",
    "description": "past a ball, a capsule and a wall",
    "controller": "small_arm",
    "duration": 4.0,
    "references": {
        "tip": {"kind": "line", "start": [0.6, 0.2, 0.5], "end": [0.3, 0.6, 0.4], "duration": 3.0},
        "wrist": {"kind": "turn", "start": [0, 0, 0], "end": [0, 0, 1.0], "duration": 3.0},
    },
    "obstacles": [
        {
            "radius": 0.1,
            "path": {"kind": "line", "start": [0.3, 0.9, 0.4], "end": [0.3, 0.5, 0.4], "duration": 4.0},
        }
    ],
    "capsules": [{"start": [-1, -1, 0], "end": [-1, -1, 2], "radius": 0.2}],
    "half_spaces": [{"normal": [0, 0, 1], "offset": -0.1}],
}


def rollout_of(controller, q0):
    return prepare(controller, Scenario.parse(SCENARIO | {"q0": q0}, "small"), CASES[3]).in_c()


@pytest.fixture(scope="module")
def fixed(small_arm):
    """The arm and its rollout."""
    controller = small_arm()
    return controller, rollout_of(controller, [0.3, -0.4, 0.9])


@pytest.fixture(scope="module")
def seen(fixed):
    controller, rollout = fixed
    return scene(controller, rollout, even_steps(rollout, 21))


def test_moments_are_even_and_reach_both_ends(fixed, seen):
    assert len(seen.steps) == 21
    assert (seen.steps[0], seen.steps[-1]) == (0, len(fixed[1].t) - 1)
    assert np.ptp(np.diff(seen.steps)) <= 1
    np.testing.assert_array_equal(seen.moments, fixed[1].t[seen.steps])
    assert len(even_steps(fixed[1], 10**6)) == len(fixed[1].t)


def test_segments_lead_from_joint_to_joint_and_to_the_tracked_frame(fixed, seen, small_arm_by_hand):
    # the column turns where it stands: no piece of the robot leads to it
    assert [segment.link for segment in seen.segments] == ["upper", "lower", "lower"]
    for k, step in enumerate(seen.steps):
        places, _ = small_arm_by_hand(fixed[1].q[step], np.zeros(3))
        ends = np.vstack([np.zeros((1, 3)), places])
        for i, segment in enumerate(seen.segments):
            np.testing.assert_allclose(segment.start[k], ends[i], atol=1e-12)
            np.testing.assert_allclose(segment.end[k], ends[i + 1], atol=1e-12)
    np.testing.assert_allclose(seen.joints[:, 2], seen.segments[2].start, atol=1e-15)
    assert seen.thickness == pytest.approx(0.025 * (0.4 + 0.5), rel=1e-9)  # the column and the upper arm


def test_no_pole_leads_to_a_base_that_slides(small_arm, small_arm_by_hand):
    controller = small_arm(base=True)
    rollout = rollout_of(controller, [0.5, 0.2, 0.3, -0.4, 0.9])
    each = scene(controller, rollout, [0, 200, 399])
    assert [segment.link for segment in each.segments] == ["upper", "lower", "lower"]
    for k, step in enumerate([0, 200, 399]):
        q = rollout.q[step]
        np.testing.assert_allclose(each.segments[0].start[k], [*q[:2], 0.0], atol=1e-12)
        np.testing.assert_allclose(each.segments[2].end[k], small_arm_by_hand(q[2:], [*q[:2], 0.0])[0][2], atol=1e-12)


def test_bodies_and_regions_move_with_their_links(fixed, seen, small_arm_by_hand):
    forearm, shoulder = seen.bodies
    assert (forearm.radius, forearm.is_ball, shoulder.radius, shoulder.is_ball) == (0.05, False, 0.08, True)
    assert [region.radius for region in seen.regions] == [0.15, 0.1]
    for k, step in enumerate(seen.steps):
        places, _ = small_arm_by_hand(fixed[1].q[step], np.zeros(3))
        np.testing.assert_allclose(np.stack([forearm.start[k], forearm.end[k]]), places[1:], atol=1e-12)
        np.testing.assert_allclose(shoulder.start[k], places[0], atol=1e-12)
        np.testing.assert_allclose(np.stack([region.center[k] for region in seen.regions]), places[1:], atol=1e-12)


def test_a_region_is_touched_when_it_was_since_the_moment_before(fixed, seen, small_arm_by_hand):
    _, rollout = fixed
    ball = np.linspace([0.3, 0.9, 0.4], [0.3, 0.5, 0.4], 401)[:400]
    touching = np.zeros((400, 2), dtype=bool)
    for k in range(400):
        for i, place in enumerate(small_arm_by_hand(rollout.q[k], np.zeros(3))[0][1:]):
            nearest = [-1, -1, np.clip(place[2], 0, 2)]
            distances = [np.linalg.norm(place - ball[k]) - 0.1, np.linalg.norm(place - nearest) - 0.2, place[2] + 0.1]
            touching[k, i] = min(distances) <= (0.15, 0.1)[i]
    assert 0 < touching[:, 1].sum() < 400
    begin = 0
    for k, step in enumerate(seen.steps):
        for i, region in enumerate(seen.regions):
            assert region.touched[k] == touching[begin : step + 1, i].any()
        begin = step + 1


def test_obstacles_are_where_the_scenario_says(seen):
    ball, capsule = seen.obstacles
    expected = np.array([0.3, 0.9, 0.4]) + seen.moments[:, None] / 4.0 * np.array([0.0, -0.4, 0.0])
    np.testing.assert_allclose(ball.start, expected, atol=1e-12)
    assert ball.is_ball
    assert ball.radius == 0.1
    np.testing.assert_array_equal(capsule.start[0], [-1, -1, 0])
    np.testing.assert_array_equal(capsule.end[-1], [-1, -1, 2])
    (wall,) = seen.walls
    np.testing.assert_array_equal(wall.normal, [0, 0, 1])
    assert wall.offset == -0.1


@pytest.mark.parametrize("normal", [[0, 0, 1], [1, 0, 0], [0.6, 0, -0.8], [0, -1, 0]])
def test_a_patch_of_a_wall_is_a_square_on_its_surface(normal):
    wall = Wall("w", np.array(normal, dtype=float), 0.3)
    corners = wall.patch(np.array([1.0, 2.0, 3.0]), 0.5)
    np.testing.assert_allclose(corners @ wall.normal, 0.3, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(np.diff(corners, axis=0), axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(corners[0] - corners[2]), np.sqrt(2.0), atol=1e-12)


def test_paths_errors_and_signals_are_those_of_the_rollout(fixed, seen):
    _, rollout = fixed
    (path,) = seen.paths
    way = np.clip(rollout.t / 3.0, 0, 1)[:, None]
    np.testing.assert_allclose(path.commanded, [0.6, 0.2, 0.5] + way * [-0.3, 0.4, -0.1], atol=1e-12)
    np.testing.assert_allclose(path.traced, rollout.signals["tip_position"], rtol=0, atol=4e-16)
    tip, wrist = seen.errors
    assert (tip.name, tip.unit, wrist.name, wrist.unit) == ("tip", "m", "wrist", "rad")
    np.testing.assert_allclose(tip.norm, np.linalg.norm(path.commanded - path.traced, axis=1), atol=1e-12)
    np.testing.assert_array_equal(seen.lam, rollout.signals["lam"])
    np.testing.assert_array_equal(seen.active, rollout.active)
    np.testing.assert_array_equal(seen.clearance, rollout.signals["clearance"])


def test_triads_turn_with_the_frame_and_sit_on_it(fixed, seen, small_arm_by_hand):
    (triad,) = seen.triads
    for k, step in enumerate(seen.steps):
        places, rotation = small_arm_by_hand(fixed[1].q[step], np.zeros(3))
        np.testing.assert_allclose(triad.actual[k], rotation, atol=1e-9)
        np.testing.assert_allclose(triad.origin[k], places[2], atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(triad.commanded[k]), 1.0, atol=1e-12)
    np.testing.assert_allclose(triad.commanded[-1], Rotation.from_euler("z", 1.0).as_matrix(), atol=1e-9)


def test_every_place_is_within_the_box_of_the_scene(seen):
    places = seen.places()
    low, high = places.min(axis=0), places.max(axis=0)
    for segment in seen.segments:
        assert np.all((segment.start >= low) & (segment.end <= high))
    np.testing.assert_allclose(low[:2], [-1.2, -1.2])  # the capsule
    assert high[2] >= 2.2


def test_a_planar_robot_lies_in_the_plane_z_0():
    controller = CompiledController.load("planar5")
    wanted = read_scenario(find_scenario("paper"), ["duration=1.0"])
    each = scene(controller, prepare(controller, wanted, CASES[1]).in_c(), [0, 50, 99])
    assert len(each.outlines) > 0
    for flat in (
        each.joints,
        each.paths[0].traced,
        each.segments[0].end,
        each.regions[0].center,
        each.obstacles[0].start,
    ):
        assert flat.shape[-1] == 3
        assert not flat[..., 2].any()
    np.testing.assert_allclose(each.segments[-1].end, each.paths[0].traced[[0, 50, 99]], atol=1e-12)
    assert each.walls == each.triads == each.bodies == ()
    assert each.clearance is not None


def test_without_obstacles_there_is_no_clearance():
    controller = CompiledController.load("planar5")
    wanted = read_scenario(find_scenario("paper"), ["duration=1.0", "obstacles=[]"])
    each = scene(controller, prepare(controller, wanted, CASES[1]).in_c(), [0, 99])
    assert each.clearance is None
    assert each.obstacles == ()
