"""Sustained oscillation: joints that turn around again and again although nothing asks for it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks

from clikgen.runtime.simulation import Rollout

Array = NDArray[np.floating]

WINDOW = 1.0
"""[s] in which turning points are counted."""
ALLOWED = 4
"""Turning points in a window beyond those of the free run: two points may meet an obstacle within it, each of which
makes a joint brake and let go. What turns more often, for a whole window, oscillates at 2 Hz or more."""


@dataclass(frozen=True, slots=True)
class Oscillation:
    """A joint that turned around `reversals` times from `start` to `end` [s], where the free run turned `free` times.

    The figures are those of its busiest window; `start` and `end` are the first and the last of all such windows.
    """

    joint: str
    start: float
    end: float
    reversals: int
    free: int


def oscillations(rollout: Rollout, free: Rollout, dead_band: float) -> list[Oscillation]:
    """The joints of a rollout that oscillate, against the same run `free` of all one-sided tasks.

    A joint oscillates where its velocity has more turning points, of prominence `dead_band` [unit/s] or more, within a
    WINDOW than the free run within the same window and one on either side of it, by more than ALLOWED.
    """
    found = []
    for i, joint in enumerate(rollout.manifest.joints):
        turns, wanted = (turning_points(run.dq[:, i], dead_band) * run.period for run in (rollout, free))
        busy = _busy(turns, wanted)
        if busy:
            _, count, asked = max(busy, key=lambda window: window[1] - window[2])
            found.append(Oscillation(joint.name, busy[0][0], busy[-1][0] + WINDOW, count, asked))
    return found


def turning_points(velocity: Array, dead_band: float) -> NDArray[np.int_]:
    """The samples at which a velocity (N,) turns around, by `dead_band` or more, in order."""
    ends = [find_peaks(side * velocity, prominence=max(dead_band, 1e-12))[0] for side in (1, -1)]
    return np.sort(np.concatenate(ends))


def _busy(turns: Array, wanted: Array) -> Sequence[tuple[float, int, int]]:
    """Start, turning points and those of the free run, of every window that begins at a turn and has too many."""
    windows = []
    for start in turns:
        count = int(np.count_nonzero((turns >= start) & (turns < start + WINDOW)))
        asked = int(np.count_nonzero((wanted >= start - WINDOW) & (wanted < start + 2 * WINDOW)))
        if count > asked + ALLOWED:
            windows.append((float(start), count, asked))
    return windows
