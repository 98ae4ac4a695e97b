"""The laws against numpy's projectors: what a lower task may change, and what it may not."""

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
import pytest

from clikgen.symbolic.damping import ConstantDamping, Damping, FadingDamping, NearSingularDamping
from clikgen.symbolic.laws import augmented, nsb

UNDAMPED = 1e-9  # changes a velocity by its square over σ², and σ >= 0.01 here: 1e-14
LEAK = 1e-9  # the promise; what is measured is some 1e-14


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """As much of a task as a law looks at."""

    jacobian: ca.SX
    velocity: ca.SX
    damping: Damping


@cache
def _compiled(law, rows, n, selective):
    """(J_k, v_k, maxima λ, ε) -> q̇."""
    jacobians = [ca.SX.sym(f"J{k}", m, n) for k, m in enumerate(rows)]
    velocities = [ca.SX.sym(f"v{k}", m) for k, m in enumerate(rows)]
    maxima, near = ca.SX.sym("maxima", len(rows)), ca.SX.sym("near")
    tasks = [
        _Task(J, v, NearSingularDamping(maximum, near) if selective else ConstantDamping(maximum))
        for J, v, maximum in zip(jacobians, velocities, ca.vertsplit(maxima), strict=True)
    ]
    return ca.Function("law", [*jacobians, *velocities, maxima, near], [ca.cse(law.combine(tasks))])


def _velocity(law, stack, damping=UNDAMPED, near=None):
    """q̇ of a stack of (J, v); with `near` the damping is selective; `damping` one for all, or one a level."""
    jacobians, velocities = zip(*stack, strict=True)
    function = _compiled(law, tuple(len(J) for J in jacobians), jacobians[0].shape[1], near is not None)
    maxima = np.broadcast_to(damping, len(stack))
    return np.array(function(*jacobians, *velocities, maxima, near or 0.0))[:, 0]


def _rows(rng, m, n, least=0.3):
    """A Jacobian with singular values between `least` and 3."""
    U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
    return U * rng.uniform(least, 3, m) @ V[:, :m].T


def _regular_stack(rng, n, levels):
    """Tasks that are all compatible: the rows together have singular values between 0.3 and 3."""
    cuts = np.sort(rng.choice(np.arange(1, n), size=levels - 1, replace=False))
    together = _rows(rng, rng.integers(cuts[-1] + 1, n + 1), n)
    return [(J, rng.normal(size=len(J))) for J in np.split(together, cuts)]


def _conflicting_stack(rng, n, levels):
    """The same, but from some level on there is a task that asks what those above have settled, or nothing."""
    stack = _regular_stack(rng, n, levels)
    for k in range(rng.integers(1, levels), levels):
        above = np.vstack([J for J, _ in stack[:k]])
        J = [rng.normal(size=(2, len(above))) @ above, rng.normal(size=(2, n)), np.zeros((1, n))][rng.integers(3)]
        if rng.integers(2):
            J = np.vstack([J, rng.normal(size=(1, n))])
        stack[k] = (J, rng.normal(size=len(J)))
    return stack


def _stacks(count, make):
    for seed in range(count):
        rng = np.random.default_rng(seed)
        yield rng, make(rng, int(rng.integers(6, 13)), int(rng.integers(2, 7)))


def _other_lower_tasks(rng, stack, k):
    """The stack up to level k with nothing below, with other velocities, other tasks and one task more."""
    n = stack[0][0].shape[1]
    yield stack[:k]
    yield [*stack[:k], *((J, 10 * rng.normal(size=len(J))) for J, _ in stack[k:])]
    yield [*stack[:k], (rng.normal(size=(2, n)), rng.normal(size=2))]
    yield [*stack[:k], (rng.normal(size=(1, k)) @ np.vstack([J[0] for J, _ in stack[:k]]), rng.normal(size=1))]
    yield [*stack, (np.eye(n), rng.normal(size=n))]


def _null(J):
    return np.eye(J.shape[1]) - np.linalg.pinv(J) @ J


# ---- Strict priority ----


@pytest.mark.parametrize("make", [_regular_stack, _conflicting_stack])
def test_augmented_no_lower_task_changes_any_higher_one(make):
    for rng, stack in _stacks(10, make):
        whole = _velocity(augmented, stack)
        for k in range(1, len(stack) + 1):
            for other in _other_lower_tasks(rng, stack, k):
                change = _velocity(augmented, other) - whole
                for J, _ in stack[:k]:
                    np.testing.assert_allclose(J @ change, 0, rtol=0, atol=LEAK)


