"""The damped pseudo-inverse against numpy's factorisations."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.symbolic.least_squares import damped_pseudo_inverse_times

EPS = np.finfo(float).eps


@cache
def _compiled(m, n):
    J, v, damping = ca.SX.sym("J", m, n), ca.SX.sym("v", m), ca.SX.sym("damping")
    return ca.Function("f", [J, v, damping], [damped_pseudo_inverse_times(J, v, damping)])


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
