"""`clikgen analyse clik`: how far the gain may go, linear and certified, predicted and measured."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.certificate import Certificate, certify
from clikgen.analysis.certificate_figures import certificate_figures
from clikgen.analysis.clik_figures import bound_curves, clik_plates
from clikgen.analysis.clik_loop import (
    READINGS,
    Loop,
    gain_bound,
    margins,
    oscillation_onset,
    pole_radius,
    ramp_lag,
)
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.measured_loop import measure_loop, measure_ramp_lag
from clikgen.analysis.plates import Plate
from clikgen.analysis.stability_map import Progress, StabilityMap, stability_map
from clikgen.analysis.study import Study, Table
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario
from clikgen.runtime.simulation import Run, prepare

PERIODS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # [s] of the table
GRID = 28  # sampling times, and gains, of the measured map


def clik_study(
    controller: CompiledController,
    scenario: Scenario,
    source: str = "scenario",
    delay: int = 0,
    servo: float = 0.0,
    progress: Progress | None = None,
) -> Study:
    """The loop of a scenario's tracking task: linear with `delay` [samples] and servo lag [s], certified, measured.

    Gains are the eigenvalues of K_g, one scalar loop each; the largest is the one that matters for stability,
    the smallest for lag. `progress` is told of the measurement, the longest part. Raises BadInput for a scenario
    that does not fit, without a tracking task, through a singular Jacobian, or with another planner than `event`.
    """
    controller.manifest.check_planner("event")
    runs = {number: prepare(controller, scenario, CASES[number], source) for number in (1, 2)}
    slowest, fastest, cutoff = _gains_and_cutoff(runs[1])
    if np.ptp(runs[1].values["filter_cutoff"]) > 0:  # A_β = βI with the least f_c, as after eq. 16
        scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, "filter_cutoff": cutoff}})
        runs = {number: prepare(controller, scenario, CASES[number], source) for number in (1, 2)}
    period = runs[1].period
    loop = Loop("A", period, beta_of(cutoff, period), delay, servo)
    document = _linear(loop, slowest, fastest, cutoff)
    for name, f_c in (("no filter", None), ("A", cutoff)):
        document["loops"][name]["ramp_lag_measured_s"] = measure_ramp_lag(controller, slowest, period, f_c)
    comparable = delay == 0 and servo == 0 and pole_radius(loop, fastest) < 1
    measured = measure_loop(controller, fastest, period, cutoff) if comparable else None
    curves = bound_curves(loop, cutoff, np.asarray(PERIODS))
    document["bound_over_period"] = {"T": list(PERIODS), **{name: k.tolist() for name, k in curves.items()}}
    certificates, singular = _certificates(controller, runs)
    found = stability_map(
        controller,
        scenario,
        np.geomspace(1e-3, 0.5, GRID).tolist(),
        np.geomspace(min(1.0, slowest / 2), 1e3, GRID).tolist(),
        bounds=certificates["no filter, along the scenario" if singular else "no filter, within the limits"].bounds,
        progress=progress,
    )
    document |= {
        "controller": controller.manifest.controller,
        "spec_sha256": controller.manifest.spec_sha256,
        "scenario": scenario.name,
        "certificates": {name: certified.as_dict() for name, certified in certificates.items()},
        "measured_boundary": {
            "no filter": [asdict(point) for point in found.boundary],
            "A": [asdict(point) for point in found.filtered_boundary],
        },
    }
    rows = [[f"{1e3 * T:g}", *(_plain(values[i]) for values in curves.values())] for i, T in enumerate(PERIODS)]
    return Study(
        title=f"CLIK loop of {scenario.name} on {controller.manifest.controller}",
        verdicts=[*_verdicts(document), *_certified_words(certificates), *singular, _measured_words(found)],
        tables=[
            _loop_table(document),
            Table("Largest stable gain [1/s]", ["T [ms]", *curves], rows),
            _certificate_table(certificates),
            _boundary_table(found),
        ],
        plates=[*clik_plates(loop, fastest, cutoff, measured), *_map_plates(found)],
        assumptions=[
            "Linear loop near a regular configuration, where J J⁺ = I: one scalar loop per eigenvalue of K_g.",
            f"Transport delay {delay} samples, first-order velocity servo with lag {1e3 * servo:g} ms; certificate "
            "and measurement have neither.",
            f"A_β = βI with the least f_c of all joints, {cutoff:g} Hz, as after eq. 16.",
            "Feedforward is the velocity of the reference at t_k.",
            "The certificate holds while no task above the tracking task acts. Bounds said to be estimates are the "
            "worst of many samples and of local searches from there; the others are closed forms.",
            "Measured: rollouts of the compiled step, obstacles left out of the tracking maps.",
        ],
        document=document,
    )


def _linear(loop: Loop, slowest: float, fastest: float, cutoff: float) -> dict[str, Any]:
    """The linear loops' part of the document."""
    return {
        "period": loop.period,
        "f_c": cutoff,
        "beta": loop.beta,
        "delay": loop.delay,
        "servo": loop.servo,
        "gain_min": slowest,
        "gain_max": fastest,
        "loops": {
            "no filter": _figures_of(replace(loop, beta=1.0), slowest, fastest),
            **{reading: _figures_of(replace(loop, reading=reading), slowest, fastest) for reading in READINGS},
        },
    }