def _least_left(stack, k):
    """The least singular value of J_k P_{k−1} over √m: selective damping is off where it is above ε."""
    J = stack[k][0]
    P = _null(np.vstack([np.zeros_like(J[:1]), *(above for above, _ in stack[:k])]))
    return np.linalg.svd(J @ P, compute_uv=False)[-1] / np.sqrt(len(J)) if len(J) <= J.shape[1] else 0.0


@pytest.mark.parametrize("make", [_regular_stack, _conflicting_stack])
def test_augmented_selectively_damped_tasks_that_are_not_near_a_singularity_are_not_changed(make):
    near, checked = 0.01, 0
    for rng, stack in _stacks(10, make):
        free = [_least_left(stack, k) > near for k in range(len(stack))]
        whole = _velocity(augmented, stack, 0.05, near)
        for k in range(1, len(stack) + 1):
            for other in _other_lower_tasks(rng, stack, k):
                change = _velocity(augmented, other, 0.05, near) - whole
                for i in range(k):
                    if free[i]:
                        np.testing.assert_allclose(stack[i][0] @ change, 0, rtol=0, atol=LEAK)
                        checked += 1
    assert checked > 100


@pytest.mark.parametrize("make", [_regular_stack, _conflicting_stack])
@pytest.mark.parametrize("near", [None, 0.01])
def test_nsb_no_lower_task_changes_the_first_one(make, near):
    for rng, stack in _stacks(10, make):
        J, v = stack[0]
        np.testing.assert_allclose(J @ _velocity(nsb, stack, UNDAMPED, near), v, rtol=0, atol=LEAK)
        for other in _other_lower_tasks(rng, stack, 1):
            np.testing.assert_allclose(J @ _velocity(nsb, other, UNDAMPED, near), v, rtol=0, atol=LEAK)


def test_nsb_a_third_task_changes_the_second_by_exactly_what_the_projectors_leave():
    """J_2 N_1 N_2 z: not zero in general, where augmented projection has zero."""
    rng = np.random.default_rng(1)
    stack = [(_rows(rng, 2, 8), rng.normal(size=2)) for _ in range(3)]
    (J1, _), (J2, _), (J3, v3) = stack
    change = J2 @ (_velocity(nsb, stack) - _velocity(nsb, stack[:2]))
    expected = J2 @ _null(J1) @ _null(J2) @ np.linalg.pinv(J3) @ v3
    np.testing.assert_allclose(change, expected, rtol=0, atol=1e-12)  # rounding, condition <= 10
    assert np.linalg.norm(change) > 0.05
    assert np.linalg.norm(J2 @ (_velocity(augmented, stack) - _velocity(augmented, stack[:2]))) < LEAK


def _commuting_levels(rng, n, levels):
    """Row spaces spanned by subsets of one orthonormal basis: orthogonal, nested or sharing some directions."""
    basis = np.linalg.qr(rng.normal(size=(n, n)))[0]
    for _ in range(levels):
        m = int(rng.integers(1, 4))
        J = rng.normal(size=(m, m)) + 3 * np.eye(m)
        yield J @ basis[rng.choice(n, m, replace=False)], rng.normal(size=m)


def test_nsb_no_lower_task_changes_any_higher_one_where_the_projectors_commute():
    shared = 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(6, 13))
        stack = list(_commuting_levels(rng, n, 4))
        shared += np.linalg.matrix_rank(np.vstack([J for J, _ in stack]), tol=1e-9) < sum(len(J) for J, _ in stack)
        for k in range(1, 4):
            below = [(rng.normal(size=(2, n)), rng.normal(size=2))]
            change = _velocity(nsb, [*stack[:k], *below]) - _velocity(nsb, stack[:k])
            for J, _ in stack[:k]:
                np.testing.assert_allclose(J @ change, 0, rtol=0, atol=LEAK)
    assert shared > 5  # more than orthogonal row spaces


