"""The barrier's quadratic program against two solvers of the field: alone, and in states of real controllers.

`CLIKGEN_STATES=100000` in the environment tries as many states instead of the few of a common test run.
"""

import os
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import casadi as ca
import cffi
import daqp
import numpy as np
import pytest
import quadprog
from scipy.optimize import nnls

from clikgen.runtime.compiler import compile_library
from clikgen.runtime.controller import CompiledController
from clikgen.symbolic.barrier import SINGULAR
from clikgen.symbolic.emitter import Names, function_text, module_text
from clikgen.symbolic.generate import generate
from clikgen.symbolic.quadratic_program import FIRM, MOST_STEPS, SPARE, Program, Solution, Solver
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.stage import Procedure

STATES = int(os.environ.get("CLIKGEN_STATES", "2000"))
AGREEMENT = 1e-8  # the worst of 110,000 states is 3e-9: two refinements leave that much of the slack's bias
FEASIBLE = 1e-8  # [m/s, rad/s] what a feasible program may be violated by, as `barrier_row` has it
RELAXED = 3e-4  # of contradicting rows the least squares are known to rounding over the slack, 1e-16 / 1e-11, times 30
SIZES = [(1, 1, False), (1, 5, True), (2, 3, False), (3, 0, True), (5, 18, False), (5, 18, True), (10, 18, True)]


@dataclass(frozen=True)
class Problems:
    """N programs of one structure, named as in `Program`; without bounds the last two are (N, 0)."""

    start: np.ndarray  # (N, n)
    metric_inverse: np.ndarray  # (N, n, n)
    rows: np.ndarray  # (N, m, n)
    limits: np.ndarray  # (N, m)
    lower: np.ndarray  # (N, n)
    upper: np.ndarray  # (N, n)

    def each(self):
        return zip(*(getattr(self, field.name) for field in fields(self)), strict=True)

    def __getitem__(self, index):
        return Problems(*(getattr(self, field.name)[index] for field in fields(self)))


def _random(n, m, bounds, *, count=300, seed=0, condition=1e3):
    """Programs around a point that keeps every row by 1e-3 at least; most starts do not."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(count, n, n)))[0]
    metric = np.einsum("kij,kj,klj->kil", turn, 1 / condition ** rng.random((count, n)), turn)
    rows, inside = rng.normal(size=(count, m, n)), rng.normal(size=(count, n))
    return Problems(
        start=inside + 3 * rng.normal(size=(count, n)),
        metric_inverse=(metric + metric.transpose(0, 2, 1)) / 2,
        rows=rows,
        limits=np.einsum("kij,kj->ki", rows, inside) + rng.exponential(0.3, (count, m)) + 1e-3,
        lower=(inside - rng.exponential(0.5, (count, n)))[:, : n * bounds],
        upper=(inside + rng.exponential(0.5, (count, n)))[:, : n * bounds],
    )


@pytest.fixture(scope="module", params=["in C", "by CasADi"])
def solved(request, tmp_path_factory):
    """`solved(problems, pattern)`: u (N, n), violations (N, m + bounds), steps (N,) and solved (N,)."""
    made = {}

    def function(n, m, bounds, pattern):
        sparsity = ca.Sparsity.dense(m, n) if pattern is None else ca.DM(pattern.astype(float)).sparsity()
        columns = [ca.SX.sym("x", size) for size in (n, m, n * bounds, n * bounds)]
        metric, rows = ca.SX.sym("M", n, n), ca.SX.sym("A", sparsity)
        solution = Solution.of(Program(columns[0], metric, rows, *columns[1:]))
        given = [ca.SX.sym("p", argument.numel()) for argument in solution.arguments]
        shaped = [ca.reshape(one, like.shape) for one, like in zip(given, solution.arguments, strict=True)]
        procedure = Procedure("qp", tuple(given), solution.symbols, (replace(solution, arguments=tuple(shaped)),))
        evaluated = procedure.casadi().map if request.param == "by CasADi" else in_c(procedure)
        return evaluated, np.array(sparsity.get_triplet()[:2], dtype=int)

    def in_c(procedure):
        """As many evaluations of the compiled function, in the way of CasADi's map."""
        names = Names("double")
        arguments = [f"p{k}" for k in range(len(procedure.given))], [f"r{k}" for k in range(len(procedure.results))]
        source = tmp_path_factory.mktemp("qp") / "qp.c"
        source.write_text(module_text([function_text(procedure, *arguments, names)], names))
        ffi = cffi.FFI()
        ffi.cdef("int qp(const double **, double **, long long *, double *, int);")
        library = ffi.dlopen(str(compile_library([source])))

        def call(columns):
            columns = [np.ascontiguousarray(np.array(column).T) for column in columns]
            results = [np.empty((len(columns[0]), one.numel())) for one in procedure.results]
            arg, res = ffi.new("const double *[]", len(columns)), ffi.new("double *[]", len(results))
            for k in range(len(columns[0])):
                for table, arrays in ((arg, columns), (res, results)):
                    for i, array in enumerate(arrays):
                        table[i] = ffi.cast("double *", array.ctypes.data + k * array.strides[0])
                library.qp(arg, res, ffi.NULL, ffi.NULL, 0)
            return [result.T for result in results]

        return lambda count: SimpleNamespace(call=call)

    def run(problems, pattern=None):
        (count, m, n), bounds = problems.rows.shape, bool(problems.lower.shape[1])
        key = (n, m, bounds, None if pattern is None else pattern.tobytes())
        if key not in made:
            made[key] = function(n, m, bounds, pattern)
        qp, (row, column) = made[key]
        i, j = np.tril_indices(n)
        columns = [
            problems.start,
            problems.metric_inverse[:, i, j],
            problems.rows[:, row, column],
            problems.limits,
            problems.lower,
            problems.upper,
        ]
        u, violations, steps, done = (np.array(one).T for one in qp(count).call([ca.DM(c.T) for c in columns]))
        return u, violations, steps[:, 0], done[:, 0]

    return run


