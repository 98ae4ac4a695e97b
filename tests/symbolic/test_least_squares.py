"""The damped pseudo-inverse and its factorisation against numpy's."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.symbolic.damping import ConstantDamping
from clikgen.symbolic.least_squares import LdlFactor, damped_pseudo_inverse_times

EPS = np.finfo(float).eps


@cache
def _compiled(m, n):
    J, v, damping = ca.SX.sym("J", m, n), ca.SX.sym("v", m), ca.SX.sym("damping")
    return ca.Function("f", [J, v, damping], [damped_pseudo_inverse_times(J, v, ConstantDamping(damping))])


def _solution(J, v, damping):
    return np.array(_compiled(*J.shape)(J, v, damping))[:, 0]


def _by_lstsq(J, v, damping):
    """min |J x − v|² + damping² |x|² by an orthogonal factorisation of the stacked system."""
    n = J.shape[1]
    return np.linalg.lstsq(np.vstack([J, damping * np.eye(n)]), np.concatenate([v, np.zeros(n)]))[0]


def _tolerance(J, v, damping):
    """What solving with the gram matrix may lose: rounding times its condition times the solution's scale."""
    sigma = np.linalg.svd(J, compute_uv=False)
    least = sigma[-1] ** 2 + damping**2
    condition = (sigma[0] ** 2 + damping**2) / least
    return 50 * EPS * condition * (sigma[0] * np.linalg.norm(v) / least + EPS)


def _tolerance_of_lstsq(v, damping):
    """What the orthogonal factorisation may lose: it rounds v and divides by singular values >= damping."""
    return 50 * EPS * np.linalg.norm(v) / damping


@st.composite
def _systems(draw, full_rank):
    m = draw(st.integers(1 if full_rank else 2, 6))
    n = draw(st.integers(m, 8))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    rank = m if full_rank else draw(st.integers(1, m - 1))
    J = rng.normal(size=(m, rank)) @ rng.normal(size=(rank, n))
    return J * 10.0 ** draw(st.integers(-3, 3)), rng.normal(size=m)


@given(_systems(full_rank=True), st.floats(-6, 1))
def test_it_is_the_damped_least_squares_solution(system, exponent):
    J, v = system
    damping = 10**exponent
    x = _solution(J, v, damping)
    atol = _tolerance(J, v, damping) + _tolerance_of_lstsq(v, damping)
    np.testing.assert_allclose(x, _by_lstsq(J, v, damping), rtol=0, atol=atol)
    explicit = J.T @ np.linalg.solve(J @ J.T + damping**2 * np.eye(len(v)), v)
    np.testing.assert_allclose(x, explicit, rtol=0, atol=_tolerance(J, v, damping))


@given(_systems(full_rank=True))
def test_without_much_damping_it_is_the_moore_penrose_inverse(system):
    J, v = system
    sigma = np.linalg.svd(J, compute_uv=False)
    damping = 1e-6 * sigma[-1]  # changes the solution by (damping/σ)² = 1e-12 of its size
    moore_penrose = np.linalg.pinv(J) @ v
    tolerance = _tolerance(J, v, damping) + 1e-12 * np.linalg.norm(v) / sigma[-1]
    np.testing.assert_allclose(_solution(J, v, damping), moore_penrose, rtol=0, atol=tolerance)


@given(_systems(full_rank=False), st.floats(-2, 1))
def test_a_rank_deficient_jacobian_gives_the_damped_solution(system, exponent):
    J, v = system
    damping = 10**exponent * np.linalg.norm(J, 2)
    atol = _tolerance(J, v, damping) + _tolerance_of_lstsq(v, damping)
    np.testing.assert_allclose(_solution(J, v, damping), _by_lstsq(J, v, damping), rtol=0, atol=atol)


@given(_systems(full_rank=False), st.floats(-12, -5))
def test_a_rank_deficient_jacobian_under_a_vanishing_damping_gives_finite_velocity(system, exponent):
    """Rounding of J Jᵀ is then larger than damping², so that a pivot could come out zero or negative."""
    J, v = system
    assert np.all(np.isfinite(_solution(J, v, 10**exponent * np.linalg.norm(J, 2))))


