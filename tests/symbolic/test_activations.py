"""How one-sided tasks begin and end to act: jumps, formulas, cycles, equilibria, and what the barrier keeps."""

from dataclasses import dataclass

import numpy as np
import pytest

from clikgen.symbolic.activation import SINGULAR as APART
from clikgen.symbolic.barrier import SINGULAR

PERIOD = 0.01  # T [s]
ACTIVATIONS = {
    "switched": {"gain": 20.0, "damping": 1e-9},
    "hysteresis": {"gain": 20.0, "width": 0.01},
    "ramp": {"gain": 20.0, "width": 0.01},
    "damped": {"gain": 20.0, "damping": 1e-3},
    "barrier": {"rate": 10.0},
}
ONE_SIDED = [kind for kind in ACTIVATIONS if kind != "switched"]
CONTINUOUS = ["ramp", "damped", "barrier"]
BOUNDARIES = ["obstacle", "self_collision", "joint_limit", "wall"]


def _activation(kind, **values):
    return {"kind": kind} | ACTIVATIONS[kind] | values


# ---- An arm at every kind of boundary ----

LENGTHS = [0.5, 0.4, 0.3, 0.2]
S_POINTS = np.array([0.1, 0.15])  # influence radii of elbow and hand [m]
S_LIMIT, S_WALL = 0.2, 0.1  # [rad], [m]
BODIES = np.array([0.05 + 0.06, 0.05 + 0.04])  # radii of upper and fist, upper and fore [m]
SEGMENTS = 12_500  # at each of 4 boundaries, at one contact or a corner of two: 10⁵ in all for each activation
COMPARED = 2_000  # of them where each is compared with a formula
GOAL = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 3.0, "damping": 0.1}
TABLES = {
    "obstacle": {"kind": "obstacle_avoidance"},
    "self_collision": {"kind": "self_collision", "pairs": [["upper", "fist"], ["upper", "fore"]], "margin": 0.1},
    "joint_limit": {"kind": "joint_limits", "margin": S_LIMIT},
    "wall": {
        "kind": "workspace_walls",
        "walls": [{"normal": [1.0, 0.0], "offset": -1.0}, {"normal": [0.0, 1.0], "offset": -1.0}],
        "frames": ["tool"],
        "margin": S_WALL,
    },
}


@pytest.fixture(scope="module")
def arm(plane_arm, evaluated):
    """`arm(boundary, kind)`: four joints, the tool after a goal, kept from a boundary; `arm()` knows only its goal."""
    points = [
        {"name": "elbow", "link": "link1", "offset": [0.2, 0, 0], "influence_radius": S_POINTS[0]},
        {"name": "hand", "link": "link3", "offset": [0.2, 0, 0], "influence_radius": S_POINTS[1]},
    ]
    bodies = [
        {"name": "upper", "link": "link0", "start": [0.05, 0, 0], "end": [0.45, 0, 0], "radius": 0.05},
        {"name": "fore", "link": "link2", "start": [0.05, 0, 0], "end": [0.25, 0, 0], "radius": 0.04},
        {"name": "fist", "link": "link3", "start": [0.1, 0, 0], "radius": 0.06},
    ]
    robot, made = plane_arm(LENGTHS, points_of_interest=points, bodies=bodies), {}

    def build(boundary=None, kind="ramp", **values):
        key = (boundary, kind, *values.items())
        if key not in made:
            keep = {"name": "keep", "activation": _activation(kind, **values)}
            above = [keep | TABLES[boundary]] if boundary else []
            made[key] = evaluated(robot, *above, GOAL, obstacles={"maximum": 2}, period=PERIOD)
        return made[key]

    return build


def _place(q, link, x):
    """Where the point at x [m] along a link is, (N, 2), by hand."""
    angle = np.cumsum(q, axis=1)
    along = np.stack([np.cos(angle), np.sin(angle)], axis=2)
    return np.einsum("i,nid->nd", LENGTHS[:link], along[:, :link]) + x * along[:, link]


def _to_segment(point, start, end):
    """The distance of points (N, 2) to segments."""
    along = end - start
    share = np.clip(np.sum((point - start) * along, axis=1) / np.sum(along**2, axis=1), 0, 1)
    return np.linalg.norm(point - start - share[:, None] * along, axis=1)


def _between_bodies(q):
    """How far apart the axes of upper and fist, and of upper and fore are, (N, 2); they do not cross."""
    upper, fore = (
        (_place(q, link, low), _place(q, link, high)) for link, low, high in ((0, 0.05, 0.45), (2, 0.05, 0.25))
    )
    pairs = [_to_segment(end, *upper) for end in fore] + [_to_segment(end, *fore) for end in upper]
    return np.stack([_to_segment(_place(q, 3, 0.1), *upper), np.min(pairs, axis=0)], axis=1)


