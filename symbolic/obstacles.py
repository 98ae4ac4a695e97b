"""Obstacles, points or discs that may move, and what every point of interest senses of them."""

from dataclasses import dataclass
from typing import Self

import casadi as ca

from clikgen.runtime.manifest import FAR
from clikgen.symbolic.chain import SerialChain
from clikgen.symbolic.signals import Signal, symbol

COINCIDENT = 1e-12  # [m] nearer than this to an obstacle's centre, the direction to it is taken as +x


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """Up to `maximum` discs (in 3-D, balls): centre [m], radius [m] (0 is a point), and how many there are."""

    center: Signal  # (maximum, dimension)
    radius: Signal  # (maximum,)
    count: Signal  # scalar

    @classmethod
    def up_to(cls, maximum: int, dimension: int) -> Self:
        """New symbols for `maximum` obstacles."""
        return cls(
            symbol("obstacle_center", (maximum, dimension), "m", "obstacle centres o", "signal", (-1e6, 1e6)),
            symbol("obstacle_radius", (maximum,), "m", "obstacle radii; 0 is a point", "signal", (0.0, 1e3)),
            symbol("obstacle_count", (), "1", "how many are there; the rest is ignored", "signal", (0.0, maximum)),
        )

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The signals the controller has to be given."""
        return (self.center, self.radius, self.count)

    def closest(self, point: ca.SX) -> tuple[ca.SX, ca.SX]:
        """D and u of eqs. 8-9 for the closest obstacle to `point` (dimension, 1).

        d [m] is the distance to the closest point on the disc, negative inside it and FAR without an obstacle;
        u (dimension, 1) is the unit vector toward its centre, +x where the point sits on the centre.
        """
        center, radius = self.center.expression, self.radius.expression
        distance, toward, norm = ca.SX(FAR), ca.SX.eye(point.shape[0])[:, 0], ca.SX(1)
        for k in range(center.shape[0]):
            toward_k = center[k, :].T - point
            norm_k = ca.sqrt(ca.sumsqr(toward_k))
            distance_k = ca.if_else(k < self.count.expression, norm_k - radius[k], FAR)
            closer = distance_k < distance
            distance = ca.if_else(closer, distance_k, distance)
            toward = ca.if_else(closer, toward_k, toward)
            norm = ca.if_else(closer, norm_k, norm)
        first_axis = ca.SX.eye(point.shape[0])[:, 0]
        return distance, ca.if_else(norm > COINCIDENT, toward / norm, first_axis)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """What one point of interest senses: distance d [m], depth x = s − d [m] where positive, and −∂d/∂q."""

    distance: ca.SX  # scalar [m]
    inside: ca.SX  # scalar, 1 where d <= s
    depth: ca.SX  # scalar [m], 0 outside
    approach: ca.SX  # (1, n), uᵀ J_r


@dataclass(frozen=True, slots=True, eq=False)
class Sensing:
    """All points of interest against all obstacles."""

    obstacles: Obstacles
    influence_radius: Signal  # (points,)
    contacts: tuple[Contact, ...]

    @classmethod
    def of(cls, chain: SerialChain, obstacles: Obstacles) -> Self:
        """Every point of interest of the chain, each with its own influence radius s as a parameter."""
        points = chain.robot.points_of_interest
        radius = symbol(
            "influence_radius",
            (len(points),),
            "m",
            "influence radius s of each point of interest (eq. 8)",
            "parameter",
            (1e-6, 1e3),
            [point.influence_radius for point in points],
        )
        contacts = []
        for i, point in enumerate(points):
            distance, toward = obstacles.closest(chain.position(point.link, point.offset))
            inside = distance <= radius.expression[i]
            depth = ca.if_else(inside, radius.expression[i] - distance, 0)
            approach = toward.T @ chain.position_jacobian(point.link, point.offset)
            contacts.append(Contact(distance, inside, depth, approach))
        return cls(obstacles, radius, tuple(contacts))

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The signals the controller has to be given."""
        return (*self.obstacles.inputs, self.influence_radius)

    @property
    def distance(self) -> ca.SX:
        """D of every point of interest, shape (points, 1) [m]."""
        return ca.vertcat(*(contact.distance for contact in self.contacts))

    @property
    def clearance(self) -> ca.SX:
        """The least d − s over the points of interest [m]: negative is intrusion."""
        return ca.mmin(self.distance - self.influence_radius.expression)

    @property
    def event(self) -> ca.SX:
        """1 where some influence region meets an obstacle, 𝓘 ∩ 𝓞 ≠ ∅ (eq. 18), else 0."""
        event = ca.SX(0)
        for contact in self.contacts:
            event = ca.logic_or(event, contact.inside)
        return event
