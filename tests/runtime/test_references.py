"""Every kind of reference: its velocity is the derivative of its position, and it starts and ends as it says."""

import typing

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from clikgen.runtime.documents import BadInput, Document
from clikgen.runtime.references import (
    AnyTrajectory,
    Circle,
    Csv,
    Fixed,
    Line,
    Orientation,
    OrientationSpline,
    PointToPoint,
    Spin,
    Spline,
    Turn,
)
from clikgen.runtime.scenario import Obstacle

WAYPOINTS = [[0.0, 1.0], [0.5, 0.2], [1.5, 0.8], [1.0, -0.3]]
TIMES = [0.0, 0.7, 1.5, 3.0]

# kind -> what its table holds, how long it moves [s], and where it starts and ends
EXAMPLES = {
    "fixed": ({"position": [0.3, -0.2]}, 0.0, [0.3, -0.2], [0.3, -0.2]),
    "line": ({"start": [0.0, 1.0], "end": [2.0, 0.5], "duration": 1.6}, 1.6, [0.0, 1.0], [2.0, 0.5]),
    "point_to_point": ({"start": [0.0, 1.0], "end": [2.0, 0.5], "duration": 1.6}, 1.6, [0.0, 1.0], [2.0, 0.5]),
    "circle": (
        {"center": [1.0, 2.0], "radius": 0.5, "period": -1.7, "phase": np.pi / 2},
        np.inf,
        [1.0, 2.5],
        None,
    ),
    "spline": ({"waypoints": WAYPOINTS, "times": TIMES}, 3.0, WAYPOINTS[0], WAYPOINTS[-1]),
    "csv": ({}, 3.0, WAYPOINTS[0], WAYPOINTS[-1]),
}

# roll, pitch, yaw [rad]; each a large turn away from the last, the third past half a turn of yaw
RPYS = [[0.3, -0.5, 0.2], [1.1, 0.4, 2.5], [-0.6, 0.9, -2.6], [2.0, -1.2, -1.0]]

# kind -> what its table holds, how long it moves [s], and the rpy [rad] it starts and ends at, None where it needs work
ROTATIONS = {
    "orientation": ({"rpy": RPYS[0]}, 0.0, RPYS[0], RPYS[0]),
    "turn": ({"start": RPYS[0], "end": RPYS[1], "duration": 1.6}, 1.6, RPYS[0], RPYS[1]),
    "spin": ({"start": RPYS[0], "axis": [1.0, -2.0, 0.5], "rate": -5.0, "duration": 3.2}, 3.2, RPYS[0], None),
    "orientation_spline": ({"waypoints": RPYS, "times": TIMES}, 3.0, RPYS[0], RPYS[-1]),
}
KINDS = {kind.model_fields["kind"].annotation.__args__[0]: kind for kind in typing.get_args(AnyTrajectory)[0].__args__}


@pytest.fixture
def csv_file(tmp_path):
    path = tmp_path / "path.csv"
    rows = "".join(f"{t},{x},{y}\n" for t, (x, y) in zip(TIMES, WAYPOINTS, strict=True))
    path.write_text("t,x,y\n" + rows)
    return path


@pytest.fixture
def example(csv_file):
    """The example of a kind, as a spec file would make it."""

    def make(kind, **more):
        table = (EXAMPLES | ROTATIONS)[kind][0] | ({"file": str(csv_file)} if kind == "csv" else {})
        return KINDS[kind].parse({"kind": kind, **table, **more}, "a test")

    return make


def test_every_kind_has_an_example():
    assert set(EXAMPLES) | set(ROTATIONS) == set(KINDS)


kinds = pytest.mark.parametrize("kind", EXAMPLES)
rotations = pytest.mark.parametrize("kind", ROTATIONS)


@kinds
@pytest.mark.parametrize("delay", [0.0, 0.8])
def test_velocity_is_the_derivative_of_position(kind, delay, example):
    trajectory = example(kind, delay=delay)
    h = 1e-5
    t = np.linspace(-0.5, 5, 1111)
    kinks = [delay, delay + EXAMPLES[kind][1]]  # a line's velocity steps there
    t = t[np.all(np.abs(t[:, None] - kinks) > 2 * h, axis=1)]
    velocity = trajectory.sample(t)[1]
    difference = (trajectory.sample(t + h)[0] - trajectory.sample(t - h)[0]) / (2 * h)
    # h²/6 of a third derivative below 60 m/s³ is 1e-9; rounding of 4e-16 m over 2h is 2e-11
    np.testing.assert_allclose(velocity, difference, rtol=0, atol=2e-9)
    assert np.any(velocity) == (kind != "fixed")


