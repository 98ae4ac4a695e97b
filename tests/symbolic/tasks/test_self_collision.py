"""Self-collision avoidance: distances between bodies, their gradients, and a loop that keeps them apart."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from clikgen.runtime.documents import BadInput

SWITCHED = {"kind": "switched", "gain": 100.0, "damping": 1e-6, "combine": "rows"}
GAP = {"name": "apart", "kind": "self_collision", "margin": 0.1, "activation": SWITCHED}


@pytest.fixture(scope="module")
def bodied(space_arm):
    """The spatial arm with capsules and balls on its links."""
    rng = np.random.default_rng(11)
    bodies = []
    for i in range(7):
        start, end = rng.uniform(-0.2, 0.2, (2, 3)).tolist()
        bodies.append({"name": f"b{i}", "link": f"link{i}", "start": start, "radius": float(rng.uniform(0.02, 0.08))})
        if i % 3:  # b0, b3 and b6 are balls
            bodies[-1]["end"] = end
    return space_arm(bodies=bodies)


@pytest.fixture(scope="module")
def claw(plane_arm):
    """Four links in the plane with a capsule along each: it can fold back onto itself."""
    lengths = [0.5, 0.4, 0.4, 0.3]
    bodies = [
        {"name": f"bone{i}", "link": f"link{i}", "start": [0.05, 0, 0], "end": [length - 0.05, 0, 0], "radius": 0.03}
        for i, length in enumerate(lengths)
    ]
    return plane_arm(lengths, bodies=bodies)


def _solved_distance(controller, q, names):
    """The distance of two bodies by a bounded least-squares solver, from the poses of the links alone."""
    robot = controller.controller.spec.robot
    poses = controller("kinematics", q=q)["link_pose"]
    bodies = {body.name: body for body in robot.bodies}
    axes, radii = [], 0.0
    for name in names:
        body = bodies[name]
        pose = poses[[joint.link for joint in robot.joints].index(body.link)]
        axes += [pose[:, 3] + pose[:, :3] @ (body.start if end is None else end) for end in (body.start, body.end)]
        radii += body.radius
    p1, e1, p2, e2 = axes
    solved = lsq_linear(np.column_stack([e1 - p1, p2 - e2]), p2 - p1, bounds=(0, 1), method="bvls", tol=1e-14)
    return np.sqrt(2 * solved.cost) - radii


@pytest.mark.parametrize("pair", [["b1", "b5"], ["b0", "b4"], ["b4", "b0"], ["b3", "b6"]])
def test_distance_equals_a_bounded_least_squares_solver_s(evaluated, bodied, pair):
    controller = evaluated(bodied, GAP | {"pairs": [pair]})
    for q in np.random.default_rng(0).uniform(-2, 2, (100, 7)):
        # the solver stops at a relative change of 1e-14 of the square: where that is small, 1e-8 m
        assert controller(q=q)["apart_distance"][0] == pytest.approx(_solved_distance(controller, q, pair), abs=1e-8)


@pytest.mark.parametrize("pair", [["b1", "b5"], ["b0", "b4"], ["b4", "b2"], ["b3", "b6"]])
def test_task_jacobian_is_the_derivative_of_the_potential(evaluated, bodied, pair):
    controller = evaluated(bodied, GAP | {"pairs": [pair], "margin": 1.0, "activation": SWITCHED | {"combine": "sum"}})
    q = np.random.default_rng(1).uniform(-2, 2, (600, 7))
    distance = controller(q=q)["apart_distance"][:, 0]
    # away from the boundary and from axes that meet: there the curvature of d, up to 1/(d + radii), steps or ends
    smooth = (distance < 1.0 - 1e-4) & (distance > 0)
    assert np.sum(smooth) > 200
    J = controller("jacobians", q=q[smooth])["apart_jacobian"]
    # C¹ only: where a nearest point comes to an end of its axis the curvature, of up to 1/0.05 m, steps: h of 1e-6
    difference = controller.derivative("apart_potential", q[smooth])
    np.testing.assert_allclose(J, difference, rtol=0, atol=2e-5)
    assert np.mean(np.abs(J - difference) < 1e-8) > 0.98


def test_potential_sums_over_the_pairs(evaluated, bodied):
    pairs, margins = [["b1", "b5"], ["b0", "b4"], ["b2", "b6"]], np.array([0.3, 0.5, 0.4])
    controller = evaluated(
        bodied, GAP | {"pairs": pairs, "margin": margins.tolist(), "activation": SWITCHED | {"combine": "sum"}}
    )
    q = np.random.default_rng(2).uniform(-2, 2, (200, 7))
    outputs = controller(q=q)
    depth = np.maximum(margins - outputs["apart_distance"], 0)
    # three squares below 1
    np.testing.assert_allclose(outputs["apart_potential"], np.sum(depth**2 / 2, axis=1), rtol=0, atol=1e-15)
    assert 20 < np.sum(outputs["apart_potential"] > 0) < 200


def test_margins_are_parameters(evaluated, bodied):
    controller = evaluated(bodied, GAP | {"pairs": [["b1", "b5"], ["b2", "b6"]]})
    assert controller.infos()["apart_margin"].default == (0.1, 0.1)
    q = np.zeros(7)
    distance = controller(q=q)["apart_distance"]
    assert not np.any(controller(q=q, apart_margin=distance)["apart_potential"])
    further, expected = np.array([0.0, 0.2]), [0.0, 0.2**2 / 2]
    # rounding of positions of about 1 m
    assert controller(q=q, apart_margin=distance + further)["apart_potential"] == pytest.approx(expected, abs=1e-15)


def test_a_joint_that_carries_both_bodies_does_not_count(evaluated, bodied):
    """∂d/∂q is zero there exactly, not just to rounding."""
    controller = evaluated(bodied, GAP | {"pairs": [["b2", "b5"]], "margin": 10.0})
    J = controller("jacobians", q=np.random.default_rng(3).uniform(-2, 2, (50, 7)))["apart_jacobian"]
    np.testing.assert_array_equal(J[:, [0, 1, 2, 6]], 0)
    assert np.all(J[:, 3:6] != 0)


def test_default_pairs_are_those_that_two_joints_keep_apart(evaluated, space_arm):
    """Of a body's own link, of one fixed to it and of the next one no pair is made: they cannot get apart."""
    rest = {"radius": 0.02}
    robot = space_arm()
    tip = {"name": "flange", "type": "fixed", "link": "flange", "parent": "link6", "xyz": [0.1, 0.0, 0.0]}
    branch = {"name": "other", "type": "revolute", "link": "arm2", "parent": "link0", "lower": -1.0, "upper": 1.0}
    robot["joints"] = [*robot["joints"], tip, branch]
    bodies = {"floor": "world", "base": "link0", "fore": "link5", "hand": "link6", "nail": "flange", "arm2": "arm2"}
    robot["bodies"] = [{"name": name, "link": link} | rest for name, link in bodies.items()]
    controller = evaluated(robot, GAP)
    pairs = controller.infos()["apart_margin"].description.removeprefix("s of each pair: ").split(", ")
    assert set(pairs) == {
        "floor-fore", "floor-hand", "floor-nail", "floor-arm2",
        "base-fore", "base-hand", "base-nail",
        "fore-arm2", "hand-arm2", "nail-arm2",
    }  # fmt: skip


