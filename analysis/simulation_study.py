"""What the rollouts of a scenario show: metrics and figures of the three cases, as a part of the report."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.figures import paper_figures
from clikgen.analysis.metrics import metrics
from clikgen.analysis.plates import Columns, Plate
from clikgen.analysis.study import Study, Table
from clikgen.analysis.summary import metrics_table, simulation_document
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.simulation import Rollout


def simulation_study(controller: CompiledController, rollouts: Mapping[int, Rollout]) -> Study:
    """Metrics and figures of the three cases."""
    title, columns, rows = metrics_table(rollouts)
    measured = {number: metrics(rollout) for number, rollout in rollouts.items()}
    first = rollouts[1]
    verdicts = [
        f"Case {number}, {rollouts[number].title}: {m.switches} switches, hf_rms {m.hf_rms:.3g}, "
        f"tracking error {m.tracking_rms:.3g} m RMS"
        + ("." if m.min_clearance is None else f", intrusion of at most {max(0.0, -1e3 * m.min_clearance):.2g} mm.")
        for number, m in measured.items()
    ]
    figures = paper_figures(rollouts, controller)
    glance = "The three cases at a glance: the path, joint velocities, and half a second of contact enlarged."
    plates = [Plate("overview", glance, figures["overview"], _trajectory(rollouts))]
    plates += [
        Plate(name, f"Case {number}: {what}.", figure, _trajectory({number: rollout}))
        for number, rollout in rollouts.items()
        for kind, what in (("joints", "joint motion"), ("path", "path of the end effector"))
        for name, figure in figures.items()
        if name.endswith(f"case{number}_{kind}")
    ]
    parameters = [[name, np.array2string(value, separator=", ")] for name, value in first.parameters.items()]
    return Study(
        title="Simulation",
        verdicts=verdicts,
        tables=[Table(title, columns, rows), Table("Parameters of the step", ["name", "value"], parameters)],
        plates=plates,
        assumptions=[
            "Kinematic simulation: the robot follows the commanded joint velocity exactly (eq. 13).",
            f"hf_rms counts what lies above {first.scenario.metrics.f_h:g} Hz; reversals below "
            f"{first.scenario.metrics.dead_band:g} m/s or rad/s are not counted.",
            "The law does not know joint or velocity limits; joints that left theirs are named in the table.",
        ],
        document=simulation_document(rollouts, {}),
    )


def _trajectory(rollouts: Mapping[int, Rollout]) -> Columns:
    """Time, reference, and per case position, joint positions and velocities."""
    first = next(iter(rollouts.values()))
    columns: dict[str, NDArray[np.floating]] = {"t [s]": first.t}
    for i in range(first.reference.shape[1]):
        columns[f"reference {i} [m]"] = first.reference[:, i]
    for number, rollout in rollouts.items():
        for i in range(rollout.position.shape[1]):
            columns[f"case {number}: position {i} [m]"] = rollout.position[:, i]
        for i, joint in enumerate(rollout.manifest.joints):
            columns[f"case {number}: {joint.name} [{joint.unit}]"] = rollout.q[:-1, i]
            columns[f"case {number}: {joint.name} velocity [{joint.unit}/s]"] = rollout.dq[:, i]
    return columns