@kinds
def test_it_starts_and_ends_where_it_says_and_rests_before_and_after(kind, example):
    delay = 0.8
    trajectory = example(kind, delay=delay)
    _, end, first, last = EXAMPLES[kind]
    position, velocity = trajectory.sample(np.array([-1.0, 0.0, delay - 1e-9, delay]))
    # a circle's start goes through a cosine; nothing is larger than 3 m
    np.testing.assert_allclose(position, [first] * 4, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(velocity[:3], np.zeros((3, 2)))
    if last is not None:
        position, velocity = trajectory.sample(delay + end + np.array([0.0, 1e-9, 1.0, 1e6]))
        # delay + end − delay rounds to 2e-16 s, a spline's last piece to some 1e-15 m
        np.testing.assert_allclose(position, [last] * 4, rtol=0, atol=2e-15)
        np.testing.assert_array_equal(velocity[2:], np.zeros((2, 2)))


@kinds
def test_delay_only_shifts_it_in_time(kind, example):
    t = np.linspace(0, 5, 500)
    delayed, plain = example(kind, delay=0.75), example(kind)
    # times of up to 6 s, rounded to 9e-16 s, at speeds of up to 3 m/s
    for late, early in zip(delayed.sample(t + 0.75), plain.sample(t), strict=True):
        np.testing.assert_allclose(late[1:-1], early[1:-1], rtol=0, atol=2e-14)


@kinds
def test_samples_have_a_row_for_each_time_and_are_ones_own(kind, example):
    trajectory = example(kind)
    t = np.linspace(0, 2, 7)
    assert trajectory.dimension == 2
    assert trajectory.space == "vector"
    for array in trajectory.sample(t):
        assert array.shape == (7, 2)
        array[:] = np.nan  # to write into one sample changes no other
    assert all(np.all(np.isfinite(array)) for array in trajectory.sample(t))
    for array in trajectory.sample(np.empty(0)):
        assert array.shape == (0, 2)


def test_a_line_has_constant_speed():
    line = Line(kind="line", start=(0.0, 1.0), end=(2.0, 0.5), duration=1.6)
    t = np.linspace(0, 1.6, 17)
    np.testing.assert_array_equal(line.sample(t)[1], np.tile([2.0 / 1.6, -0.5 / 1.6], (17, 1)))


def test_point_to_point_starts_and_ends_without_velocity_and_acceleration():
    motion = PointToPoint(kind="point_to_point", start=(0.0,), end=(2.0,), duration=1.6, delay=0.5)
    for moment in (0.5, 2.1):
        t = moment + np.array([-1e-4, 0.0, 1e-4])
        # 30 τ² · 2 m / 1.6 s with τ = 1e-4 / 1.6
        assert np.max(np.abs(motion.sample(t)[1])) < 1.5e-7
    middle, velocity = motion.sample(np.array([1.3]))
    assert middle[0, 0] == pytest.approx(1.0, rel=1e-15)
    assert velocity[0, 0] == pytest.approx(15 / 8 * 2.0 / 1.6, rel=1e-15)


def test_a_circle_keeps_its_radius_turns_in_its_period_and_stays_at_its_height():
    circle = Circle(kind="circle", center=(1.0, 2.0, 3.0), radius=0.5, period=-4.0)
    t = np.linspace(0, 8, 100)
    position, velocity = circle.sample(t)
    # coordinates of up to 3 m, rounded
    np.testing.assert_allclose(np.linalg.norm(position - [1, 2, 3], axis=1), 0.5, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), 0.5 * 2 * np.pi / 4, rtol=1e-14, atol=0)
    np.testing.assert_array_equal(position[:, 2], np.full(100, 3.0))
    np.testing.assert_array_equal(velocity[:, 2], np.zeros(100))
    quarter = circle.sample(np.array([1.0, 5.0]))[0]
    np.testing.assert_allclose(quarter, [[1, 1.5, 3]] * 2, rtol=0, atol=1e-15)  # clockwise: from +x to −y


