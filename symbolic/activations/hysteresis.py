"""A contact counts from the moment its boundary is reached until it is left by a width."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import NonNegative, Positive
from clikgen.symbolic.activation import ActivationSpec, Boundary, Correction
from clikgen.symbolic.signals import result, symbol


class Spec(ActivationSpec):
    """h = 1 from x >= 0 until x < −w: u ← u − h j max(0, v_n + K x/2)/ν², with one jump each way.

    Between, the contact settles where the drift c of a sample (the curvature of its boundary) meets K T x/2 = −c, so
    it does not cycle while w > x_f = 2 c/(K T). `gain` is K [1/s], `width` w in the unit of the distance.
    """

    kind: Literal["hysteresis"]
    gain: NonNegative = 20.0
    width: Positive = 0.01

    def build(self, boundary: Boundary) -> Correction:
        """The share of each contact by its depth and by whether it counted before."""
        name, count = boundary.name, len(boundary.contacts)
        gain = boundary.gain(self.gain)
        text = "w, how far a contact is left before it counts no more"
        width = symbol(f"{name}_width", (), boundary.unit, text, "parameter", (0.0, 1e3), self.width)
        before = symbol(f"{name}_held", (count,), "1", "1 for each contact that counts", "state", (0.0, 1.0))
        shares = ca.vertcat(
            *(
                ca.logic_or(c.inside, ca.logic_and(before.column[i] > 0.5, c.distance <= c.margin + width.expression))
                for i, c in enumerate(boundary.contacts)
            )
        )
        after = result(
            f"{name}_held_next", shares, (count,), "1", "1 for each contact that counts", "state", f"{name}_held"
        )
        return Correction.at(boundary, shares, gain, (width,), states=(before,), outputs=(after,))
