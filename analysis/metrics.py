"""What a rollout is judged by: one definition each, the same names in every table and JSON document."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import find_peaks, welch
from scipy.spatial import KDTree

from clikgen.runtime.batch import ENCOUNTER_GAP, WINDOW
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import FAR
from clikgen.runtime.simulation import Rollout

Array = NDArray[np.float64]

SETTLING = 1.0  # [s] after an encounter the motion still counts as part of it


@dataclass(frozen=True, slots=True)
class Metrics:
    """The metrics of a rollout. Norms over joints mix m/s and rad/s, in SI units."""

    switches: int
    """Changes of the active flag."""
    switch_rate: float
    """Switches per second of encounter [Hz]."""
    hf_rms: float
    """RMS of q̇ above f_h, all joints: √∫_{f ≥ f_h} PSD(q̇) df, Welch with a Hann window [rad/s, m/s]."""
    reversal_rate: float
    """Turning points of q̇ that stand out by the dead-band or more, all joints, per second [Hz]."""
    max_velocity_step: float
    """max_k ‖q̇_k − q̇_{k−1}‖ [rad/s, m/s]."""
    total_variation: float
    """Σ_k ‖q̇_k − q̇_{k−1}‖₁ [rad/s, m/s]."""
    tracking_rms: float
    """RMS of ‖r_g − f_g(q)‖ [m]; 0 without a tracking task."""
    tracking_max: float
    """Maximum of ‖r_g − f_g(q)‖ [m]."""
    final_error: float
    """‖r_g − f_g(q)‖ at the last step [m]."""
    min_clearance: float | None
    """Least distance minus influence radius [m]: negative is intrusion; None without obstacles."""
    min_distance: float | None
    """Least distance of a point of interest to an obstacle [m]; None without obstacles."""

    def as_dict(self) -> dict[str, float | None]:
        """Name -> value, in the order above."""
        return asdict(self)


def metrics(rollout: Rollout) -> Metrics:
    """All metrics of a rollout, with f_h and the dead-band of its scenario; of one that diverged, up to there.

    Raises BadInput when f_h lies above the Nyquist frequency.
    """
    rollout = rollout.before_divergence()
    settings, period = rollout.scenario.metrics, rollout.period
    steps = np.diff(rollout.dq, axis=0)
    error = np.linalg.norm(rollout.error, axis=1)
    switches = int(np.count_nonzero(np.diff(rollout.active.astype(int))))
    in_encounter = sum(end - begin for begin, end in encounters(rollout)) * period
    return Metrics(
        switches=switches,
        switch_rate=switches / in_encounter if in_encounter else 0.0,
        hf_rms=float(np.linalg.norm(hf_rms(rollout.dq, period, settings.f_h))),
        reversal_rate=reversals(rollout.dq, settings.dead_band) / (len(rollout.t) * period),
        max_velocity_step=float(np.max(np.linalg.norm(steps, axis=1), initial=0.0)),
        total_variation=float(np.sum(np.abs(steps))),
        tracking_rms=rms(error),
        tracking_max=float(np.max(error)),
        final_error=float(error[-1]),
        min_clearance=_least(rollout, "clearance"),
        min_distance=_least(rollout, "distance"),
    )


def rms(values: Array) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else 0.0


def hf_rms(velocity: Array, period: float, f_h: float) -> Array:
    """RMS of each column of `velocity` (N, n) above f_h [Hz], shape (n,).

    √∫_{f ≥ f_h} PSD df with Welch's method (Hann, segments of WINDOW). Nearly independent of the sampling time,
    as it leaves out the reference's band. Raises BadInput when f_h is above the Nyquist frequency.
    """
    if f_h >= 0.5 / period:
        raise BadInput(f"metrics.f_h: wanted less than the Nyquist frequency {0.5 / period:g} Hz, got {f_h:g}")
    segment = min(len(velocity), max(8, round(WINDOW / period)))
    frequency, density = welch(velocity, fs=1 / period, window="hann", nperseg=segment, axis=0)
    power: Array = np.sum(density[frequency >= f_h], axis=0) * (frequency[1] - frequency[0])
    return np.sqrt(power)


def reversals(velocity: Array, dead_band: float) -> int:
    """Turning points of the columns of `velocity` (N, n) whose prominence is `dead_band` or more, added up."""
    return sum(
        find_peaks(side * column, prominence=max(dead_band, 1e-12))[0].size for column in velocity.T for side in (1, -1)
    )


def encounters(rollout: Rollout) -> list[tuple[int, int]]:
    """First step and step after the last of every encounter: contacts with gaps below ENCOUNTER_GAP joined."""
    active = np.flatnonzero(rollout.active)
    if not active.size:
        return []
    breaks = np.flatnonzero(np.diff(active) * rollout.period > ENCOUNTER_GAP)
    begins, ends = active[[0, *(breaks + 1)]], active[[*breaks, -1]] + 1
    return [(int(begin), int(end)) for begin, end in zip(begins, ends, strict=True)]


def away_from_encounters(rollout: Rollout) -> NDArray[np.bool_]:
    """The steps outside every encounter and its SETTLING time, shape (N,)."""
    away = np.ones(len(rollout.t), dtype=bool)
    for begin, end in encounters(rollout):
        away[begin : end + round(SETTLING / rollout.period)] = False
    return away


def path_deviation(rollout: Rollout) -> Array:
    """Distance of the tracked frame to the commanded path, whatever the time it is due there, (N,) [m]."""
    distance, _ = KDTree(rollout.reference).query(rollout.position)
    return np.asarray(distance, dtype=np.float64)


def task_velocity(rollout: Rollout) -> Array:
    """Velocity of the tracked frame from step to step, (N − 1, m) [m/s]."""
    return np.diff(rollout.position, axis=0) / rollout.period


def hf_rms_by_joint(rollout: Rollout) -> dict[str, float]:
    """hf_rms of every joint by its name [rad/s or m/s]."""
    values = hf_rms(rollout.before_divergence().dq, rollout.period, rollout.scenario.metrics.f_h)
    return {joint.name: float(value) for joint, value in zip(rollout.manifest.joints, values, strict=True)}


def outside_limits(rollout: Rollout) -> list[str]:
    """Joints that leave their position or velocity limits, which the law of the paper does not know."""
    joints = rollout.manifest.joints
    lower, upper = rollout.manifest.limits.T
    fastest = np.array([np.inf if joint.velocity is None else joint.velocity for joint in joints])
    beyond: Sequence[bool] = np.any((rollout.q < lower) | (rollout.q > upper), axis=0) | np.any(
        np.abs(rollout.dq) > fastest, axis=0
    )
    return [joint.name for joint, is_beyond in zip(joints, beyond, strict=True) if is_beyond]


def _least(rollout: Rollout, signal: str) -> float | None:
    if signal not in rollout.signals:
        return None
    least = float(np.min(rollout.signals[signal]))
    return least if least < FAR / 2 else None