@given(_systems(full_rank=False), st.floats(-12, -5))
def test_the_velocity_stays_within_the_bound_that_damping_sets(system, exponent):
    """|J⁺ v| <= |v| / (2 damping), the greatest value of σ/(σ² + damping²)."""
    J, v = system
    damping = 10**exponent * np.linalg.norm(J, 2)
    x = _solution(J, v, damping)
    # ten times the bound leaves room for any rounding that deserves the name
    assert np.max(np.abs(x)) <= 10 * np.linalg.norm(v) / (2 * damping)


@pytest.mark.parametrize("m", range(1, 7))
@pytest.mark.parametrize("damping", [1e-9, 1e-6, 1.0, 1e3])
def test_a_zero_jacobian_gives_exactly_zero(m, damping):
    for n in range(m, 9):
        np.testing.assert_array_equal(_solution(np.zeros((m, n)), np.ones(m), damping), np.zeros(n))


def test_repeated_rows_share_the_velocity():
    # x solves (2 + damping²) x = 2 v along the one direction there is: by hand 2·3/(2 + 0.25)
    x = _solution(np.array([[0.0, 1.0], [0.0, 1.0]]), np.array([3.0, 3.0]), 0.5)
    np.testing.assert_allclose(x, [0, 6 / 2.25], rtol=1e-15, atol=0)


# ---- The factorisation ----


@cache
def _compiled_factor(m, k):
    A, b = ca.SX.sym("A", m, m), ca.SX.sym("b", m, k)
    factor = LdlFactor.of(A, ca.SX.zeros(m, 1))
    L = ca.SX.eye(m)
    for i, row in enumerate(factor.rows):
        for j, entry in row.items():
            L[i, j] = entry
    return ca.Function("f", [A, b], [factor.solve(b), factor.trace_of_inverse(), L, ca.vertcat(*factor.pivots)])


@pytest.mark.parametrize("m", range(1, 7))
@pytest.mark.parametrize("k", [1, 3])
def test_a_factor_solves_for_every_column_and_knows_the_trace_of_the_inverse(m, k):
    rng = np.random.default_rng(10 * m + k)
    for _ in range(20):
        Q, _ = np.linalg.qr(rng.normal(size=(m, m)))
        A = Q * rng.uniform(0.1, 10, m) @ Q.T
        b = rng.normal(size=(m, k))
        x, trace, L, d = (np.array(output) for output in _compiled_factor(m, k)(A, b))
        np.testing.assert_allclose(L * d[:, 0] @ L.T, A, rtol=0, atol=1e-14)  # rounding of entries up to 10
        np.testing.assert_allclose(x, np.linalg.solve(A, b), rtol=0, atol=1e-12)  # rounding times a condition of 100
        np.testing.assert_allclose(trace[0, 0], np.trace(np.linalg.inv(A)), rtol=1e-12)


def test_a_factor_reads_the_lower_triangle_alone():
    A, b = np.array([[4.0, np.nan], [2.0, 3.0]]), np.array([[1.0], [2.0]])
    np.testing.assert_allclose(_compiled_factor(2, 1)(A, b)[0], [[-0.125], [0.75]], rtol=1e-15)  # by hand


def test_a_pivot_is_held_at_its_least_value():
    factor = LdlFactor.of(ca.SX(ca.DM([[1, 1], [1, 1]])), ca.SX(ca.DM([0, 0.25])))
    np.testing.assert_array_equal([float(pivot) for pivot in factor.pivots], [1, 0.25])


def _instructions(expression):
    return ca.Function("f", [ca.vertcat(*ca.symvar(expression))], [expression]).n_instructions()


def test_a_diagonal_jacobian_costs_linear_time_even_when_its_zeros_are_stored():
    """A task of joint limits: twice the rows is twice the work, and a dense one of 12 rows is far more."""

    def cost(J):
        m = J.shape[0]
        return _instructions(damped_pseudo_inverse_times(J, ca.SX.sym("v", m), ConstantDamping(ca.SX.sym("a"))))

    def diagonal(m):
        return ca.diag(ca.SX.sym("j", m))

    assert diagonal(6).is_dense() is False
    assert cost(diagonal(24)) <= 2 * cost(diagonal(12)) <= 4 * cost(diagonal(6))
    assert cost(ca.densify(diagonal(12))) == cost(diagonal(12))
    assert cost(ca.SX.sym("J", 12, 12)) > 20 * cost(diagonal(12))
