"""Workspace walls: every point stays on the inner side of every wall."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput

SWITCHED = {"kind": "switched", "gain": 50.0, "damping": 1e-6, "combine": "rows"}
WALLS = {"name": "room", "kind": "workspace_walls", "margin": 0.1, "activation": SWITCHED}
FLOOR = {"normal": [0.0, 0.0, 1.0], "offset": -0.5}
SLOPE = {"normal": [0.6, -0.8, 0.0], "offset": -0.7}


@pytest.fixture(scope="module")
def pointed(space_arm):
    """The spatial arm with two points of interest."""
    points = [
        {"name": "elbow", "link": "link3", "offset": [0.1, -0.2, 0.05], "influence_radius": 0.1},
        {"name": "wrist", "link": "link5", "offset": [0.0, 0.1, 0.2], "influence_radius": 0.1},
    ]
    return space_arm(points_of_interest=points)


@pytest.fixture(scope="module")
def planar(plane_arm):
    points = [{"name": "elbow", "link": "link0", "offset": [0.5, 0, 0], "influence_radius": 0.1}]
    return plane_arm([0.5, 0.4, 0.3], points_of_interest=points)


def test_distances_are_those_of_the_points_to_the_walls(evaluated, pointed):
    controller = evaluated(pointed, WALLS | {"walls": [FLOOR, SLOPE], "activation": SWITCHED | {"combine": "sum"}})
    q = np.random.default_rng(0).uniform(-2, 2, (200, 7))
    points = controller("kinematics", q=q)["point_position"]
    expected = np.stack([points[..., 2] + 0.5, points @ [0.6, -0.8, 0.0] + 0.7], axis=1)  # a row a wall
    # sums of numbers of about 1
    np.testing.assert_allclose(controller(q=q)["room_distance"], expected, rtol=0, atol=2e-15)
    depth = np.maximum(0.1 - expected, 0)
    np.testing.assert_allclose(controller(q=q)["room_potential"], np.sum(depth**2, axis=(1, 2)) / 2, rtol=0, atol=2e-15)


def test_frames_take_the_place_of_the_points_of_interest(evaluated, pointed):
    controller = evaluated(pointed, WALLS | {"walls": [FLOOR], "frames": ["tool", "link2"]})
    q = np.random.default_rng(1).uniform(-2, 2, (100, 7))
    poses = controller("kinematics", q=q)["link_pose"]
    tool = np.array(pointed["frames"][0]["xyz"])
    heights = np.column_stack([poses[:, 6, 2, 3] + poses[:, 6, 2, :3] @ tool, poses[:, 2, 2, 3]])
    # sums of numbers of about 1
    np.testing.assert_allclose(controller(q=q)["room_distance"][:, 0], heights + 0.5, rtol=0, atol=2e-15)


def test_task_jacobian_is_the_derivative_of_the_potential(evaluated, pointed):
    controller = evaluated(
        pointed, WALLS | {"walls": [FLOOR, SLOPE], "margin": [0.5, 0.6], "activation": SWITCHED | {"combine": "sum"}}
    )
    q = np.random.default_rng(2).uniform(-2, 2, (500, 7))
    J = controller("jacobians", q=q)["room_jacobian"]
    assert np.sum(np.any(J != 0, axis=1)) > 100
    # C¹: the curvature steps by |∂d/∂q|² <= 4 at the edge of a margin, within h = 1e-6
    difference = controller.derivative("room_potential", q)
    np.testing.assert_allclose(J, difference, rtol=0, atol=4e-6)
    assert np.mean(np.abs(J - difference) < 1e-8) > 0.99


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_a_tool_drawn_through_a_wall_stays_before_it(evaluated, planar, law):
    wall = {"normal": [0.0, 1.0], "offset": 0.2}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0, "damping": 1e-2}
    room = WALLS | {"walls": [wall], "frames": ["tool"]}
    controller = evaluated(planar, room, goal, law=law, period=0.002)
    start, reference = [0.8, 0.6, 0.3], np.array([0.7, -0.1])
    path, outputs = controller.run(4000, start, tool_reference=reference)
    # where the margin begins the goal is 0.4 m away: the tool enters by T v = 0.002 · 4 · 0.4 m at most
    assert 0.1 - 0.0032 < np.min(outputs["room_distance"]) < 0.1
    # it ends at the edge of the margin, but for what the damping lets through
    x, y = outputs["tool_position"][-1]
    assert y == pytest.approx(0.3, abs=1e-3)
    if law == "augmented":  # nearest to the goal; successive projection rests where e is along J Jᵀn instead
        assert x == pytest.approx(0.7, abs=1e-3)
    unaware, _ = evaluated(planar, goal, period=0.002).run(4000, start, tool_reference=reference)
    assert controller(q=unaware[-1])["tool_position"][1] < 0.2
    assert np.linalg.norm(path[-1] - path[0]) > 0.1


def test_a_point_behind_a_wall_comes_back(evaluated, planar):
    controller = evaluated(
        planar, WALLS | {"walls": [{"normal": [0.0, 1.0], "offset": 0.3}], "activation": SWITCHED | {"gain": 20.0}}
    )
    _, outputs = controller.run(2000, [0.2, 0.0, 0.0])
    distance = outputs["room_distance"][:, 0, 0]
    assert distance[0] < -0.2
    assert np.all(np.diff(distance) > -1e-15)
    # the depth shrinks at K/2 = 10/s until it is near damping/|∂d/∂q|, 1e-6 m²/0.3 m
    assert distance[-1] == pytest.approx(0.1, abs=1e-4)


def test_walls_can_move_while_it_runs(evaluated, planar):
    controller = evaluated(
        planar, WALLS | {"walls": [{"normal": [0.0, 1.0], "offset": -1.0}], "activation": SWITCHED | {"gain": 20.0}}
    )
    infos = controller.infos()
    assert infos["room_normal"].default == (0.0, 1.0)
    assert infos["room_offset"].default == (-1.0,)
    pushed = {"room_normal": np.array([[-1.0, 0.0]]), "room_offset": lambda t: np.array([-0.6 + 0.1 * t])}
    path, outputs = controller.run(500, [0.3, 0.5, 0.5], **pushed)
    # x <= 0.6 m − 0.1 m/s · t: the elbow at 0.5 cos q0 turns away before it
    wall = 0.6 - 0.1 * controller.period * np.arange(500)
    np.testing.assert_allclose(outputs["room_distance"][:, 0, 0], wall - 0.5 * np.cos(path[:-1, 0]), rtol=0, atol=1e-15)
    # the lag of a loop of K/2 = 10/s after a wall of 0.1 m/s is 0.01 m
    assert outputs["room_distance"][-1, 0, 0] == pytest.approx(0.09, abs=1e-3)


def test_random_and_degenerate_states_step_to_finite_ones(evaluated, pointed):
    controller = evaluated(pointed, WALLS | {"walls": [FLOOR, SLOPE]})
    rng = np.random.default_rng(3)
    q = rng.normal(size=(10_000, 7)) * 10.0 ** rng.uniform(-10, 4, (10_000, 1))
    q[:10] = 0
    outputs = controller(q=q)
    assert all(np.all(np.isfinite(values)) for values in outputs.values())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"walls": [{"normal": [0.0, 1.0], "offset": 0.0}]},
            "task 'room': wanted normals of 3 numbers, got .0.0, 1.0.",
        ),
        (
            {"walls": [{"normal": [0.0, 1.0, 1.0], "offset": 0.0}]},
            r"walls\.0\.normal: wanted a unit vector, got \[0\.0, 1\.0, 1\.0\]$",
        ),
        ({"walls": []}, "walls"),
        ({"walls": [FLOOR], "frames": ["tol"]}, "no frame 'tol'; did you mean 'tool'"),
        ({"walls": [FLOOR], "margin": [0.1, 0.2]}, r"room_margin: wanted shape \(1,\), got \(2,\)"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(evaluated, pointed, wrong, message):
    with pytest.raises(BadInput, match=message) as error:
        evaluated(pointed, WALLS | wrong)
    assert "\n" not in str(error.value)


def test_a_robot_without_points_is_told_so(evaluated, space_arm):
    with pytest.raises(BadInput, match="task 'room': wanted frames, or a robot with points of interest"):
        evaluated(space_arm(), WALLS | {"walls": [FLOOR]})