def _by_daqp(start, metric_inverse, rows, limits, lower, upper):
    """The solution, or None of a program that has none."""
    n, cost = len(start), _symmetric_inverse(metric_inverse)
    if not len(lower):
        lower, upper = np.full(n, -1e30), np.full(n, 1e30)
    below, above = np.concatenate([lower, np.full(len(limits), -1e30)]), np.concatenate([upper, limits])
    kind = np.zeros(len(above), dtype=np.int32)
    u, _, found, _ = daqp.solve(cost, -cost @ start, np.ascontiguousarray(rows), above, below, kind, primal_tol=1e-11)
    return u if found == 1 else None


def _by_quadprog(start, metric_inverse, rows, limits, lower, upper):
    """The solution, or None of a program that has none."""
    cost, sides = _symmetric_inverse(metric_inverse), np.eye(len(start))[: len(lower)]
    # bounds that are equal, as of a joint that has to leave its limit at full speed, hold nothing to rounding
    lower = np.where(upper - lower < 1e-12, upper - 1e-12, lower)
    normals, least = np.vstack([-rows, sides, -sides]), np.concatenate([-limits, lower, -upper])
    try:
        return quadprog.solve_qp(cost, cost @ start, np.ascontiguousarray(normals.T), least)[0]
    except ValueError:
        return None


def _symmetric_inverse(matrix):
    inverse = np.linalg.inv(matrix)
    return (inverse + inverse.T) / 2


def _relaxed(start, metric_inverse, rows, limits, lower, upper):
    """Where rows contradict each other: the least squares of what they are violated by, then the least change.

    Bounds count 1/FIRM times as much; what is left of their violation is cut off.
    """
    n, sides = len(start), np.eye(len(start))[: len(lower)]
    normals, most = np.vstack([rows, sides, -sides]), np.concatenate([limits, upper, -lower])
    weight = np.concatenate([np.ones(len(limits)), np.full(2 * len(lower), FIRM**-0.5)])
    columns = weight[:, None] * np.hstack([normals, -normals, np.eye(len(most))])  # u⁺, u⁻ and the room left
    found, _ = nnls(columns, weight * most, maxiter=10_000)
    violation = np.maximum(0, normals @ (found[:n] - found[n : 2 * n]) - most)
    # 1e-9 more than the violation: a feasible set of one point is empty to rounding
    u = _by_daqp(start, metric_inverse, normals, most + violation + 1e-9, lower[:0], upper[:0])
    return np.clip(u, lower, upper) if len(lower) else u


