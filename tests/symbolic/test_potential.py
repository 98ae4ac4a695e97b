"""Contacts in one row, as the paper sums them, or a row each."""

import numpy as np
import pytest

from clikgen.runtime.documents import BadInput

SWITCHED = {"kind": "switched", "gain": 50.0, "damping": 1e-6}
KINDS = {
    "obstacle_avoidance": {},
    "workspace_walls": {
        "margin": 0.2,
        "walls": [{"normal": [0.0, 1.0], "offset": -0.2}, {"normal": [1.0, 0.0], "offset": 0.1}],
    },
    "self_collision": {"margin": 0.6, "pairs": [["b0", "b2"], ["b0", "b3"]]},
}


@pytest.fixture(scope="module")
def arm(plane_arm):
    links = [f"link{i}" for i in range(4)]
    points = [
        {"name": f"p{i}", "link": link, "offset": [0.3, 0, 0], "influence_radius": 0.3} for i, link in enumerate(links)
    ]
    bodies = [{"name": f"b{i}", "link": link, "end": [0.3, 0, 0], "radius": 0.05} for i, link in enumerate(links)]
    return plane_arm([0.4, 0.4, 0.3, 0.3], points_of_interest=points, bodies=bodies)


def build(evaluated, arm, kind, combine, **more):
    obstacles = {"maximum": 2} if kind == "obstacle_avoidance" else {}
    task = {"name": "away", "kind": kind, "activation": SWITCHED | {"combine": combine}} | KINDS[kind]
    return evaluated(arm, task, obstacles=obstacles, **more)


def scene(kind):
    if kind != "obstacle_avoidance":
        return {}
    return {
        "obstacle_center": np.array([[0.5, 0.3], [0.9, -0.2]]),
        "obstacle_radius": np.array([0.1, 0.0]),
        "obstacle_count": 2.0,
    }


@pytest.mark.parametrize("kind", KINDS)
def test_rows_add_up_to_the_sum(evaluated, arm, kind):
    q = np.random.default_rng(0).uniform(-2, 2, (300, 4))
    one, each = (build(evaluated, arm, kind, combine) for combine in ("sum", "rows"))
    whole, parts = one(q=q, **scene(kind))["away_potential"], each(q=q, **scene(kind))["away_potential"]
    assert np.count_nonzero(np.count_nonzero(parts, axis=1) > 1) > 20  # several contacts at once
    np.testing.assert_allclose(parts.sum(axis=1), whole, rtol=0, atol=1e-15)
    J, rows = (
        one("jacobians", q=q, **scene(kind))["away_jacobian"],
        each("jacobians", q=q, **scene(kind))["away_jacobian"],
    )
    np.testing.assert_allclose(rows.sum(axis=1), J, rtol=0, atol=1e-14)  # sums of lengths of metres


@pytest.mark.parametrize("kind", KINDS)
def test_each_row_is_the_derivative_of_its_potential(evaluated, arm, kind):
    q = np.random.default_rng(1).uniform(-2, 2, (300, 4))
    controller = build(evaluated, arm, kind, "rows")
    J = controller("jacobians", q=q, **scene(kind))["away_jacobian"]
    difference = controller.derivative("away_potential", q, **scene(kind))
    wrong = np.abs(J - difference).max(axis=(1, 2)) > 1e-7  # C¹: the curvature steps where a margin begins
    assert np.mean(wrong) < 0.02


@pytest.mark.parametrize(("combine", "held"), [("rows", True), ("sum", False)])
def test_rows_hold_several_contacts_at_once_and_the_sum_lets_them_in_and_jumps(evaluated, arm, combine, held):
    """A snake whose tool is drawn along and through a wall lays two of its points against it."""
    wall = {"normal": [0.0, 1.0], "offset": -0.15}
    room = {"name": "room", "kind": "workspace_walls", "walls": [wall], "margin": 0.1}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0, "speed": 1.0}
    controller = evaluated(
        arm, room | {"activation": SWITCHED | {"combine": combine}}, goal, law="augmented", period=0.002
    )
    _, outputs = controller.run(3000, [0.2, -0.3, 0.3, -0.2], tool_reference=np.array([-0.9, -0.5]))
    distance = outputs["room_distance"][:, 0]
    assert np.max(np.count_nonzero(distance < 0.1, axis=1)) > 1
    # a point enters by T · 1 m/s at most in the step that meets the margin, and is pushed back from there
    assert (np.min(distance) > 0.1 - 0.0021) == held
    assert (np.max(np.abs(np.diff(outputs["dq"], axis=0))) < 5) == held


def test_an_unknown_way_to_combine_names_the_choices(evaluated, arm):
    with pytest.raises(BadInput, match="'sum' or 'rows'") as error:
        build(evaluated, arm, "workspace_walls", "product")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("law", ["nsb", "augmented"])
def test_a_tool_that_was_pressed_against_a_wall_leaves_it_when_it_is_called_back(evaluated, arm, law):
    """The projector holds both ways of a direction; that it fades with the depth is what lets go."""
    wall = {"normal": [0.0, 1.0], "offset": -0.15}
    faded = SWITCHED | {"damping": 1e-4, "combine": "rows"}
    room = {"name": "room", "kind": "workspace_walls", "walls": [wall], "margin": 0.1, "activation": faded}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0, "speed": 1.0}
    controller = evaluated(arm, room, goal, law=law, period=0.002)

    def reference(t):
        return np.array([1.0, -0.3 if t < 2.0 else 0.3])

    _, outputs = controller.run(3000, [0.2, -0.3, 0.3, -0.2], tool_reference=reference)
    pressed, distance = slice(800, 1000), outputs["room_distance"][:, 0, 3]
    assert np.all(distance[pressed] < 0.1)
    # it gives way by some times the depth where the task fades, 1e-4 m² / 1 m
    assert np.min(distance) > 0.1 - 0.01
    assert np.linalg.norm(outputs["tool_error"][-1]) < 1e-3
