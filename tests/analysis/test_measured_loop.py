"""The compiled loop's response and ramp lag against the linear loop, which shares no code with the step."""

import numpy as np
import pytest

from clikgen.analysis.clik_loop import Loop, closed_loop, ramp_lag
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.measured_loop import measure_loop, measure_ramp_lag
from clikgen.runtime.documents import BadInput

TUNINGS = [(4.0, 0.01, None), (4.0, 0.01, 4.0), (30.0, 0.01, 10.0), (10.0, 0.02, 2.0)]  # K, T, f_c


def loop_of(period, cutoff):
    return Loop("A", period, 1.0 if cutoff is None else beta_of(cutoff, period))


@pytest.mark.parametrize(("gain", "period", "cutoff"), TUNINGS)
def test_compiled_loop_responds_as_the_linear_one(gain, period, cutoff, planar5):
    measured = measure_loop(planar5, gain, period, cutoff)
    z = np.exp(2j * np.pi * measured.frequency * period)
    ratio = measured.response / closed_loop(loop_of(period, cutoff), gain)(z)
    assert np.max(np.abs(np.abs(ratio) - 1)) < 0.01
    assert np.max(np.abs(np.degrees(np.angle(ratio)))) < 1


@pytest.mark.parametrize(("gain", "period", "cutoff"), TUNINGS)
def test_measured_ramp_lag_is_the_predicted_one(gain, period, cutoff, planar5):
    predicted = ramp_lag(loop_of(period, cutoff), gain)
    # 2 %: the robot leaves its configuration by a millimetre; 1e-5 s where the prediction is none
    assert measure_ramp_lag(planar5, gain, period, cutoff) == pytest.approx(predicted, rel=0.02, abs=1e-5)


def test_a_loop_that_takes_too_long_or_diverges_has_no_measured_lag(planar5):
    assert measure_ramp_lag(planar5, 1e-3, 1e-5, 1.0) is None
    assert measure_ramp_lag(planar5, 300.0, 0.01, None) is None


@pytest.mark.parametrize(
    ("gain", "period", "cutoff", "said"),
    [(0.0, 0.01, 4.0, "gain"), (4.0, 0.0, 4.0, "period"), (4.0, 0.01, -1, "cutoff")],
)
def test_values_without_sense_are_refused(gain, period, cutoff, said, planar5):
    for measure in (measure_loop, measure_ramp_lag):
        with pytest.raises(BadInput, match=said):
            measure(planar5, gain, period, cutoff)
