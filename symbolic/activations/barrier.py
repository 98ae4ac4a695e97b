"""The barrier: velocities are changed as little as keeps every contact from closing, all contacts at once."""

from typing import Literal

from clikgen.runtime.documents import Positive
from clikgen.symbolic.activation import ActivationSpec, Boundary, Guard
from clikgen.symbolic.signals import symbol


class Spec(ActivationSpec):
    """ḋ >= −γ (d − s) for every pair: a velocity damper (Faverjon & Tournassoud 1987), a control barrier function.

    The change of the law's velocity is the least one in the metric of `symbolic/barrier.py`. A contact engages v_n/γ
    before its boundary; sampled, it is approached without overshoot while γ T <= 1. `rate` is γ [1/s].
    """

    kind: Literal["barrier"]
    rate: Positive = 10.0

    def build(self, boundary: Boundary) -> Guard:
        """All pairs, with the rate as a parameter."""
        name = boundary.name
        rate = symbol(f"{name}_rate", (), "1/s", "γ of the barrier", "parameter", (1e-6, 1e6), self.rate)
        contacts = tuple(boundary.pairs() if boundary.pairs else boundary.contacts)
        return Guard(
            name=name,
            parameters=(*boundary.inputs, rate),
            diagnostics=boundary.diagnostics,
            contacts=contacts,
            rate=rate.expression,
        )
