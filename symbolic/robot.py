"""What a robot is made of: joints, links, frames and points of interest, as a spec file writes them.

Everything is three-dimensional; `space = "planar"` says that the motion stays in the x-y plane, so that
positions and obstacles have two coordinates.
"""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput, Document, Identifier, Number, Positive, choices

Vector = tuple[Number, Number, Number]


class Joint(Document):
    """A joint and the link it moves.

    The joint frame sits at `xyz` [m], rotated by `rpy` [rad] (fixed-axis roll, pitch, yaw, as in URDF), in the
    frame of `parent`; the link moves along (prismatic) or about (revolute) `axis`, a unit vector in that
    frame. Limits are in m or rad, the velocity limit in m/s or rad/s.
    """

    name: Identifier
    type: Literal["prismatic", "revolute"]
    link: Identifier
    parent: Identifier | None = Field(default=None, description="the link before; default: the joint before's")
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector
    lower: Number
    upper: Number
    velocity: Positive
    outline: tuple[Vector, ...] = Field(default=(), description="polygon [m] in the link's frame, for drawing")

    @model_validator(mode="after")
    def _limits_and_axis(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"wanted lower < upper, got {self.lower} and {self.upper}")
        if not math.isclose(math.hypot(*self.axis), 1.0, abs_tol=1e-9):
            raise ValueError(f"wanted axis to be a unit vector, got {list(self.axis)}")
        return self

    @property
    def unit(self) -> Literal["m", "rad"]:
        """The unit of the joint's coordinate."""
        return "m" if self.type == "prismatic" else "rad"


class Frame(Document):
    """A named frame fixed to a link at `xyz` [m]: what a task moves."""

    name: Identifier
    link: Identifier
    xyz: Vector = (0.0, 0.0, 0.0)


class PointOfInterest(Document):
    """A point at `offset` [m] on a link that keeps `influence_radius` [m] away from obstacles (eq. 7)."""

    name: Identifier
    link: Identifier
    offset: Vector = (0.0, 0.0, 0.0)
    influence_radius: Positive


class Robot(Document):
    """A serial chain of joints from the `root` frame, with its frames and points of interest."""

    space: Literal["planar", "spatial"] = "spatial"
    root: Identifier = "world"
    joints: Annotated[tuple[Joint, ...], Field(min_length=1)]
    frames: tuple[Frame, ...] = ()
    points_of_interest: tuple[PointOfInterest, ...] = ()

    @property
    def dimension(self) -> Literal[2, 3]:
        """How many coordinates a position has."""
        return 2 if self.space == "planar" else 3

    def frame(self, name: str) -> Frame:
        """The frame called `name`; raises BadInput with the valid names."""
        for frame in self.frames:
            if frame.name == name:
                return frame
        raise BadInput(f"no frame '{name}'; {choices(name, (frame.name for frame in self.frames))}")

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        for kind, names in (
            ("joint", [joint.name for joint in self.joints]),
            ("link", [self.root, *(joint.link for joint in self.joints)]),
            ("frame", [frame.name for frame in self.frames]),
            ("point of interest", [point.name for point in self.points_of_interest]),
        ):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{kind} '{name}' is there twice")
        return self

    @model_validator(mode="after")
    def _chain_is_serial(self) -> Self:
        links = [self.root, *(joint.link for joint in self.joints)]
        for joint, before in zip(self.joints, links, strict=False):
            if joint.parent not in (None, before):
                raise ValueError(
                    f"joint '{joint.name}': wanted parent '{before}' (a serial chain), got '{joint.parent}'"
                )
        carriers: tuple[Frame | PointOfInterest, ...] = (*self.frames, *self.points_of_interest)
        for carrier in carriers:
            if carrier.link not in links:
                raise ValueError(f"'{carrier.name}': no link '{carrier.link}'; {choices(carrier.link, links)}")
        return self

    @model_validator(mode="after")
    def _planar_stays_in_the_plane(self) -> Self:
        if self.space == "spatial":
            return self
        for joint in self.joints:
            x, y, z = joint.axis
            in_plane = z == 0 if joint.type == "prismatic" else x == y == 0
            if not in_plane or joint.xyz[2] != 0 or joint.rpy[:2] != (0, 0):
                raise ValueError(
                    f"joint '{joint.name}' leaves the x-y plane: a planar robot wants prismatic axes in it, "
                    "revolute axes along z, z = 0, and no roll or pitch"
                )
        return self