@pytest.mark.parametrize("law", ["nsb", "augmented"])
@pytest.mark.parametrize("pairs", [[[0, 3]], [[0, 2], [0, 3], [1, 3]]])
def test_arm_that_would_fold_through_itself_keeps_the_margin(evaluated, claw, law, pairs):
    """A body enters the margin by the way of one step at most, and leaves it again."""
    fold = {"name": "rest", "kind": "posture", "posture": [0.0, 2.4, 2.0, 1.0], "gain": 4.0}
    start = [0.0, 1.0, 0.8, 0.6]
    unaware, _ = evaluated(claw, fold, period=0.002).run(2000, start)
    gap = GAP | {"pairs": [[f"bone{i}", f"bone{j}"] for i, j in pairs]}
    controller = evaluated(claw, gap, fold, law=law, period=0.002)
    assert np.min(controller(q=unaware)["apart_distance"]) < -0.02  # it would collide
    _, outputs = controller.run(4000, start)
    distance = outputs["apart_distance"]
    way = np.max(-np.diff(distance, axis=0))  # in one step
    assert way < 0.01
    assert 0.1 - way < np.min(distance) < 0.1
    assert np.min(distance[-1]) == pytest.approx(0.1, abs=3e-4)


def test_two_bodies_inside_the_margin_part(evaluated, claw):
    controller = evaluated(claw, GAP | {"pairs": [["bone0", "bone3"]], "activation": SWITCHED | {"gain": 20.0}})
    _, outputs = controller.run(3000, [0.0, 2.0, 1.6, 0.8])
    distance = outputs["apart_distance"][:, 0]
    assert 0 < distance[0] < 0.07
    assert np.all(np.diff(distance) >= -1e-15)
    # the depth shrinks by K/2 = 10/s until x is near the damping over |∂d/∂q|, 1e-6 m²/0.5 m
    assert distance[-1] == pytest.approx(0.1, abs=1e-4)


