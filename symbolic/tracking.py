"""What the tasks that follow a reference have in common: they hold always, by a gain on an error."""

from collections.abc import Sequence

import casadi as ca

from clikgen.symbolic.damping import DampingSpec, damping_signals
from clikgen.symbolic.signals import Signal, result
from clikgen.symbolic.task import NEAR_SINGULARITY, GainSpec, Reference, Task, TaskSpec, Yield, jacobian_result


class TrackingSpec(TaskSpec):
    """q̇ = J⁺ (ẋ_d + K e), always: `gain` is K [1/s], `damping` that of J⁺ in the unit of J.

    `yields` is ε, how far a barrier lets the task go where something has to give way, its null space 1: by default 0.02
    for the first task, and ten times as much for each one below.
    """

    gain: GainSpec
    damping: DampingSpec = NEAR_SINGULARITY
    yields: Yield | None = None

    @property
    def equality(self) -> bool:
        """Tracking holds always."""
        return True

    def output(self, what: str, column: ca.SX, unit: str, description: str) -> Signal:
        """The output `<name>_<what>`, a vector (k,), of a column (k, 1)."""
        return result(f"{self.name}_{what}", column, (column.numel(),), unit, description)

    def task(
        self,
        *,
        jacobian: ca.SX,
        unit: str,
        text: str,
        gain: Signal,
        values: Sequence[Signal],
        errors: Sequence[Signal],
        feedforward: ca.SX,
        references: Sequence[Reference],
    ) -> Task:
        """J q̇ = ẋ_d + K e, with the `errors` e one below the other (m, 1) and ẋ_d the `feedforward` (m, 1).

        `jacobian` (m, n) has `unit` per joint unit and `text` as its description; a `gain` (m,) is the diagonal of K.
        """
        damping, damping_parameters = damping_signals(self.name, unit, self.damping)
        K = gain.expression
        return Task(
            name=self.name,
            jacobian=jacobian,
            error=ca.vertcat(*(error.expression for error in errors)),
            feedforward=feedforward,
            gain=ca.diag(K) if len(gain.info.shape) == 1 else K,
            damping=damping,
            parameters=(gain, *damping_parameters),
            diagnostics=(*values, *errors),
            values=tuple(values),
            jacobians=(jacobian_result(self.name, jacobian, unit, text),),
            references=tuple(references),
            yields=self.yields,
        )
