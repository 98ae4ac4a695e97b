"""Loops in C, unrolled and by CasADi are the same numbers, and many points and obstacles are little text.

The loops made up here compute with whole numbers, which no order of operations rounds: what differs is wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import cffi
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from clikgen.runtime.clearance import distances
from clikgen.runtime.compiler import compile_library
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import FAR
from clikgen.runtime.scenario import Capsule, HalfSpace, Obstacle, Scenario
from clikgen.symbolic.controller import build
from clikgen.symbolic.emitter import Names, function_text, module_text
from clikgen.symbolic.generate import generate
from clikgen.symbolic.obstacles import WATCHED, ObstacleCapacity, Obstacles
from clikgen.symbolic.points import places, position_jacobians
from clikgen.symbolic.robot import PointOfInterest
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs
from clikgen.symbolic.stage import Loop, Procedure, Stage
from clikgen.symbolic.tree import KinematicTree

STATES = 100
FLAGS = {"as it ships": (), "with wide vectors": ("-O3", "-march=native"), "one by one": ("-O1", "-UCLIKGEN_OPENMP")}


class Library:
    """Procedures of columns in C, of N states at once."""

    def __init__(self, folder, procedures, extra=()):
        names, texts, self._procedures = Names("double"), [], {one.name: one for one in procedures}
        for one in procedures:
            labels = [
                [f"{letter}_{k}" for k in range(len(columns))]
                for letter, columns in (("x", one.given), ("y", one.results))
            ]
            texts.append(function_text(one, *labels, names))
        self.text = module_text(texts, names)
        (folder / "loops.c").write_text(self.text, encoding="utf-8")
        self._ffi = cffi.FFI()
        for name in self._procedures:
            self._ffi.cdef(f"int {name}(const double **, double **, long long *, double *, int);")
        self._library = self._ffi.dlopen(str(compile_library([folder / "loops.c"], extra=extra)))

    def __call__(self, name, inputs):
        """The results, (N, rows) each, of `inputs` (N, rows)."""
        null, function = self._ffi.NULL, getattr(self._library, name)
        arrays = [np.ascontiguousarray(array, dtype=float) for array in inputs]
        results = [np.empty((len(arrays[0]), one.numel())) for one in self._procedures[name].results]
        for k in range(len(arrays[0])):
            arg, res = ([self._ffi.from_buffer("double[]", one[k]) for one in group] for group in (arrays, results))
            assert not function(self._ffi.new("double *[]", arg), self._ffi.new("double *[]", res), null, null, 0)
        return results


def by_casadi(procedure, inputs):
    """The same by CasADi's function."""
    results = procedure.casadi().map(len(inputs[0])).call([ca.DM(np.asarray(one, dtype=float).T) for one in inputs])
    return [np.array(one).T for one in results]


def unrolled(procedure):
    """Without any loop."""
    straight = procedure.unrolled(lambda _: True)
    assert not straight.stages
    return replace(straight, name=f"{procedure.name}_unrolled")


def test_what_a_loop_carries_for_nobody_is_left_out():
    """A sum that no one reads and what it is made of; what is read in the end, or by what is, stays."""
    x, s = ca.SX.sym("x", 1, 4), ca.SX.sym("s")

    def body(mine, columns, shared, _):
        total, square, least = mine
        return [total + columns[0], square + columns[1] * shared[0], ca.fmin(least, total)], [square, columns[0] + 1]

    loop = Loop.of("loop", body, [ca.SX(0), ca.SX(0), ca.SX(9)], [x, x**2], [s])
    total, square, least, squares, more = loop.symbols
    kept = {
        "total": (total, 1, 1, 2),  # starts at 0, and goes over x
        "least": (least, 2, 1, 3),  # which reads the total
        "square": (square, 1, 1, 3),  # s is shared
        "squares": (squares, 1, 1, 3),
        "more": (more, 0, 1, 1),
    }
    for result, carried, over, arguments in kept.values():
        (left,) = Procedure.of("p", [x.T, s], [ca.vec(result)], [loop]).stages
        assert (left.carried, left.over, len(left.arguments)) == (carried, over, arguments)
        assert len(left.body.given) == arguments


# ---- Loops made up ----