@dataclass(frozen=True)
class Contacts:
    """States of the arm and a boundary there, for its one contact or the two of a corner."""

    boundary: str
    corner: bool
    q: np.ndarray  # (N, 4)
    away: np.ndarray  # (N, 2, 2) unit vectors: from a point to its obstacle, or normals of walls
    radius: np.ndarray  # (N, 2) of the obstacles
    goal: dict

    def __getitem__(self, index):
        goal = {name: value[index] for name, value in self.goal.items()}
        return Contacts(self.boundary, self.corner, self.q[index], self.away[index], self.radius[index], goal)

    @property
    def points(self):
        """Of elbow and hand, (N, 2, 2)."""
        return np.stack([_place(self.q, 1, 0.2), _place(self.q, 3, 0.2)], axis=1)

    def centers(self, gap):
        return self.points + (self.radius + S_POINTS + np.reshape(gap, (-1, 1)))[:, :, None] * self.away

    def inputs(self, gap=0.0):
        """What puts the boundary where both contacts are at d − s = gap, (N,) or one; without a corner one is far."""
        gap, there, q = np.reshape(gap, (-1, 1)), np.array([True, self.corner]), self.q
        if self.boundary == "obstacle":
            own = {
                "obstacle_center": self.centers(gap),
                "obstacle_radius": self.radius,
                "obstacle_count": 1 + self.corner,
            }
        elif self.boundary == "self_collision":
            own = {"keep_margin": np.where(there, np.maximum(_between_bodies(q) - BODIES - gap, 1e-6), 1e-6)}
        elif self.boundary == "joint_limit":
            lower, upper = np.full(q.shape, -50.0), np.full(q.shape, 50.0)
            lower[:, :1] = q[:, :1] - S_LIMIT - gap
            upper[:, 1:2] = q[:, 1:2] + S_LIMIT + gap if self.corner else 50.0
            own = {"keep_lower": lower, "keep_upper": upper}
        else:
            tool = _place(q, 3, LENGTHS[3])
            offset = np.einsum("nkd,nd->nk", self.away, tool) - S_WALL - gap
            own = {"keep_normal": self.away, "keep_offset": np.where(there, offset, -50.0)}
        return own | self.goal

    def distances(self, q):
        """How far both contacts are at q, with the boundary where it is for gap = 0, (N, 2)."""
        if self.boundary == "obstacle":
            moved = Contacts(**vars(self) | {"q": q})
            return np.linalg.norm(self.centers(0.0) - moved.points, axis=2)
        if self.boundary == "self_collision":
            return _between_bodies(q)
        if self.boundary == "joint_limit":
            return np.stack([q[:, 0], -q[:, 1]], axis=1)
        return np.einsum("nkd,nd->nk", self.away, _place(q, 3, LENGTHS[3]))

    @property
    def j(self):
        """−∂d/∂q of the contacts, (N, 1 or 2, 4), by central differences."""
        h = 1e-6
        slopes = [(self.distances(self.q - h * e) - self.distances(self.q + h * e)) / (2 * h) for e in np.eye(4)]
        return np.stack(slopes, axis=2)[:, : 1 + self.corner]

    @property
    def distinct(self):
        """Where the contacts are those meant: ν >= 0.1, nothing else near, and in a corner no two that are opposed."""
        j = self.j
        good = np.all(np.linalg.norm(j, axis=2) > 0.1, axis=1)
        if self.boundary == "obstacle":
            way = self.centers(0.0)[:, None, : 1 + self.corner] - self.points[:, :, None]  # points, obstacles
            beyond = np.linalg.norm(way, axis=3) - self.radius[:, None, : 1 + self.corner] - S_POINTS[:, None]
            good &= np.sum(beyond < 0.03, axis=(1, 2)) == 1 + self.corner
        if self.boundary == "self_collision":
            good &= np.all(_between_bodies(self.q) > BODIES + 0.03, axis=1)
        if self.corner:
            unit = j / np.maximum(np.linalg.norm(j, axis=2, keepdims=True), 1e-9)
            good &= np.abs(np.sum(unit[:, 0] * unit[:, 1], axis=1)) < 0.95
        return good


@pytest.fixture(scope="module")
def contacts(arm):
    """`contacts(boundary, corner)`: SEGMENTS distinct ones, the arm's velocity without them, j, v_n and ν."""

    def find(boundary, corner):
        rng, drawn = np.random.default_rng(0), 8 * SEGMENTS
        q, angle = rng.uniform(-2.7, 2.7, (drawn, 4)), rng.uniform(0, 2 * np.pi, (drawn, 2))
        goal = {
            "tool_reference": _place(q, 3, LENGTHS[3]) + rng.uniform(-0.3, 0.3, (drawn, 2)),
            "tool_reference_velocity": rng.uniform(-0.2, 0.2, (drawn, 2)),
        }
        away = np.stack([np.cos(angle), np.sin(angle)], axis=2)
        every = Contacts(boundary, corner, q, away, rng.uniform(0, 0.3, (drawn, 2)), goal)
        some = every[np.flatnonzero(every.distinct)[:SEGMENTS]]
        assert len(some.q) == SEGMENTS
        return some, arm()(q=some.q, **some.goal)["dq_law"], some.j

    made = {}

    def cached(boundary, corner=False, count=SEGMENTS):
        if (boundary, corner) not in made:
            made[boundary, corner] = find(boundary, corner)
        some, free, j = made[boundary, corner]
        return some[:count], free[:count], j[:count]

    return cached


# ---- Jumps ----

# |Δq̇_law| <= LIPSCHITZ |Δq| [1/s]: 6 rad/s over δ = 0.01 m of depth and up to 1 m of leverage make 600 at one contact;
# the most is 2,400, in corners of contacts 18° from opposed or parallel
LIPSCHITZ = 5_000.0


def _kinks(kind, v_n, rng):
    """D − s (N,) where the law has a kink, a third each: x = 0, where it is full or begins to act, anywhere about."""
    full = {"ramp": -0.01, "damped": -0.002, "barrier": np.maximum(v_n / ACTIVATIONS["barrier"]["rate"], 0)}
    places = 0 * v_n, full.get(kind, 0.0) + 0 * v_n, rng.uniform(-0.02, 0.02, len(v_n))
    return np.choose(rng.integers(0, 3, len(v_n)), places)


def _steps(kind, boundary, corner, arm, contacts):
    """Ends of short segments in q through the boundary: |Δq| and |Δq̇_law|, (N,) each."""
    some, free, j = contacts(boundary, corner)
    rng = np.random.default_rng(1)
    inputs = some.inputs(_kinks(kind, np.sum(j[:, 0] * free, axis=1), rng))
    h, way = 10 ** rng.uniform(-9, -6, len(free)), rng.normal(size=free.shape)
    way *= (h / 2 / np.linalg.norm(way, axis=1))[:, None]
    ends = [arm(boundary, kind)(q=some.q + side * way, **inputs)["dq_law"] for side in (1, -1)]
    return h, np.linalg.norm(ends[0] - ends[1], axis=1)


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("kind", CONTINUOUS)
def test_a_continuous_law_steps_in_proportion_to_q_across_every_boundary(kind, boundary, arm, contacts):
    """End points 1e-9 to 1e-6 rad apart, about x = 0 and where the law begins to act or is full."""
    for corner in (False, True):
        h, step = _steps(kind, boundary, corner, arm, contacts)
        assert np.max(step / h) < LIPSCHITZ
        assert np.max(step / h) > 10  # it does act there


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("kind", ["switched", "hysteresis"])
def test_a_law_that_switches_fails_the_same_probe_however_short_the_segment(kind, boundary, arm, contacts):
    h, step = _steps(kind, boundary, False, arm, contacts)
    shortest = h < 1e-8
    assert np.max(step[shortest]) > 0.5  # [rad/s]
    assert np.max((step / h)[shortest]) > 1e4 * LIPSCHITZ