def test_a_spline_meets_its_waypoints_and_rests_at_both_ends():
    spline = Spline(kind="spline", waypoints=tuple(map(tuple, WAYPOINTS)), times=tuple(TIMES))
    position, velocity = spline.sample(np.array(TIMES))
    # a piece adds up four terms below 2 m, and its slopes terms of up to 10 m/s
    np.testing.assert_allclose(position, WAYPOINTS, rtol=0, atol=2e-15)
    np.testing.assert_allclose(velocity[[0, -1]], 0, rtol=0, atol=2e-14)
    assert np.all(np.abs(velocity[1:-1]).max(axis=1) > 0.1)


def test_a_spline_bends_without_jumps_in_acceleration():
    spline = Spline(kind="spline", waypoints=tuple(map(tuple, WAYPOINTS)), times=tuple(TIMES))
    h = 1e-5
    for knot in TIMES[1:-1]:
        before, at, after = spline.sample(knot + np.array([-h, 0, h]))[1]
        # slopes of the velocity differ by h times a jerk below 50 m/s³, and rounding of 1e-15/h
        np.testing.assert_allclose((at - before) / h, (after - at) / h, rtol=0, atol=1e-3)


def test_a_csv_is_the_spline_through_its_rows(example):
    t = np.linspace(-1, 4, 200)
    for first, second in zip(example("csv").sample(t), example("spline").sample(t), strict=True):
        np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(
        example("csv").sample(np.array([1.1]))[0],
        CubicSpline(TIMES, WAYPOINTS, bc_type="clamped")([1.1]),
    )


def test_a_csv_may_have_blank_lines_spaces_and_dos_line_ends(example, tmp_path):
    path = tmp_path / "dos.csv"
    rows = "".join(f" {t} , {x},{y} \r\n\r\n" for t, (x, y) in zip(TIMES, WAYPOINTS, strict=True))
    path.write_bytes(("t,x,y\r\n" + rows).encode())
    t = np.linspace(0, 3, 50)
    for first, second in zip(example("csv", file=str(path)).sample(t), example("csv").sample(t), strict=True):
        np.testing.assert_array_equal(first, second)


def test_a_csv_that_goes_away_after_it_was_read_changes_nothing(example, csv_file):
    trajectory, twin = example("csv"), example("spline")
    csv_file.unlink()
    t = np.linspace(0, 3, 50)
    np.testing.assert_array_equal(trajectory.sample(t)[0], twin.sample(t)[0])


# ---- Many coordinates ----

N = 50


@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        ("fixed", {"position": (N,)}),
        ("line", {"start": (N,), "end": (N,), "duration": ()}),
        ("point_to_point", {"start": (N,), "end": (N,), "duration": ()}),
        ("spline", {"waypoints": (4, N)}),
    ],
)
def test_each_of_fifty_coordinates_moves_as_it_would_alone(kind, fields):
    rng = np.random.default_rng(3)
    values = {name: rng.uniform(0.5, 2.0, shape) for name, shape in fields.items()}
    more = {"times": TIMES} if kind == "spline" else {}

    def sample(columns):
        table = {name: (value[..., columns] if value.ndim else value).tolist() for name, value in values.items()}
        trajectory = KINDS[kind].parse({"kind": kind, **table, **more}, "a test")
        assert trajectory.dimension == len(range(N)[columns])
        return trajectory.sample(np.linspace(-0.5, 3.5, 41))

    together = sample(slice(None))
    for i in range(N):
        for all_of_them, alone in zip(together, sample(slice(i, i + 1)), strict=True):
            # values below 3, slopes below 20; a spline's solver may sum in another order
            np.testing.assert_allclose(all_of_them[:, [i]], alone, rtol=0, atol=1e-13)