def _change_cost(u, problem):
    """(u − u₀)ᵀ M⁻¹ (u − u₀)."""
    return (u - problem.start) @ np.linalg.solve(problem.metric_inverse, u - problem.start)


# ---- Feasible programs ----


@pytest.mark.parametrize(("n", "m", "bounds"), SIZES)
def test_random_feasible_programs_have_the_solution_of_two_libraries(n, m, bounds, solved):
    problems = _random(n, m, bounds)
    u, violations, steps, done = solved(problems)
    for library in (_by_daqp, _by_quadprog):
        expected = np.array([library(*problem) for problem in problems.each()])
        # the worst of these is 8e-12: the bias of the slack, 1e-11 times a multiplier, twice refined
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-10)
    assert np.all(violations < 1e-10)
    assert np.all(done == 1)
    assert np.sum(steps > 0) > 100
    assert np.max(steps) < MOST_STEPS


def test_structural_zeros_of_the_rows_change_nothing_but_the_work(solved):
    pattern = np.arange(30).reshape(10, 3) % 7 < 3
    problems = _random(3, 10, True, seed=1)
    problems = replace(problems, rows=problems.rows * pattern)
    problems = replace(problems, limits=np.abs(problems.limits), lower=-1 + 0 * problems.lower, upper=problems.upper**2)
    sparse, dense = solved(problems, pattern), solved(problems)
    for one, other in zip(sparse, dense, strict=True):
        # a term that is zero is left out: nothing is rounded differently but for the order of sums
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11)
    assert np.sum(sparse[2] > 1) > 100


def test_a_start_that_violates_nothing_comes_back_bit_for_bit(solved):
    problems, rng = _random(5, 18, True, seed=2), np.random.default_rng(2)
    start, room = problems.start, rng.exponential(size=(300, 18)) * (rng.random((300, 18)) < 0.9)
    limits = np.einsum("kij,kj->ki", problems.rows, start) + room + 1e-14  # sums that are rounded in another order
    u, violations, steps, done = solved(replace(problems, limits=limits, lower=start - 1, upper=start))
    np.testing.assert_array_equal(u.view(np.uint64), start.view(np.uint64))
    assert np.all(violations == 0)
    assert np.all(steps == 0)
    assert np.all(done == 1)


def test_one_row_is_met_along_m_a(solved):
    problems = _random(4, 1, False, seed=3)
    u, _, steps, _ = solved(problems)
    M, a = problems.metric_inverse, problems.rows[:, 0]
    along = np.einsum("kij,kj->ki", M, a)
    excess = np.maximum(0, np.sum(a * problems.start, axis=1) - problems.limits[:, 0])
    expected = problems.start - along * (excess / np.sum(a * along, axis=1))[:, None]
    # rounding of numbers up to 10, by a pivot down to 1e-3
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(steps, excess > 0)


def test_bounds_alone_in_a_diagonal_metric_are_a_clamp(solved):
    problems = _random(6, 0, True, seed=4)
    problems = replace(problems, metric_inverse=problems.metric_inverse * np.eye(6))
    u, _, _, _ = solved(problems)
    # a bound is met to rounding of the way there, up to 10
    np.testing.assert_allclose(u, np.clip(problems.start, problems.lower, problems.upper), rtol=0, atol=1e-14)


def test_the_order_of_the_rows_does_not_matter(solved):
    problems = _random(5, 18, True, seed=5)
    order = np.random.default_rng(5).permutation(18)
    swapped = replace(problems, rows=problems.rows[:, order], limits=problems.limits[:, order])
    # each is within 1e-10 of the solution, see above
    np.testing.assert_allclose(solved(swapped)[0], solved(problems)[0], rtol=0, atol=1e-10)


# ---- Degenerate ones ----