@pytest.mark.parametrize("depth", [1e-3, 1e-4, 1e-5, 1e-6])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_the_paper_s_switch_jumps_by_the_normal_velocity_however_small_the_depth(boundary, depth, arm, contacts):
    """Δq̇ = −j (v_n + K x/2)/ν², so |Δq̇| → |v_n|/ν as x → 0, whichever way the arm wants to go."""
    some, free, j = contacts(boundary, count=COMPARED)
    v_n, nu = np.sum(j[:, 0] * free, axis=1), np.linalg.norm(j[:, 0], axis=1)
    inside, outside = (arm(boundary, "switched")(q=some.q, **some.inputs(gap))["dq_law"] for gap in (-depth, 1e-9))
    expected = -j[:, 0] * ((v_n + ACTIVATIONS["switched"]["gain"] * depth / 2) / nu**2)[:, None]
    # the damping of 1e-9 m² takes (1e-9 / (x ν))² away, ν >= 0.1; else j by differences, 1e-9 of velocities up to 6
    damped = (1e-9 / (depth * nu)) ** 2
    np.testing.assert_array_less(np.max(np.abs(inside - outside - expected), axis=1), 10 * damped + 1e-7)
    if depth == 1e-6:
        jump = np.linalg.norm(inside - outside, axis=1)
        # K x/2 is 1e-5 m/s here
        np.testing.assert_array_less(np.abs(jump - np.abs(v_n) / nu), (1e-5 + 1e-7) / nu + 10 * damped)
        assert np.max(jump) > 2


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_hysteresis_jumps_once_at_the_boundary_and_once_a_width_from_it(boundary, arm, contacts):
    some, free, j = contacts(boundary, count=COMPARED)
    values, law = ACTIVATIONS["hysteresis"], arm(boundary, "hysteresis")
    v_n, squares = np.sum(j[:, 0] * free, axis=1), np.sum(j[:, 0] ** 2, axis=1)

    def at(beyond, held):
        """Where d − s = `beyond`; the contacts that are not at the boundary do not count."""
        outputs = law(q=some.q, **some.inputs(beyond), keep_held=np.full(law.infos()["keep_held"].shape, held))
        return outputs["dq_law"], outputs["keep_held_next"]

    def removed(excess):
        return -j[:, 0] * (np.maximum(0, excess) / squares / (1 + APART))[:, None]

    e, w, K = 1e-9, values["width"], values["gain"]
    # the gain over 2 e, and j by differences
    close = {"rtol": 0, "atol": 1e-6}
    np.testing.assert_allclose(at(-e, 0.0)[0] - at(e, 0.0)[0], removed(v_n), **close)
    np.testing.assert_allclose(at(w - e, 1.0)[0] - at(w + e, 1.0)[0], removed(v_n - K * w / 2), **close)
    np.testing.assert_allclose(at(-e, 1.0)[0], at(e, 1.0)[0], **close)
    np.testing.assert_array_equal(at(w + e, 1.0)[0], at(w + e, 0.0)[0])
    for beyond, held, after in ((-e, 0.0, 1), (e, 0.0, 0), (e, 1.0, 1), (w - e, 1.0, 1), (w + e, 1.0, 0)):
        assert np.all(np.max(at(beyond, held)[1], axis=1) == after)


# ---- One contact, by hand ----


def _tool_jacobian(q):
    """By central differences, (N, 2, 4)."""
    tool, h = lambda q: _place(q, 3, LENGTHS[3]), 1e-6
    return np.stack([(tool(q + h * e) - tool(q - h * e)) / (2 * h) for e in np.eye(4)], axis=2)


