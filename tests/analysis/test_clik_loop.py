"""Linear loops: bounds from both sides, closed forms, python-control, and the compiled step."""

import warnings

import control
import numpy as np
import pytest

from clikgen.analysis.clik_loop import (
    READINGS,
    Loop,
    closed_loop,
    gain_bound,
    margins,
    open_loop,
    oscillation_onset,
    pole_radius,
    ramp_lag,
)
from clikgen.runtime.documents import BadInput

T = 0.01
SERVOS = (0.0, 0.05, 0.2, 1.0, 5.0, 20.0)  # τ/T
BETAS = (0.05, 0.2, 0.6, 0.9, 1.0)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("delay", range(6))
def test_bound_separates_stable_from_unstable(reading, delay):
    for servo in SERVOS:
        for beta in BETAS:
            loop = Loop(reading, T, beta, delay, servo * T)
            bound = gain_bound(loop)
            assert pole_radius(loop, 0.999 * bound) < 1 < pole_radius(loop, 1.001 * bound)
            below = [pole_radius(loop, share * bound) for share in np.linspace(0.02, 0.98, 25)]
            assert max(below) < 1  # no window of instability below it


def test_bound_of_the_plain_loop_is_2_over_T_although_python_control_sees_none():
    loop = Loop("A", T)
    assert gain_bound(loop) == pytest.approx(2 / T, rel=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gain_margin = control.margin(open_loop(loop, 1.0))[0]
    assert gain_margin == np.inf
    assert margins(loop, 50.0).gain == pytest.approx(2 / T / 50, rel=1e-12)


@pytest.mark.parametrize("beta", BETAS)
def test_bounds_of_the_three_readings(beta):
    assert gain_bound(Loop("A", T, beta)) * T == pytest.approx(2 / beta, rel=1e-9)
    assert gain_bound(Loop("B", T, beta)) * T == pytest.approx(2, rel=1e-9)
    assert gain_bound(Loop("C", T, beta)) * T == pytest.approx(2 * (2 - beta) / beta, rel=1e-9)


@pytest.mark.parametrize("delay", range(6))
def test_bounds_with_delay(delay):
    loop = Loop("A", T, delay=delay)
    assert gain_bound(loop) * T == pytest.approx(2 * np.sin(np.pi / (2 * (2 * delay + 1))), rel=1e-9)
    onset = oscillation_onset(loop)
    assert onset * T == pytest.approx(delay**delay / (delay + 1) ** (delay + 1), rel=1e-9)


@pytest.mark.parametrize(("lag", "bound"), [(0.05, 2.22), (0.2, 3.30), (1.0, 2.39), (20.0, 2.02)])
def test_bounds_with_a_servo(lag, bound):
    assert gain_bound(Loop("A", T, servo=lag * T)) * T == pytest.approx(bound, abs=5e-3)


@pytest.mark.parametrize("reading", READINGS)
def test_bound_only_shrinks_as_delay_grows(reading):
    bounds = [gain_bound(Loop(reading, T, 0.3, delay)) for delay in range(6)]
    assert bounds == sorted(bounds, reverse=True)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("feedforward", [True, False])
@pytest.mark.parametrize(("delay", "servo"), [(0, 0.0), (2, 0.0), (0, 0.5), (3, 2.0)])
def test_closed_loop_is_the_loop_run_sample_by_sample(reading, feedforward, delay, servo):
    """The transfer function against the recursion it stands for, written out."""
    beta, gain, steps = 0.3, 5.0, 400
    loop = Loop(reading, T, beta, delay, servo * T)
    reference = np.random.default_rng(3).standard_normal(steps + 1).cumsum() * 0.01
    reference[0] = 0.0
    system = closed_loop(loop, gain, feedforward=feedforward)
    predicted = control.forced_response(system, T * np.arange(steps), reference[:steps]).outputs
    simulated = run_by_hand(loop, gain, reference, feedforward)
    assert predicted == pytest.approx(simulated, abs=1e-9)


def run_by_hand(loop, gain, reference, feedforward):
    steps = len(reference) - 1
    raw = velocity = filtered = 0.0
    pipeline = [0.0] * loop.delay
    out = []
    decay = np.exp(-loop.period / loop.servo) if loop.servo else 0.0
    for k in range(steps):
        # what the paper's filter makes of the raw position at k
        filtered = loop.beta * raw + (1 - loop.beta) * filtered
        out.append(raw if loop.reading == "A" else filtered)
        measured = filtered if loop.reading == "C" else raw
        command = gain * (reference[k] - measured)
        if feedforward:
            command += (reference[k + 1] - reference[k]) / loop.period
        pipeline.append(command)
        command = pipeline.pop(0)
        if loop.reading == "A":
            command *= loop.beta
        if loop.servo:  # exact over one period of a constant command
            raw += loop.servo * (1 - decay) * (velocity - command) + loop.period * command
            velocity = command + (velocity - command) * decay
        else:
            raw += loop.period * command
    return np.array(out)


@pytest.mark.parametrize("beta", [0.05, 0.3, 0.9])
def test_ramp_lags_of_the_three_readings(beta):
    gain = 4.0
    f_c = beta / (1 - beta) / (2 * np.pi * T)
    assert ramp_lag(Loop("A", T, beta), gain) == pytest.approx(1 / (2 * np.pi * f_c * gain * T), rel=1e-9)
    assert ramp_lag(Loop("B", T, beta), gain) == pytest.approx(1 / (2 * np.pi * f_c), rel=1e-9)
    assert ramp_lag(Loop("C", T, beta), gain) == pytest.approx(0, abs=1e-12)
    assert ramp_lag(Loop("A", T), gain, feedforward=False) == pytest.approx(1 / gain, rel=1e-9)


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_margins_agree_with_the_loop_they_are_margins_of(reading, delay):
    loop, gain = Loop(reading, T, 0.4, delay, 0.7 * T), 20.0
    found = margins(loop, gain)
    assert found.gain * gain == pytest.approx(gain_bound(loop), rel=1e-9)
    omega = np.linspace(1e-4, np.pi, 100_000)
    response = open_loop(loop, gain)(np.exp(1j * omega))
    assert found.modulus == pytest.approx(np.min(np.abs(1 + response)), rel=1e-3)
    crossing = np.argmin(np.abs(np.abs(response) - 1))
    assert found.phase == pytest.approx(np.angle(-response[crossing]), abs=1e-3)
    # one sample more of delay than the margin breaks the loop, one less does not
    assert found.delay is not None
    for extra, stable in ((int(np.floor(found.delay)), True), (int(np.ceil(found.delay)), False)):
        delayed = Loop(reading, T, 0.4, delay + extra, 0.7 * T)
        assert (pole_radius(delayed, gain) < 1) is stable


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"reading": "D"}, "A, B, C"),
        ({"period": 0.0}, "T > 0"),
        ({"period": -0.01}, "T > 0"),
        ({"beta": 0.0}, "β in"),
        ({"beta": 1.5}, "β in"),
        ({"delay": -1}, "delay"),
        ({"servo": -0.1}, "τ"),
    ],
)
def test_a_loop_without_sense_is_refused(wrong, said):
    with pytest.raises(BadInput, match=said):
        Loop(**({"reading": "A", "period": T} | wrong))