@pytest.mark.parametrize("copies", [2, 5])
@pytest.mark.parametrize(("n", "m"), [(1, 3), (3, 4), (5, 6)])
def test_rows_that_are_there_several_times_count_once(n, m, copies, solved):
    """A row that those held make up is not taken in: it needs no slot, and the program is solved."""
    once = _random(n, m, True, seed=6)
    scale = np.random.default_rng(6).uniform(0.5, 2, (len(once.start), copies * m))
    rows, limits = np.tile(once.rows, (1, copies, 1)) * scale[:, :, None], np.tile(once.limits, (1, copies)) * scale
    u, violations, _, done = solved(replace(once, rows=rows, limits=limits))
    # parallel rows share a multiplier, refined twice as above
    np.testing.assert_allclose(u, solved(once)[0], rtol=0, atol=1e-10)
    assert np.all(violations < 1e-10)
    assert np.all(done == 1)


@pytest.mark.parametrize("copies", [1, 4, 12])
def test_a_contact_at_its_boundary_that_many_rows_name_does_not_stop_the_robot(copies, solved):
    """Limits of exactly 0, as at rest on a boundary: motion along it goes on."""
    angle = np.linspace(0, 2 * np.pi, 50)
    normal, start = np.stack([np.cos(angle), np.sin(angle)], axis=1), np.ones((50, 2))
    metric, none = np.tile(np.eye(2), (50, 1, 1)), np.zeros((50, 0))
    rows = np.repeat(normal[:, None], copies, axis=1)
    u, _, _, done = solved(Problems(start, metric, rows, np.zeros((50, copies)), none, none))
    expected = start - normal * np.maximum(0, np.sum(normal * start, axis=1))[:, None]
    # rounding, and the bias of the slack, 1e-11, refined
    np.testing.assert_allclose(u, expected, rtol=0, atol=1e-13)
    assert np.all(done == 1)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_a_vertex_through_which_many_rows_go_is_found(n, solved):
    """Three times as many rows as variables through one point, and a start from which that point is the solution."""
    rng = np.random.default_rng(7)
    problems = _random(n, 3 * n, False, seed=7, condition=1e2)
    vertex = rng.normal(size=problems.start.shape)
    push = np.einsum("kij,kj->ki", problems.rows.transpose(0, 2, 1), rng.exponential(size=(len(vertex), 3 * n)))
    start = vertex + np.einsum("kij,kj->ki", problems.metric_inverse, push)
    problems = replace(problems, start=start, limits=np.einsum("kij,kj->ki", problems.rows, vertex))
    u, violations, _, done = solved(problems)
    # n of 3 n random rows can be nearly dependent: the worst of these is 1e-11
    np.testing.assert_allclose(u, vertex, rtol=0, atol=1e-9)
    assert np.all(violations < 1e-9)
    assert np.all(done == 1)


# ---- Programs without a solution ----


def test_rows_that_no_velocity_changes_leave_the_others_as_they_are(solved):
    problems = _random(3, 6, True, seed=8)
    zero, limit = np.zeros((len(problems.start), 1, 3)), np.full((len(problems.start), 1), -0.5)
    more = replace(problems, rows=np.hstack([zero, problems.rows]), limits=np.hstack([limit, problems.limits]))
    u, violations, _, done = solved(more)
    np.testing.assert_allclose(u, solved(problems)[0], rtol=0, atol=1e-10)  # as above
    np.testing.assert_array_equal(violations[:, 0], 0.5)
    assert np.all(violations[:, 1:] < 1e-10)
    assert np.all(done == 1)


@pytest.mark.parametrize("leverage", [0.0, 1e-16, 1e-8, 1e-5, 1e-3])
def test_a_contact_that_u_hardly_changes_is_not_kept_at_the_cost_of_one_that_it_can_keep(leverage, solved):
    """Violations count in m/s, not in the joint velocity that would undo them."""
    rows, limits = np.array([[[-leverage, 0.0], [1.0, 0.0]]]), np.array([[-0.1, 0.01]])
    side = np.ones((1, 2))
    u, violations, _, _ = solved(Problems(0 * side, np.eye(2)[None], rows, limits, -2 * side, 2 * side))
    assert violations[0, 0] > 0.09
    # the least squares of both: the second gives way by the leverage times what the first lacks
    assert 0 <= u[0, 0] <= 0.01 + 0.1 * leverage + 1e-9
    assert u[0, 1] == 0