def test_the_goal_s_velocity_is_the_damped_least_squares_one(contacts):
    some, free, _ = contacts("wall", count=COMPARED)
    J, goal = _tool_jacobian(some.q), some.goal
    v = goal["tool_reference_velocity"] + 3.0 * (goal["tool_reference"] - _place(some.q, 3, LENGTHS[3]))
    gram = J @ J.transpose(0, 2, 1) + 0.1**2 * np.eye(2)
    expected = np.einsum("nij,nj->ni", J.transpose(0, 2, 1) @ np.linalg.inv(gram), v)
    np.testing.assert_allclose(free, expected, rtol=0, atol=1e-7)  # J by differences, 1e-9, over damping 0.1


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("kind", ["hysteresis", "ramp", "damped"])
def test_one_contact_takes_its_share_of_the_motion_toward_it(kind, boundary, arm, contacts):
    """u = u_g − h(x) j max(0, v_n + K x/2)/ν²: h = 1, clip(x/δ, 0, 1) or x²/(x² + ℓ²) with ℓ = λ/ν."""
    some, free, j = contacts(boundary, count=COMPARED)
    values, x = ACTIVATIONS[kind], np.random.default_rng(2).uniform(-0.01, 0.02, len(free))
    v_n, nu = np.sum(j[:, 0] * free, axis=1), np.linalg.norm(j[:, 0], axis=1)
    share = {
        "hysteresis": lambda: 1.0 * (x >= 0),
        "ramp": lambda: np.clip(x / values["width"], 0, 1),
        "damped": lambda: np.maximum(x, 0) ** 2 / (x**2 + (values["damping"] / nu) ** 2),
    }[kind]()
    change = -j[:, 0] * (share * np.maximum(0, v_n + values["gain"] * x / 2) / nu**2)[:, None]
    u = arm(boundary, kind)(q=some.q, **some.inputs(-x))["dq_law"]
    # rows are held apart by APART of their square, which takes as much away; j by differences
    error = np.max(np.abs(u - free - change), axis=1)
    assert np.all(error < 1.1 * APART * np.linalg.norm(change, axis=1) + 1e-7)
    assert np.sum(np.linalg.norm(change, axis=1) > 0.1) > COMPARED / 5


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_one_contact_of_the_barrier_moves_the_arm_along_m_j(boundary, arm, contacts):
    """u = u₀ − M j max(0, v_n − γ (d − s))/(jᵀ M j), M = N + ε² (I − N), N of the tool's Jacobian."""
    some, free, j = contacts(boundary, count=COMPARED)
    beyond, rate = np.random.default_rng(3).uniform(-1e-3, 2e-3, len(free)), 100.0  # others, 0.03 m off, do not count
    J, share = _tool_jacobian(some.q), arm(boundary, "barrier").infos()["tool_yields"].default[0]
    gram = J @ J.transpose(0, 2, 1) + SINGULAR**2 * np.eye(2)
    N = np.eye(4) - J.transpose(0, 2, 1) @ np.linalg.inv(gram) @ J
    M = N + share**2 * (np.eye(4) - N)
    along = np.einsum("nij,nj->ni", M, j[:, 0])
    excess = np.maximum(0, np.sum(j[:, 0] * free, axis=1) - rate * beyond)
    leverage = np.sum(j[:, 0] * along, axis=1)
    outputs = arm(boundary, "barrier")(q=some.q, **some.inputs(beyond), keep_rate=rate)
    alone = outputs["barrier_steps"] == (excess > 0)
    assert np.mean(alone) > 0.99
    expected = free - along * (excess / leverage)[:, None]
    error = np.max(np.abs(outputs["dq_law"] - expected), axis=1)[alone]
    # J and j by differences, 1e-9, where M is nearly singular along j
    assert np.all(error < 1e-8 * (1 + excess / leverage)[alone])
    assert np.sum(excess > 0.01) > COMPARED / 5


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("kind", ONE_SIDED)
def test_where_the_task_leaves_fast_enough_nothing_changes(kind, boundary, arm, contacts):
    """Bit for bit: only motion toward the boundary is taken away."""
    some, free, j = contacts(boundary, count=COMPARED)
    x = np.random.default_rng(4).uniform(0, 0.01, len(free))
    v_n = np.sum(j[:, 0] * free, axis=1)
    wanted = ACTIVATIONS[kind]["rate"] * x if kind == "barrier" else ACTIVATIONS[kind]["gain"] * x / 2
    leaves = np.flatnonzero(v_n < -wanted - 1e-6)  # j is known to 1e-9
    assert len(leaves) > COMPARED / 5
    outputs = arm(boundary, kind)(q=some.q[leaves], **some[leaves].inputs(-x[leaves]))
    alone = outputs["barrier_steps"] == 0 if kind == "barrier" else np.full(len(leaves), True)
    assert np.mean(alone) > 0.9
    np.testing.assert_array_equal(outputs["dq_law"][alone].view(np.uint64), free[leaves][alone].view(np.uint64))


@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_the_paper_s_law_takes_motion_away_from_the_boundary_out_as_well(boundary, arm, contacts):
    """The contrast: two-sided, eq. 11 leaves nothing of v_n whatever its sign."""
    some, free, j = contacts(boundary, count=COMPARED)
    v_n = np.sum(j[:, 0] * free, axis=1)
    u = arm(boundary, "switched")(q=some.q, **some.inputs(-1e-3))["dq_law"]
    left = np.sum(j[:, 0] * u, axis=1)
    np.testing.assert_allclose(left, -20.0 * 1e-3 / 2, rtol=0, atol=1e-6)  # −K x/2; j by differences
    assert np.sum(v_n < -0.1) > COMPARED / 5


# ---- A point in the plane, in the loop ----


@pytest.fixture(scope="module")
def slide(evaluated):
    """`slide(kind, ...)`: a point that slides along x and y, one of which it may lack, and keeps 0.1 m from things.

    `toward` is the gain of its way to a goal; as good as none where its reference velocity alone moves it.
    """
    made = {}

    def build(kind, *, axes="xy", toward=1e-6, balls=1, period=PERIOD, limits=None, **values):
        key = (kind, axes, toward, balls, period, limits, *values.items())
        if key not in made:
            joints = [
                {"name": axis, "type": "prismatic", "link": axis, "lower": -50.0, "upper": 50.0, "velocity": 5.0}
                | {"axis": [float(axis == other) for other in "xyz"]}
                for axis in axes
            ]
            point = {"name": "body", "link": axes[-1], "influence_radius": 0.1}
            robot = {"space": "planar", "joints": joints, "frames": [{"name": "tool", "link": axes[-1]}]}
            goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": toward, "damping": 1e-6}
            keep = {"name": "keep", "kind": "obstacle_avoidance", "activation": _activation(kind, **values)}
            made[key] = evaluated(
                robot | {"points_of_interest": [point]},
                keep,
                goal | {"axes": list(axes)},
                obstacles={"maximum": balls, "half_spaces": 1},
                period=period,
                **({"velocity_limits": {"kind": "clamp", "limit": limits}} if limits else {}),
            )
        return made[key]

    return build


WALL = {"half_space_normal": np.array([[-1.0, 0.0]]), "half_space_offset": np.array([0.0]), "half_space_count": 1}


def _pressed(law, v_n, depth, steps=4_000):
    """Depth over time (steps + 1,) of a point that a reference velocity v_n presses against a flat wall."""
    q, _ = law.run(steps, [depth - 0.1, 0.0], tool_reference_velocity=np.array([v_n, 0.0]), **WALL)
    return q[:, 0] + 0.1


