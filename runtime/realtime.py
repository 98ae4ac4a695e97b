"""A loop at a fixed rate: absolute deadlines, counted overruns, measured latencies."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

SPIN = 2e-4  # [s] the last stretch before a deadline is waited out awake: sleeping is no more exact than this


class Clock(Protocol):
    """What the loop needs of time."""

    def now(self) -> float:
        """Seconds since some fixed moment."""

    def sleep_until(self, deadline: float) -> None:
        """Return at `deadline` [s], or at once when it has passed."""


class MonotonicClock:
    """The machine's monotonic clock."""

    def now(self) -> float:
        """Seconds since some fixed moment."""
        return time.perf_counter()

    def sleep_until(self, deadline: float) -> None:
        """Sleep until just before `deadline` [s], then wait awake."""
        time.sleep(max(0.0, deadline - self.now() - SPIN))
        while self.now() < deadline:
            pass


@dataclass(frozen=True, slots=True, eq=False)
class Timing:
    """How punctual a run was: per step the start's latency after its deadline and the work's duration [s].

    A step overran when it ended after the next step's deadline.
    """

    period: float
    latency: NDArray[np.float64]  # (steps,)
    work: NDArray[np.float64]  # (steps,)

    @property
    def overruns(self) -> int:
        """How many steps ended after the next one's deadline."""
        return int(np.sum(self.latency + self.work > self.period))

    def percentiles(self) -> dict[str, dict[str, float]]:
        """p50, p99 and the maximum of latency and work, in microseconds."""
        return {
            name: {
                "p50": float(np.percentile(seconds, 50) * 1e6),
                "p99": float(np.percentile(seconds, 99) * 1e6),
                "max": float(np.max(seconds) * 1e6),
            }
            for name, seconds in (("latency_us", self.latency), ("work_us", self.work))
        }

    def summary(self) -> str:
        """Overruns and percentiles in one line."""
        times = ", ".join(
            f"{name.removesuffix('_us')} {' / '.join(f'{value:.0f}' for value in percentiles.values())} us"
            for name, percentiles in self.percentiles().items()
        )
        return f"{self.overruns} of {len(self.work)} steps overran; p50 / p99 / max: {times}"


def run_at_fixed_rate(step: Callable[[int], None], period: float, steps: int, clock: Clock) -> Timing:
    """Call step(k) at start + k·period [s] for k = 0 .. steps−1.

    Deadlines are absolute, so lateness does not add up: after an overrun the next steps follow at once until the
    schedule is met again, and none is left out.
    """
    latency, work = np.empty(steps), np.empty(steps)
    start = clock.now()
    for k in range(steps):
        deadline = start + k * period
        clock.sleep_until(deadline)
        begun = clock.now()
        step(k)
        latency[k], work[k] = begun - deadline, clock.now() - begun
    return Timing(period, latency, work)
