"""What a robot is made of: joints, links, frames, points of interest and collision bodies.

Everything is three-dimensional; `space = "planar"` says that the motion stays in the x-y plane, so that
positions and obstacles have two coordinates.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput, Document, NonNegative, Number, Positive, UnitVector, choices

Vector = tuple[Number, Number, Number]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]


class Mimic(Document):
    """The joint follows another one: its position is multiplier · (that joint's position) + offset."""

    joint: Name
    multiplier: Number = 1.0
    offset: Number = 0.0


class Joint(Document):
    """A joint and the link it moves.

    The joint frame sits at `xyz` [m], rotated by `rpy` [rad] (fixed-axis roll, pitch, yaw, as in URDF), in the
    frame of `parent`; the link moves along (prismatic) or about (revolute, continuous) `axis`, a unit vector in
    that frame. Limits are in m or rad, the velocity limit in m/s or rad/s; a continuous joint turns without end.
    """

    name: Name
    type: Literal["fixed", "prismatic", "revolute", "continuous"]
    link: Name
    parent: Name | None = Field(default=None, description="the link before; default: the joint before's")
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: UnitVector[Vector] = (0.0, 0.0, 1.0)
    lower: Number | None = None
    upper: Number | None = None
    velocity: NonNegative | None = None
    mimic: Mimic | None = None
    outline: tuple[Vector, ...] = Field(default=(), description="polygon [m] in the link's frame, for drawing")

    @model_validator(mode="after")
    def _limits_fit_the_type(self) -> Self:
        if self.type == "fixed":
            if self.mimic:
                raise ValueError(f"joint '{self.name}' is fixed and cannot mimic another")
            return self
        if self.type == "continuous":
            if (self.lower, self.upper) != (None, None):
                raise ValueError(f"joint '{self.name}' is continuous and has no limits; with limits it is revolute")
        elif self.lower is None or self.upper is None:
            raise ValueError(f"joint '{self.name}': wanted lower and upper")
        elif self.lower > self.upper:
            raise ValueError(f"wanted lower <= upper, got {self.lower} and {self.upper}")
        return self

    @property
    def unit(self) -> Literal["m", "rad"]:
        """The unit of the joint's coordinate."""
        return "m" if self.type == "prismatic" else "rad"

    @property
    def independent(self) -> bool:
        """Whether the joint has a coordinate of its own: it is neither fixed nor a mimic."""
        return self.type != "fixed" and self.mimic is None


class Frame(Document):
    """A named frame fixed to a link at `xyz` [m], rotated by `rpy` [rad]: what a task moves."""

    name: Name
    link: Name
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


class PointOfInterest(Document):
    """A point at `offset` [m] on a link that keeps `influence_radius` [m] away from obstacles (eq. 7)."""

    name: Name
    link: Name
    offset: Vector = (0.0, 0.0, 0.0)
    influence_radius: Positive


class Body(Document):
    """A ball of `radius` [m] at `start` [m] on a link or, with `end`, the capsule between the two points."""

    name: Name
    link: Name
    start: Vector = (0.0, 0.0, 0.0)
    end: Vector | None = None
    radius: Positive


class DifferentialDrive(Document):
    """Wheels that neither slip nor skid: the base moves along its own x axis and turns, ẏ cos ψ = ẋ sin ψ.

    `x`, `y` and `yaw` name the joints whose rates are (v cos ψ, v sin ψ, ω) for the inputs v and ω.
    """

    x: Name
    y: Name
    yaw: Name
    velocity: Positive = Field(description="limit of the forward velocity v [m/s]")


@dataclass(frozen=True, slots=True)
class Input:
    """A velocity that the controller commands: that of a joint, or of a differential drive."""

    name: str
    unit: Literal["m", "rad"]
    velocity: float | None  # its limit [unit/s]


class Robot(Document):
    """A tree of joints from the `root` link, each after the one that carries it, and what is fixed to its links."""

    space: Literal["planar", "spatial"] = "spatial"
    root: Name = "world"
    joints: Annotated[tuple[Joint, ...], Field(min_length=1)]
    drive: DifferentialDrive | None = None
    frames: tuple[Frame, ...] = ()
    points_of_interest: tuple[PointOfInterest, ...] = ()
    bodies: tuple[Body, ...] = ()

    @property
    def dimension(self) -> Literal[2, 3]:
        """How many coordinates a position has."""
        return 2 if self.space == "planar" else 3

    @property
    def coordinates(self) -> tuple[Joint, ...]:
        """The joints with a coordinate of their own, in the order of q (n,)."""
        return tuple(joint for joint in self.joints if joint.independent)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """What the controller commands, (n_u,): the joint velocities or, for a differential drive, v, ω and those."""
        return tuple(
            Input("base_forward", "m", self.drive.velocity)
            if self.drive and joint.name == self.drive.x
            else Input(joint.name, joint.unit, joint.velocity)
            for joint in self.coordinates
            if not self.drive or joint.name != self.drive.y
        )

    @property
    def input_of(self) -> tuple[int, ...]:
        """The input that moves each coordinate; x and y of a differential drive share one."""
        names = [one.name for one in self.inputs]
        forward = (self.drive.x, self.drive.y) if self.drive else ()
        return tuple(names.index("base_forward" if j.name in forward else j.name) for j in self.coordinates)

    @property
    def links(self) -> tuple[str, ...]:
        """Every link, the root first, each after the one that carries it."""
        return (self.root, *(joint.link for joint in self.joints))

    def coordinate(self, name: str) -> int:
        """Where the joint called `name` is in q; raises BadInput with the valid names."""
        names = [joint.name for joint in self.coordinates]
        if name not in names:
            raise BadInput(f"no joint '{name}'; {choices(name, names)}")
        return names.index(name)

    def frame(self, name: str) -> Frame:
        """The frame called `name`, a link's own frame among them; raises BadInput with the valid names."""
        for frame in self.frames:
            if frame.name == name:
                return frame
        if name in self.links:
            return Frame(name=name, link=name)
        raise BadInput(f"no frame '{name}'; {choices(name, (*(frame.name for frame in self.frames), *self.links))}")

    def parent(self, joint: Joint) -> str:
        """The link that carries `joint`: the one it names, else the link of the joint before."""
        return joint.parent or self.links[self.joints.index(joint)]

    @model_validator(mode="after")
    def _names_are_unique(self) -> Self:
        for kind, names in (
            ("joint", [joint.name for joint in self.joints]),
            ("link", list(self.links)),
            ("frame", [*(frame.name for frame in self.frames), *self.links]),
            ("point of interest", [point.name for point in self.points_of_interest]),
            ("body", [body.name for body in self.bodies]),
        ):
            seen: set[str] = set()
            for name in names:
                if name in seen:
                    raise ValueError(f"{kind} '{name}' is there twice")
                seen.add(name)
        return self

    @model_validator(mode="after")
    def _what_is_named_is_there(self) -> Self:
        before = [self.root]
        for joint in self.joints:
            if joint.parent is not None and joint.parent not in before:
                raise ValueError(
                    f"joint '{joint.name}': no link '{joint.parent}' before it; {choices(joint.parent, before)}"
                )
            before.append(joint.link)
        fixed: tuple[Frame | PointOfInterest | Body, ...] = (*self.frames, *self.points_of_interest, *self.bodies)
        for carried in fixed:
            if carried.link not in self.links:
                raise ValueError(f"'{carried.name}': no link '{carried.link}'; {choices(carried.link, self.links)}")
        coordinates = [joint.name for joint in self.coordinates]
        if not coordinates:
            raise ValueError("no joint moves: wanted one at least that is not fixed")
        for joint in self.joints:
            if joint.mimic and joint.mimic.joint not in coordinates:
                raise ValueError(
                    f"joint '{joint.name}' mimics '{joint.mimic.joint}', which is no joint that moves by itself; "
                    f"{choices(joint.mimic.joint, coordinates)}"
                )
        for name in (self.drive.x, self.drive.y, self.drive.yaw) if self.drive else ():
            if name not in coordinates:
                raise ValueError(f"drive: no joint '{name}'; {choices(name, coordinates)}")
        return self

    @model_validator(mode="after")
    def _planar_stays_in_the_plane(self) -> Self:
        if self.space == "spatial":
            return self
        for joint in self.joints:
            x, y, z = joint.axis
            in_plane = z == 0 if joint.type == "prismatic" else x == y == 0 or joint.type == "fixed"
            if not in_plane or joint.xyz[2] != 0 or joint.rpy[:2] != (0, 0):
                raise ValueError(
                    f"joint '{joint.name}' leaves the x-y plane: a planar robot wants prismatic axes in it, "
                    "revolute axes along z, z = 0, and no roll or pitch"
                )
        return self
