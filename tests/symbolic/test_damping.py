"""Constant and selective damping against numpy's singular values."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clikgen.runtime.documents import BadInput, Document
from clikgen.symbolic.damping import (
    ConstantDamping,
    DampingSpec,
    NearSingularDamping,
    SelectiveDamping,
    damping_signals,
    squared_lower_estimate,
)
from clikgen.symbolic.least_squares import damped_pseudo_inverse_times

ROUNDING_OF_S = 1e-11  # of s², for a condition of J up to 100: eps times its square, with room for m, n <= 12


@cache
def _compiled(m, n):
    """(J, v, λ₀, ε) -> s², λ², J⁺ v."""
    J, v, maximum, near = ca.SX.sym("J", m, n), ca.SX.sym("v", m), ca.SX.sym("maximum"), ca.SX.sym("near")
    damping, gram = NearSingularDamping(maximum, near), J @ J.T
    outputs = [squared_lower_estimate(gram), damping.squared(gram), damped_pseudo_inverse_times(J, v, damping)]
    return ca.Function("f", [J, v, maximum, near], outputs)


def _evaluate(J, v=0.0, maximum=1.0, near=1.0):
    s_squared, squared, dq = _compiled(*J.shape)(J, v, maximum, near)
    return float(s_squared), float(squared), np.array(dq)[:, 0]


def _with_singular_values(rng, sigma, n):
    m = len(sigma)
    U, V = (np.linalg.qr(rng.normal(size=(k, k)))[0] for k in (m, n))
    return U * sigma @ V[:, :m].T


@st.composite
def _jacobians(draw):
    m = draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = 10.0 ** draw(st.integers(-3, 3))
    return scale * _with_singular_values(rng, 10 ** rng.uniform(-2, 0, m), draw(st.integers(m, 12)))


# ---- How near to singular ----


@given(_jacobians())
def test_the_estimate_is_below_the_least_singular_value_and_not_by_more_than_root_m(J):
    s = np.sqrt(_evaluate(J)[0])
    least = np.linalg.svd(J, compute_uv=False)[-1]
    assert s <= least * (1 + ROUNDING_OF_S)
    assert least <= np.sqrt(len(J)) * s * (1 + ROUNDING_OF_S)


@given(_jacobians())
def test_the_estimate_is_the_sum_over_the_singular_values(J):
    expected = 1 / np.sum(np.linalg.svd(J, compute_uv=False) ** -2.0)
    np.testing.assert_allclose(_evaluate(J)[0], expected, rtol=ROUNDING_OF_S)


@given(_jacobians(), st.integers(1, 5), st.floats(-9, 0), st.booleans())
def test_the_estimate_vanishes_at_a_singular_jacobian(J, rank, exponent, scaled):
    """Rounding alone sees the pivot that is zero; rows of any scale, and exact or nearly exact dependence."""
    rng = np.random.default_rng(len(J))
    J = np.vstack([J, rng.normal(size=(1, len(J))) @ J])
    J = J * 10 ** rng.uniform(-6, 6, (len(J), 1)) if scaled else J
    J[rank % len(J)] *= 1 + 2.0**-52
    assert np.sqrt(_evaluate(J)[0]) <= 3e-7 * np.linalg.norm(J)
    assert _evaluate(J, near=1e-5 * np.linalg.norm(J))[1] >= 0.99  # so that the damping is there


def test_the_estimate_of_nothing_is_nothing():
    for m in range(1, 7):
        assert _evaluate(np.zeros((m, 8)))[0] <= 1e-200
        assert _evaluate(np.zeros((m, 8)), maximum=0.5, near=1e-9)[1] == 0.25


@given(_jacobians(), st.floats(0, 2 * np.pi), st.integers(0, 2**32 - 1))
def test_the_estimate_is_as_continuous_as_the_singular_values(J, angle, seed):
    """|s(J + D) − s(J)| <= |D|: 1/s is the norm of (1/σ_i), and σ_i moves by no more than |D| (Weyl)."""
    D = np.random.default_rng(seed).normal(size=J.shape)
    for size in (1e-1, 1e-3):
        step = size * np.linalg.norm(J) * np.sin(angle) * D / np.linalg.norm(D)
        before, after = (np.sqrt(_evaluate(matrix)[0]) for matrix in (J, J + step))
        # 3e-7: what rounding leaves at a singular J
        assert abs(after - before) <= np.linalg.norm(step) * (1 + 1e-9) + 3e-7 * np.linalg.norm(J)


# ---- Selective damping ----


@given(_jacobians(), st.floats(-3, 0))
def test_damping_is_exactly_zero_away_from_singularity(J, exponent):
    least = np.linalg.svd(J, compute_uv=False)[-1]
    near = least / np.sqrt(len(J)) * (1 - ROUNDING_OF_S)
    assert _evaluate(J, near=near, maximum=10**exponent)[1] == 0
    assert _evaluate(J, near=0.01 * near, maximum=10**exponent)[1] == 0


@given(_jacobians(), st.floats(1.001, 100))
def test_damping_acts_wherever_the_least_singular_value_is_below_near(J, factor):
    assert _evaluate(J, near=factor * np.linalg.svd(J, compute_uv=False)[-1])[1] > 0


@given(_jacobians(), st.floats(-3, 1), st.floats(-1, 1))
def test_damping_follows_its_formula(J, exponent, nearness):
    s_squared = 1 / np.trace(np.linalg.inv(J @ J.T))
    maximum, near = 10**exponent, np.sqrt(s_squared) * 10**nearness
    expected = maximum**2 * max(0.0, 1 - s_squared / near**2) ** 2
    slack = 4 * maximum**2 * ROUNDING_OF_S * s_squared / near**2
    np.testing.assert_allclose(_evaluate(J, maximum=maximum, near=near)[1], expected, rtol=0, atol=slack)


def test_at_a_singularity_the_velocity_stays_within_the_bound_of_the_full_damping():
    rng = np.random.default_rng(3)
    for m in range(2, 7):
        J = _with_singular_values(rng, np.array([*rng.uniform(0.5, 1, m - 1), 0.0]), 8)
        v = rng.normal(size=m)
        dq = _evaluate(J, v, maximum=0.01, near=0.1)[2]
        gram = J @ J.T + 0.01**2 * np.eye(m)
        np.testing.assert_allclose(dq, J.T @ np.linalg.solve(gram, v), rtol=0, atol=1e-9)  # s² <= 1e-13 of ε²
        assert np.linalg.norm(dq) <= np.linalg.norm(v) / (2 * 0.01)


def test_away_from_singularity_the_inverse_is_that_of_moore_and_penrose():
    rng = np.random.default_rng(4)
    J = _with_singular_values(rng, np.array([0.3, 0.5, 2.0]), 7)
    v = rng.normal(size=3)
    dq = _evaluate(J, v, maximum=1.0, near=0.17)[2]  # 0.17 < 0.3/√3
    np.testing.assert_allclose(dq, np.linalg.pinv(J) @ v, rtol=0, atol=1e-13)  # rounding, condition 44 of J Jᵀ


@pytest.mark.parametrize("n", [6, 12])
@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-170, 1e-155, 1e-150, 1e-110, 1e-100, 1e-60, 1e-9, 1.0, 1e6])
@pytest.mark.parametrize("other", [0.0, 1e-160, 1e-100, 1.0, 1e6])
def test_everything_is_finite_whatever_the_jacobian(size, other, n):
    """Zero, rank one, huge, tiny and all of these in different rows; the law's bound holds, too."""
    rng = np.random.default_rng(5)
    for m in (1, 2, 3, 6):
        rows = np.where(np.arange(m) % 2, size, other)[:, None]
        for J in (rows * rng.uniform(-1, 1, (m, n)), rows * rng.uniform(-1, 1, (1, n)), rows * np.eye(m, n)):
            s_squared, squared, dq = _evaluate(J, np.ones(m), 0.1, 0.3)
            assert np.isfinite(s_squared)
            assert 0 <= squared <= 0.1**2
            # 5.7 is the greatest σ/(σ² + λ(s)²) with σ >= s
            assert np.linalg.norm(dq) <= 6 * np.sqrt(m)


