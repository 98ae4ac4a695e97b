"""The fixed-rate loop on clocks that the test controls."""

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from clikgen.runtime.realtime import MonotonicClock, Timing, run_at_fixed_rate

PERIOD = 0.125  # [s] a power of two, so that deadlines are exact


@dataclass
class FakeClock:
    """Time passes only by sleeping, always `oversleep` [s] too long, and by work()."""

    time: float = 1000.0
    oversleep: float = 0.0
    deadlines: list[float] = field(default_factory=list)

    def now(self):
        return self.time

    def sleep_until(self, deadline):
        self.deadlines.append(deadline)
        if deadline > self.time:
            self.time = deadline + self.oversleep

    def work(self, seconds):
        self.time += seconds


def _run(clock, durations):
    """When each step began, and the timing of steps that take `durations` [s]."""
    begun = []

    def step(k):
        begun.append(clock.now())
        assert k == len(begun) - 1
        clock.work(durations[k])

    timing = run_at_fixed_rate(step, PERIOD, len(durations), clock)
    return np.array(begun) - 1000.0, timing


def test_steps_begin_at_multiples_of_the_period():
    begun, timing = _run(FakeClock(), [0.03] * 50)
    np.testing.assert_array_equal(begun, PERIOD * np.arange(50))
    np.testing.assert_array_equal(timing.latency, np.zeros(50))
    # differences of times near 1000 s, rounded to 1e-13 s
    np.testing.assert_allclose(timing.work, 0.03, rtol=0, atol=5e-13)
    assert timing.overruns == 0
    assert timing.period == PERIOD


def test_lateness_does_not_accumulate():
    oversleep = 1 / 64
    clock = FakeClock(oversleep=oversleep)
    begun, timing = _run(clock, [1 / 32] * 1000)
    np.testing.assert_array_equal(clock.deadlines, 1000.0 + PERIOD * np.arange(1000))
    # the first deadline is already there, so nothing is slept; the last step is as late as the second
    np.testing.assert_array_equal(begun[1:], PERIOD * np.arange(1, 1000) + oversleep)
    np.testing.assert_array_equal(timing.latency, [0.0] + [oversleep] * 999)
    assert timing.overruns == 0


def test_after_an_overrun_the_schedule_is_met_again_and_no_step_is_left_out():
    durations = [1 / 64] * 20
    durations[5] = 3.25 * PERIOD  # ends 2.25 periods after the next deadline
    begun, timing = _run(FakeClock(), durations)
    assert len(begun) == 20
    late = begun - PERIOD * np.arange(20)
    np.testing.assert_array_equal(late > 0, [6 <= k <= 8 for k in range(20)])
    # steps 6, 7, 8 follow at once, each 1/64 s after the one before, until step 9 is on time again
    np.testing.assert_array_equal(begun[6:9], begun[5] + 3.25 * PERIOD + np.arange(3) / 64)
    np.testing.assert_array_equal(timing.latency, late)


def test_a_step_overruns_when_it_ends_after_the_next_deadline():
    durations = np.full(10, PERIOD)  # ends exactly at the next deadline: in time
    assert _run(FakeClock(), durations)[1].overruns == 0
    durations[3] = PERIOD + 1 / 1024  # late, and with full periods after it there is no time to catch up
    assert _run(FakeClock(), durations)[1].overruns == 7
    durations[4] = PERIOD / 2  # catches up at once
    assert _run(FakeClock(), durations)[1].overruns == 1


def test_latency_counts_toward_an_overrun():
    timing = Timing(PERIOD, latency=np.array([0.0, 0.1, 0.1]), work=np.array([0.1, 0.02, 0.1]))
    assert timing.overruns == 1


def test_percentiles_are_in_microseconds():
    timing = Timing(PERIOD, latency=np.arange(101) * 1e-6, work=np.arange(101)[::-1] * 2e-6)
    expected = {"latency_us": (50, 99, 100), "work_us": (100, 198, 200)}
    percentiles = timing.percentiles()
    assert percentiles.keys() == expected.keys()
    for name, values in expected.items():
        # seconds to microseconds, two roundings
        assert percentiles[name] == pytest.approx(dict(zip(("p50", "p99", "max"), values, strict=True)), rel=1e-14)


def test_an_exception_in_a_step_ends_the_loop():
    clock = FakeClock()
    calls = []

    def step(k):
        calls.append(k)
        if k == 3:
            raise RuntimeError("the robot is gone")

    with pytest.raises(RuntimeError, match="the robot is gone"):
        run_at_fixed_rate(step, PERIOD, 10, clock)
    assert calls == [0, 1, 2, 3]


def test_the_monotonic_clock_never_returns_before_the_deadline():
    clock = MonotonicClock()
    for ahead in (0.0, 1e-5, 1e-4, 5e-4, 2e-3, 5e-3):
        deadline = clock.now() + ahead
        clock.sleep_until(deadline)
        assert clock.now() >= deadline


def test_the_monotonic_clock_lets_a_past_deadline_pass_at_once(monkeypatch):
    slept = []
    monkeypatch.setattr(time, "sleep", slept.append)
    clock = MonotonicClock()
    clock.sleep_until(clock.now() - 10.0)
    assert slept == [0.0]


def test_the_monotonic_clock_sleeps_most_of_the_way(monkeypatch):
    """To wait awake alone would take a whole core."""
    slept = []
    nap = time.sleep

    def sleep(seconds):
        slept.append(seconds)
        nap(seconds)

    monkeypatch.setattr(time, "sleep", sleep)
    clock = MonotonicClock()
    clock.sleep_until(clock.now() + 0.02)
    # less a stretch of 0.2 ms awake, and what the call itself takes on a busy machine
    assert 0.01 < sum(slept) <= 0.02