@dataclass(frozen=True)
class Case:
    """Columns that are given, what is made of them with loops, and the same in numpy for one state."""

    sizes: tuple[int, ...]
    made: Callable
    expected: Callable

    def procedure(self, name):
        symbols, stages = [ca.SX.sym("x", size) for size in self.sizes], []
        results = [ca.densify(ca.vec(one)) for one in self.made(symbols, stages)]
        return Procedure.of(name, symbols, results, stages)


def loop(stages, body, *, carried=(), over=(), shared=()):
    """What a loop carries in the end, and its results."""
    one = Loop.of("loop", body, carried, over, shared)
    stages.append(one)
    return list(one.symbols[: len(carried)]), list(one.symbols[len(carried) :])


def rows_of(x, count):
    """The matrix (count, n) whose rows stand one after the other in x."""
    return ca.reshape(x, x.numel() // count, count).T


def total(x, stages):
    """Carried only."""
    (sum_, last), _ = loop(
        stages,
        lambda mine, column, _, __: ([2 * mine[0] + column[0], column[0]], []),
        carried=[x[1], ca.SX(0)],
        over=[x[0].T],
    )
    return [sum_, last]


def fibonacci(x, stages):
    """What is carried on changes places: the next a is b, and the next b is a."""
    (a, b, c), _ = loop(
        stages,
        lambda m, column, _, __: ([m[1], m[0], m[0] + column[0]], []),
        carried=[x[1][0], x[1][1], ca.SX(3)],
        over=[x[0].T],
    )
    return [a, b, c]


def turned_on(x, stages):
    """A sum that is carried on before one of its terms is replaced."""
    (a, b), (seen,) = loop(
        stages,
        lambda m, column, _, __: ([m[0] + m[1] + column[0], m[0]], [m[0] - m[1]]),
        carried=[ca.SX(1), x[1]],
        over=[x[0].T],
    )
    return [a, b, seen]


def every_one(x, stages):
    """Columns only."""
    _, (squares, signs) = loop(
        stages,
        lambda _, column, shared, __: (
            [],
            [column[0] * shared[0] + column[1], ca.if_else(column[0] < shared[0], -1, 1)],
        ),
        over=[x[0].T, 3 * x[0].T],
        shared=[x[1]],
    )
    return [squares, signs]


def running(x, stages):
    """Both."""
    (last,), (sums,) = loop(
        stages,
        lambda mine, column, _, __: ([mine[0] + column[0]], [mine[0] + 2 * column[0]]),
        carried=[x[1]],
        over=[x[0].T],
    )
    return [last, sums]


def least_of_each(x, stages):
    """A loop in a loop, over what is shared: the least squared distance of each point to the others, and its number."""
    points, others = rows_of(x[0], 4).T, rows_of(x[1], 6).T  # (2, 4), (2, 6)

    def inner(mine, columns, shared, _):
        other, number = columns
        squared = ca.sumsqr(other - shared[0])
        nearer = squared < mine[0]
        return [ca.if_else(nearer, squared, mine[0]), ca.if_else(nearer, number, mine[1])], []

    def outer(_, columns, shared, inside):
        start = [ca.SX(1000), ca.SX(-1)]
        (least, number), _ = loop(
            inside, inner, carried=start, over=[shared[0], ca.SX(ca.DM(range(6))).T], shared=columns
        )
        return [], [least, number]

    _, (least, number) = loop(stages, outer, over=[points], shared=[others])
    return [least, number]


def carried_through_both(x, stages):
    """Carried through a loop in a loop, which begins with what the outer one carries."""

    def inner(mine, columns, shared, _):
        return [mine[0] + columns[0] * shared[0]], [mine[0] - columns[0]]

    def outer(mine, columns, shared, inside):
        (now,), (seen,) = loop(inside, inner, carried=mine, over=[shared[0]], shared=[columns[0]])
        return [now - columns[0]], [ca.sum2(seen), seen[1]]

    (last,), seen = loop(stages, outer, carried=[x[2]], over=[x[0].T], shared=[x[1].T])
    return [last, *seen]


def shared_array(x, stages):
    """Twenty numbers that have to be computed first, and two that are given."""
    _, (dots,) = loop(
        stages,
        lambda _, columns, shared, __: ([], [columns[0] * ca.sum1(shared[0]) + ca.dot(shared[0][:2], shared[1])]),
        over=[x[1].T],
        shared=[3 * x[0] + 1, x[1][:2]],
    )
    return [dots]


def constants(x, stages):
    """Columns that are constants: a table in memory."""
    table = ca.SX(ca.DM([[1, -2, 3, 5], [0, 4, 0, -7]]))
    _, (found,) = loop(
        stages,
        lambda _, columns, shared, __: ([], [columns[0][0] * shared[0] + columns[0][1]]),
        over=[table],
        shared=[x[0]],
    )
    return [found]


def strided(x, stages):
    """Columns that lie in memory one after the other, row by row, backwards, and every other one."""
    by_column, by_row = ca.reshape(x[0], 3, 4), rows_of(x[0], 3)
    backwards, others = x[0][::-1], x[0][::2]
    ways = [by_column, by_row, ca.reshape(backwards, 3, 4), ca.vertcat(others[:4].T, others[2:].T), by_row[[2, 0], :]]
    return [
        loop(stages, lambda _, columns, __, ___: ([], [2 * columns[0], ca.sum1(columns[0])]), over=[way])[1][k]
        for way in ways
        for k in range(2)
    ]


def uneven(x, stages):
    """Columns whose entries are not evenly apart, or are of different inputs."""
    some = ca.horzcat(x[0][0], x[0][1], x[0][3], x[0][7])
    mixed = ca.horzcat(x[0][0], x[0][1], x[1][0], x[1][1])
    return [loop(stages, lambda _, columns, __, ___: ([], [3 * columns[0]]), over=[way])[1][0] for way in (some, mixed)]


def one_after_the_other(x, stages):
    """The columns of a loop are the results of another."""
    _, (first, _) = loop(stages, lambda _, c, __, ___: ([], [c[0] + 1, c[0] ** 3]), over=[x[0].T])
    (most,), (second,) = loop(
        stages, lambda m, c, __, ___: ([ca.fmax(m[0], c[0])], [c[0] * c[0]]), carried=[x[1]], over=[first]
    )
    return [most, second, first[0, 2]]


def unused(x, stages):
    """One of two results, and none of what is carried on for the other."""
    (_, kept), (_, seen) = loop(
        stages,
        lambda mine, c, shared, _: ([mine[0] * c[0], mine[1] + c[1]], [mine[0] + shared[0], mine[1] - shared[1]]),
        carried=[x[1], ca.SX(0)],
        over=[x[0].T, 2 * x[0].T],
        shared=[x[1], x[2]],
    )
    return [kept, seen]


def folded(step, start, items):
    """All intermediate results, the last one included."""
    seen = [start]
    for item in items:
        seen.append(step(seen[-1], item))
    return seen


def by_hand_of_least(points, others):
    points, others = points.reshape(4, 2), others.reshape(6, 2)
    squared = np.sum((points[:, None] - others) ** 2, axis=2)
    return [np.min(squared, axis=1), np.argmin(squared, axis=1)]


def by_hand_through_both(rows, columns, start):
    now, sums, seconds = start, [], []
    for row in rows:
        seen = folded(lambda value, column, row=row: value + column * row, now, columns)
        differences = [value - column for value, column in zip(seen, columns, strict=False)]
        sums.append(sum(differences))
        seconds.append(differences[1])
        now = seen[-1] - row
    return [now, np.array(sums), np.array(seconds)]


def by_hand_strided(x):
    by_column, by_row = x.reshape(4, 3).T, x.reshape(3, 4)
    ways = [by_column, by_row, x[::-1].reshape(4, 3).T, np.array([x[::2][:4], x[::2][2:]]), by_row[[2, 0]]]
    return [one.ravel(order="F") for way in ways for one in (2 * way, np.sum(way, axis=0))]


def by_hand_turned_on(x, start):
    a, b, seen = np.array([1.0]), start, []
    for one in x:
        seen.append(a - b)
        a, b = a + b + one, a
    return [a, b, np.ravel(seen)]


CASES = {
    "total": Case((7, 1), total, lambda x, y: [folded(lambda v, c: 2 * v + c, y, x)[-1], x[-1:]]),
    "fibonacci": Case((3, 2), fibonacci, lambda x, y: [y[1:], y[:1], y[:1] + x[-1]]),
    "turned_on": Case((5, 1), turned_on, by_hand_turned_on),
    "every_one": Case((9, 1), every_one, lambda x, s: [x * s + 3 * x, np.where(x < s, -1, 1)]),
    "running": Case((5, 1), running, lambda x, y: [y + np.sum(x), y + np.cumsum(x) + x]),
    "least_of_each": Case((8, 12), least_of_each, by_hand_of_least),
    "carried_through_both": Case((4, 3, 1), carried_through_both, by_hand_through_both),
    "shared_array": Case((20, 5), shared_array, lambda x, y: [y * np.sum(3 * x + 1) + (3 * x[:2] + 1) @ y[:2]]),
    "constants": Case((1,), constants, lambda x: [np.array([1, -2, 3, 5]) * x + np.array([0, 4, 0, -7])]),
    "strided": Case((12,), strided, by_hand_strided),
    "uneven": Case((9, 2), uneven, lambda x, y: [3 * x[[0, 1, 3, 7]], 3 * np.array([*x[:2], *y])]),
    "one_after_the_other": Case(
        (6, 1), one_after_the_other, lambda x, y: [max(y[0], *(x + 1)), (x + 1) ** 2, x[2] + 1]
    ),
    "unused": Case((4, 1, 1), unused, lambda x, _, z: [2 * np.sum(x), 2 * (np.cumsum(x) - x) - z]),
    "once": Case((1, 1), running, lambda x, y: [y + x, y + 2 * x]),
    "twice": Case((2, 1), running, lambda x, y: [y + np.sum(x), y + np.cumsum(x) + x]),
}


@pytest.fixture(scope="module", params=FLAGS)
def library(request, tmp_path_factory):
    looped = [case.procedure(name) for name, case in CASES.items()]
    return Library(tmp_path_factory.mktemp("loops"), [*looped, *map(unrolled, looped)], FLAGS[request.param])


@pytest.mark.parametrize("name", CASES)
def test_a_loop_in_c_unrolled_and_by_casadi_is_what_it_says(name, library):
    case = CASES[name]
    procedure = case.procedure(name)
    x = [np.random.default_rng(0).integers(-9, 10, (STATES, size)).astype(float) for size in case.sizes]
    expected = [case.expected(*(one[k] for one in x)) for k in range(STATES)]
    expected = [np.array([np.ravel(one) for one in column]) for column in zip(*expected, strict=True)]
    ways = {
        "in C": library(name, x),
        "unrolled in C": library(f"{name}_unrolled", x),
        "by CasADi": by_casadi(procedure, x),
        "unrolled by CasADi": by_casadi(unrolled(procedure), x),
    }
    for way, results in ways.items():
        for one, other in zip(results, expected, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=way)


# ---- Any loop ----

OPERATIONS: dict[str, tuple[Callable, Callable]] = {  # of CasADi, and of numpy
    "add": (lambda x, y, _: x + y, lambda x, y, _: x + y),
    "sub": (lambda x, y, _: x - y, lambda x, y, _: x - y),
    "neg": (lambda x, *_: -x, lambda x, *_: -x),
    "abs": (lambda x, *_: ca.fabs(x), lambda x, *_: np.abs(x)),
    "max": (lambda x, y, _: ca.fmax(x, y), lambda x, y, _: np.maximum(x, y)),
    "min": (lambda x, y, _: ca.fmin(x, y), lambda x, y, _: np.minimum(x, y)),
    "if_else": (lambda x, y, z: ca.if_else(x < y, z, x), lambda x, y, z: np.where(x < y, z, x)),
    "same": (lambda x, *_: x, lambda x, *_: x),
}
number = st.integers(0, 10**6)


@dataclass(frozen=True)
class AnyLoop:
    """`count` times a program of what is carried, two numbers of a column and two that are shared."""

    count: int
    carried: int
    program: list[tuple[str, int, int, int]]  # at most eight operations: five times doubled, still exact
    onward: list[int]
    results: list[int]

    def body(self, mine, column, shared, language):
        """What is carried on, and the results."""
        found = [*mine, *column, *shared]
        for operation, *at in self.program:
            found.append(OPERATIONS[operation][language](*(found[i % len(found)] for i in at)))
        return [found[i % len(found)] for i in self.onward], [found[i % len(found)] for i in self.results]

    def procedure(self, name):
        start, columns, shared = ca.SX.sym("a", self.carried), ca.SX.sym("b", 2 * self.count), ca.SX.sym("c", 2)
        stages = []
        last, seen = loop(
            stages,
            lambda mine, column, alike, _: self.body(mine, ca.vertsplit(column[0]), ca.vertsplit(alike[0]), 0),
            carried=ca.vertsplit(start),
            over=[ca.reshape(columns, 2, self.count)],
            shared=[shared],
        )
        results = [ca.vertcat(*last, *map(ca.vec, seen))]
        return Procedure.of(name, [start, columns, shared], results, stages)

    def expected(self, start, columns, shared):
        mine, seen = list(start.T), []
        for i in range(self.count):
            mine, results = self.body(mine, columns.T[2 * i : 2 * i + 2], shared.T, 1)
            seen.append(results)
        return np.array([*mine, *(results[k] for k in range(len(self.results)) for results in seen)]).T


@st.composite
def any_loop(draw):
    carried = draw(st.integers(1, 3))
    steps = st.tuples(st.sampled_from(sorted(OPERATIONS)), number, number, number)
    return AnyLoop(
        count=draw(st.integers(1, 5)),
        carried=carried,
        program=draw(st.lists(steps, min_size=1, max_size=8)),
        onward=draw(st.lists(number, min_size=carried, max_size=carried)),
        results=draw(st.lists(number, min_size=1, max_size=2)),
    )


@settings(max_examples=3, phases=[Phase.generate])
@given(st.lists(any_loop(), min_size=40, max_size=40))
def test_any_loop_is_what_it_says(tmp_path_factory, loops):
    looped = [one.procedure(f"loop_{k}") for k, one in enumerate(loops)]
    library = Library(tmp_path_factory.mktemp("any"), [*looped, *map(unrolled, looped)])
    rng = np.random.default_rng(1)
    for one, procedure in zip(loops, looped, strict=True):
        x = [rng.integers(-9, 10, (20, column.numel())).astype(float) for column in procedure.given]
        expected = one.expected(*x)
        assert np.max(np.abs(expected)) < 2**53
        ways = library(procedure.name, x), library(f"{procedure.name}_unrolled", x), by_casadi(procedure, x)
        for (found,) in ways:
            np.testing.assert_array_equal(found, expected, err_msg=str(one))


# ---- Many points and obstacles ----

ROUNDING = 4e-15  # of distances and coordinates below 4 m, some ten terms
WALLS = ((0.6, 0.8), (-1.0, 0.0), (0.28, -0.96))


def crowded(spec, points, **capacity):
    """The spec with as many points of interest, spread over the links that have some, and room for obstacles."""
    old = spec.robot.points_of_interest
    spread = [
        old[i % len(old)].model_copy(
            update={
                "name": f"point_{i}",
                "offset": (old[i % len(old)].offset[0] * (1 - i / (2 * points)), old[i % len(old)].offset[1], 0.0),
            }
        )
        for i in range(points)
    ]
    robot = spec.robot.model_copy(update={"points_of_interest": tuple(spread)})
    return spec.model_copy(update={"robot": robot, "obstacles": ObstacleCapacity(**capacity)})


CROWDS = {"balls": (24, {"maximum": 100}), "all kinds": (6, {"maximum": 30, "capsules": 10, "half_spaces": 3})}


@pytest.fixture(scope="module", params=CROWDS)
def crowd(request, planar5_spec, tmp_path_factory):
    """A crowded planar5: its spec, compiled, and inputs of its step in STATES states, balls near its points."""
    points, capacity = CROWDS[request.param]
    spec, folder = crowded(planar5_spec, points, **capacity), tmp_path_factory.mktemp("crowd")
    for name, text in generate(spec).items():
        (folder / name).write_text(text, encoding="utf-8")
    controller, rng = CompiledController.load(folder), np.random.default_rng(2)
    q = rng.uniform(-2, 2, (STATES, 5))
    place = controller.kinematics.map(STATES, {"q": q})["point_position"]
    balls = capacity["maximum"]
    chosen = np.take_along_axis(place, rng.integers(0, points, (STATES, balls, 1)), axis=1)
    values = {
        "q": q,
        "tool_reference": rng.uniform(-1, 1, (STATES, 2)),
        "obstacle_center": chosen + rng.normal(0, 0.5, (STATES, balls, 2)),
        "obstacle_radius": np.broadcast_to(rng.uniform(0, 0.1, balls), (STATES, balls)),
        "obstacle_count": np.full(STATES, float(balls)),
    }
    if "capsules" in capacity:
        values |= {
            "capsule_start": np.broadcast_to(rng.uniform(-4, 4, (10, 2)), (STATES, 10, 2)),
            "capsule_end": np.broadcast_to(rng.uniform(-4, 4, (10, 2)), (STATES, 10, 2)),
            "capsule_radius": np.broadcast_to(rng.uniform(0, 0.1, 10), (STATES, 10)),
            "capsule_count": np.full(STATES, 9.0),
            "half_space_normal": np.broadcast_to(WALLS, (STATES, 3, 2)),
            "half_space_offset": np.broadcast_to([-3.0, -2.5, -3.5], (STATES, 3)),
            "half_space_count": np.full(STATES, 3.0),
        }
    return spec, controller, values


def scenario(values):
    """The obstacles of the first state, as scenarios have them."""
    one = {name: value[0].tolist() for name, value in values.items()}
    capsules = zip(*(one.get(f"capsule_{key}", [])[:9] for key in ("start", "end", "radius")), strict=True)
    walls = zip(one.get("half_space_normal", []), one.get("half_space_offset", []), strict=True)
    return Scenario(
        name="crowd",
        description="many",
        controller="planar5",
        duration=1.0,
        q0=(0.0,) * 5,
        obstacles=tuple(Obstacle(center=(0.0, 0.0), radius=radius) for radius in one["obstacle_radius"]),
        capsules=tuple(Capsule(start=start, end=end, radius=radius) for start, end, radius in capsules),
        half_spaces=tuple(HalfSpace(normal=normal, offset=offset) for normal, offset in walls),
    )


def test_distances_to_many_obstacles_are_those_in_numpy(crowd):
    _, controller, values = crowd
    outputs = controller.step.map(STATES, values)
    place = controller.kinematics.map(STATES, {"q": values["q"]})["point_position"]
    expected = distances(place, values["obstacle_center"], scenario(values))
    np.testing.assert_allclose(outputs["distance"], expected, rtol=0, atol=ROUNDING)
    reach = np.array(controller.step.info.input("influence_radius").default)
    np.testing.assert_allclose(outputs["clearance"], np.min(expected - reach, axis=1), rtol=0, atol=ROUNDING)
    potential = np.sum(np.maximum(reach - expected, 0) ** 2, axis=1) / 2
    np.testing.assert_allclose(outputs["obstacles_potential"], potential, rtol=0, atol=ROUNDING)
    assert np.mean(outputs["active"]) > 0.5


def test_a_step_past_many_obstacles_is_casadi_s(crowd):
    """CasADi unrolls, or maps, what is a loop in C."""
    spec, controller, values = crowd
    for one in build(spec).functions:
        compiled = getattr(controller, one.name)
        inputs = {name: values[name] for name in compiled.inputs if name in values}
        found = compiled.map(STATES, inputs)
        columns = []
        for signal in compiled.info.inputs:
            value = inputs.get(signal.name, np.reshape(signal.default or 0.0, signal.shape))
            columns.append(ca.DM(np.broadcast_to(value, (STATES, *signal.shape)).reshape(STATES, -1).T))
        for (name, array), result in zip(found.items(), one.casadi.map(STATES).call(columns), strict=True):
            # where obstacles hardly move the joints, their damping of 1e-3 divides rounding of 1e-16 by its square
            np.testing.assert_allclose(array.reshape(STATES, -1), np.array(result).T, rtol=0, atol=1e-8, err_msg=name)


def test_many_obstacles_are_little_text(planar5_spec):
    """Each obstacle is a place in an array, and a loop counts to another number."""
    sizes = {count: len(generate(crowded(planar5_spec, 6, maximum=count))["planar5.c"]) for count in (30, 100)}
    assert sizes[100] < 30_000
    assert sizes[100] - sizes[30] < 1_000


def test_many_points_are_little_text(planar5_spec):
    """A point more on a link is a few numbers in its tables; their sum is written out up to a number of them."""
    sizes = {count: len(generate(crowded(planar5_spec, count, maximum=100))["planar5.c"]) for count in (6, 24, 384)}
    assert sizes[24] < 1.5 * sizes[6]
    assert sizes[384] < 5 * sizes[6]


@pytest.mark.parametrize("name", [path.stem for path in shipped_specs()])
def test_points_in_loops_are_where_each_is_by_itself_and_move_so(name, tmp_path):
    """Points on all links, the root among them, in no order: against expressions of each point alone."""
    robot, rng = read_spec({path.stem: path for path in shipped_specs()}[name]).robot, np.random.default_rng(8)
    flat = [1.0, 1.0, robot.space == "spatial"]
    points = [
        PointOfInterest(name=f"p{k}", link=link, offset=tuple(rng.uniform(-1, 1, 3) * flat), influence_radius=0.1)
        for k, link in enumerate(rng.permutation(list(robot.links) * 5).tolist())
    ]
    tree, stages = KinematicTree.of(robot.model_copy(update={"points_of_interest": tuple(points)})), list[Stage]()
    where = places(tree, stages)
    results = [ca.vec(where), ca.vec(position_jacobians(tree, where, stages).T)]
    library = Library(tmp_path, [Procedure.of("points", [tree.q], results, stages)])
    expected = ca.Function(
        "alone",
        [tree.q],
        [
            ca.densify(ca.vertcat(*(tree.position(one.link, one.offset) for one in points))),
            ca.densify(ca.vec(ca.vertcat(*(tree.position_jacobian(one.link, one.offset) for one in points)).T)),
        ],
    )
    q = rng.uniform(-3, 3, (STATES, tree.q.numel()))
    for found, one in zip(library("points", [q]), expected.map(STATES).call([ca.DM(q.T)]), strict=True):
        np.testing.assert_allclose(found, np.array(one).T, rtol=0, atol=20 * ROUNDING)  # mobile bases go 3 m away
    assert library.text.count("for (") < 12 * len(robot.links)


# ---- The nearest ones, of which a barrier keeps off ----


def each_contact(point, values):
    """D, u and uᵀȯ of every ball, capsule and half-space that is there: (k,), (k, 2), (k,)."""
    found = []
    for k in range(int(values["obstacle_count"])):
        way = values["obstacle_center"][k] - point
        length = np.linalg.norm(way)
        found.append(
            (length - values["obstacle_radius"][k], way / length, way / length @ values["obstacle_velocity"][k])
        )
    for k in range(int(values["capsule_count"])):
        start, end = values["capsule_start"][k], values["capsule_end"][k]
        share = np.clip((point - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
        way = start + share * (end - start) - point
        length = np.linalg.norm(way)
        found.append((length - values["capsule_radius"][k], way / length, 0.0))
    for k in range(int(values["half_space_count"])):
        normal = values["half_space_normal"][k]
        found.append((normal @ point - values["half_space_offset"][k], -normal, 0.0))
    return [np.array(one) for one in zip(*found, strict=True)]


@pytest.mark.parametrize("balls", [6, 20])
def test_the_nearest_obstacles_are_the_first_ones_when_sorted(balls, tmp_path):
    obstacles = Obstacles.up_to(ObstacleCapacity(maximum=balls, capsules=3, half_spaces=2), 2)
    point, stages = ca.SX.sym("point", 2), []
    nearest = obstacles.shapes(stages).nearest(point, WATCHED, stages)
    inputs = [point, *(signal.column for signal in obstacles.inputs)]
    procedure = Procedure.of("nearest", inputs, [ca.vec(one) for one in nearest], stages)
    rng = np.random.default_rng(3)
    points = rng.uniform(-2, 2, (STATES, 2))
    values = {signal.info.name: rng.uniform(-2, 2, (STATES, *signal.info.shape)) for signal in obstacles.inputs}
    values["half_space_normal"] /= np.linalg.norm(values["half_space_normal"], axis=2, keepdims=True)
    values["half_space_offset"] -= 2
    for kind, most in (("obstacle", balls), ("capsule", 3), ("half_space", 2)):
        values[f"{kind}_count"] = rng.integers(kind == "half_space", most + 1, STATES).astype(float)
    x = [points, *(values[signal.info.name].reshape(STATES, -1) for signal in obstacles.inputs)]
    library = Library(tmp_path, [procedure])
    for distance, toward, opening in (library("nearest", x), by_casadi(procedure, x)):
        toward = toward.reshape(STATES, WATCHED, 2)
        for k in range(STATES):
            d, u, opens = each_contact(points[k], {name: value[k] for name, value in values.items()})
            first = np.argsort(d)[:WATCHED]
            there = len(first)
            np.testing.assert_allclose(distance[k, :there], d[first], rtol=0, atol=ROUNDING)
            np.testing.assert_allclose(toward[k, :there], u[first], rtol=0, atol=1e-13)  # to a point 0.02 m away
            np.testing.assert_allclose(opening[k, :there], opens[first], rtol=0, atol=1e-13)
            assert np.all(distance[k, there:] >= FAR)


def behind_a_barrier(spec, maximum):
    """The spec with one point of interest, at the hand, that keeps off obstacles by a barrier."""
    table = spec.model_dump(exclude_none=True)
    table["tasks"][0]["activation"] = {"kind": "barrier"}
    table["robot"]["points_of_interest"] = table["robot"]["points_of_interest"][-1:]
    table |= {"obstacles": {"maximum": maximum}, "velocity_limits": {"kind": "clamp"}, "name": f"watch_{maximum}"}
    return ControllerSpec.parse(table, "the test")


def test_a_barrier_past_more_obstacles_than_it_watches_minds_the_nearest_ones(planar5_spec, tmp_path):
    """As if the others were not there: a controller of so many obstacles, given those, moves alike."""
    loaded, count, rng = {}, 400, np.random.default_rng(4)
    for maximum in (WATCHED, 14):
        (tmp_path / str(maximum)).mkdir()
        for name, text in generate(behind_a_barrier(planar5_spec, maximum)).items():
            (tmp_path / str(maximum) / name).write_text(text, encoding="utf-8")
        loaded[maximum] = CompiledController.load(tmp_path / str(maximum))
    q = rng.uniform(-2, 2, (count, 5))
    seen = loaded[14].kinematics.map(count, {"q": q})
    radius, away = rng.uniform(0, 0.3, (count, 14)), rng.normal(size=(count, 14, 2))
    away *= (radius + rng.uniform(0.1, 0.6, radius.shape))[..., None] / np.linalg.norm(away, axis=2, keepdims=True)
    many = {
        "q": q,
        "tool_reference": seen["tool_position"] + rng.uniform(-1, 1, (count, 2)),
        "obstacle_center": seen["point_position"] + away,
        "obstacle_radius": radius,
        "obstacle_velocity": rng.uniform(-0.2, 0.2, away.shape),
        "obstacle_count": rng.integers(0, 15, count).astype(float),
    }
    distance = np.linalg.norm(away, axis=2) - radius
    distance[np.arange(14) >= many["obstacle_count"][:, None]] = np.inf
    order = np.argsort(distance, axis=1)

    def only(chosen):
        some = {"obstacle_count": np.minimum(many["obstacle_count"], WATCHED)}
        for name in ("obstacle_center", "obstacle_radius", "obstacle_velocity"):
            index = chosen.reshape(*chosen.shape, *[1] * (many[name].ndim - 2))
            some[name] = np.take_along_axis(many[name], index, axis=1)
        return loaded[WATCHED].step.map(count, many | some)

    moved, nearest = loaded[14].step.map(count, many), only(order[:, :WATCHED])
    solved = (moved["barrier_solved"] == 1) & (moved["barrier_excess"] < 1e-8)
    assert np.sum(solved & (moved["barrier_steps"] > 1)) > count / 10
    # rows in another order: the solver's rounding over its slack
    np.testing.assert_allclose(moved["dq_law"][solved], nearest["dq_law"][solved], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(moved["barrier_solved"], nearest["barrier_solved"])
    first = only(np.broadcast_to(np.arange(WATCHED), (count, WATCHED)))
    assert np.mean(np.any(np.abs(first["dq_law"] - moved["dq_law"]) > 1e-3, axis=1)) > 0.1