def _certificates(controller: CompiledController, runs: Mapping[int, Run]) -> tuple[dict[str, Certificate], list[str]]:
    """Certificates with and without filter within the joint limits, and why if one cannot be.

    Along the run too where that says more: where the bounds within the limits are estimates, or J is singular.
    """
    found: dict[str, Certificate] = {}
    singular: list[str] = []
    for number, name in ((1, "no filter"), (2, "A")):
        rollout = runs[number].in_c()
        try:
            found[f"{name}, within the limits"] = certify(controller, rollout, "limits")
        except BadInput as error:
            singular = [f"No certificate within the joint limits: {error}."]
        if singular or not found[f"{name}, within the limits"].bounds.exact:
            found[f"{name}, along the scenario"] = certify(controller, rollout, "rollout")
    return found, singular


def _certificate_table(certificates: Mapping[str, Certificate]) -> Table:
    """A certificate a column, a figure a row."""

    def row(name: str, figure: Callable[[Certificate], float | None]) -> list[str]:
        values = [figure(certified) for certified in certificates.values()]
        return [name, *("none" if value is None or not np.isfinite(value) else f"{value:.4g}" for value in values)]

    rows = [
        row("σ_min of J", lambda c: c.bounds.sigma_min),
        row("L, bound of the Hessian", lambda c: c.bounds.hessian),
        ["bounds", *("closed forms" if c.bounds.exact else "estimates" for c in certificates.values())],
        row("v [m/s]", lambda c: c.motion.speed),
        row("a [m/s²]", lambda c: c.motion.acceleration),
        row("ultimate error e− [m]", lambda c: c.e_minus),
        row("from errors below e+ [m]", lambda c: c.e_plus),
        row("largest certified T [s]", lambda c: c.largest_period),
        row("largest certified K [1/s]", lambda c: c.largest_gain),
        row("T beyond any gain [s]", lambda c: c.period_limit),
    ]
    return Table("Nonlinear certificate", ["", *certificates], rows)


def _certified_words(certificates: Mapping[str, Certificate]) -> list[str]:
    words = []
    for name, certified in certificates.items():
        kind = "certified" if certified.bounds.exact else "estimated (bounds by sampling)"
        filtered = "with the filter" if name.startswith("A") else "without the filter"
        where = certified.bounds.where
        if certified.e_minus is None:
            words.append(f"{where.capitalize()}, {filtered}: no error ball is certified at this T and K.")
        else:
            words.append(
                f"{where.capitalize()}, {filtered}: the tracking error is {kind} to end below "
                f"{certified.e_minus:.3g} m; T may grow to {certified.largest_period:.3g} s "
                f"or K to {certified.largest_gain:.4g}/s."
            )
    return words


def _measured_words(found: StabilityMap) -> str:
    worst = max(abs(point.deviation) for point in (*found.boundary, *found.filtered_boundary))
    count = 2 * found.tracking.largest.size
    return (
        f"Measured with the compiled step: the stability boundary lies within {100 * worst:.2g} % of the linear bound "
        f"at {len(found.boundary)} sampling times with and without filter; tracking errors from {count} rollouts."
    )


