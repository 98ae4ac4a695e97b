"""Metrics against signals whose figures are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from clikgen.analysis.metrics import (
    away_from_encounters,
    encounters,
    hf_rms,
    hf_rms_by_joint,
    metrics,
    outside_limits,
    path_deviation,
    reversals,
)
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare


@pytest.fixture(scope="module")
def controller():
    return CompiledController.load("planar5")


@pytest.fixture(scope="module")
def rollout(controller):
    """Case 1 of the paper, whose signals a test may replace."""
    return prepare(controller, read_scenario(find_scenario("paper")), CASES[1]).in_c()


def with_signals(rollout, **signals):
    return replace(rollout, signals={**rollout.signals, **signals})


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01, 0.02])
def test_hf_rms_of_a_sine_above_f_h_is_its_rms_at_every_sampling_time(period):
    t = np.arange(0, 20, period)
    sine = 0.3 * np.sin(2 * np.pi * 12.0 * t)
    slow = 2.0 * np.sin(2 * np.pi * 0.4 * t)
    measured = hf_rms(np.column_stack([sine, slow, sine + slow]), period, f_h=5.0)
    # the Hann window leaks the slow sine's 1.4 RMS into the band by less than 1e-3 of it
    assert measured == pytest.approx([0.3 / np.sqrt(2), 0.0, 0.3 / np.sqrt(2)], abs=2e-3)


def test_hf_rms_of_white_noise_is_the_share_of_the_band():
    noise = np.random.default_rng(1).standard_normal((200_000, 1))
    # 50 Hz of band, 45 above f_h; 3 % for the estimate from 2,000 segments and the edge bin
    assert hf_rms(noise, 0.01, f_h=5.0)[0] == pytest.approx(np.sqrt(0.9), rel=0.03)


def test_hf_rms_of_nyquist_chatter_is_its_amplitude():
    chatter = 0.2 * np.where(np.arange(2000) % 2, 1.0, -1.0)[:, None]
    assert hf_rms(chatter, 0.01, f_h=5.0)[0] == pytest.approx(0.2, rel=1e-9)


def test_reversals_count_turning_points_beyond_the_dead_band():
    t = np.arange(0, 10, 0.01)
    wave = np.sin(2 * np.pi * 0.1 * t) + 0.004 * np.sin(2 * np.pi * 30.0 * t)
    assert reversals(wave[:, None], dead_band=0.01) == 2
    assert reversals(wave[:, None], dead_band=0.0) > 200
    assert reversals(np.ones((100, 3)), dead_band=0.0) == 0
    assert reversals(t[:, None], dead_band=0.0) == 0  # a ramp never turns


def test_switches_are_counted_per_second_of_encounter(rollout):
    active = np.zeros(len(rollout.t))
    active[100:140:2] = 1  # one encounter of 39 steps: 20 contacts, 40 switches
    active[1000:1100] = 1  # another, of 100 steps: 2 switches
    changed = with_signals(rollout, active=active)
    assert encounters(changed) == [(100, 139), (1000, 1100)]
    measured = metrics(changed)
    assert measured.switches == 42
    assert measured.switch_rate == pytest.approx(42 / 1.39)
    away = away_from_encounters(changed)
    assert away.sum() == len(rollout.t) - (39 + 100) - (100 + 100)  # each with 1 s of settling


def test_velocity_metrics_of_a_known_step(rollout):
    dq = np.zeros_like(rollout.dq)
    dq[500:, 0], dq[500:, 1] = 0.3, -0.4
    measured = metrics(with_signals(rollout, dq=dq))
    assert measured.max_velocity_step == pytest.approx(0.5)
    assert measured.total_variation == pytest.approx(0.7)


def test_tracking_metrics_of_a_known_error(rollout):
    error = np.zeros_like(rollout.error)
    error[:850] = [0.03, 0.04]
    error[-1] = [0.0, 0.01]
    measured = metrics(with_signals(rollout, tool_error=error))
    assert measured.tracking_rms == pytest.approx(np.sqrt((850 * 0.05**2 + 0.01**2) / 1700))
    assert measured.tracking_max == pytest.approx(0.05)
    assert measured.final_error == pytest.approx(0.01)


def test_clearance_agrees_with_distances_and_radii(rollout):
    distance = rollout.signals["distance"]
    clearance = distance - rollout.parameters["influence_radius"]
    measured = metrics(rollout)
    assert measured.min_clearance == pytest.approx(clearance.min(), abs=1e-15)
    assert measured.min_distance == pytest.approx(distance.min())


def test_hf_rms_by_joint_adds_up_to_hf_rms(rollout):
    by_joint = hf_rms_by_joint(rollout)
    assert list(by_joint) == ["base_x", "base_y", "base_yaw", "shoulder", "elbow"]
    assert np.linalg.norm(list(by_joint.values())) == pytest.approx(metrics(rollout).hf_rms)


def test_path_deviation_forgives_lateness_but_not_a_shift(rollout):
    late = with_signals(rollout, tool_position=np.roll(rollout.reference, 30, axis=0))
    assert path_deviation(late).max() < 1e-12
    # straight up from a path that winds by less than 45 degrees nowhere gets closer than this
    shifted = with_signals(rollout, tool_position=rollout.reference + np.array([0.0, 0.1]))
    assert 0.05 < path_deviation(shifted).max() <= 0.1 + 1e-12


def test_joint_beyond_its_limit_is_named(rollout):
    assert outside_limits(rollout) == []
    dq = rollout.dq.copy()
    dq[3, 4] = -3.1
    assert outside_limits(with_signals(rollout, dq=dq)) == ["elbow"]


def test_hf_rms_hardly_depends_on_the_sampling_time(controller):
    """The primary metric may compare runs at other sampling times: the same smooth run at T and T/2."""
    measured = []
    for period in (0.01, 0.005):
        settings = [f"period={period}", "obstacles=[]", "metrics.f_h=1.0"]
        run = prepare(controller, read_scenario(find_scenario("paper"), settings), CASES[1])
        measured.append(metrics(run.in_c()).hf_rms)
    assert measured[0] == pytest.approx(measured[1], rel=0.1)
    assert measured[0] > 0
