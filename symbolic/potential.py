"""Tasks that keep contacts from closing, by the potential of their depths (eqs. 8-10): in one row, or a row each."""

from collections.abc import Sequence
from typing import Literal

import casadi as ca

from clikgen.symbolic.activation import Boundary
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.damping import LIMITS, FadingDamping
from clikgen.symbolic.signals import result, symbol
from clikgen.symbolic.task import Task, jacobian_result

Combine = Literal["sum", "rows"]
"""sum: one row for all contacts, as the paper has it; where two contacts push against each other the row nearly
vanishes, and the law asks for any velocity. rows: a row for each contact, so that all of them are held at once."""


def summed(contacts: Sequence[Contact]) -> tuple[ca.SX, ca.SX]:
    """V = Σ ½ x² and ∂V/∂q = Σ x (−∂d/∂q), shape (1, n), contact by contact."""
    gradient = sum((c.depth * c.approach for c in contacts), ca.SX(1, contacts[0].approach.numel()))
    return ca.sumsqr(ca.vertcat(*(contact.depth for contact in contacts))) / 2, gradient


def potential_task(boundary: Boundary, gain: float, damping: float, combine: Combine) -> Task:
    """V = Σ ½ x² (eq. 8) to be 0 with J = ∂V/∂q = Σ x (−∂d/∂q) (eq. 9); as rows, V and J of each contact.

    J goes to zero with the depth, so below a depth of damping / |∂d/∂q| the task fades instead of switching.
    """
    name, contacts, unit = boundary.name, boundary.contacts, boundary.squared_unit
    shape: tuple[int, ...] = ()
    if combine == "sum":
        potential, J = boundary.summed or summed(contacts)
        texts = "V, sum of eq. 8", "J_o = ∂V/∂q, sum of eq. 9"
    else:
        potential, shape = ca.vertcat(*(contact.depth**2 / 2 for contact in contacts)), (len(contacts),)
        J = ca.vertcat(*(contact.depth * contact.approach for contact in contacts))
        texts = "V, eq. 8 of each contact", "J_o = ∂V/∂q, eq. 9 of each contact"
    K = boundary.gain(gain)
    constant = symbol(f"{name}_damping", (), unit, "damping of J⁺", "parameter", LIMITS, damping)
    return Task(
        name=name,
        jacobian=J,
        error=-potential,
        feedforward=ca.SX.zeros(J.shape[0]),
        gain=K.expression,
        damping=FadingDamping(constant.expression),
        parameters=(K, constant, *boundary.inputs),
        diagnostics=(result(f"{name}_potential", potential, shape, unit, texts[0]), *boundary.diagnostics),
        jacobians=(jacobian_result(name, J, unit, texts[1]),),
    )