def _ramp_at(share, gain_period, width=0.01):
    """Gain, v_n [m/s] and the depth of rest of a ramp with T √(v_n² + 2 K v_n δ) = share · 2 δ."""
    gain = gain_period / PERIOD
    v_n = width * (np.sqrt(gain_period**2 + 4 * share**2) - gain_period) / PERIOD
    return gain, v_n, (-v_n + np.sqrt(v_n**2 + 2 * gain * v_n * width)) / gain


def _damped_at(share, gain_period, damping=0.01):
    """Gain, v_n [m/s] and the depth of rest of a damped contact with K T h* = share · 4/3; ν = 1."""
    gain, h = gain_period / PERIOD, share * 4 / 3 / gain_period
    v_n = gain * damping * (h / (1 - h)) ** 1.5 / 2
    return gain, v_n, np.cbrt(2 * v_n * damping**2 / gain)


REST = 3e-4  # of a depth: the rows are held apart by 1e-4 of their square, over the slope of the share
BELOW, ABOVE = 0.97, 1.03  # of a threshold


@pytest.mark.parametrize("depth", [-0.01, 1e-4, 0.015])
@pytest.mark.parametrize("gain_period", [0.5, 1.0, 1.9])
def test_the_ramp_rests_below_its_threshold_and_cycles_above(gain_period, depth, slide):
    """T √(v_n² + 2 K v_n δ) < 2 δ, and at rest x = (−v_n + √(v_n² + 2 K v_n δ))/K."""
    gain, v_n, rest = _ramp_at(BELOW, gain_period)
    np.testing.assert_allclose(_pressed(slide("ramp", gain=gain), v_n, depth)[-200:], rest, rtol=REST)
    gain, v_n, rest = _ramp_at(ABOVE, gain_period)
    assert np.ptp(_pressed(slide("ramp", gain=gain), v_n, depth)[-200:]) > 0.05 * rest


@pytest.mark.parametrize("depth", [-0.01, 1e-4, 0.015])
@pytest.mark.parametrize("gain_period", [1.5, 1.9, 3.0])
def test_the_damped_contact_rests_below_its_threshold_and_cycles_above(gain_period, depth, slide):
    """K T h* < 4/3, and at rest x = (2 v_n ℓ²/K)^⅓."""
    gain, v_n, rest = _damped_at(BELOW, gain_period)
    np.testing.assert_allclose(_pressed(slide("damped", gain=gain, damping=0.01), v_n, depth)[-200:], rest, rtol=REST)
    gain, v_n, rest = _damped_at(ABOVE, gain_period)
    assert np.ptp(_pressed(slide("damped", gain=gain, damping=0.01), v_n, depth)[-200:]) > 0.05 * rest


@pytest.mark.parametrize("v_n", [0.02, 0.5, 2.0])
@pytest.mark.parametrize("gain", [20.0, 100.0])
def test_a_steady_approach_is_held_at_the_depth_of_the_formula(gain, v_n, slide):
    """The same two depths over a range of speeds, far from their thresholds."""
    ramp = _pressed(slide("ramp", gain=gain, width=0.05), v_n, -0.01)[-1]
    damped = _pressed(slide("damped", gain=gain, damping=0.02), v_n, -0.01)[-1]
    assert ramp == pytest.approx((-v_n + np.sqrt(v_n**2 + 2 * gain * v_n * 0.05)) / gain, rel=REST)
    assert damped == pytest.approx(np.cbrt(2 * v_n * 0.02**2 / gain), rel=REST)


@pytest.mark.parametrize("depth", [-0.02, 0.02])
def test_the_barrier_is_monotone_up_to_one_and_rests_up_to_two(depth, slide):
    """γ T <= 1: no overshoot. γ T < 2: no cycle. Above: one."""

    def pressed(rate_period):
        return _pressed(slide("barrier", rate=rate_period / PERIOD), 0.3, depth)

    for share in (0.5, 1.0):
        assert np.all(np.sign(depth) * pressed(share) > -1e-15)  # rounding of 0.1 m
        assert np.all(np.diff(-np.sign(depth) * pressed(share)) > -1e-15)
    overshoot = pressed(1.03)
    assert np.min(np.sign(depth) * overshoot) < -1e-6
    # 0.94^4000
    assert np.ptp(pressed(2 * BELOW)[-200:]) < 1e-14
    assert np.ptp(pressed(2 * ABOVE)[-200:]) > 1e-3


def _orbit(law, v_n, v_t, steps, radius=0.2):
    """Depth and share over time of a point that goes around a ball, drawn to it with v_n and along it with v_t."""
    q, depths, shares = np.array([radius + 0.1 + 0.002, 0.0]), [], []
    held = np.zeros(law.infos()["keep_held"].shape)
    ball = {"obstacle_center": np.zeros((1, 2)), "obstacle_radius": np.array([radius]), "obstacle_count": 1}
    for _ in range(steps):
        away = q / np.linalg.norm(q)
        wanted = -v_n * away + v_t * np.array([-away[1], away[0]])
        outputs = law(q=q, tool_reference=q, tool_reference_velocity=wanted, keep_held=held, **ball)
        depths.append(radius + 0.1 - np.linalg.norm(q))
        shares.append(outputs["keep_share"][0])
        q, held = outputs["q_next"], outputs["keep_held_next"]
    return np.array(depths), np.array(shares)


def test_hysteresis_holds_a_contact_as_wide_as_its_drift_and_cycles_when_narrower(slide):
    """Width w against x_f = 2 c/(K T), c = T² v_t²/(2 ρ): 5 % wider it rests x_f outside, 5 % narrower it lets go."""
    v_n, v_t, gain = 0.4, 0.6, 20.0
    drift = PERIOD**2 * v_t**2 / (2 * (0.2 + 0.1))
    rest = 2 * drift / (gain * PERIOD)
    assert drift < v_n * PERIOD  # else the task alone cannot keep up, and nothing is held
    depths, shares = _orbit(slide("hysteresis", gain=gain, width=1.05 * rest), v_n, v_t, 600)
    # c leaves out terms of T³ v³/ρ², 2 % here
    np.testing.assert_allclose(depths[-100:], -rest, rtol=0.02)
    assert np.all(shares[-100:] == 1)
    depths, shares = _orbit(slide("hysteresis", gain=gain, width=0.95 * rest), v_n, v_t, 600)
    assert np.sum(np.diff(shares[-300:]) != 0) >= 8
    assert np.ptp(depths[-300:]) > 0.9 * v_n * PERIOD - 2 * drift  # the way back in, b