def test_bodies_whose_centres_coincide_are_pushed_along_x(evaluated, plane_arm):
    """Two sliders cross at one point: the direction is +x there, so the second slides ahead."""
    limits = {"lower": -5.0, "upper": 5.0}
    robot = {
        "space": "planar",
        "joints": [
            {"name": "a", "type": "prismatic", "link": "la", "parent": "world", "axis": [1, 0, 0], **limits},
            {"name": "b", "type": "prismatic", "link": "lb", "parent": "world", "axis": [1, 0, 0], **limits},
        ],
        "bodies": [{"name": name, "link": f"l{name}", "radius": 0.1} for name in "ab"],
    }
    outputs = evaluated(robot, GAP | {"activation": SWITCHED | {"gain": 10.0}})(q=np.zeros(2))
    assert outputs["apart_distance"][0] == -0.2
    # x = 0.3, J = x (1, −1): each slides at K x/2 · 1/2
    np.testing.assert_allclose(outputs["dq_law"], [-0.75, 0.75], rtol=1e-9, atol=0)


def test_random_and_degenerate_states_step_to_finite_ones(evaluated, bodied, claw):
    rng = np.random.default_rng(4)
    for robot, n in ((bodied, 7), (claw, 4)):
        q = rng.uniform(-3, 3, (10_000, n))
        q[::4] = np.pi * rng.integers(-1, 2, q[::4].shape)  # stretched and folded: parallel and overlapping axes
        q[1::4] = q[::4] + 10.0 ** rng.uniform(-20, -5, q[::4].shape)
        outputs = evaluated(robot, GAP | {"margin": 0.5})(q=q)
        assert all(np.all(np.isfinite(values)) for values in outputs.values())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"pairs": [["b1", "b9"]]}, "task 'apart': no body 'b9'; valid choices: b0, b1"),
        ({"pairs": [["b1", "b1"]]}, "the bodies 'b1' and 'b1' are fixed to each other"),
        ({"pairs": [["b1"]]}, "pairs"),
        ({"pairs": []}, "pairs"),
        ({"pairs": [["b1", "b5"]], "margin": [0.1, 0.2]}, r"apart_margin: wanted shape \(1,\), got \(2,\)"),
        ({"margin": 0.0}, "margin"),
    ],
)
def test_what_does_not_fit_is_one_clear_line(evaluated, bodied, wrong, message):
    with pytest.raises(BadInput, match=message) as error:
        evaluated(bodied, GAP | wrong)
    assert "\n" not in str(error.value)


def test_a_robot_without_bodies_is_told_so(evaluated, space_arm):
    with pytest.raises(BadInput, match="wanted bodies with two joints or more between them, got none"):
        evaluated(space_arm(), GAP)
