"""`clikgen analyse filter`: the filter that a controller ships, designed in hertz and measured."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from clikgen.analysis.discrete_filter import (
    EXISTENCE_EDGE,
    beta_for,
    cutoff_of,
    designs,
    group_delay,
    magnitude,
    minus_3_db,
    noise_gain,
    phase,
)
from clikgen.analysis.filter_figures import filter_plates
from clikgen.analysis.measured_filter import MeasuredResponse, measure_response
from clikgen.analysis.study import Study, Table
from clikgen.runtime.controller import CompiledController


def filter_study(
    controller: CompiledController,
    cutoff: float | None = None,
    period: float | None = None,
    design: float | None = None,
) -> Study:
    """The filter of joint 0 at f_c = `cutoff` [Hz] and T = `period` [s], the manifest's defaults where None.

    `design` [Hz] is a wanted true −3 dB frequency, for which β and the f_c to write are given. Raises BadInput
    for values outside the manifest's limits, a design beyond the Nyquist frequency, or a planner other than `event`,
    which filters something else.
    """
    controller.manifest.check_planner("event")
    measured = [measure_response(controller, 0, cutoff, period, excitation=kind) for kind in ("noise", "swept sine")]
    beta, T = measured[0].beta, measured[0].period
    f_c, end = cutoff_of(beta, T), minus_3_db(beta)
    hertz = None if end is None else end / (2 * np.pi * T)
    gain_error, phase_error = _worst_disagreement(measured, beta)
    delay = float(group_delay(beta, np.array(0.0))) * T
    document: dict[str, Any] = {
        "controller": controller.manifest.controller,
        "spec_sha256": controller.manifest.spec_sha256,
        "period": T,
        "f_c": f_c,
        "beta": beta,
        "cutoff_hz": hertz,
        "noise_gain": noise_gain(beta),
        "delay_at_dc_s": delay,
        "largest_lag_rad": float(np.arcsin(1 - beta)),
        "designs": {one.method: one.cutoff for one in designs(f_c, T)},
        "measured_gain_error": gain_error,
        "measured_phase_error_deg": phase_error,
    }
    verdicts = [
        f"At T = {1e3 * T:g} ms, f_c = {f_c:.4g} Hz gives β = {beta:.4g}: " + _cutoff_words(f_c, hertz),
        f"It lets through {100 * noise_gain(beta):.3g} % of the power of white noise and delays slow motion by "
        f"{1e3 * delay:.3g} ms.",
        f"The compiled step agrees with the closed form within {100 * gain_error:.2g} % in gain and "
        f"{phase_error:.2g}° in phase, up to 0.8 of the Nyquist frequency.",
    ]
    tables = [Table("The filter", ["", "value"], _rows(document))]
    if design is not None:
        wanted = beta_for(design, T)
        document["design"] = {"cutoff_hz": design, "beta": wanted, "f_c": cutoff_of(wanted, T)}
        verdicts.insert(
            0,
            f"For a true cut-off of {design:g} Hz at T = {1e3 * T:g} ms take β = {wanted:.6g}: write "
            f"cutoff = {cutoff_of(wanted, T):.6g} in the spec's [filter].",
        )
    return Study(
        title=f"Filter of {controller.manifest.controller}",
        verdicts=verdicts,
        tables=tables,
        plates=filter_plates(measured),
        assumptions=[
            "The filter acts on joint positions, λ = 1 throughout; all figures are of joint 0.",
            "β is the compiled step's own: its filtered joint velocity over its unfiltered one.",
        ],
        document=document,
    )


def _worst_disagreement(measured: Sequence[MeasuredResponse], beta: float) -> tuple[float, float]:
    """Largest relative error in gain and largest error in phase [deg] up to 0.8 of Nyquist."""
    gain, angle = 0.0, 0.0
    for one in measured:
        omega = 2 * np.pi * one.frequency * one.period
        inside = omega <= 0.8 * np.pi
        ratio = one.response[inside] / (magnitude(beta, omega) * np.exp(1j * phase(beta, omega)))[inside]
        gain = max(gain, float(np.max(np.abs(np.abs(ratio) - 1))))
        angle = max(angle, float(np.max(np.abs(np.degrees(np.angle(ratio))))))
    return gain, angle


def _cutoff_words(f_c: float, hertz: float | None) -> str:
    if hertz is None:
        return f"above {EXISTENCE_EDGE:.4g}, so that the gain never falls to −3 dB."
    return f"the gain is at −3 dB at {hertz:.4g} Hz, {100 * hertz / f_c:.3g} % of f_c."


def _rows(document: Mapping[str, Any]) -> list[list[str]]:
    names = {
        "period": "T [s]",
        "f_c": "f_c [Hz], as in eq. 15",
        "beta": "β",
        "cutoff_hz": "true −3 dB frequency [Hz]",
        "noise_gain": "noise variance, out over in",
        "delay_at_dc_s": "delay of slow motion [s]",
        "largest_lag_rad": "largest phase lag [rad]",
    }
    rows = [[name, "none" if document[key] is None else f"{document[key]:.6g}"] for key, name in names.items()]
    for method, cutoff in document["designs"].items():
        rows.append([f"−3 dB of the {method} design [Hz]", "none" if cutoff is None else f"{cutoff:.6g}"])
    return rows
