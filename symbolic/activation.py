"""What a one-sided task watches, and what its activation makes of it: a task, a correction or a guard."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Self

import casadi as ca

from clikgen.runtime.documents import Document
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.least_squares import LdlFactor
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import Level, Task

SINGULAR = 1e-4  # of a row's square: what keeps rows apart that say the same
OFF = 1e-30  # the share of a row that is as good as none


@dataclass(frozen=True, slots=True, eq=False)
class Boundary:
    """The contacts that a one-sided task watches.

    `contacts` are one a row; `pairs`, where given, all pairs that could close: an obstacle that is not the nearest
    one is there too. `summed` are Σ ½ x² and Σ x (−∂d/∂q) over the contacts where there is a cheaper way to them.
    """

    name: str
    unit: str  # of the distances
    contacts: tuple[Contact, ...]
    inputs: tuple[Signal, ...] = ()
    diagnostics: tuple[Signal, ...] = ()
    pairs: Callable[[], Sequence[Contact]] | None = None
    summed: tuple[ca.SX, ca.SX] | None = None

    @property
    def squared_unit(self) -> str:
        """Of the potential."""
        return ", ".join(f"{one}^2" for one in self.unit.split(", "))

    def gain(self, gain: float) -> Signal:
        """The parameter `<task>_gain`, K_o [1/s] of eq. 10: inside, a contact leaves with K_o x/2."""
        return symbol(f"{self.name}_gain", (), "1/s", "K_o (eq. 10)", "parameter", (0.0, 1e6), gain)


class ActivationSpec(Document, ABC):
    """How a one-sided task begins and ends to act; each file in `activations/` holds one kind, found by its name."""

    kind: str

    def rows(self, contacts: int) -> int:
        """How many rows the task has: one a contact."""
        return contacts

    @abstractmethod
    def build(self, boundary: Boundary) -> "Task | Correction | Guard":
        """The task as the law takes it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Correction(Level):
    """A velocity that is changed as little as it takes, and the less the less a contact counts.

    Contact i, at depth x_i = s − d (negative outside), may approach with v_i <= −K x_i/2; what exceeds that,
    r_i = max(0, v_i + K x_i/2), is taken away by the share h_i of the contact alone, row by row where there are more:
    u ← u − Jᵀ y, (J Jᵀ + diag(ν_i² (1 − h_i)/h_i)) y = r, ν_i = |j_i|.
    For one contact that is u − h j max(0, j·u + K x/2)/ν²: only motion toward the boundary is removed.
    """

    contacts: tuple[Contact, ...]
    shares: ca.SX  # h (k, 1), 0 to 1
    gain: ca.SX  # K [1/s]

    @classmethod
    def at(
        cls,
        boundary: Boundary,
        shares: ca.SX,
        gain: Signal,
        parameters: Sequence[Signal],
        states: Sequence[Signal] = (),
        outputs: Sequence[Signal] = (),
    ) -> Self:
        """The correction whose contacts count by `shares` (k, 1), which are the diagnostic `<task>_share`."""
        text = "h, the share by which each contact counts"
        share = result(f"{boundary.name}_share", shares, (shares.numel(),), "1", text)
        return cls(
            name=boundary.name,
            parameters=(*states, gain, *parameters, *boundary.inputs),
            diagnostics=(*outputs, *boundary.diagnostics, share),
            contacts=boundary.contacts,
            shares=shares,
            gain=gain.expression,
        )

    def corrected(self, u: ca.SX, velocity_map: ca.SX) -> ca.SX:
        """The velocity u (n_u, 1), q̇ = S u, with what the contacts take away."""
        contacts = [contact.moved_by(velocity_map) for contact in self.contacts]
        J = ca.vertcat(*(contact.approach for contact in contacts))
        allowed = ca.vertcat(*(c.opening - self.gain * (c.margin - c.distance) / 2 for c in contacts))
        excess = ca.fmax(0, J @ u - allowed)
        squares = ca.sum2(J**2)
        weights = squares * (SINGULAR + (1 - self.shares) / ca.fmax(self.shares, OFF)) + OFF
        return u - J.T @ LdlFactor.of(J @ J.T + ca.diag(weights), weights).solve(excess)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Guard(Level):
    """Contacts that the barrier keeps: ḋ >= −γ (d − s) for each of them."""

    contacts: tuple[Contact, ...]
    rate: ca.SX  # γ [1/s]

    def moved_by(self, velocity_map: ca.SX) -> "Guard":
        """The same in terms of the input velocity u, q̇ = S u."""
        return replace(self, contacts=tuple(contact.moved_by(velocity_map) for contact in self.contacts))