# ---- Leaving ----

BALL = {"obstacle_center": np.zeros((1, 2)), "obstacle_radius": np.array([0.2]), "obstacle_count": 1}


@pytest.mark.parametrize("kind", ACTIVATIONS)
def test_only_the_paper_s_law_sticks_to_the_boundary_point_nearest_the_goal(kind, slide):
    """From 1 cm inside, a goal 0.7 m outside: eq. 11 lets it slide along the boundary, but not off it."""
    weak = {} if kind == "barrier" else {"gain": 1.0}
    start = 0.29 * np.array([np.cos(1.0), np.sin(1.0)])
    q, outputs = slide(kind, toward=2.0, **weak).run(600, start, tool_reference=np.array([1.0, 0.0]), **BALL)
    if kind == "switched":
        # the depth decays as exp(−K t/2), 20 times in 6 s; the point nearest the goal is (0.3, 0)
        assert 0 < 0.3 - q[-1, 0] < 0.01 / np.exp(0.5 * 6) + 1e-4
        assert abs(q[-1, 1]) < 1e-4
        assert np.linalg.norm(outputs["tool_error"][-1]) > 0.69
    else:
        # exp(−2 · 5.5 s) of the way
        np.testing.assert_allclose(q[-1], [1.0, 0.0], rtol=0, atol=1e-4)


# ---- Several contacts ----


def _passage(half):
    """Two balls of 0.2 m above and below the x axis, their boundaries 2 `half` apart."""
    y = 0.2 + 0.1 + half
    return {
        "obstacle_center": np.array([[0.0, y], [0.0, -y]]),
        "obstacle_radius": np.array([0.2, 0.2]),
        "obstacle_count": 2,
    }


def _across(law, half, rng, **given):
    """Ends of short segments across a passage along x, a third of them at its middle line and at a boundary."""
    q = np.stack([rng.uniform(-0.05, 0.05, 5_000), rng.uniform(-0.02, 0.02, 5_000)], axis=1)
    q[::3, 1] = 0
    q[1::3, 1] = half
    h, way = 10 ** rng.uniform(-7, -4, len(q)), rng.normal(size=q.shape)
    way *= (h / 2 / np.linalg.norm(way, axis=1))[:, None]
    ends = [law(q=q + side * way, tool_reference=np.array([0.6, 0.1]), **given)["dq_law"] for side in (1, -1)]
    return np.max(np.abs(ends)), h, np.linalg.norm(ends[0] - ends[1], axis=1)


@pytest.mark.parametrize("half", [0.01, 0.0, -0.004])
@pytest.mark.parametrize("kind", CONTINUOUS)
def test_between_opposed_walls_the_law_is_finite_and_continuous(kind, half, slide, evaluated):
    """In a corridor wide enough, just wide enough and too narrow: across its middle line, too.

    But for a ramp whose shares are both full there: within 1e-6 m the one that is fuller takes over.
    """
    joints = slide(kind).controller.spec.robot.model_dump(exclude_none=True)
    walls = [{"normal": [0.0, side], "offset": -0.1 - half} for side in (1.0, -1.0)]
    keep = {"name": "keep", "kind": "workspace_walls", "walls": walls, "frames": ["tool"], "margin": 0.1}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 2.0, "damping": 1e-6}
    law = evaluated(joints, keep | {"activation": _activation(kind)}, goal, period=PERIOD)
    most, h, step = _across(law, half, np.random.default_rng(5))
    assert most < 1.5  # [m/s]; the goal alone asks for 1.3
    # the most is 137: 0.2 m/s over ℓ = 1e-3 m; the least squares of the corridor that is too narrow are known to 1e-9
    assert np.all(step < 200 * h + 1e-8)


def test_among_balls_the_barrier_is_continuous_where_a_passage_leaves_room(slide):
    """All obstacles count at once: nothing happens where another one becomes the nearest."""
    law, rng = slide("barrier", toward=2.0, balls=2), np.random.default_rng(5)
    most, h, step = _across(law, 0.01, rng, **_passage(0.01))
    assert most < 1.5
    assert np.all(step < 300 * h)


@pytest.mark.parametrize("kind", ["ramp", "damped"])
def test_the_others_know_the_nearest_obstacle_alone_and_jump_where_it_changes(kind, slide):
    """A point that is inside the regions of two obstacles at once: what the barrier is for."""
    law, rng = slide(kind, toward=2.0, balls=2), np.random.default_rng(5)
    _, h, step = _across(law, -0.01, rng, **_passage(-0.01))
    assert np.max(step[h < 1e-6]) > 0.05
    _, h, step = _across(law, 0.01, rng, **_passage(0.01))
    assert np.all(step < 300 * h)


def test_the_barrier_goes_through_a_passage_that_is_wide_enough_and_keeps_both_sides(slide):
    """By 1 mm on either side; the goal beyond is reached."""
    q, outputs = slide("barrier", toward=2.0, balls=2).run(
        2_000, [-0.6, 0.03], tool_reference=np.array([0.6, 0.0]), **_passage(1e-3)
    )
    assert np.min(outputs["clearance"]) > -1e-12
    assert np.all(outputs["barrier_row"] == -1)
    np.testing.assert_allclose(q[-1], [0.6, 0.0], rtol=0, atol=1e-6)


