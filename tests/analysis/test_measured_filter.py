"""The compiled step's own filter against the closed form of eq. 15, with which it shares no code."""

import numpy as np
import pytest

from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.measured_filter import SEGMENT, measure_response, shipped_beta
from clikgen.runtime.documents import BadInput


def response(beta, omega):
    """H(e^{jΩ}) from its definition, β/(1 − (1−β)e^{−jΩ})."""
    return beta / (1 - (1 - beta) * np.exp(-1j * omega))


def test_compiled_step_ships_the_beta_of_eq_15(planar5):
    assert shipped_beta(planar5, cutoff=4.0, period=0.01) == pytest.approx([beta_of(4.0, 0.01)] * 5, rel=1e-9)


@pytest.mark.parametrize("excitation", ["noise", "swept sine"])
@pytest.mark.parametrize("cutoff", [0.5, 4.0, 40.0, 300.0])
def test_compiled_step_responds_as_the_closed_form(planar5, cutoff, excitation):
    measured = measure_response(planar5, cutoff=cutoff, excitation=excitation)
    inside = measured.frequency <= 0.8 * 0.5 / measured.period
    wanted = response(beta_of(cutoff, 0.01), 2 * np.pi * measured.frequency * measured.period)
    ratio = (measured.response / wanted)[inside]
    assert np.max(np.abs(np.abs(ratio) - 1)) < 0.01
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 1.0
    assert measured.coherence[inside].min() > 0.99


def test_too_short_a_run_is_refused(planar5):
    with pytest.raises(BadInput, match=f"too short.*{8 * SEGMENT} steps, got 1000"):
        measure_response(planar5, steps=1000)
