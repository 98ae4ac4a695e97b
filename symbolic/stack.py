"""What can be said of a stack of tasks before it runs: which task is singular, whatever the configuration."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from clikgen.symbolic.damping import NearSingularDamping
from clikgen.symbolic.task import Task

SAMPLES = 8  # configurations; a rank that all of them lack is lacking everywhere, with probability one


def stack_notes(tasks: Sequence[Task], velocity_map: ca.SX) -> tuple[str, ...]:
    """A line for each selectively damped task below which nothing will ever move under the law `augmented`.

    That is one whose rows, or whose rows together with those of the tasks above that hold always, are linearly
    dependent in every configuration. `tasks` are those that hold always, the highest first.
    """
    jacobians = [task.jacobian @ velocity_map for task in tasks]
    symbols = ca.symvar(ca.vertcat(*jacobians))
    function = ca.Function("jacobians", symbols, [ca.densify(J) for J in jacobians])
    rng = np.random.default_rng(0)
    draws = [[np.array(J) for J in function.call(list(rng.uniform(-1, 1, len(symbols))))] for _ in range(SAMPLES)]
    notes = []
    for k, task in enumerate(tasks[:-1]):
        if not isinstance(task.damping, NearSingularDamping):
            continue
        rows = task.jacobian.shape[0]
        alone = max(np.linalg.matrix_rank(J[k]) for J in draws)
        above = [np.vstack(J[:k]) for J in draws if k]
        left = max(np.linalg.matrix_rank(np.vstack(J[: k + 1])) for J in draws) - max(
            (np.linalg.matrix_rank(J) for J in above), default=0
        )
        if left < rows:
            why = f"has rank {alone}" if alone < rows else f"keeps {left} beside the tasks above it"
            notes.append(
                f"task '{task.name}', of {rows} rows, {why}, in any configuration: the law 'augmented' never moves "
                "what lies below; give it fewer rows, or a number as damping"
            )
    return tuple(notes)