@pytest.mark.parametrize("cost", [1.0, 1e3])
def test_opposed_rows_meet_in_the_middle_whatever_the_metric(cost, solved):
    """u_0 <= −0.1 and u_0 >= 0.3: half of the gap each; what is free of them stays."""
    rows, limits = np.array([[[1.0, 0.0], [-1.0, 0.0]]]), np.array([[-0.1, -0.3]])
    side = np.ones((1, 2))
    metric = np.diag([1 / cost, 1.0])[None]
    u, violations, _, done = solved(Problems(side, metric, rows, limits, -side, side))
    # the slack over a M aᵀ: 1e-11 times the cost
    np.testing.assert_allclose(u[0], [0.1, 1.0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(violations[0], [0.2, 0.2, 0, 0], rtol=0, atol=1e-5)
    assert done[0] == 1


@pytest.mark.parametrize(("n", "m", "bounds"), [(1, 3, True), (2, 3, True), (2, 5, False), (3, 6, False)])
def test_rows_that_contradict_each_other_are_violated_by_the_least_squares(n, m, bounds, solved):
    """With no more rows and bounds than the solver has slots for, whatever is infeasible has that solution."""
    assert m + n * bounds <= n + SPARE
    problems = _random(n, m, bounds, seed=9, condition=1e2)
    problems = replace(problems, limits=problems.limits - np.random.default_rng(9).exponential(size=(300, m)))
    none = np.array([_by_quadprog(*problem) is None for problem in problems.each()])
    assert np.sum(none) > 100
    u, violations, _, done = solved(problems[none])
    expected = np.array([_relaxed(*problem) for problem in problems[none].each()])
    np.testing.assert_allclose(u, expected, rtol=0, atol=RELAXED)
    assert np.all(np.max(violations, axis=1) > FEASIBLE)
    assert np.all(done == 1)


@pytest.mark.parametrize(("n", "m"), [(2, 4), (3, 6), (5, 10), (5, 18)])
def test_whatever_contradicts_whatever_the_bounds_are_kept_and_the_violation_is_reported(n, m, solved):
    problems = _random(n, m, True, seed=10)
    problems = replace(problems, limits=problems.limits - np.random.default_rng(10).exponential(2, size=(300, m)))
    u, violations, steps, done = solved(problems)
    none = np.array([_by_quadprog(*problem) is None for problem in problems.each()])
    assert np.sum(none) > 200
    assert np.all((problems.lower <= u) & (u <= problems.upper))
    expected = np.maximum(0, np.einsum("kij,kj->ki", problems.rows, u) - problems.limits)
    np.testing.assert_allclose(violations[:, :m], expected, rtol=0, atol=1e-14)  # sums of five terms up to 3
    assert np.all(np.max(violations, axis=1)[none] > FEASIBLE)
    assert np.all(np.max(violations, axis=1)[~none] < FEASIBLE)
    assert np.all(done[~none] == 1)
    assert np.max(steps) < MOST_STEPS


def test_where_the_slots_run_out_what_rest_keeps_is_kept(solved):
    """More than n + SPARE rows that contradict each other: unsolved, yet nothing is closed that could stay open."""
    problems = _random(5, 18, True, seed=11)
    limits = problems.limits - np.random.default_rng(11).exponential(2, size=(300, 18))
    problems = replace(problems, limits=limits, lower=-1 + 0 * problems.lower, upper=1 + 0 * problems.upper)
    _, violations, _, done = solved(problems)
    assert np.sum(done == 0) > 100
    kept_by_rest = (limits >= 0) & (done == 0)[:, None]
    assert np.max(violations[:, :18][kept_by_rest]) < FEASIBLE


@pytest.mark.parametrize(("n", "m", "bounds"), [(1, 3, True), (2, 3, True), (3, 6, False)])
def test_the_solution_is_continuous_from_feasible_to_contradicting(n, m, bounds, solved):
    """Limits fall; the widest step of u is halved 26 times over: what jumped stays, what is continuous vanishes."""
    problems = _random(n, m, bounds, count=100, seed=12, condition=1e2)
    length = np.linalg.norm(problems.rows, axis=2)
    problems = replace(problems, rows=problems.rows / length[:, :, None], limits=problems.limits / length)
    fall = np.random.default_rng(12).exponential(size=problems.limits.shape)

    def at(t, index):
        some = problems[index]
        return solved(replace(some, limits=some.limits - t[:, None] * fall[index]))

    every, grid = np.arange(100), np.linspace(0, 3, 301)
    u, violations, _, _ = at(np.tile(grid, 100), np.repeat(every, 301))
    assert np.sum(np.max(violations.reshape(100, 301, -1)[:, -1], axis=1) > 0.1) > 50  # it does contradict
    widest = np.argmax(np.max(np.abs(np.diff(u.reshape(100, 301, n), axis=1)), axis=2), axis=1)
    low, high = grid[widest], grid[widest + 1]
    for _ in range(26):
        middle = (low + high) / 2
        ends = [at(t, every)[0] for t in (low, middle, high)]
        left = np.max(np.abs(ends[1] - ends[0]), axis=1) > np.max(np.abs(ends[2] - ends[1]), axis=1)
        low, high = np.where(left, low, middle), np.where(left, middle, high)
    jump = np.max(np.abs(at(low, every)[0] - at(high, every)[0]), axis=1)
    assert np.max(jump) < RELAXED


# ---- Real controllers ----


@pytest.fixture(scope="module")
def guarded(evaluated):
    """`guarded(name)`: a shipped controller with barriers and velocity limits, and the same one without barriers."""

    def build(name):
        spec = read_spec({path.stem: path for path in shipped_specs()}[name]).model_dump(exclude_none=True)
        for task in spec["tasks"]:
            if "activation" in task:
                task["activation"] = {"kind": "barrier"}
        free = [task for task in spec["tasks"] if "activation" not in task]
        more = {"obstacles": spec["obstacles"], "law": spec["law"], "velocity_limits": {"kind": "clamp"}}
        more["period"] = spec["period"]
        return evaluated(spec["robot"], *spec["tasks"], **more), evaluated(spec["robot"], *free, **more)

    made = {}
    return lambda name: made[name] if name in made else made.setdefault(name, build(name))


def _states(controller, q, seed):
    """Step inputs about the joint positions q (N, n): obstacles, some of them moving, near points of interest."""
    rng, count = np.random.default_rng(seed), len(q)
    infos, seen = controller.infos(), controller("kinematics", q=q)
    s = np.reshape(infos["influence_radius"].default, -1)
    place, space = seen["point_position"], seen["point_position"].shape[2]
    shape = (count, *infos["obstacle_radius"].shape)
    chosen, radius = rng.integers(0, len(s), shape), rng.uniform(0, 0.3, shape) * (rng.random(shape) < 2 / 3)
    away = rng.normal(size=(*shape, space))
    away /= np.linalg.norm(away, axis=2, keepdims=True)
    distance = radius + s[chosen] + rng.uniform(-0.02, 0.3, shape)
    values = {
        "q": q,
        "obstacle_center": np.take_along_axis(place, chosen[:, :, None], axis=1) + distance[:, :, None] * away,
        "obstacle_radius": radius,
        "obstacle_count": rng.integers(0, shape[1] + 1, count).astype(float),
        "obstacle_velocity": rng.uniform(-0.3, 0.3, away.shape) * (rng.random((count, 1, 1)) < 0.5),
        "obstacles_rate": rng.uniform(5, 20, count),
    }
    for name in (name for name in infos if name.endswith("_yields")):
        values[name] = 10 ** rng.uniform(-2, 0, count)
    return values


def _distance_rows(values, seen, moves, s):
    """A (N, pairs, n) and b (N, pairs) of ḋ >= −γ (d − s) + …, each point with each obstacle, by hand."""
    way = values["obstacle_center"][:, None] - seen["point_position"][:, :, None]
    length = np.linalg.norm(way, axis=3)
    toward, there = way / length[..., None], np.arange(way.shape[2]) < values["obstacle_count"][:, None]
    rows = np.einsum("npkd,npdj->npkj", toward, moves["point_jacobian"])
    room = values["obstacles_rate"][:, None, None] * (length - values["obstacle_radius"][:, None] - s[:, None])
    room += np.einsum("npkd,nkd->npk", toward, values["obstacle_velocity"])
    count = len(rows)
    return rows.reshape(count, -1, rows.shape[3]), np.where(there[:, None], room, 1e6).reshape(count, -1)


def _metric(yields, jacobians):
    """M of the barrier's docstring, with explicit inverses."""
    n = jacobians[0].shape[2]
    M = np.eye(n)
    for share, J in zip(yields, jacobians, strict=True):
        gram = J @ M @ J.transpose(0, 2, 1) + SINGULAR**2 * np.eye(J.shape[1])
        N = M - M @ J.transpose(0, 2, 1) @ np.linalg.inv(gram) @ J @ M
        M = N + share[:, None, None] ** 2 * (M - N)
    return (M + M.transpose(0, 2, 1)) / 2


@pytest.fixture(scope="module")
def planar5_states(guarded):
    """The program of planar5 by hand, all that its controller says, and the inputs, at STATES random states."""
    controller, free = guarded("planar5")
    rng = np.random.default_rng(20)
    values = _states(controller, rng.uniform(-3, 3, (STATES, 5)), 20)
    seen, moves = controller("kinematics", q=values["q"]), controller("jacobians", q=values["q"])
    values["tool_reference"] = seen["tool_position"] + rng.uniform(-1, 1, (STATES, 2))
    values["tool_reference_velocity"] = rng.uniform(-1, 1, (STATES, 2))
    rows, limits = _distance_rows(values, seen, moves, np.reshape(controller.infos()["influence_radius"].default, -1))
    v = np.broadcast_to(controller.infos()["velocity_limit"].default, (STATES, 5))
    metric = _metric([values["tool_yields"]], [moves["tool_jacobian"]])
    return Problems(free(**values)["dq_law"], metric, rows, limits, -v, +v), controller(**values), values


@pytest.fixture(scope="module")
def panda_states(guarded):
    """The same of mobile_panda, whose joint limits are bounds of the program: a tenth as many states."""
    controller, free = guarded("mobile_panda")
    rng, count = np.random.default_rng(21), max(STATES // 10, 100)
    infos = controller.infos()
    limited = [i for i, joint in enumerate(controller.controller.spec.robot.coordinates) if joint.lower is not None]
    lower, upper, s = np.full(10, -1e6), np.full(10, 1e6), np.zeros(10)
    for name, array in {"limits_lower": lower, "limits_upper": upper, "limits_margin": s}.items():
        array[limited] = infos[name].default
    v = np.array(infos["velocity_limit"].default)
    low, high = np.maximum(lower + s - 0.2, -3), np.minimum(upper - s + 0.2, 3)
    values = _states(controller, rng.uniform(low, high, (count, 10)), 21)
    seen, moves = controller("kinematics", q=values["q"]), controller("jacobians", q=values["q"])
    values["hand_reference"] = seen["hand_position"] + rng.uniform(-0.5, 0.5, (count, 3))
    values["hand_orientation_reference"] = rng.normal(size=(count, 4))
    values["limits_rate"] = rng.uniform(5, 20, count)
    rows, limits = _distance_rows(values, seen, moves, np.reshape(infos["influence_radius"].default, -1))
    down, up = (
        np.clip(values["limits_rate"][:, None] * room, -v, v)
        for room in (values["q"] - lower - s, upper - s - values["q"])
    )
    metric = _metric(
        [values["hand_yields"], values["heading_yields"]],
        [moves["hand_jacobian"], moves["heading_jacobian"][:, None]],
    )
    return Problems(free(**values)["dq_law"], metric, rows, limits, -down, up), controller(**values), values


@pytest.fixture(params=["planar5_states", "panda_states"])
def states(request):
    return request.getfixturevalue(request.param)


@pytest.fixture
def answers(states):
    """What both libraries say of the program by hand: (N, n), NaN of a program without a solution."""
    nothing = np.full(states[0].start.shape[1], np.nan)
    return [
        np.array([nothing if (u := library(*problem)) is None else u for problem in states[0].each()])
        for library in (_by_daqp, _by_quadprog)
    ]


def test_a_controller_s_velocity_is_the_solution_of_the_program_written_by_hand(states, answers):
    """A, b, M and the bounds from numpy, u₀ from the controller without barriers, and two libraries to solve it."""
    _, outputs, _ = states
    feasible = np.isfinite(answers[0][:, 0])
    np.testing.assert_array_equal(feasible, np.isfinite(answers[1][:, 0]))
    assert 0.5 < np.mean(feasible) < 0.95
    errors = [np.max(np.abs(outputs["dq_law"] - u), axis=1)[feasible] for u in answers]
    print(
        f"{len(feasible)} states, {np.mean(~feasible):.1%} infeasible, worst error {np.max(errors):.1e}, "
        f"{np.max(outputs['barrier_steps']):.0f} steps at most, {np.max(outputs['barrier_steps'][feasible]):.0f} where "
        f"feasible, {np.sum(outputs['barrier_solved'] == 0)} unsolved, all of them infeasible"
    )
    assert np.max(errors) < AGREEMENT
    assert np.all(outputs["barrier_excess"][feasible] < FEASIBLE)
    assert np.all(outputs["barrier_row"][feasible] == -1)
    assert np.all(outputs["barrier_solved"][feasible] == 1)


def test_a_state_without_a_solution_is_reported_and_keeps_the_velocity_limits(states, answers):
    problems, outputs, _ = states
    none = ~np.isfinite(answers[0][:, 0])
    assert np.all(outputs["barrier_excess"][none] > FEASIBLE)
    assert np.all(np.isfinite(outputs["q_next"]))
    beyond = np.maximum(problems.lower - outputs["dq_law"], outputs["dq_law"] - problems.upper)
    assert np.max(beyond) < 1e-13  # γ (q − q̲ − s) up to 3 is rounded in another order
    rows = np.einsum("kij,kj->ki", problems.rows, outputs["dq_law"]) - problems.limits
    row = outputs["barrier_row"][none].astype(int)
    named = np.take_along_axis(rows[none], np.minimum(row, rows.shape[1] - 1)[:, None], axis=1)[:, 0]
    of_rows = row < rows.shape[1]  # not a bound: as bounds are kept, that is all of them
    assert np.all(of_rows)
    # rounding of distances
    np.testing.assert_allclose(named, outputs["barrier_excess"][none], rtol=0, atol=1e-12)


def test_no_real_state_takes_as_many_steps_as_there_are(states):
    _, outputs, _ = states
    assert np.max(outputs["barrier_steps"]) < MOST_STEPS
    assert np.sum(outputs["barrier_steps"] > 3) > len(outputs["barrier_steps"]) / 20


@pytest.mark.parametrize("name", ["planar5", "mobile_panda"])
def test_the_stated_operations_count_every_step_and_stay_below_the_unrolled_ones(name, guarded):
    """CasADi's version asks of every row and slot in turn what ours looks up, so it has more to do in every step."""
    controller, free = guarded(name)
    step = {one.name: one for one in controller.controller.functions}["step"].procedure
    (solution,) = (stage for stage in step.stages if isinstance(stage, Solution))
    solver = Solver.of(solution.program)
    assert MOST_STEPS * solution.program.start.numel() ** 2 < solution.operations < solver.instructions
    assert step.operations > solution.operations
    assert step.operations > 10 * free.operations()


def test_casadi_s_c_equals_casadi_bit_for_bit_with_a_barrier_and_ours_to_the_solver_s_rounding(
    guarded, planar5_states, tmp_path
):
    _, outputs, values = planar5_states
    shaped = {name: np.broadcast_to(value, (STATES, *np.shape(value)[1:])) for name, value in values.items()}
    compiled = {}
    for target in ("casadi", "c"):
        (tmp_path / target).mkdir()
        for name, text in generate(guarded("planar5")[0].controller.spec, target).items():
            (tmp_path / target / name).write_text(text, encoding="utf-8")
        compiled[target] = CompiledController.load(tmp_path / target).step.map(STATES, shaped)
    assert len(np.unique(outputs["barrier_steps"])) > 10
    for name, array in compiled["casadi"].items():
        expected = np.ascontiguousarray(outputs[name])
        np.testing.assert_array_equal(array.view(np.uint64), expected.view(np.uint64), err_msg=name)
    feasible = (outputs["barrier_excess"] < FEASIBLE) & (outputs["barrier_solved"] == 1)
    assert 0.5 < np.mean(feasible) < 0.9
    for name, array in compiled["c"].items():
        exactly = name in ("barrier_steps", "barrier_solved", "barrier_row")
        alike = (
            array[feasible] == outputs[name][feasible] if exactly else np.abs(array - outputs[name])[feasible] < 1e-7
        )
        assert np.mean(alike) > (0.999 if exactly else 1 - 1e-9), name