def test_before_a_passage_that_is_too_narrow_the_barrier_stops(slide):
    q, outputs = slide("barrier", toward=2.0, balls=2).run(
        2_000, [-0.6, 0.03], tool_reference=np.array([0.6, 0.0]), **_passage(-0.01)
    )
    assert np.min(outputs["clearance"]) > -1e-12
    assert np.max(np.linalg.norm(outputs["dq_law"], axis=1)) < 2.5  # [m/s] the goal alone asks for 2.4
    # where the balls leave 2 · 0.3 m between their centres' distance: √(0.3² − 0.29²) before the middle
    np.testing.assert_allclose(q[-1], [-np.sqrt(0.3**2 - 0.29**2), 0], rtol=0, atol=1e-6)


def test_the_paper_s_sum_flings_a_point_where_two_contacts_cancel(slide, evaluated):
    """The contrast: J_o = Σ x j → 0 while V > 0, so q̇_o = J_o⁺ K (0 − V) grows without bound."""
    joints = slide("switched").controller.spec.robot.model_dump(exclude_none=True)
    walls = [{"normal": [0.0, side], "offset": -0.09} for side in (1.0, -1.0)]
    keep = {"name": "keep", "kind": "workspace_walls", "walls": walls, "frames": ["tool"], "margin": 0.1}
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 2.0, "damping": 1e-6}
    law = evaluated(joints, keep | {"activation": _activation("switched")}, goal, period=PERIOD)
    u = law(q=np.array([0.0, 1e-6]), tool_reference=np.zeros(2))["dq_law"]
    # K V / |J_o| = 20 · 0.01² / 2e-6, V = 2 · ½ x²
    assert np.linalg.norm(u) == pytest.approx(1000, rel=0.01)


# ---- Obstacles that move ----


@pytest.mark.parametrize("aside", [0.0, 0.15])
def test_a_moving_obstacle_is_kept_off_when_its_velocity_is_known(aside, slide):
    """Straight motion past a ball only opens it: its curvature is on the safe side, and clearance stays >= 0."""
    start, velocity = np.array([-1.0, aside]), np.array([0.5, 0.0])
    given = {
        "tool_reference": np.zeros(2),
        "obstacle_center": lambda t: (start + velocity * t)[None],
        "obstacle_radius": np.array([0.2]),
        "obstacle_count": 1,
    }
    law = slide("barrier")
    _, known = law.run(400, [0.0, 0.0], obstacle_velocity=velocity[None], **given)
    assert np.min(known["clearance"]) > -1e-9
    assert np.min(known["clearance"]) < 1e-3  # and it does come as near as it may
    _, unknown = law.run(400, [0.0, 0.0], **given)
    sunk = np.linalg.norm(velocity) / ACTIVATIONS["barrier"]["rate"]
    if aside == 0:
        assert unknown["clearance"][-1] == pytest.approx(-sunk, rel=1e-6)  # v_o/γ, for as long as it is pushed
    assert -sunk - 1e-9 < np.min(unknown["clearance"]) < -0.5 * sunk


def test_an_arm_sinks_no_deeper_than_its_curvature_takes_it(plane_arm, evaluated):
    """A step leaves the straight line by L T² |q̇|²/2 at most, which γ T balances: x <= L T |q̇|²/(2 γ).

    L = λ_max(Σ l_i b_i b_iᵀ) bounds the second derivative of the hand's position; distance to a wall is linear.
    """
    lengths, rng = [0.5, 0.4, 0.3], np.random.default_rng(6)
    points = [{"name": "hand", "link": "link2", "offset": [0.3, 0, 0], "influence_radius": 0.1}]
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 5.0, "damping": 0.05}
    keep = {"name": "keep", "kind": "obstacle_avoidance", "activation": _activation("barrier")}
    law = evaluated(
        plane_arm(lengths, points_of_interest=points),
        keep,
        goal,
        obstacles={"half_spaces": 1},
        velocity_limits={"kind": "clamp"},
        period=PERIOD,
    )
    b = np.tril(np.ones((3, 3)))
    curvature = np.linalg.eigvalsh(np.einsum("i,ij,ik->jk", lengths, b, b))[-1]
    sunk = []
    for _ in range(25):
        q = rng.uniform(-2, 2, 3)
        hand, angle = law("kinematics", q=q)["tool_position"], rng.uniform(0, 2 * np.pi)
        normal = np.array([np.cos(angle), np.sin(angle)])
        size, pace, phase = rng.uniform(0.2, 1), rng.uniform(1, 3), rng.uniform(0, 6)

        def circle(t, hand=hand, size=size, pace=pace, phase=phase):
            return hand + size * np.array([np.cos(pace * t + phase), np.sin(pace * t + phase)])

        offset = np.array([normal @ hand - 0.1 - rng.uniform(0, 0.1)])
        wall = {"half_space_normal": normal[None], "half_space_offset": offset, "half_space_count": 1}
        _, outputs = law.run(400, q, tool_reference=circle, **wall)
        fastest = np.max(np.linalg.norm(outputs["dq_law"], axis=1))
        assert np.max(outputs["barrier_excess"]) < 1e-8
        bound = curvature * PERIOD * fastest**2 / (2 * ACTIVATIONS["barrier"]["rate"])
        assert -np.min(outputs["clearance"]) < bound
        sunk.append(-np.min(outputs["clearance"]) / bound)
    assert max(sunk) > 0.1  # the curvature is there


# ---- What cannot be kept ----


def _closing(t):
    """Half the way between two obstacles' centres [m] and how fast it changes [m/s]: they close, wait, and part."""
    if t < 2.5:
        return 0.45 - 0.1 * t, -0.1
    if t < 3.5:
        return 0.2, 0.0
    return (0.2 + 0.1 * (t - 3.5), 0.1) if t < 6 else (0.45, 0.0)


