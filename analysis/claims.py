"""What the paper says of its three cases, each with our figure and a verdict."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.metrics import (
    away_from_encounters,
    encounters,
    hf_rms,
    metrics,
    path_deviation,
    rms,
    task_velocity,
)
from clikgen.runtime.simulation import Rollout

Verdict = Literal["reproduced", "partly", "not reproduced"]


@dataclass(frozen=True, slots=True)
class Claim:
    """A sentence of the paper (section 6), what we measured, and whether it holds and why."""

    case: int
    claim: str
    measured: str
    verdict: Verdict
    why: str


def claims(rollouts: Mapping[int, Rollout], floor: Rollout) -> list[Claim]:
    """The claims of sections 6.1-6.3 against cases 1, 2, 3; `floor` is Case 1 without obstacles."""
    return [*_case_1(rollouts[1], floor), *_case_2(rollouts), *_case_3(rollouts)]


def _case_1(one: Rollout, floor: Rollout) -> list[Claim]:
    m, quiet = metrics(one), metrics(floor)
    task, task_quiet = _task_hf(one), _task_hf(floor)
    return [
        Claim(
            1,
            "heavy chatter in joint space (figure 6)",
            f"{m.switches} switches, {m.switch_rate:.0f} per second of encounter; "
            f"hf_rms {m.hf_rms:.3g} against {quiet.hf_rms:.2g} without obstacle",
            _verdict(m.switches >= 100 and m.hf_rms >= 10 * quiet.hf_rms, m.hf_rms >= 2 * quiet.hf_rms),
            _chatter_regime(one),
        ),
        Claim(
            1,
            "which propagates to the end effector (figures 7, 8)",
            f"hf_rms of its velocity {task:.3g} m/s against {task_quiet:.2g} m/s without obstacle",
            _verdict(task >= 10 * task_quiet, task >= 2 * task_quiet),
            "the projector switches with the joints, and the end effector moves with them",
        ),
    ]


def _case_2(rollouts: Mapping[int, Rollout]) -> list[Claim]:
    one, two = rollouts[1], rollouts[2]
    m1, m2 = metrics(one), metrics(two)
    contacts = max(1, len(encounters(two)))
    length = float(np.sum(np.linalg.norm(np.diff(two.reference, axis=0), axis=1)))
    lag, shift = _free_error(two), _free_deviation(two)
    untouched = m2.min_distance is None or m2.min_distance > 0
    return [
        Claim(
            2,
            "chatter reduced significantly, smooth joint motion (figure 9)",
            f"hf_rms {m2.hf_rms:.3g}, {m1.hf_rms / m2.hf_rms:.0f} times below Case 1",
            _verdict(m2.hf_rms <= m1.hf_rms / 5, m2.hf_rms <= m1.hf_rms / 2),
            "the filter scales every step, jumps included, by β",
        ),
        Claim(
            2,
            "no oscillation at all in the end effector (section 6.2)",
            f"{m2.switches} switches in {contacts} encounter(s); 2 each would be none",
            _verdict(m2.switches <= 2 * contacts, _task_hf(two) <= _task_hf(one) / 5),
            "a slow sawtooth is left: K_o T falls to β K_o T, but the switch in the projector stays",
        ),
        Claim(
            2,
            "does not follow the commanded path (figures 10, 11)",
            f"away from the obstacle: error {lag:.3g} m RMS, path shifted by up to {shift:.3g} m; "
            f"Case 1: {_free_error(one):.2g} m and {_free_deviation(one):.2g} m",
            _verdict(lag >= 10 * _free_error(one) and shift >= 0.02, lag >= 2 * _free_error(one)),
            f"eq. 16 slows the loop down to β K_g; the linear loop predicts {_predicted_lag(two):.3g} m RMS",
        ),
        Claim(
            2,
            "avoids the obstacle and reaches the target (section 6.2)",
            f"least distance {_or_none(m2.min_distance)} m, final error {m2.final_error:.2g} m",
            _verdict(untouched and m2.final_error <= 0.01 * length, untouched),
            "reached: within 1 % of the path's length",
        ),
    ]


def _case_3(rollouts: Mapping[int, Rollout]) -> list[Claim]:
    one, two, three = (rollouts[number] for number in (1, 2, 3))
    m1, m2, m3 = (metrics(rollout) for rollout in (one, two, three))
    contacts = max(1, len(encounters(three)))
    return [
        Claim(
            3,
            "tracking error drastically reduced (figure 13)",
            f"tracking_rms {m3.tracking_rms:.3g} m, {m2.tracking_rms / m3.tracking_rms:.1f} times below Case 2 "
            f"(Case 1: {m1.tracking_rms:.3g} m)",
            _verdict(m3.tracking_rms <= m2.tracking_rms / 2, m3.tracking_rms < m2.tracking_rms),
            "λ = 0 away from the obstacle; while λ = 1 the lag of Case 2 builds up",
        ),
        Claim(
            3,
            "follows the path very well except near the obstacle (figure 14)",
            f"away from the obstacle: error {_free_error(three):.2g} m RMS, path within {_free_deviation(three):.2g} m",
            _verdict(_free_error(three) <= 0.01, _free_error(three) <= _free_error(two) / 2),
            "there the law is Case 1's, without a filter",
        ),
        Claim(
            3,
            "no chattering at all (figures 12-14)",
            f"{m3.switches} switches in {contacts} encounter(s); hf_rms {m3.hf_rms:.3g}, "
            f"{m1.hf_rms / m3.hf_rms:.1f} times below Case 1, {m3.hf_rms / m2.hf_rms:.1f} times above Case 2",
            _verdict(m3.switches <= 2 * contacts and m3.hf_rms <= m1.hf_rms / 5, m3.hf_rms <= m1.hf_rms / 5),
            "the alternation becomes a slow sawtooth just as high: λ = 0 outside leaves the step back in, v_nT, as it "
            f"was; and q̇ jumps by up to {m3.max_velocity_step:.2g} where the filter lets go "
            f"(Case 1: {m1.max_velocity_step:.2g})",
        ),
    ]


def _verdict(holds: bool, in_part: bool) -> Verdict:
    return "reproduced" if holds else "partly" if in_part else "not reproduced"


def _task_hf(rollout: Rollout) -> float:
    """hf_rms of the tracked frame's velocity [m/s]."""
    return float(np.linalg.norm(hf_rms(task_velocity(rollout), rollout.period, rollout.scenario.metrics.f_h)))


