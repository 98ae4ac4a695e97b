"""Rollouts as documents: the JSON of `clikgen simulate`, its table, and trajectories as CSV."""

import io
from collections.abc import Mapping
from typing import Any

import numpy as np

from clikgen.analysis.metrics import hf_rms_by_joint, metrics, outside_limits
from clikgen.runtime.realtime import Timing
from clikgen.runtime.simulation import Rollout

UNITS = {
    "switches": "",
    "switch_rate": "Hz",
    "hf_rms": "m/s, rad/s",
    "reversal_rate": "Hz",
    "max_velocity_step": "m/s, rad/s",
    "total_variation": "m/s, rad/s",
    "tracking_rms": "m",
    "tracking_max": "m",
    "final_error": "m",
    "min_clearance": "m",
    "min_distance": "m",
}


def simulation_document(rollouts: Mapping[int, Rollout], timings: Mapping[int, Timing]) -> dict[str, Any]:
    """What was run, with every metric of every case and, for runs in real time, how punctual they were."""
    first = next(iter(rollouts.values()))
    return {
        "scenario": first.scenario.name,
        "controller": first.manifest.controller,
        "spec_sha256": first.manifest.spec_sha256,
        "period": first.period,
        "steps": len(first.t),
        "f_h": first.scenario.metrics.f_h,
        "dead_band": first.scenario.metrics.dead_band,
        "units": UNITS,
        "cases": {
            str(number): {
                "title": rollout.title,
                **metrics(rollout).as_dict(),
                "hf_rms_by_joint": hf_rms_by_joint(rollout),
                "outside_limits": outside_limits(rollout),
                "diverged_s": rollout.diverged,
            }
            for number, rollout in rollouts.items()
        },
        "realtime": {
            str(number): {"overruns": timing.overruns, **timing.percentiles()} for number, timing in timings.items()
        },
    }


def metrics_table(rollouts: Mapping[int, Rollout]) -> tuple[str, list[str], list[list[str]]]:
    """Title, column heads and rows: a metric a row, a case a column."""
    first = next(iter(rollouts.values()))
    measured = {number: metrics(rollout).as_dict() for number, rollout in rollouts.items()}
    heads = [f"case {number}: {rollout.title}" for number, rollout in rollouts.items()]
    rows = [[name, *(_figure(measured[number][name]) for number in rollouts), unit] for name, unit in UNITS.items()]
    rows.append(["outside limits", *(", ".join(outside_limits(rollout)) or "-" for rollout in rollouts.values()), ""])
    lost = {number: rollout.diverged for number, rollout in rollouts.items()}
    if any(at is not None for at in lost.values()):
        rows.append(["diverged at", *("-" if at is None else f"{at:g}" for at in lost.values()), "s"])
    title = (
        f"{first.scenario.name} on {first.manifest.controller}: {len(first.t)} steps of {first.period:g} s, "
        f"f_h = {first.scenario.metrics.f_h:g} Hz"
    )
    return title, ["metric", *heads, "unit"], rows


def trajectory_csv(rollout: Rollout) -> str:
    """Time [s], the reference and every signal, a column per component, a row per step."""
    columns = {"t": rollout.t, f"{rollout.tracked}_reference": rollout.reference, "q": rollout.q[:-1]}
    columns |= {name: values for name, values in rollout.signals.items() if name != "q"}
    heads, blocks = [], []
    for name, values in columns.items():
        block = values.reshape(len(rollout.t), -1)
        heads += [name] if values.ndim == 1 else [f"{name}_{i}" for i in range(block.shape[1])]
        blocks.append(block)
    text = io.StringIO()
    np.savetxt(text, np.hstack(blocks), delimiter=",", header=",".join(heads), comments="", fmt="%.17g")
    return text.getvalue()


def _figure(value: float | None) -> str:
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.4g}"
