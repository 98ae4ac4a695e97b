"""What keeps a distance: a pair of things that a one-sided task watches."""

from dataclasses import dataclass, field
from typing import Self

import casadi as ca


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Two things at distance d that want s between them: ḋ = −approach q̇ + opening."""

    distance: ca.SX  # scalar [m, or the unit of a joint]
    margin: ca.SX  # scalar, s
    approach: ca.SX  # (1, n), −∂d/∂q: how fast the two approach each other
    opening: ca.SX = field(default_factory=lambda: ca.SX(0))  # scalar, ∂d/∂t: what moves by itself

    @property
    def inside(self) -> ca.SX:
        """1 where d <= s."""
        return self.distance <= self.margin

    @property
    def depth(self) -> ca.SX:
        """x = s − d where positive, else 0."""
        return ca.fmax(self.margin - self.distance, 0)

    def moved_by(self, velocity_map: ca.SX) -> Self:
        """The contact in terms of the input velocity u, q̇ = S u."""
        return type(self)(self.distance, self.margin, self.approach @ velocity_map, self.opening)