def test_nsb_second_task_is_safe_only_where_the_projectors_commute():
    """J_2 N_1 N_2 = 0 is the same as N_1 N_2 = N_2 N_1; else some third task changes the second."""
    for seed in range(25):
        rng = np.random.default_rng(seed)
        J1, J2 = _rows(rng, 2, 7), _rows(rng, 2, 7)
        N1, N2 = _null(J1), _null(J2)
        assert np.linalg.norm(N1 @ N2 - N2 @ N1) > 0.01
        third = np.linalg.svd(J2 @ N1 @ N2)[2][:1]  # the direction that does most
        stack = [(J1, np.zeros(2)), (J2, np.zeros(2)), (third, np.ones(1))]
        assert np.linalg.norm(J2 @ _velocity(nsb, stack)) > 1e-3


# ---- Secondary tracking ----


def test_augmented_two_levels_are_the_textbook_formula():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        (J1, v1), (J2, v2) = [(rng.normal(size=(m, 9)), rng.normal(size=m)) for m in rng.integers(1, 5, 2)]
        first = np.linalg.pinv(J1) @ v1
        expected = first + np.linalg.pinv(J2 @ _null(J1)) @ (v2 - J2 @ first)
        size = np.linalg.norm(expected)
        np.testing.assert_allclose(
            _velocity(augmented, [(J1, v1), (J2, v2)]), expected, rtol=0, atol=1e-11 * (1 + size)
        )  # rounding of a gram of condition up to 1e4


def _textbook(stack):
    """Siciliano & Slotine with numpy's pinv, which drops what lies below 1e-9."""
    n = stack[0][0].shape[1]
    dq, above = np.zeros(n), np.zeros((1, n))
    for J, v in stack:
        dq = dq + np.linalg.pinv(J @ (np.eye(n) - np.linalg.pinv(above, rcond=1e-9) @ above), rcond=1e-9) @ (v - J @ dq)
        above = np.vstack([above, J])
    return dq


