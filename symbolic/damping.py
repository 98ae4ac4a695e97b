"""Damping of a task's pseudo-inverse: a constant, or none until the task comes near a singularity."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import casadi as ca
from pydantic import Discriminator, Tag

from clikgen.runtime.documents import Document, Positive
from clikgen.symbolic.least_squares import ROUNDING, LdlFactor
from clikgen.symbolic.signals import Signal, symbol

LIMITS = (1e-9, 1e3)
TINY = 1e-200  # keeps 1/0 away; its inverse and the square of that times a Jacobian's entry do not overflow


class SelectiveDamping(Document):
    """Damping that grows to `maximum` (λ₀) as the least singular value falls from about `near` (ε) to zero.

    Both are in the unit of the task's Jacobian.
    """

    maximum: Positive
    near: Positive


def _form(value: object) -> str:
    return "table" if isinstance(value, Mapping | SelectiveDamping) else "number"


# told apart by form, so that a mistake in the table is reported as one
DampingSpec = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[SelectiveDamping, Tag("table")], Discriminator(_form)
]


class Damping(ABC):
    """λ of a damped pseudo-inverse Jᵀ(J Jᵀ + λ² I)⁻¹, and how far from singular the task is."""

    @abstractmethod
    def squared(self, gram: ca.SX) -> ca.SX:
        """λ² of the inverse, a scalar in the unit of `gram` = J Jᵀ (m, m)."""

    def projector_squared(self) -> ca.SX:
        """μ² of the projector I − f fᵀ/(|f|² + μ²) that keeps lower tasks off a row f of the task: 0, a strict one."""
        return ca.SX(0)

    @abstractmethod
    def regularity(self, gram: ca.SX) -> ca.SX:
        """From 0 at a singularity to 1 where the damping does not act: the share that lower tasks get to move."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstantDamping(Damping):
    """The same λ everywhere."""

    value: ca.SX  # λ

    def squared(self, gram: ca.SX) -> ca.SX:
        """λ²."""
        return self.value**2

    def regularity(self, gram: ca.SX) -> ca.SX:
        """One: nothing is known of singularities."""
        return ca.SX(1)


@dataclass(frozen=True, slots=True, eq=False)
class FadingDamping(ConstantDamping):
    """The same λ everywhere, of a task whose rows grow from zero as it begins to act.

    Below |f| = λ such a row lets go of the tasks below as it lets go of its own velocity: the task fades in, and one
    that nothing presses any more is left again.
    """

    def projector_squared(self) -> ca.SX:
        """λ²."""
        return self.value**2


@dataclass(frozen=True, slots=True, eq=False)
class NearSingularDamping(Damping):
    """λ² = λ₀² (1 − s²/ε²)² where s < ε, else exactly 0, with s of `squared_lower_estimate`.

    After Nakamura & Hanafusa (1986), who let λ² grow so with the manipulability. Since s <= σ_min <= √m s, it
    acts surely where σ_min < ε and surely not where σ_min >= √m ε. Continuous, with its first derivative.
    """

    maximum: ca.SX  # λ₀
    near: ca.SX  # ε

    def squared(self, gram: ca.SX) -> ca.SX:
        """λ²(s)."""
        return near_singular(gram, self.maximum**2, self.near**2)

    def regularity(self, gram: ca.SX) -> ca.SX:
        """1 − λ²(s)/λ₀²."""
        return 1 - near_singular(gram, ca.SX(1), self.near**2)


def near_singular(gram: ca.SX, maximum_squared: ca.SX, near_squared: ca.SX) -> ca.SX:
    """λ₀² (1 − s²/ε²)² where s < ε, else exactly 0, from λ₀² and ε²: a scalar."""
    return maximum_squared * ca.fmax(0, 1 - squared_lower_estimate(gram) / near_squared) ** 2


def squared_lower_estimate(gram: ca.SX) -> ca.SX:
    """s² = 1/trace(A⁻¹) of A = J Jᵀ (m, m), with s <= σ_min(J) <= √m s: a scalar, continuous in J.

    Proof: trace(A⁻¹) = Σ 1/σ_i² lies between 1/σ_min² and m/σ_min². For m = 1 it is σ² itself.
    At a singular J rounding leaves s <= 3e-7 |J|_F instead of 0; J = 0 gives s <= 1e-100.
    """
    least = ROUNDING * ca.diag(gram) + TINY  # pivot i rounds off relative to the squares of row i alone
    return 1 / LdlFactor.of(gram, least).trace_of_inverse()


def damping_signals(task_name: str, unit: str, spec: DampingSpec) -> tuple[Damping, tuple[Signal, ...]]:
    """A task's damping and the run-time parameters that it adds; `unit` is that of the task's Jacobian."""
    name = f"{task_name}_damping"
    if isinstance(spec, SelectiveDamping):
        maximum = symbol(name, (), unit, "greatest damping of J⁺, at a singularity", "parameter", LIMITS, spec.maximum)
        text = "damping of J⁺ sets in where its least singular value falls below this"
        near = symbol(f"{task_name}_near_singularity", (), unit, text, "parameter", LIMITS, spec.near)
        return NearSingularDamping(maximum.expression, near.expression), (maximum, near)
    value = symbol(name, (), unit, "damping of J⁺", "parameter", LIMITS, spec)
    return ConstantDamping(value.expression), (value,)
