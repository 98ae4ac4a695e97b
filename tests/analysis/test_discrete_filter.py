"""The filter's closed forms against its frequency response, python-control, and the compiled step."""

import control
import numpy as np
import pytest

from clikgen.analysis.discrete_filter import (
    EXISTENCE_EDGE,
    beta_for,
    beta_of,
    cutoff_of,
    designs,
    group_delay,
    magnitude,
    minus_3_db,
    noise_gain,
    phase,
    prototype,
    system,
)
from clikgen.runtime.documents import BadInput


def random_filters(count=1000, seed=0):
    """(f_c, T) over six decades of f_cT, on both sides of the existence edge."""
    draw = np.random.default_rng(seed)
    period = 10 ** draw.uniform(-4, -1, count)
    cutoff = 10 ** draw.uniform(-4, 2, count) / period
    return list(zip(cutoff, period, strict=True))


def response(beta, omega):
    """H(e^{jΩ}) from its definition, β/(1 − (1−β)e^{−jΩ})."""
    return beta / (1 - (1 - beta) * np.exp(-1j * omega))


def test_random_filters_lie_on_both_sides_of_the_existence_edge():
    betas = np.array([beta_of(*each) for each in random_filters()])
    assert np.sum(betas > EXISTENCE_EDGE) > 100
    assert np.sum(betas < EXISTENCE_EDGE) > 100


def test_magnitude_and_phase_are_those_of_the_response():
    omega = np.random.default_rng(1).uniform(0, np.pi, 1000)
    for (cutoff, period), at in zip(random_filters(), omega, strict=True):
        beta = beta_of(cutoff, period)
        h = response(beta, at)
        assert magnitude(beta, at) == pytest.approx(abs(h), rel=1e-10)
        assert phase(beta, at) == pytest.approx(np.angle(h), abs=1e-10)


def test_minus_3_db_is_where_the_response_is_half_the_power():
    for cutoff, period in random_filters():
        beta = beta_of(cutoff, period)
        end = minus_3_db(beta)
        if end is None:
            assert beta > EXISTENCE_EDGE
            assert abs(response(beta, np.pi)) ** 2 > 0.5
        else:
            # |H|² loses digits as Ω² at small β when computed from its definition; the half power is at 1e-10
            # in the logarithm of the frequency: d|H|²/dlnΩ is -1/2 there
            assert magnitude(beta, np.array(end)) ** 2 == pytest.approx(0.5, rel=1e-10)
            if beta > 1e-4:
                assert abs(response(beta, end)) ** 2 == pytest.approx(0.5, rel=1e-10)


def test_group_delay_is_the_slope_of_the_phase():
    """−dφ/dΩ by the derivative of H itself: Re(jH′/H), H′ from the definition."""
    omega = np.random.default_rng(2).uniform(0, np.pi, 1000)
    for (cutoff, period), at in zip(random_filters(), omega, strict=True):
        beta = beta_of(cutoff, period)
        a, z = 1 - beta, np.exp(1j * at)
        slope = -1j * a / z / (1 - a / z)  # d ln H/dΩ
        assert group_delay(beta, at) == pytest.approx(-slope.imag, rel=1e-10, abs=1e-10)


def test_group_delay_at_dc_is_the_time_constant():
    for cutoff, period in random_filters():
        delay = group_delay(beta_of(cutoff, period), np.array(0.0)) * period
        assert delay == pytest.approx(1 / (2 * np.pi * cutoff), rel=1e-10)


def test_noise_gain_is_the_power_of_the_impulse_response_and_the_gain_at_nyquist():
    for cutoff, period in random_filters():
        beta = beta_of(cutoff, period)
        assert noise_gain(beta) == pytest.approx(beta**2 / (1 - (1 - beta) ** 2), rel=1e-10)  # Σ β²(1−β)^{2k}
        assert noise_gain(beta) == pytest.approx(abs(response(beta, np.pi)), rel=1e-10)


def test_largest_lag_is_the_arcsine_of_the_pole():
    omega = np.linspace(0, np.pi, 200_001)
    for beta in (0.05, 0.2, 0.5, 0.9):
        assert -phase(beta, omega).min() == pytest.approx(np.arcsin(1 - beta), abs=1e-9)


def test_design_for_a_wanted_cutoff_has_it():
    for cutoff, period in random_filters():
        wanted = min(cutoff, 0.499 / period)
        beta = beta_for(wanted, period)
        assert minus_3_db(beta) == pytest.approx(2 * np.pi * wanted * period, rel=1e-9)
        assert beta_of(cutoff_of(beta, period), period) == pytest.approx(beta, rel=1e-12)


@pytest.mark.parametrize(("share", "ratio"), [(0.01, 0.970), (0.05, 0.875), (0.1, 0.792)])
def test_true_cutoff_falls_below_f_c(share, ratio):
    # the three figures that the theory prints, to their last digit
    assert minus_3_db(beta_of(share / 0.01, 0.01)) / (2 * np.pi * share) == pytest.approx(ratio, abs=5e-4)


def test_existence_edges_of_the_designs():
    def ends(share):
        return {design.method: design.cutoff for design in designs(share / 0.01, 0.01)}

    assert ends(0.767)["backward Euler"] is not None
    assert ends(0.769)["backward Euler"] is None
    assert ends(0.2804)["pole-matched"] is not None
    assert ends(0.2806)["pole-matched"] is None
    assert ends(10.0)["Tustin"] is not None


def test_every_design_is_at_half_power_at_its_cutoff():
    for share in (0.003, 0.05, 0.2, 0.5):
        for design in designs(share / 0.01, 0.01):
            if design.cutoff is not None:
                z = np.exp(2j * np.pi * design.cutoff * 0.01)
                assert abs(design.system(z)) ** 2 == pytest.approx(0.5, rel=1e-9)


def test_system_is_the_filter_as_python_control_runs_it():
    beta, period = 0.2, 0.01
    t = np.arange(50) * period
    stepped = control.step_response(system(beta, period), t).outputs
    assert stepped == pytest.approx(1 - (1 - beta) ** (np.arange(50) + 1), abs=1e-12)
    assert system(beta, period).dt == period
    assert abs(prototype(4.0)(2j * np.pi * 4.0)) == pytest.approx(np.sqrt(0.5))


@pytest.mark.parametrize(("cutoff", "period"), [(0.0, 0.01), (-1.0, 0.01), (4.0, 0.0), (4.0, -0.01), (np.nan, 0.01)])
def test_a_filter_without_sense_is_refused(cutoff, period):
    with pytest.raises(BadInput, match="wanted f_c > 0"):
        beta_of(cutoff, period)


@pytest.mark.parametrize("cutoff", [0.0, -3.0, 51.0, np.inf])
def test_a_cutoff_beyond_nyquist_cannot_be_designed(cutoff):
    with pytest.raises(BadInput, match="Nyquist frequency 50 Hz"):
        beta_for(cutoff, 0.01)


@pytest.mark.parametrize("beta", [0.0, 1.0, -0.1, 1.1])
def test_beta_outside_its_range_is_refused(beta):
    with pytest.raises(BadInput, match="β in"):
        cutoff_of(beta, 0.01)