def test_a_point_on_a_rail_is_squeezed_by_two_obstacles_and_recovers(slide):
    """No velocity keeps both: finite, within the limits, reported while it lasts, and over when they part."""
    limit = 0.5
    law = slide("barrier", axes="y", toward=1.0, balls=2, limits=limit)
    given = {
        "tool_reference": np.array([0.02]),
        "obstacle_center": lambda t: np.array([[0.03, _closing(t)[0]], [0.03, -_closing(t)[0]]]),
        "obstacle_velocity": lambda t: np.array([[0.0, _closing(t)[1]], [0.0, -_closing(t)[1]]]),
        "obstacle_radius": np.array([0.2, 0.2]),
        "obstacle_count": 2,
    }
    q, outputs = law.run(1_000, [0.02], **given)
    squeezed = outputs["barrier_row"] >= 0
    assert np.all(np.isfinite(q))
    assert np.max(np.abs(outputs["dq_law"])) <= limit
    assert np.sum(squeezed) > 150
    assert set(outputs["barrier_row"][squeezed]) <= {0, 1}
    np.testing.assert_array_equal(squeezed, outputs["barrier_excess"] > 1e-8)
    assert np.all(outputs["barrier_solved"] == 1)
    # in the middle: both are violated alike
    assert np.max(np.abs(q[300:350, 0])) < 1e-3
    assert not np.any(squeezed[620:])
    assert outputs["clearance"][-1] > 0.1
    assert q[-1, 0] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.parametrize("fast", [0, 1])
def test_an_obstacle_faster_than_the_robot_is_the_row_that_is_named(fast, slide):
    law = slide("barrier", toward=1.0, balls=2, limits=0.5)

    def along(t):
        return -0.6 + t if t < 0.6 else 0.6 - t, 1.0 if t < 0.6 else -1.0

    def places(t):
        return np.array([[along(t)[0], 0.0] if k == fast else [9.0, 9.0] for k in range(2)])

    def velocities(t):
        return np.array([[along(t)[1], 0.0] if k == fast else [0.0, 0.0] for k in range(2)])

    sizes = {"obstacle_radius": np.array([0.2, 0.2]), "obstacle_count": 2}
    q, outputs = law.run(
        600, [0.0, 0.0], tool_reference=np.zeros(2), obstacle_center=places, obstacle_velocity=velocities, **sizes
    )
    beaten = outputs["barrier_excess"] > 1e-8
    assert np.sum(beaten) > 20
    assert np.all(outputs["barrier_row"][beaten] == fast)
    assert np.all(outputs["barrier_row"][~beaten] == -1)
    assert np.max(np.abs(outputs["dq_law"])) <= 0.5
    np.testing.assert_allclose(q[-1], 0, rtol=0, atol=0.01)


@pytest.mark.parametrize("bent", [0.0, 1e-16, 1e-8, 1e-5, 1e-3])
def test_a_contact_that_can_be_kept_is_not_given_up_for_one_that_cannot(bent, plane_arm, evaluated):
    """An arm stretched toward an obstacle 1 cm too near can hardly move away; its elbow, 1 mm from another, stays."""
    points = [
        {"name": "elbow", "link": "link0", "offset": [0.5, 0, 0], "influence_radius": 0.1},
        {"name": "hand", "link": "link2", "offset": [0.3, 0, 0], "influence_radius": 0.1},
    ]
    keep = {"name": "keep", "kind": "obstacle_avoidance", "activation": _activation("barrier")}
    law = evaluated(
        plane_arm([0.5, 0.4, 0.3], points_of_interest=points),
        keep,
        GOAL,
        obstacles={"maximum": 2},
        velocity_limits={"kind": "clamp"},
        period=PERIOD,
    )
    q = np.array([bent, 0.0, 0.0])
    seen = law("kinematics", q=q)
    center = np.array([[1.29, 0.0], seen["point_position"][0] + [0, 0.101]])
    outputs = law(
        q=q,
        tool_reference=seen["tool_position"],
        obstacle_center=center,
        obstacle_radius=np.zeros(2),
        obstacle_count=2,
    )
    assert np.all(np.isfinite(outputs["dq_law"]))
    assert np.max(np.abs(outputs["dq_law"])) <= 2.0
    # γ · 1 mm, and what the hand's leverage, 1.2 m · bent, is worth in the least squares
    assert 0.5 * outputs["dq_law"][0] < 0.01 + 5 * bent + 1e-6
    assert outputs["barrier_row"] == 2  # the hand and the first obstacle
    assert outputs["barrier_excess"] > 0.05


# ---- Redundancy ----


def test_an_obstacle_at_the_elbow_costs_the_barrier_a_tenth_of_the_switch_s_tracking_error_at_most(
    plane_arm, evaluated
):
    """Four joints, a tool on a circle, and an obstacle that creeps up to the elbow: null-space motion can clear it."""
    points = [{"name": "elbow", "link": "link1", "influence_radius": 0.15}]
    robot = plane_arm([0.5, 0.4, 0.3, 0.3], points_of_interest=points)
    goal = {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0, "damping": 1e-3}
    q, size, pace, rise = np.array([0.3, 0.6, 0.5, -0.9]), 0.1, 0.5, 0.1

    def tracked(kind, **values):
        keep = {"name": "keep", "kind": "obstacle_avoidance", "activation": _activation(kind, **values)}
        law = evaluated(robot, keep, goal, obstacles={"maximum": 1}, period=PERIOD)
        seen = law("kinematics", q=q)
        tool, elbow = seen["tool_position"], seen["point_position"][0]
        return law.run(
            1_000,
            q,
            tool_reference=lambda t: tool + size * np.array([np.cos(pace * t) - 1, np.sin(pace * t)]),
            tool_reference_velocity=lambda t: size * pace * np.array([-np.sin(pace * t), np.cos(pace * t)]),
            obstacle_center=lambda t: (elbow + np.array([0.05, -0.35 + rise * min(t, 3.0)]))[None],
            obstacle_velocity=lambda t: np.array([[0.0, rise if t < 3 else 0.0]]),
            obstacle_radius=np.array([0.1]),
            obstacle_count=1,
        )[1]

    errors = {}
    for kind, values in (("switched", {"gain": 250.0}), ("barrier", {})):
        outputs = tracked(kind, **values)
        assert np.any(outputs["clearance"] < 1e-3)  # it is met
        errors[kind] = np.sqrt(np.mean(np.sum(outputs["tool_error"] ** 2, axis=1)))
    assert errors["switched"] > 0.01
    assert 10 * errors["barrier"] < errors["switched"]
