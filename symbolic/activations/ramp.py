"""The share of a contact grows with its depth, from nothing at the boundary to all at a depth δ."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import NonNegative, Positive
from clikgen.symbolic.activation import ActivationSpec, Boundary, Correction
from clikgen.symbolic.signals import symbol


class Spec(ActivationSpec):
    """h = min(max(x/δ, 0), 1): u ← u − h j max(0, v_n + K x/2)/ν², continuous in q.

    A steady approach v_n is held at the depth (−v_n + √(v_n² + 2 K v_n δ))/K, without a cycle while
    T √(v_n² + 2 K v_n δ) < 2 δ. `gain` is K [1/s], `width` δ in the unit of the distance.
    """

    kind: Literal["ramp"]
    gain: NonNegative = 20.0
    width: Positive = 0.01

    def build(self, boundary: Boundary) -> Correction:
        """The share of each contact by its depth."""
        gain = boundary.gain(self.gain)
        text = "δ, the depth from which a contact counts in full"
        width = symbol(f"{boundary.name}_width", (), boundary.unit, text, "parameter", (1e-9, 1e3), self.width)
        shares = [ca.fmin(ca.fmax((c.margin - c.distance) / width.expression, 0), 1) for c in boundary.contacts]
        return Correction.at(boundary, ca.vertcat(*shares), gain, (width,))