def _free_error(rollout: Rollout) -> float:
    """RMS of ‖r_g − f_g(q)‖ away from encounters [m]."""
    return rms(np.linalg.norm(rollout.error[away_from_encounters(rollout)], axis=1))


def _free_deviation(rollout: Rollout) -> float:
    """Largest distance to the commanded path away from encounters [m]."""
    return float(np.max(path_deviation(rollout)[away_from_encounters(rollout)], initial=0.0))


def _or_none(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g}"


def _predicted_lag(rollout: Rollout) -> float:
    """RMS error away from encounters of the linear filtered loop on this reference [m].

    Reading A in task space, x⁺ = x + βT(ṙ + K_g(r − x)); behind a steady ramp its error is (1 − β)v/(β K_g).
    """
    period, cutoff = float(rollout.parameters["period"]), float(np.min(rollout.parameters["filter_cutoff"]))
    gain, beta = rollout.parameters[f"{rollout.tracked}_gain"], beta_of(cutoff, period)
    x, errors = rollout.position[0], np.empty_like(rollout.reference)
    for k, (r, dr) in enumerate(zip(rollout.reference, rollout.reference_velocity, strict=True)):
        errors[k] = r - x
        x = x + beta * period * (dr + gain @ errors[k])
    return rms(np.linalg.norm(errors[away_from_encounters(rollout)], axis=1))


def _chatter_regime(rollout: Rollout) -> str:
    """K_o T against 2, above which a point in contact alternates from sample to sample."""
    avoidance = next((task.name for task in rollout.manifest.tasks if task.kind == "obstacle_avoidance"), None)
    if avoidance is None:
        return "no obstacle avoidance"
    loop = float(rollout.parameters[f"{avoidance}_gain"]) * rollout.period
    if loop > 2:
        return f"K_o T = {loop:.3g} > 2: a point in contact goes in and out every other step"
    return f"K_o T = {loop:.3g} <= 2: a point in contact leaves slowly and falls back"
