"""Velocity limits: always kept, by shrinking the whole velocity or joint by joint, and kept by the filter too."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import lsq_linear

from clikgen.runtime.documents import BadInput
from clikgen.symbolic.velocity_limits import clamp, scale

KINDS = {"scale": scale.Spec(kind="scale"), "clamp": clamp.Spec(kind="clamp")}
N = 5


def _function(kind):
    u, limit = ca.SX.sym("u", N), ca.SX.sym("limit", N)
    function = ca.Function("limited", [u, limit], [KINDS[kind].limited(u, limit)])

    def limited(u, limit):
        """The limited velocities of u (count, N) with limits (count, N)."""
        return np.array(function(np.ascontiguousarray(np.transpose(u)), np.ascontiguousarray(np.transpose(limit)))).T

    return limited


@pytest.fixture(scope="module", params=sorted(KINDS))
def limited(request):
    return _function(request.param)


@pytest.fixture
def cases():
    """Velocities of all sizes, (10000, 5), and limits."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(10_000, N)) * 10.0 ** rng.uniform(-6, 9, (10_000, 1))
    u[::10] *= rng.integers(0, 2, (1_000, N))
    return u, 10.0 ** rng.uniform(-6, 6, (10_000, N))


@pytest.fixture(scope="module")
def driven(plane_arm):
    """A planar arm whose two joints follow a posture as fast as they are let."""
    robot = plane_arm([0.5, 0.4])
    return robot, {"name": "rest", "kind": "posture", "posture": [2.0, -1.0], "gain": 50.0}


def test_velocities_are_within_the_limits(limited, cases):
    u, limit = cases
    # a quotient and a product, each rounded
    assert np.all(np.abs(limited(u, limit)) <= limit * (1 + 4e-16))


def test_velocities_within_the_limits_stay_as_they_are(limited, cases):
    u, limit = cases
    inside = np.all(np.abs(u) <= limit, axis=1)
    assert np.sum(inside) > 100
    np.testing.assert_array_equal(limited(u, limit)[inside], u[inside])
    np.testing.assert_array_equal(limited(limit, limit), limit)


def test_scale_keeps_the_direction_and_is_as_fast_as_allowed(cases):
    u, limit = cases
    shrunk = _function("scale")(u, limit)
    beyond = np.any(np.abs(u) > limit, axis=1)
    assert np.sum(beyond) > 1_000
    share = np.linalg.norm(shrunk, axis=1) / np.maximum(np.linalg.norm(u, axis=1), 1e-300)
    # one division an entry
    np.testing.assert_allclose(shrunk, share[:, None] * u, rtol=1e-15, atol=0)
    np.testing.assert_allclose(np.max(np.abs(shrunk) / limit, axis=1)[beyond], 1, rtol=1e-15, atol=0)


def test_clamp_is_the_nearest_velocity_within_the_limits():
    rng = np.random.default_rng(1)
    u, limit = rng.normal(size=(100, N)) * 3, rng.uniform(0.1, 3, (100, N))
    for mine, u_i, limit_i in zip(_function("clamp")(u, limit), u, limit, strict=True):
        nearest = lsq_linear(np.eye(N), u_i, bounds=(-limit_i, limit_i), method="bvls").x
        # a solver of a problem with the identity as its matrix
        np.testing.assert_allclose(mine, nearest, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("kind", "factor"), [("scale", 2.0 * np.sqrt(N) + 1), ("clamp", 1.0)])
def test_limits_are_continuous(kind, factor):
    """|f(u) − f(u')| <= L |u − u'|, L = 1 for the nearest point of a box and, for scaling, 1 + |u|/(r least v)."""
    rng = np.random.default_rng(2)
    limited, limit = _function(kind), np.ones((10_000, N))
    u = rng.normal(size=(10_000, N)) * 2
    u[::2] /= np.max(np.abs(u[::2]), axis=1, keepdims=True)  # on the boundary
    step = rng.normal(size=(10_000, N)) * 10.0 ** rng.uniform(-9, -1, (10_000, 1))
    change = np.linalg.norm(limited(u + step, limit) - limited(u, limit), axis=1)
    # rounding of numbers of about 10
    assert np.all(change <= factor * np.linalg.norm(step, axis=1) + 1e-14)


