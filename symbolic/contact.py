"""What keeps a distance: a pair of things that a one-sided task watches."""

from dataclasses import dataclass
from typing import Self

import casadi as ca


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Two things at distance d that want s between them: the depth x = s − d where positive, and −∂d/∂q."""

    distance: ca.SX  # scalar [m, or the unit of a joint]
    inside: ca.SX  # scalar, 1 where d <= s
    depth: ca.SX  # scalar, 0 outside
    approach: ca.SX  # (1, n), −∂d/∂q: how fast the two approach each other

    @classmethod
    def of(cls, distance: ca.SX, margin: ca.SX, approach: ca.SX) -> Self:
        """The contact of two things `distance` apart that want `margin` between them."""
        inside = distance <= margin
        return cls(distance, inside, ca.if_else(inside, margin - distance, 0), approach)
