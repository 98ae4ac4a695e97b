"""`clikgen analyse clik`: how far the gain may go, linear and certified, predicted and measured."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

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
from clikgen.analysis.study import Study, Table
from clikgen.runtime.documents import BadInput
from clikgen.runtime.simulation import Run

PERIODS = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # [s] of the table


def clik_study(run: Run, delay: int = 0, servo: float = 0.0) -> Study:
    """The linear loop of a run's tracking task with `delay` [samples] of transport and servo lag [s].

    Gains are the eigenvalues of K_g, one scalar loop each; the largest is the one that matters for stability,
    the smallest for lag. Raises BadInput for a run without a tracking task.
    """
    slowest, fastest, cutoff = _gains_and_cutoff(run)
    loop = Loop("A", run.period, beta_of(cutoff, run.period), delay, servo)
    plain = replace(loop, beta=1.0)
    document: dict[str, Any] = {
        "controller": run.controller.manifest.controller,
        "spec_sha256": run.controller.manifest.spec_sha256,
        "scenario": run.scenario.name,
        "period": run.period,
        "f_c": cutoff,
        "beta": loop.beta,
        "delay": delay,
        "servo": servo,
        "gain_min": slowest,
        "gain_max": fastest,
        "loops": {
            "no filter": _figures_of(plain, slowest, fastest),
            **{reading: _figures_of(replace(loop, reading=reading), slowest, fastest) for reading in READINGS},
        },
    }
    curves = bound_curves(loop, cutoff, np.asarray(PERIODS))
    document["bound_over_period"] = {
        "T": list(PERIODS),
        **{name: list(map(float, k)) for name, k in curves.items()},
    }
    rows = [[f"{1e3 * T:g}", *(_plain(values[i]) for values in curves.values())] for i, T in enumerate(PERIODS)]
    return Study(
        title=f"CLIK loop of {run.scenario.name} on {run.controller.manifest.controller}",
        verdicts=_verdicts(document),
        tables=[_loop_table(document), Table("Largest stable gain [1/s]", ["T [ms]", *curves], rows)],
        plates=clik_plates(loop, fastest, cutoff),
        assumptions=[
            "Linear loop near a regular configuration, where J J⁺ = I: one scalar loop per eigenvalue of K_g.",
            f"Transport delay {delay} samples, first-order velocity servo with lag {1e3 * servo:g} ms.",
            "The least f_c of all joints; feedforward is the exact velocity of the reference.",
        ],
        document=document,
    )


def _gains_and_cutoff(run: Run) -> tuple[float, float, float]:
    """Smallest and largest eigenvalue of K_g [1/s], and the least f_c [Hz]."""
    tracked = next(iter(run.scenario.references), None)
    if tracked is None:
        raise BadInput(f"{run.scenario.name}: no tracking task to analyse the loop of")
    eigenvalues = np.linalg.eigvalsh(run.values[f"{tracked}_gain"])
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
        row("ramp lag [ms]", lambda loop: abs(round(1e3 * loop["ramp_lag_s"], 9))),
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
        return (
            "unstable" if share >= 1 else f"stable, at {100 * share:.3g} % of its bound {loop['gain_bound']:.4g}/s"
        )

    return [
        f"K = {K:g}/s at T = {1e3 * document['period']:g} ms is {stability(plain)} without the filter, and "
        f"{stability(shipped)} with it.",
        f"The unfiltered loop oscillates from K = {plain['oscillation_onset']:.4g}/s on.",
        f"The filter (reading A) makes the robot follow a ramp {1e3 * shipped['ramp_lag_s']:.4g} ms late, against "
        f"{abs(round(1e3 * plain['ramp_lag_s'], 6)):.3g} ms without: (1 − β)/(βK).",
    ]


def _plain(value: float) -> str:
    """Four digits, or all before the point, never an exponent."""
    return f"{value:.0f}" if value >= 1e4 else f"{value:.4g}"