def _boundary_table(found: StabilityMap) -> Table:
    pairs = list(zip(found.boundary, found.filtered_boundary, strict=True))[:: max(1, GRID // 8)]
    rows = [
        [
            f"{1e3 * plain.period:.4g}",
            *(text for p in (plain, filtered) for text in (_plain(p.linear), _plain(p.gain), f"{p.deviation:+.1e}")),
        ]
        for plain, filtered in pairs
    ]
    columns = ["T [ms]", "2/T", "measured", "off by", "2/(βT)", "measured", "off by"]
    return Table("Stability boundary K [1/s]: linear and measured, without and with the filter", columns, rows)


def _map_plates(found: StabilityMap) -> list[Plate]:
    """The figures of certificate_figures with their data, a row per sampling time and gain."""
    figures = certificate_figures(found)
    T, K = np.meshgrid(found.tracking.periods, found.tracking.gains, indexing="ij")
    data: dict[str, NDArray[np.floating]] = {"T [s]": T.ravel(), "K [1/s]": K.ravel()}
    for name, tracking in (("no filter", found.tracking), ("filter", found.filtered_tracking)):
        data |= {
            f"{name}: measured largest error [m]": tracking.largest.ravel(),
            f"{name}: certified e- [m]": tracking.ultimate.ravel(),
            f"{name}: certified K below [1/s]": np.repeat(tracking.certified, tracking.gains.size),
        }
    captions = {
        "stability_map": "Colour: the largest tracking error measured with the compiled step. Dots: where it stops "
        "being stable, measured. Lines: the linear bound, and below what gain the nonlinear certificate holds.",
        "tracking_error": "The largest tracking error against the sampling time, measured with the compiled step, "
        "beside the certified ball e− and the ramp lag that the filter causes.",
    }
    return [Plate(f"clik_{name}", captions[name], figure, data) for name, figure in figures.items()]


def _gains_and_cutoff(run: Run) -> tuple[float, float, float]:
    """Smallest and largest eigenvalue of K_g [1/s], and the least f_c [Hz]; raises BadInput without K_g."""
    eigenvalues = np.linalg.eigvalsh(run.values[f"{run.controller.manifest.position_task().name}_gain"])
    return float(eigenvalues[0]), float(eigenvalues[-1]), float(np.min(run.values["filter_cutoff"]))


def _figures_of(loop: Loop, slowest: float, fastest: float) -> dict[str, Any]:
    return {
        "gain_bound": gain_bound(loop),
        "oscillation_onset": oscillation_onset(loop),
        "pole_radius": max(pole_radius(loop, slowest), pole_radius(loop, fastest)),
        "ramp_lag_s": ramp_lag(loop, slowest),
        "ramp_lag_without_feedforward_s": ramp_lag(loop, slowest, feedforward=False),
        "margins": asdict(margins(loop, fastest)),
    }


def _loop_table(document: dict[str, Any]) -> Table:
    """A loop a column, a figure a row."""
    loops = document["loops"]

    def row(name: str, figure: Callable[[dict[str, Any]], float | None]) -> list[str]:
        values = [figure(loop) for loop in loops.values()]
        return [name, *("none" if value is None else f"{value:.5g}" for value in values)]

    rows = [
        row("bound on K [1/s]", lambda loop: loop["gain_bound"]),
        row("oscillates from K [1/s]", lambda loop: loop["oscillation_onset"]),
        row("largest |z|", lambda loop: loop["pole_radius"]),
        row("gain margin", lambda loop: loop["margins"]["gain"]),
        row("phase margin [rad]", lambda loop: loop["margins"]["phase"]),
        row("delay margin [samples]", lambda loop: loop["margins"]["delay"]),
        row("least |1 + L|", lambda loop: loop["margins"]["modulus"]),
        row("ramp lag [ms]", lambda loop: _milliseconds(loop["ramp_lag_s"])),
        row("measured, compiled step [ms]", lambda loop: _milliseconds(loop.get("ramp_lag_measured_s"))),
        row("without feedforward [ms]", lambda loop: 1e3 * loop["ramp_lag_without_feedforward_s"]),
    ]
    gains = f"K = {document['gain_min']:g} to {document['gain_max']:g}/s"
    title = f"Loops at T = {1e3 * document['period']:g} ms, {gains}; A, B, C: readings of eq. 16"
    return Table(title, ["", *loops], rows)


def _verdicts(document: dict[str, Any]) -> list[str]:
    plain, shipped = document["loops"]["no filter"], document["loops"]["A"]
    K = document["gain_max"]

    def stability(loop: dict[str, Any]) -> str:
        share = K / loop["gain_bound"]
        return "unstable" if share >= 1 else f"stable, at {100 * share:.3g} % of its bound {loop['gain_bound']:.4g}/s"

    lag = shipped["ramp_lag_measured_s"]
    seen = "" if lag is None else f" (measured without delay and servo: {1e3 * lag:.4g} ms)"
    return [
        f"K = {K:g}/s at T = {1e3 * document['period']:g} ms is {stability(plain)} without the filter, and "
        f"{stability(shipped)} with it.",
        f"The unfiltered loop oscillates from K = {plain['oscillation_onset']:.4g}/s on.",
        f"The filter (reading A) makes the robot follow a ramp {1e3 * shipped['ramp_lag_s']:.4g} ms late{seen}, "
        f"against {_milliseconds(plain['ramp_lag_s']):.3g} ms without: (1 − β)/(βK).",
    ]


def _milliseconds(seconds: float | None) -> float | None:
    """Rounded, so that rounding noise reads as 0."""
    return None if seconds is None else abs(round(1e3 * seconds, 6))


def _plain(value: float) -> str:
    """Four digits, or all before the point, never an exponent."""
    return f"{value:.0f}" if value >= 1e4 else f"{value:.4g}"