@pytest.mark.parametrize("order", [1, -1])
def test_augmented_a_posture_below_two_tasks_takes_what_they_leave_in_the_least_squares_sense(order):
    """Its J = I has lost four directions; none of its rows may count for more than another."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        stack = [(_rows(rng, m, 7), rng.normal(size=m)) for m in (3, 1)]
        stack.append((np.eye(7)[::order], rng.normal(size=7)))
        # the guard: 2^-30 |J|² = 7e-9 of the velocity, and rounding 1e-16 over that
        np.testing.assert_allclose(_velocity(augmented, stack), _textbook(stack), rtol=0, atol=1e-6)


def test_augmented_tasks_partly_in_conflict_give_the_least_squares_compromise():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        first = _rows(rng, 2, 6)
        mixed = np.vstack([rng.normal(size=(1, 2)) @ first, _rows(rng, 2, 6)])[rng.permutation(3)]
        stack = [(first, rng.normal(size=2)), (mixed, rng.normal(size=3)), (_rows(rng, 3, 6), rng.normal(size=3))]
        expected = _textbook(stack)
        size = np.linalg.norm(expected)
        np.testing.assert_allclose(_velocity(augmented, stack), expected, rtol=0, atol=1e-5 * (1 + size))


def test_augmented_reaches_every_velocity_of_a_compatible_stack_and_is_the_shortest_that_does():
    for _, stack in _stacks(50, _regular_stack):
        J, v = np.vstack([J for J, _ in stack]), np.concatenate([v for _, v in stack])
        dq = _velocity(augmented, stack)
        np.testing.assert_allclose(J @ dq, v, rtol=0, atol=1e-9)
        np.testing.assert_allclose(dq, np.linalg.pinv(J) @ v, rtol=0, atol=1e-9)


def test_nsb_loses_secondary_tracking_between_oblique_tasks_that_augmented_keeps():
    """Rows at 45° in the plane: by hand q̇_1 = (1, 0), q̇_2 = (0.5, 0.5), so nsb gives (1, 0.5) and J_2q̇ = 1.5."""
    stack = [(np.array([[1.0, 0.0]]), np.array([1.0])), (np.array([[1.0, 1.0]]), np.array([1.0]))]
    np.testing.assert_allclose(_velocity(nsb, stack), [1.0, 0.5], rtol=0, atol=1e-14)
    np.testing.assert_allclose(_velocity(augmented, stack), [1.0, 0.0], rtol=0, atol=1e-14)


def test_both_laws_agree_between_orthogonal_tasks():
    rng = np.random.default_rng(2)
    basis = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    stack = [(rng.normal(size=(2, 2)) @ basis[2 * k : 2 * k + 2], rng.normal(size=2)) for k in range(4)]
    np.testing.assert_allclose(_velocity(nsb, stack), _velocity(augmented, stack), rtol=0, atol=1e-12)


def test_augmented_a_task_wholly_in_conflict_moves_nothing():
    """What rounding leaves of it (1e-16 of its Jacobian) meets a damping of 3e-5 of its Jacobian."""
    rng = np.random.default_rng(3)
    for n in (6, 12):
        J = _rows(rng, 3, n)
        first, second = (J, rng.normal(size=3)), (rng.normal(size=(2, 3)) @ J, rng.normal(size=2))
        for damping in (1e-9, 1e-6, 1e-3):
            change = _velocity(augmented, [first, second], damping) - _velocity(augmented, [first], damping)
            np.testing.assert_allclose(change, 0, rtol=0, atol=1e-6)


@pytest.mark.parametrize("angle", [1e-4, 1e-3, 1e-2, 1.0])
def test_augmented_the_guard_against_rounding_does_not_touch_a_task_with_a_direction_of_its_own(angle):
    """Down to 1e-4 rad between the tasks, against the exact solution (v_1, (v_2 − v_1 cos)/sin)."""
    stack = [(np.array([[1.0, 0.0]]), np.array([1.0])), (np.array([[np.cos(angle), np.sin(angle)]]), np.array([0.5]))]
    dq = _velocity(augmented, stack)
    expected = [1.0, (0.5 - np.cos(angle)) / np.sin(angle)]
    np.testing.assert_allclose(dq, expected, rtol=2e-18 / angle**2 + 1e-12)  # (damping/angle)², and 1e-12


@pytest.mark.parametrize("exponent", range(1, 17))
def test_augmented_no_lower_task_changes_one_however_nearly_in_conflict(exponent):
    """The second task lies 10^-exponent rad from the first; the third wants a velocity of every joint."""
    rng = np.random.default_rng(exponent)
    J = _rows(rng, 1, 6)
    stack = [(J, np.ones(1)), (J + 10.0**-exponent * rng.normal(size=(1, 6)), np.ones(1))]
    change = _velocity(augmented, [*stack, (np.eye(6), rng.normal(size=6))]) - _velocity(augmented, stack)
    # rounding times |J z|, where the guard lets |z| of the third task, in conflict itself, come to some 1e4
    np.testing.assert_allclose(np.vstack([J for J, _ in stack]) @ change, 0, rtol=0, atol=1e-11)


# ---- What damping lets through ----


def test_nsb_damping_lets_through_no_more_than_its_bound():
    """And the bound is met: along the singular direction that attains the maximum."""
    tightest = 0.0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        J, damping = _rows(rng, int(rng.integers(1, 5)), 7, least=0.01), 10 ** rng.uniform(-3, 1)
        _, sigma, V = np.linalg.svd(J)
        gains = sigma * damping**2 / (sigma**2 + damping**2)
        for z in (rng.normal(size=7), V[np.argmax(gains)]):
            stack = [(J, rng.normal(size=len(J))), (np.eye(7), z)]
            change = J @ (_velocity(nsb, stack, [damping, UNDAMPED]) - _velocity(nsb, stack[:1], damping))
            leak = np.linalg.norm(change) / np.linalg.norm(z)
            assert leak <= np.max(gains) * (1 + 1e-9) + 1e-14
            assert leak <= damping / 2 + 1e-12
            tightest = max(tightest, leak / (damping / 2))
    assert tightest > 0.99


@pytest.mark.parametrize("near", [None, 1.0], ids=["constant", "selective"])
def test_augmented_damping_lets_nothing_through(near):
    for seed in range(50):
        rng = np.random.default_rng(seed)
        damping = 10 ** rng.uniform(-6, 1)
        stack = [(_rows(rng, 2, 8, least=0.001), rng.normal(size=2)) for _ in range(3)]
        stack.append((np.eye(8), rng.normal(size=8)))
        whole = _velocity(augmented, stack, damping, near)
        for k in range(1, 4):
            change = whole - _velocity(augmented, stack[:k], damping, near)
            np.testing.assert_allclose(stack[k - 1][0] @ change, 0, rtol=0, atol=LEAK)


def test_augmented_is_the_formula_with_matrices_that_numpy_inverts():
    """P from an orthogonal basis of the rows above; damping and share from singular values."""
    for rng, stack in _stacks(25, _conflicting_stack):
        maximum, near = 10 ** rng.uniform(-1, 1), 1.0
        dq, P, share, above = np.zeros(stack[0][0].shape[1]), np.eye(stack[0][0].shape[1]), 1.0, []
        for J, v in stack:
            R = J @ P @ J.T
            sigma = np.linalg.eigvalsh(R)
            s_squared = 1 / np.sum(1 / sigma) if sigma[0] > 1e-13 * max(1, sigma[-1]) else 0.0
            nearness = max(0.0, 1 - s_squared / near**2) ** 2
            dq = dq + share * P @ J.T @ np.linalg.inv(R + maximum**2 * nearness * np.eye(len(J))) @ (v - J @ dq)
            share *= 1 - nearness
            above.append(J)
            P = _null(np.vstack(above))
        np.testing.assert_allclose(
            _velocity(augmented, stack, maximum, near), dq, rtol=0, atol=1e-9 * (1 + np.linalg.norm(dq))
        )


@pytest.mark.parametrize("near", [None, 0.5], ids=["constant", "selective"])
def test_augmented_a_task_that_moves_every_joint_takes_all_that_is_left(near):
    """The shortcut for J = I, which only a Jacobian known to be the identity takes, against numpy's projector."""
    for rng, stack in _stacks(10, _regular_stack):
        n = stack[0][0].shape[1]
        wanted = rng.normal(size=n)
        above = stack[:2]
        dq = _velocity(augmented, above, UNDAMPED)
        tasks = [_Task(ca.SX(J), ca.SX(v), ConstantDamping(ca.SX(UNDAMPED))) for J, v in above]
        if near:
            tasks = [
                _Task(task.jacobian, task.velocity, NearSingularDamping(ca.SX(1e-3), ca.SX(1e-6))) for task in tasks
            ]
        last = [
            _Task(ca.SX.eye(n), ca.SX(wanted), ConstantDamping(ca.SX(0.3))),
            _Task(ca.SX(rng.normal(size=(1, n))), ca.SX(1.0), ConstantDamping(ca.SX(0.3))),  # nothing is left for it
        ]
        expected = dq + _null(np.vstack([J for J, _ in above])) @ (wanted - dq)
        np.testing.assert_allclose(
            np.array(ca.DM(augmented.combine([*tasks, *last])))[:, 0], expected, rtol=0, atol=1e-8
        )


