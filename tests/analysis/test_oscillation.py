"""Sustained oscillation is found where it is, and nowhere else."""

from types import SimpleNamespace

import numpy as np
import pytest

from clikgen.analysis.oscillation import ALLOWED, WINDOW, oscillations, turning_points

PERIOD = 0.01
T = PERIOD * np.arange(600)


def run(*velocities):
    """What `oscillations` reads of a rollout."""
    joints = [SimpleNamespace(name=f"j{i}") for i in range(len(velocities))]
    return SimpleNamespace(dq=np.stack(velocities, axis=1), period=PERIOD, manifest=SimpleNamespace(joints=joints))


SLOW = np.sin(2 * np.pi * 0.3 * T)
REST = np.zeros_like(T)


def burst(frequency, amplitude, start=2.0, end=4.0):
    return np.where((start <= T) & (end > T), amplitude * np.sin(2 * np.pi * frequency * (T - start)), 0.0)


def test_turning_points_of_a_sine_are_two_a_period():
    assert turning_points(np.sin(2 * np.pi * 2.0 * T), 0.01).size == 24  # 6 s of 2 Hz


@pytest.mark.parametrize("frequency", [4.0, 10.0, 40.0])
def test_a_burst_on_a_slow_motion_is_found_with_its_joint_and_time(frequency):
    found = oscillations(run(SLOW, SLOW + burst(frequency, 0.2)), run(SLOW, SLOW), 0.01)
    assert [one.joint for one in found] == ["j1"]
    assert found[0].start == pytest.approx(2.0, abs=0.3)
    assert found[0].end == pytest.approx(4.0, abs=WINDOW)  # the last window starts before the last turn


def test_what_stays_within_the_dead_band_is_none():
    assert oscillations(run(burst(10.0, 0.004)), run(REST), 0.01) == []


def test_what_the_free_run_does_as_well_is_none():
    assert oscillations(run(burst(10.0, 0.2)), run(burst(10.0, 0.2)), 0.01) == []


def test_braking_and_letting_go_once_is_none():
    pulse = burst(2.0, 0.3, 2.0, 3.0)  # two periods: four turning points
    assert turning_points(pulse, 0.01).size == ALLOWED
    assert oscillations(run(pulse), run(REST), 0.01) == []
    assert oscillations(run(burst(3.0, 0.3, 2.0, 3.0)), run(REST), 0.01) != []
