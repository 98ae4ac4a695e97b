"""The damping of J_o⁺ fades a contact in: the paper's law with a damping that is not small, and one-sided."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import NonNegative, Positive
from clikgen.symbolic.activation import ActivationSpec, Boundary, Correction
from clikgen.symbolic.damping import LIMITS, TINY
from clikgen.symbolic.signals import symbol


class Spec(ActivationSpec):
    """h = x²/(x² + ℓ²), ℓ = λ/ν, where x > 0: u ← u − h j max(0, v_n + K x/2)/ν², continuous in q.

    λ is the damping of the pseudo-inverse of J_o = x j. A steady approach v_n is held at the depth (2 v_n ℓ²/K)^⅓,
    without a cycle while K T h < 4/3 there. `gain` is K [1/s], `damping` λ in the unit of the distance, squared.
    """

    kind: Literal["damped"]
    gain: NonNegative = 20.0
    damping: Positive = 1e-3

    def build(self, boundary: Boundary) -> Correction:
        """The share of each contact by its depth."""
        gain, unit = boundary.gain(self.gain), boundary.squared_unit
        damping = symbol(f"{boundary.name}_damping", (), unit, "λ, damping of J_o⁺", "parameter", LIMITS, self.damping)
        shares = []
        for contact in boundary.contacts:
            squared = contact.depth**2 * ca.sumsqr(contact.approach)  # |J_o|²
            shares.append(squared / (squared + damping.expression**2 + TINY))
        return Correction.at(boundary, ca.vertcat(*shares), gain, (damping,))