# ---- Constant damping, and what a spec says ----


def test_constant_damping_is_its_square_and_knows_of_no_singularity():
    damping = ConstantDamping(ca.SX(0.5))
    assert float(damping.squared(ca.SX.eye(2))) == 0.25
    assert float(damping.regularity(ca.SX.zeros(2, 2))) == 1


@pytest.mark.parametrize(("sigma", "share"), [(0.0, 0.0), (0.1, 1 - 0.96**2), (0.5, 1.0), (3.0, 1.0)])
def test_regularity_goes_from_nothing_at_a_singularity_to_one(sigma, share):
    """One row: s is σ itself; ε = 0.5."""
    damping = NearSingularDamping(ca.SX(2.0), ca.SX(0.5))
    assert float(damping.regularity(ca.SX(sigma**2))) == pytest.approx(share, abs=1e-12)


class _Table(Document):
    damping: DampingSpec


def test_a_spec_gives_a_number_or_a_table():
    assert _Table.parse({"damping": 0.5}, "spec").damping == 0.5
    selective = _Table.parse({"damping": {"maximum": 0.5, "near": 0.1}}, "spec").damping
    assert selective == SelectiveDamping(maximum=0.5, near=0.1)


@pytest.mark.parametrize(
    ("damping", "complaint"),
    [
        (0.0, "greater than 0, got 0.0"),
        (-1.0, "greater than 0, got -1.0"),
        ("much", "valid number, got 'much'"),
        ({"maximum": 0.1}, "near: Field required"),
        ({"maximum": 0.1, "near": 0.0}, "near: Input should be greater than 0"),
        ({"maximum": 0.1, "nera": 0.1}, "unknown key 'nera'; did you mean 'near'"),
    ],
)
def test_a_damping_that_is_not_positive_or_not_whole_is_refused_for_what_is_wrong(damping, complaint):
    with pytest.raises(BadInput, match=f"^spec: damping.*{complaint}[^\n]*$"):
        _Table.parse({"damping": damping}, "spec")


def test_a_constant_adds_one_parameter_and_a_selective_damping_two():
    constant, (value,) = damping_signals("tool", "m", 0.25)
    assert (value.info.name, value.info.default, value.info.unit) == ("tool_damping", (0.25,), "m")
    assert value.info.role == "parameter"
    assert ca.depends_on(constant.squared(ca.SX.eye(2)), value.column)

    selective, (maximum, near) = damping_signals("tool", "m", SelectiveDamping(maximum=0.5, near=0.1))
    assert (maximum.info.name, maximum.info.default) == ("tool_damping", (0.5,))
    assert (near.info.name, near.info.default) == ("tool_near_singularity", (0.1,))
    assert all((signal.info.minimum, signal.info.maximum) == (1e-9, 1e3) for signal in (value, maximum, near))
    squared = ca.Function("f", [maximum.column, near.column], [selective.squared(ca.SX(0.06**2))])
    assert float(squared(0.5, 0.1)) == pytest.approx(0.25 * (1 - 0.36) ** 2, rel=1e-14)  # by hand