def test_nothing_is_nan_at_zero_or_at_the_largest_numbers(limited):
    big = np.finfo(float).max
    u = np.array([np.zeros(N), np.full(N, 1e300), [big, -big, 0, 1, -1], np.full(N, 5e-324)])
    for limit in (1e-6, 1.0, 1e6):
        assert np.all(np.isfinite(limited(u, np.full((4, N), limit))))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_limits_come_from_the_robot_unless_the_table_has_its_own(evaluated, driven, kind):
    robot, rest = driven
    for more, limit in (({}, (2.0, 2.0)), ({"limit": 0.3}, (0.3, 0.3)), ({"limit": [0.3, 0.2]}, (0.3, 0.2))):
        controller = evaluated(robot, rest, velocity_limits={"kind": kind} | more)
        info = controller.infos()["velocity_limit"]
        assert (info.default, info.unit, info.role) == (limit, "rad/s, rad/s", "parameter")
        outputs = controller(q=np.zeros(2))
        assert np.all(np.abs(outputs["dq_law"]) <= limit)
        assert np.any(np.abs(outputs["dq_law"]) >= np.array(limit) * (1 - 1e-15))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_joint_without_a_velocity_limit_is_one_clear_line(evaluated, driven, kind):
    robot, rest = driven
    joints = [{key: value for key, value in joint.items() if key != "velocity"} for joint in robot["joints"]]
    message = "velocity_limits: joint 'j0' has no velocity limit; give it one, or velocity_limits.limit"
    with pytest.raises(BadInput, match=f"^{message}$"):
        evaluated(robot | {"joints": joints}, rest, velocity_limits={"kind": kind})
    evaluated(robot | {"joints": joints}, rest, velocity_limits={"kind": kind, "limit": 1.0})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "clamp", "limit": [1.0, 2.0, 3.0]}, r"velocity_limit: wanted shape \(2,\), got \(3,\)"),
        ({"kind": "clamp", "limit": 0.0}, "velocity_limits"),
        ({"kind": "trim"}, "velocity_limits"),
    ],
)
def test_limits_that_do_not_fit_are_one_clear_line(evaluated, driven, wrong, message):
    robot, rest = driven
    with pytest.raises(BadInput, match=message) as error:
        evaluated(robot, rest, velocity_limits=wrong)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("lam", [0.0, 0.5, 1.0])
def test_the_command_keeps_the_limits_with_the_filter_and_any_share_of_it(evaluated, driven, kind, lam):
    """Eqs. 15-17 make dq a multiple of dq_law, joint by joint, by a factor from 0 to 1."""
    robot, rest = driven
    rng = np.random.default_rng(3)
    controller = evaluated(robot, rest, velocity_limits={"kind": kind}, lam=lam)
    outputs = controller(
        q=rng.uniform(-3, 3, (10_000, 2)),
        rest_reference=rng.normal(size=(10_000, 2)) * 1e3,
        filter_cutoff=10.0 ** rng.uniform(-6, 6, (10_000, 2)),
        period=10.0 ** rng.uniform(-4, 0, (10_000,)),
    )
    # (q_next − q)/T: q of 3 rad is rounded at 4e-16 and divided by T >= 1e-4
    assert np.all(np.abs(outputs["dq"]) <= 2.0 + 1e-11)
    assert np.all(np.abs(outputs["dq_law"]) <= 2.0 * (1 + 4e-16))


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_a_limited_loop_still_arrives(evaluated, driven, kind):
    robot, rest = driven
    path, outputs = evaluated(robot, rest, velocity_limits={"kind": kind}).run(400, np.zeros(2))
    # 2 rad at 2 rad/s take 1 s, then e⁺ = (1 − 50 · 0.01) e for 3 s
    np.testing.assert_allclose(path[-1], [2.0, -1.0], rtol=0, atol=1e-12)
    assert np.max(np.abs(outputs["dq"])) <= 2.0 + 1e-13
    ahead = path[50] / [2.0, -1.0]
    if kind == "scale":  # both joints have come as far
        assert ahead[0] == pytest.approx(ahead[1], rel=1e-12)
    else:
        assert ahead[1] > 1.9 * ahead[0]


def test_a_cart_is_limited_in_what_it_drives(evaluated):
    """Forward speed and turning rate are limited, not the rates of x and y."""
    cart = {
        "space": "planar",
        "joints": [
            {"name": "x", "type": "prismatic", "link": "lx", "axis": [1, 0, 0], "lower": -9.0, "upper": 9.0},
            {"name": "y", "type": "prismatic", "link": "ly", "axis": [0, 1, 0], "lower": -9.0, "upper": 9.0},
            {"name": "yaw", "type": "continuous", "link": "base", "velocity": 1.5},
        ],
        "drive": {"x": "x", "y": "y", "yaw": "yaw", "velocity": 0.8},
        "frames": [{"name": "nose", "link": "base", "xyz": [0.3, 0.0, 0.0]}],
    }
    goal = {"name": "nose", "kind": "frame_position", "frame": "nose", "gain": 5.0, "damping": 1e-6}
    q = np.random.default_rng(4).uniform(-3, 3, (1_000, 3))
    for kind in KINDS:
        controller = evaluated(cart, goal, velocity_limits={"kind": kind}, lam=1.0)
        assert controller.infos()["velocity_limit"].default == (0.8, 1.5)
        outputs = controller(q=q, nose_reference=np.array([1.0, 1.0]))
        assert np.all(np.abs(outputs["base_velocity"]) <= np.array([0.8, 1.5]) + 1e-12)
        forward = outputs["dq_law"][:, 0] * np.cos(q[:, 2]) + outputs["dq_law"][:, 1] * np.sin(q[:, 2])
        assert np.max(np.abs(forward)) == pytest.approx(0.8, abs=1e-12)
        sideways = outputs["dq"][:, 1] * np.cos(q[:, 2]) - outputs["dq"][:, 0] * np.sin(q[:, 2])
        # it rolls with the filter on too: (q_next − q)/T rounds at 4e-16/0.01
        np.testing.assert_allclose(sideways, 0, rtol=0, atol=1e-12)