# ---- Continuity and finiteness ----


def _greatest_jump(law, stack_at, count, damping, near):
    path = np.array([_velocity(law, stack_at(t), damping, near) for t in np.linspace(0, 1, count + 1)])
    return np.max(np.linalg.norm(np.diff(path, axis=0), axis=1))


def _through_singularity(rng):
    """The first Jacobian passes a rank-one matrix at t = 0.37; other tasks lie below it."""
    tasks = [(rng.normal(size=(2, 6)), rng.normal(size=2)) for _ in range(3)]
    at = np.outer(rng.normal(size=2), rng.normal(size=6))
    away = rng.normal(size=(2, 6))
    return lambda t: [(at + (t - 0.37) * away, tasks[0][1]), *tasks[1:]]


def _through_conflict(rng):
    """The second task's row passes through the row space of the first at t = 0.37, one task lies below."""
    tasks = [(rng.normal(size=(2, 6)), rng.normal(size=2)) for _ in range(3)]
    at = rng.normal(size=(1, 2)) @ tasks[0][0]
    away = rng.normal(size=(1, 6))
    return lambda t: [tasks[0], (at + (t - 0.37) * away, np.ones(1)), tasks[2]]


def _through_nothing(rng):
    """The first task fades to J = 0 and comes back the other way."""
    tasks = [(rng.normal(size=(1, 6)), rng.normal(size=1)) for _ in range(3)]
    return lambda t: [((t - 0.37) * tasks[0][0], tasks[0][1]), *tasks[1:]]


PATHS = [_through_singularity, _through_conflict, _through_nothing]


class _FadingAbove:
    """Augmented projection in which the first task fades in, and the others are damped near a singularity."""

    @staticmethod
    def combine(tasks):
        first = _Task(tasks[0].jacobian, tasks[0].velocity, FadingDamping(tasks[0].damping.maximum))
        return augmented.combine([first, *tasks[1:]])


