"""Every kind of reference: its velocity is the derivative of its position, and it starts and ends as it says."""

import typing

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import AnyTrajectory, Circle, Csv, Fixed, Line, PointToPoint, Spline
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
        table = EXAMPLES[kind][0] | ({"file": str(csv_file)} if kind == "csv" else {})
        return KINDS[kind].parse({"kind": kind, **table, **more}, "a test")

    return make


def test_every_kind_has_an_example():
    assert set(EXAMPLES) == set(KINDS)


kinds = pytest.mark.parametrize("kind", EXAMPLES)


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


# ---- Bad input ----

LINE = {"kind": "line", "start": [0.0, 0.0], "end": [1.0, 1.0], "duration": 1.0}
SPLINE = {"kind": "spline", "waypoints": WAYPOINTS, "times": TIMES}


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "sircle"}, ["path", "sircle", "circle"]),
        ({"position": [0.0, 0.0]}, ["path", "kind"]),
        ({"kind": "fixed"}, ["position"]),
        ({"kind": "fixed", "position": []}, ["position"]),
        ({"kind": "fixed", "position": [0.0] * 4}, ["position"]),
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
        ({"kind": "circle", "center": [0.0], "radius": 1.0, "period": 1.0}, ["center"]),
        ({"kind": "circle", "center": [0.0, 0.0], "radius": -1.0, "period": 1.0}, ["radius", "greater than 0"]),
        (SPLINE | {"times": [0.0, 1.0]}, ["as many times", "4 and 2"]),
        (SPLINE | {"times": [0.1, 0.7, 1.5, 3.0]}, ["start at 0"]),
        (SPLINE | {"times": [0.0, 0.7, 0.7, 3.0]}, ["increase"]),
        (SPLINE | {"times": [0.0, 1.7, 0.7, 3.0]}, ["increase"]),
        (SPLINE | {"waypoints": [[0.0, 0.0]], "times": [0.0]}, ["two or more"]),
        (SPLINE | {"waypoints": [], "times": []}, ["two or more"]),
        (SPLINE | {"waypoints": [[0.0], [1.0, 1.0]], "times": [0.0, 1.0]}, ["waypoints of one length"]),
        ({"kind": "csv", "file": "/no/such/file.csv"}, ["/no/such/file.csv", "cannot be read"]),
        ({"kind": "csv"}, ["file"]),
    ],
)
def test_a_bad_reference_is_told_in_one_line(table, words):
    with pytest.raises(BadInput) as caught:
        Obstacle.parse({"path": table}, "scenario.toml")
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
        ("t\n0\n1\n", ["t,x,y"]),
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