def test_a_csv_of_eight_columns_is_a_motion_of_seven_joints(tmp_path):
    rows = np.column_stack([TIMES, np.random.default_rng(4).uniform(-3, 3, (4, 7))])
    path = tmp_path / "joints.csv"
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t,q1,q2,q3,q4,q5,q6,q7", comments="")
    motion = Csv.parse({"kind": "csv", "file": str(path)}, "a test")
    assert motion.dimension == 7
    posture, velocity = motion.sample(np.array(TIMES))
    # a piece adds up four terms below 20 rad, its slopes terms below 100 rad/s
    np.testing.assert_allclose(posture, rows[:, 1:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(velocity[[0, -1]], 0, rtol=0, atol=1e-13)


# ---- Rotations: the truth is written out here, none of it from scipy.spatial ----


def _rotation_matrix(axis, angle):
    """Rodrigues' formula for a unit axis."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _rpy_matrix(rpy):
    """URDF: roll, pitch, yaw about the fixed axes x, y, z, in that order."""
    roll, pitch, yaw = (_rotation_matrix(axis, angle) for axis, angle in zip(np.eye(3), rpy, strict=True))
    return yaw @ pitch @ roll


def _matrices(quaternions):
    """The rotation matrices (k, 3, 3) of the unit quaternions (k, 4), w first."""
    w, x, y, z = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def _quaternion_rates(omega, quaternions):
    """q̇ = ½ ω ⊗ q, (k, 4), for ω in the world frame."""
    w, v = quaternions[:, :1], quaternions[:, 1:]
    return np.column_stack([-np.sum(omega * v, axis=1), w * omega + np.cross(omega, v)]) / 2


def _angle(matrix):
    """How far a rotation matrix turns [rad], in [0, π]."""
    return np.arccos(np.clip((np.trace(matrix) - 1) / 2, -1, 1))


@rotations
@pytest.mark.parametrize("delay", [0.0, 0.8])
def test_angular_velocity_in_the_world_frame_is_the_derivative_of_the_quaternion(kind, delay, example):
    trajectory = example(kind, delay=delay)
    h = 1e-5
    t = np.linspace(-0.5, 5, 1111)
    kinks = delay + np.array([*TIMES, ROTATIONS[kind][1]])  # a spin's velocity steps, a spline's pieces meet
    t = t[np.all(np.abs(t[:, None] - kinks) > 2 * h, axis=1)]
    quaternion, omega = trajectory.sample(t)
    difference = (trajectory.sample(t + h)[0] - trajectory.sample(t - h)[0]) / (2 * h)
    # h²/6 of a third derivative below 300/s³ is 5e-9; rounding of 4e-16 over 2h is 2e-11
    np.testing.assert_allclose(_quaternion_rates(omega, quaternion), difference, rtol=0, atol=1e-8)
    assert np.any(omega) == (kind != "orientation")


@rotations
def test_quaternions_have_unit_norm(kind, example):
    quaternion = example(kind, delay=0.3).sample(np.linspace(-1, 5, 1000))[0]
    # a normalised quaternion times a normalised quaternion, rounded
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1, rtol=0, atol=2e-15)


@rotations
def test_a_rotation_starts_and_ends_where_it_says_and_rests_before_and_after(kind, example):
    delay = 0.8
    trajectory = example(kind, delay=delay)
    table, end, first, last = ROTATIONS[kind]
    quaternion, omega = trajectory.sample(np.array([-1.0, 0.0, delay - 1e-9, delay]))
    # products of rotation matrices, rounded a few times
    np.testing.assert_allclose(_matrices(quaternion), [_rpy_matrix(first)] * 4, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(omega[:3], np.zeros((3, 3)))
    if last is None:
        axis = np.array(table["axis"]) / np.linalg.norm(table["axis"])
        final = _rotation_matrix(axis, table["rate"] * end) @ _rpy_matrix(first)
    else:
        final = _rpy_matrix(last)
    quaternion, omega = trajectory.sample(delay + end + np.array([0.0, 1e-9, 1.0, 1e6]))
    # delay + end − delay rounds to 4e-16 s, at up to 5 rad/s, and angles of 16 rad round to 2e-15
    np.testing.assert_allclose(_matrices(quaternion), [final] * 4, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(omega[1:], np.zeros((3, 3)))


@pytest.mark.parametrize("kind", ["turn", "orientation_spline"])
def test_a_turn_and_an_orientation_spline_gather_and_lose_speed_gently(kind, example):
    end = ROTATIONS[kind][1]
    omega = example(kind).sample(np.array([0.0, 1e-6, end - 1e-6, end]))[1]
    # 1e-6 s at below 100 rad/s²; exactly at the ends, the slope of the time law as rounded
    assert np.max(np.abs(omega)) < 1e-4
    assert np.max(np.abs(omega[[0, -1]])) < 1e-13
    # a spin does not: it is the ramp
    assert np.linalg.norm(example("spin").sample(np.array([0.0]))[1]) == pytest.approx(5.0, rel=1e-15)


@rotations
def test_delay_only_shifts_a_rotation_in_time(kind, example):
    t = np.linspace(0, 5, 500)
    delayed, plain = example(kind, delay=0.75), example(kind)
    # times of up to 6 s, rounded to 9e-16 s, at below 100 rad/s²
    for late, early in zip(delayed.sample(t + 0.75), plain.sample(t), strict=True):
        np.testing.assert_allclose(late[1:-1], early[1:-1], rtol=0, atol=1e-13)


@rotations
def test_rotation_samples_have_a_row_for_each_time_and_are_ones_own(kind, example):
    trajectory = example(kind)
    t = np.linspace(0, 2, 7)
    assert (trajectory.space, trajectory.dimension) == ("rotation", 3)
    for array, width in zip(trajectory.sample(t), (4, 3), strict=True):
        assert array.shape == (7, width)
        array[:] = np.nan  # to write into one sample changes no other
    assert all(np.all(np.isfinite(array)) for array in trajectory.sample(t))
    for array, width in zip(trajectory.sample(np.empty(0)), (4, 3), strict=True):
        assert array.shape == (0, width)


def _random_rotations():
    rng = np.random.default_rng(5)
    for _ in range(20):
        rpys = rng.uniform(-2 * np.pi, 2 * np.pi, (6, 3)).tolist()
        yield Turn(kind="turn", start=rpys[0], end=rpys[1], duration=2.0)
        yield Spin(kind="spin", start=rpys[0], axis=rpys[1], rate=12.0, duration=2.0)
        times = [0.0, *np.cumsum(rng.uniform(0.3, 1.0, 5)).tolist()]
        yield OrientationSpline(kind="orientation_spline", waypoints=rpys, times=times)
    for half in (np.pi, -np.pi):  # which way round, and with which sign, is decided by rounding
        yield Turn(kind="turn", start=(0.1, 0.2, 0.3), end=(0.1, 0.2, 0.3 + half), duration=2.0)
        turns = [[0.1, 0.2, 0.3 + half * i] for i in range(6)]
        yield OrientationSpline(kind="orientation_spline", waypoints=turns, times=[0, 1, 2, 3, 4, 5])


def test_the_sign_of_the_quaternion_is_continuous_over_time():
    t = np.linspace(-0.5, 5.5, 6001)
    for trajectory in _random_rotations():
        quaternion, omega = trajectory.sample(t)
        step = np.linalg.norm(np.diff(quaternion, axis=0), axis=1)
        # |q̇| = |ω|/2, its greatest between two samples below twice that at them; a jump of sign is a step of 2
        assert np.max(step) <= np.max(np.linalg.norm(omega, axis=1)) * 1e-3
        assert np.max(step) < 0.05


def test_a_sample_of_a_rotation_depends_on_its_own_time_only():
    t = np.linspace(-0.5, 5.5, 601)
    for trajectory in _random_rotations():
        for dense, sparse in zip(trajectory.sample(t), trajectory.sample(t[::-97]), strict=True):
            # the same terms, perhaps summed in another order; rates are below 30 rad/s
            np.testing.assert_allclose(dense[::-97], sparse, rtol=0, atol=1e-13)


def test_a_fixed_orientation_is_roll_then_pitch_then_yaw_about_fixed_axes():
    quarter = np.pi / 2
    orientation = Orientation(kind="orientation", rpy=(quarter, 0.0, quarter))
    # roll takes z to −y, yaw takes −y to x; coordinates of one, rounded
    tool_z = _matrices(orientation.sample(np.zeros(1))[0])[0] @ [0, 0, 1]
    np.testing.assert_allclose(tool_z, [1, 0, 0], rtol=0, atol=1e-15)


def test_a_turn_goes_the_shortest_way_about_one_axis():
    rng = np.random.default_rng(6)
    t = np.linspace(0, 1.6, 401)
    for _ in range(50):
        start, end = rng.uniform(-2 * np.pi, 2 * np.pi, (2, 3)).tolist()
        omega = Turn(kind="turn", start=start, end=end, duration=1.6).sample(t)[1]
        speed = np.linalg.norm(omega, axis=1)
        distance = _angle(_rpy_matrix(end) @ _rpy_matrix(start).T)
        # the trapezoidal rule on a quartic that starts and ends flat is of fourth order: (1/400)⁴ times some 10
        assert np.trapezoid(speed, t) == pytest.approx(distance, abs=1e-8)
        assert distance <= np.pi
        assert speed[200] == pytest.approx(15 / 8 * distance / 1.6, abs=1e-7)  # an arccos near π has half the digits
        np.testing.assert_allclose(omega, speed[:, None] * omega[200] / speed[200], rtol=0, atol=1e-14)


def test_a_turn_past_half_a_turn_of_yaw_is_not_the_long_way_round():
    motion = Turn(kind="turn", start=(0.0, 0.0, 3.0), end=(0.0, 0.0, -3.0), duration=2.0)
    quaternion, omega = motion.sample(np.array([1.0]))
    # it meets yaw π in the middle, on a way of 2π − 6; entries up to one, rounded
    np.testing.assert_allclose(_matrices(quaternion)[0], np.diag([-1, -1, 1]), rtol=0, atol=2e-15)
    np.testing.assert_allclose(omega, [[0, 0, 15 / 8 * (2 * np.pi - 6) / 2]], rtol=0, atol=2e-15)


def test_a_turn_and_a_point_to_point_keep_one_time_law():
    t = np.linspace(-0.5, 3.0, 50)
    turn = Turn(kind="turn", start=(0.0, 0.0, 0.0), end=(0.0, 0.0, 1.2), duration=2.0, delay=0.25)
    line = PointToPoint(kind="point_to_point", start=(0.0,), end=(1.2,), duration=2.0, delay=0.25)
    (quaternion, omega), (yaw, rate) = turn.sample(t), line.sample(t)
    # the angle 1.2 comes through a sine and an arc tangent
    np.testing.assert_allclose(2 * np.arctan2(quaternion[:, 3], quaternion[:, 0]), yaw[:, 0], rtol=0, atol=2e-15)
    np.testing.assert_allclose(omega[:, 2], rate[:, 0], rtol=0, atol=2e-15)


def test_a_turn_to_where_it_is_stays_there():
    quaternion, omega = Turn(kind="turn", start=RPYS[0], end=RPYS[0], duration=1.0).sample(np.linspace(0, 1, 9))
    # the way is a rotation by rounding only
    np.testing.assert_allclose(_matrices(quaternion), [_rpy_matrix(RPYS[0])] * 9, rtol=0, atol=2e-15)
    np.testing.assert_allclose(omega, 0, rtol=0, atol=1e-15)


def test_a_spin_turns_at_its_rate_about_its_axis_in_the_world_however_long_the_axis():
    t = np.linspace(0, 9.9, 34)  # eight turns
    for length in (1.0, 5.0, 1e-200, 1e200):
        axis = tuple(length * np.array([2.0, -1.0, 2.0]))
        quaternion, omega = Spin(kind="spin", start=RPYS[1], axis=axis, rate=5.0, duration=10.0).sample(t)
        unit = np.array([2, -1, 2]) / 3
        np.testing.assert_allclose(omega, np.tile(5 * unit, (34, 1)), rtol=4e-16, atol=0)
        truth = [_rotation_matrix(unit, 5 * moment) @ _rpy_matrix(RPYS[1]) for moment in t]
        # angles of up to 50 rad, rounded to 7e-15
        np.testing.assert_allclose(_matrices(quaternion), truth, rtol=0, atol=3e-14)


def test_an_orientation_spline_passes_its_waypoints_and_rests_only_at_its_ends():
    spline = OrientationSpline(kind="orientation_spline", waypoints=RPYS, times=TIMES)
    quaternion, omega = spline.sample(np.array(TIMES))
    # a rotation of up to π on from the last waypoint, rounded a few times
    np.testing.assert_allclose(_matrices(quaternion), [_rpy_matrix(rpy) for rpy in RPYS], rtol=0, atol=5e-15)
    assert np.all(np.linalg.norm(omega[1:-1], axis=1) > 0.5)
    for knot in TIMES[1:-1]:
        before, after = spline.sample(knot + np.array([-1e-9, 1e-9]))[1]
        # 2e-9 s at below 100 rad/s²
        np.testing.assert_allclose(before, after, rtol=0, atol=2e-7)


def test_an_orientation_spline_of_two_waypoints_is_one_cubic_in_time():
    spline = OrientationSpline(kind="orientation_spline", waypoints=[[0, 0, 3.0], [0, 0, 4.0]], times=[0, 2.0])
    t = np.linspace(0, 2, 21)
    quaternion, omega = spline.sample(t)
    tau = t / 2
    truth = [_rotation_matrix([0, 0, 1], 3 + 3 * x**2 - 2 * x**3) for x in tau]
    # an angle of up to 4 rad, rounded
    np.testing.assert_allclose(_matrices(quaternion), truth, rtol=0, atol=3e-15)
    rate = (6 * tau - 6 * tau**2) / 2
    np.testing.assert_allclose(omega, rate[:, None] * [0, 0, 1], rtol=0, atol=3e-15)


def test_an_orientation_spline_never_turns_back_however_uneven_its_times():
    rng = np.random.default_rng(7)
    for _ in range(50):
        times = np.append(0, np.cumsum(10 ** rng.uniform(-3, 0, 6)))
        times *= 3 / times[-1]  # a yaw of 1 rad/s, less than half a turn in all
        waypoints = [[0, 0, yaw] for yaw in times.tolist()]
        spline = OrientationSpline(kind="orientation_spline", waypoints=waypoints, times=times.tolist())
        omega = spline.sample(np.linspace(0, times[-1], 5000))[1]
        assert np.min(omega[:, 2]) >= -1e-12  # at the ends zero as rounded: short pieces have slopes of 1e3/s
        assert np.max(omega[:, 2]) < 3


def test_an_orientation_spline_takes_the_shortest_way_between_neighbours():
    yaws = [0.0, 2.5, 5.0, 7.5, 10.0]  # wrapped, as a sensor tells them
    waypoints = [[0, 0, (yaw + np.pi) % (2 * np.pi) - np.pi] for yaw in yaws]
    spline = OrientationSpline(kind="orientation_spline", waypoints=waypoints, times=[0, 1, 2, 3, 4])
    t = np.linspace(0, 4, 4001)
    # all the way on, not back at the wrap; a trapezoidal rule with steps of 1e-3 s on at most 50 rad/s³
    assert np.trapezoid(spline.sample(t)[1][:, 2], t) == pytest.approx(10.0, abs=2e-5)


# ---- Bad input ----

LINE = {"kind": "line", "start": [0.0, 0.0], "end": [1.0, 1.0], "duration": 1.0}
SPLINE = {"kind": "spline", "waypoints": WAYPOINTS, "times": TIMES}
TURN = {"kind": "turn", "start": [0.0, 0.0, 0.0], "end": [1.0, 1.0, 1.0], "duration": 1.0}
SPIN = {"kind": "spin", "start": [0.0, 0.0, 0.0], "axis": [0.0, 0.0, 1.0], "rate": 1.0, "duration": 1.0}
ORIENTATION_SPLINE = {"kind": "orientation_spline", "waypoints": RPYS, "times": TIMES}


class Holder(Document):
    """A document with a reference in it."""

    path: AnyTrajectory


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "sircle"}, ["path", "sircle", "circle"]),
        ({"position": [0.0, 0.0]}, ["path", "kind"]),
        ({"kind": "fixed"}, ["position"]),
        ({"kind": "fixed", "position": []}, ["position"]),
        ({"kind": "fixed", "position": [0.0, np.nan]}, ["position.1", "finite"]),
        ({"kind": "fixed", "position": ["0", 0.0]}, ["position.0", "number"]),
        ({"kind": "fixed", "position": [True, 0.0]}, ["position.0", "number"]),
        (LINE | {"speed": 3.0}, ["speed", "valid choices", "duration"]),
        (LINE | {"durration": 3.0}, ["did you mean 'duration'"]),
        (LINE | {"end": [1.0]}, ["start and end of one length", "2 and 1"]),
        (LINE | {"duration": 0.0}, ["duration", "greater than 0"]),
        (LINE | {"delay": -1.0}, ["delay", "greater than or equal to 0"]),
        (LINE | {"kind": "point_to_point", "duration": -1.0}, ["duration", "greater than 0"]),
        ({"kind": "circle", "center": [0.0, 0.0], "radius": 1.0, "period": 0.0}, ["a period other than 0"]),
        ({"kind": "circle", "center": [0.0], "radius": 1.0, "period": 1.0}, ["center", "at least 2"]),
        ({"kind": "circle", "center": [0.0] * 4, "radius": 1.0, "period": 1.0}, ["center", "at most 3"]),
        ({"kind": "circle", "center": [0.0, 0.0], "radius": -1.0, "period": 1.0}, ["radius", "greater than 0"]),
        (SPLINE | {"times": [0.0, 1.0]}, ["as many times", "4 and 2"]),
        (SPLINE | {"times": [0.1, 0.7, 1.5, 3.0]}, ["start at 0"]),
        (SPLINE | {"times": [0.0, 0.7, 0.7, 3.0]}, ["increase"]),
        (SPLINE | {"times": [0.0, 1.7, 0.7, 3.0]}, ["increase"]),
        (SPLINE | {"waypoints": [[0.0, 0.0]], "times": [0.0]}, ["two or more"]),
        (SPLINE | {"waypoints": [], "times": []}, ["two or more"]),
        (SPLINE | {"waypoints": [[0.0], [1.0, 1.0]], "times": [0.0, 1.0]}, ["waypoints of one length", "[1, 2]"]),
        ({"kind": "csv", "file": "/no/such/file.csv"}, ["/no/such/file.csv", "cannot be read"]),
        ({"kind": "csv"}, ["file"]),
        ({"kind": "orientation"}, ["rpy"]),
        ({"kind": "orientation", "rpy": [0.0, 0.0]}, ["rpy", "at least 3", "not 2"]),
        ({"kind": "orientation", "rpy": [1.0, 0.0, 0.0, 0.0]}, ["rpy", "at most 3", "not 4"]),
        ({"kind": "orientation", "rpy": [0.0, 0.0, np.inf]}, ["rpy.2", "finite"]),
        ({"kind": "orientation", "quaternion": [1.0, 0.0, 0.0, 0.0]}, ["quaternion", "valid choices", "rpy"]),
        (TURN | {"end": [1.0]}, ["end", "at least 3", "not 1"]),
        (TURN | {"duration": 0.0}, ["duration", "greater than 0"]),
        (TURN | {"delay": -1.0}, ["delay", "greater than or equal to 0"]),
        (SPIN | {"axis": [0.0, 0.0, 0.0]}, ["an axis other than zero", "got [0.0, 0.0, 0.0]"]),
        (SPIN | {"axis": [0.0, 1.0]}, ["axis", "at least 3", "not 2"]),
        (SPIN | {"rate": "fast"}, ["rate", "number", "fast"]),
        (SPIN | {"duration": -1.0}, ["duration", "greater than 0"]),
        (ORIENTATION_SPLINE | {"waypoints": [[0.0, 0.0]] * 4}, ["waypoints.0", "at least 3", "not 2"]),
        (ORIENTATION_SPLINE | {"times": [0.0, 1.0]}, ["as many times", "4 and 2"]),
        (ORIENTATION_SPLINE | {"times": [0.1, 0.7, 1.5, 3.0]}, ["start at 0", "0.1"]),
        (ORIENTATION_SPLINE | {"times": [0.0, 0.7, 0.7, 3.0]}, ["increase"]),
        (ORIENTATION_SPLINE | {"waypoints": [[0.0, 0.0, 0.0]], "times": [0.0]}, ["two or more"]),
        (ORIENTATION_SPLINE | {"waypoints": [], "times": []}, ["two or more"]),
    ],
)
def test_a_bad_reference_is_told_in_one_line(table, words):
    with pytest.raises(BadInput) as caught:
        Holder.parse({"path": table}, "scenario.toml")
    _expect_one_line_with(caught, ["scenario.toml", *words])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["header"]),
        ("t,x,y\n", ["header"]),
        ("t,x,y\n0,0,0\n", ["two or more"]),
        ("t,x,y\n0,0,0\n1,one,1\n", ["numbers", "one"]),
        ("t,x,y\n0,0,0\n1,1\n", ["one length"]),
        ("t,x,y\n0;0;0\n1;1;1\n", ["numbers"]),
        ("t\n0\n1\n", ["t,x,..."]),
        ("t,x,y\n0,0,0\n1,nan,1\n", ["finite"]),
        ("t,x,y\n1,0,0\n2,1,1\n", ["start at 0"]),
        ("t,x,y\n0,0,0\n0,1,1\n", ["increase"]),
        ("t,x,y\n0,0,0\n1,1,\n", ["numbers"]),
    ],
)
def test_a_bad_csv_is_told_in_one_line(text, words, tmp_path):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        Csv.parse({"kind": "csv", "file": str(path)}, "scenario.toml")
    _expect_one_line_with(caught, ["scenario.toml", *words])


def _expect_one_line_with(caught, words):
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("table", [{}, {"center": [0.0, 0.0], "path": LINE}])
def test_an_obstacle_is_at_one_place_or_on_one_path(table):
    with pytest.raises(BadInput, match="either 'center' or 'path'"):
        Obstacle.parse(table, "scenario.toml")


def test_an_obstacle_at_rest_is_a_fixed_trajectory():
    motion = Obstacle.parse({"center": [1.0, 2.0]}, "scenario.toml").motion
    assert motion == Fixed(kind="fixed", position=(1.0, 2.0))