def test_augmented_a_task_that_fades_in_is_continuous_where_it_begins_and_strict_where_it_is_there():
    """J = h j of a task that has just begun, h from −0.1 to 0.1: without fading the tasks below jump at h = 0."""
    rng = np.random.default_rng(0)
    j, lower = rng.normal(size=(1, 6)), [(rng.normal(size=(2, 6)), rng.normal(size=2))]

    def stack_at(t):
        return [((t - 0.5) / 5 * j, np.zeros(1)), *lower]

    coarse, fine = (_greatest_jump(_FadingAbove, stack_at, count, [1e-2, 0.3], 0.5) for count in (2000, 4000))
    assert fine <= 0.6 * coarse
    assert _greatest_jump(augmented, stack_at, 4000, [1e-2, 0.3], None) > 10 * fine  # of constant damping
    there = _velocity(_FadingAbove, [(100 * j, np.zeros(1)), *lower], [1e-2, 0.3], 0.5)
    assert np.abs(j @ there)[0] < 1e-6  # (λ/|f|)² of a velocity of about 1


@pytest.mark.parametrize("law", [nsb, augmented], ids=["nsb", "augmented"])
@pytest.mark.parametrize("path", PATHS)
def test_selectively_damped_velocity_is_lipschitz_through_singularity_and_conflict(law, path):
    """Twice as many samples halve the greatest jump; 0.6 leaves room for where the samples fall."""
    for seed in range(4):
        stack_at = path(np.random.default_rng(seed))
        coarse, fine = (_greatest_jump(law, stack_at, count, 0.3, 0.5) for count in (800, 1600))
        assert fine <= 0.6 * coarse


@pytest.mark.parametrize("law", [nsb, augmented], ids=["nsb", "augmented"])
@pytest.mark.parametrize("path", [_through_singularity, _through_nothing])
def test_without_damping_the_velocity_jumps_or_diverges_there(law, path):
    """So that the probe above can fail."""
    stack_at = path(np.random.default_rng(0))
    coarse, fine = (_greatest_jump(law, stack_at, count, UNDAMPED, None) for count in (800, 1600))
    assert fine > 0.9 * coarse


@pytest.mark.parametrize("law", [nsb, augmented], ids=["nsb", "augmented"])
@pytest.mark.parametrize("near", [None, 0.1])
@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-170, 1e-150, 1e-100, 1e-60, 1e-9, 1.0, 1e6])
def test_every_law_is_finite_whatever_the_jacobians(law, near, size):
    rng = np.random.default_rng(6)
    for other in (0.0, 1e-160, 1e-100, 1.0, 1e6):
        shared = rng.uniform(-1, 1, (1, 7))
        first, second = size * rng.uniform(-1, 1, (2, 7)), other * rng.uniform(-1, 1, (3, 7))
        for stack in (
            [first, second, second],
            [first, first, second],
            [size * np.ones((2, 1)) @ shared, other * np.ones((3, 1)) @ shared, second],
        ):
            dq = _velocity(law, [(J, np.ones(len(J))) for J in stack], 1e-3, near)
            assert np.all(np.isfinite(dq))


# ---- Cost ----


def _instructions(law, jacobians, damping=None):
    damping = damping or ConstantDamping(ca.SX.sym("a"))
    tasks = [_Task(J, ca.SX.sym("v", J.shape[0]), damping) for J in jacobians]
    dq = ca.cse(law.combine(tasks))
    return ca.Function("f", ca.symvar(dq), [dq]).n_instructions()


def test_augmented_costs_no_more_than_linear_time_in_the_joints():
    def cost(n):
        return _instructions(augmented, [ca.SX.sym("J", m, n) for m in (1, 3, 2)])

    assert cost(40) <= 2 * cost(20) <= 4 * cost(10)


def test_augmented_diagonal_first_task_costs_linear_time():
    def cost(n):
        return _instructions(augmented, [ca.diag(ca.SX.sym("h", n)), ca.SX.sym("J", 1, n)])

    assert cost(24) <= 2 * cost(12) <= 4 * cost(6)
    stored = [ca.densify(ca.diag(ca.SX.sym("h", 12))), ca.SX.sym("J", 1, 12)]
    assert _instructions(augmented, stored) == cost(12)


def test_augmented_one_level_costs_what_selectively_damped_nsb_costs_but_for_the_guard():
    """Both look at the least singular value; the last level makes no projector."""
    J, damping = ca.SX.sym("J", 3, 7), NearSingularDamping(ca.SX.sym("maximum"), ca.SX.sym("near"))
    assert _instructions(augmented, [J], damping) <= _instructions(nsb, [J], damping) + 20
