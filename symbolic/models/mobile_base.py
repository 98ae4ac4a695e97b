"""A base under the arm: bolted down, holonomic or driven by two wheels."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput, Document, Number, Positive, choices
from clikgen.symbolic.robot import DifferentialDrive, Joint, Name, Vector

Limits = Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]


class MobileBase(Document):
    """What the arm stands on, and where: `mount_xyz` [m], `mount_rpy` [rad] in the frame of the base's link.

    A holonomic base slides along the world's x and y and turns about z: joints NAME_x, NAME_y and NAME_yaw with
    links slide_x, slide_y and NAME. A differential one is the same, moved only along its own x axis and about z.
    In a spec a kind alone will do: base = "holonomic".
    """

    kind: Literal["fixed", "holonomic", "differential"]
    name: Name = "base"
    mount_xyz: Vector = (0.0, 0.0, 0.0)
    mount_rpy: Vector = (0.0, 0.0, 0.0)
    lower: Limits = Field(default=(-100.0, -100.0), description="of x and y [m]; with a third, of the yaw [rad]")
    upper: Limits = (100.0, 100.0)
    velocity: Positive = Field(default=1.0, description="along x and along y; of a differential drive, forward [m/s]")
    yaw_velocity: Positive = Field(default=1.0, description="[rad/s]")
    outline: tuple[Vector, ...] = Field(default=(), description="polygon [m] in the base's frame, for drawing")

    @model_validator(mode="before")
    @classmethod
    def _kind_alone(cls, data: Any) -> Any:
        return {"kind": data} if isinstance(data, str) else data

    @model_validator(mode="after")
    def _limits_fit(self) -> Self:
        if len(self.lower) != len(self.upper):
            raise ValueError(
                f"wanted as many lower as upper limits, 2 (x, y) or 3 (x, y, yaw), got {len(self.lower)} "
                f"and {len(self.upper)}"
            )
        if any(lower > upper for lower, upper in zip(self.lower, self.upper, strict=True)):
            raise ValueError(f"wanted lower <= upper, got {list(self.lower)} and {list(self.upper)}")
        return self

    @model_validator(mode="after")
    def _fixed_has_only_a_mount(self) -> Self:
        valid = ("kind", "name", "mount_xyz", "mount_rpy")
        for key in self.model_fields_set if self.kind == "fixed" else ():
            if key not in valid:
                raise ValueError(f"a fixed base has no '{key}'; {choices(key, valid)}")
        return self

    @property
    def absent(self) -> bool:
        """Whether the arm simply stands at the origin, so that no joint is needed below it."""
        return self.kind == "fixed" and not any((*self.mount_xyz, *self.mount_rpy))

    @property
    def drive(self) -> DifferentialDrive | None:
        """The wheels of a differential base."""
        if self.kind != "differential":
            return None
        x, y, yaw = (f"{self.name}_{end}" for end in ("x", "y", "yaw"))
        return DifferentialDrive(x=x, y=y, yaw=yaw, velocity=self.velocity)

    def carrying(self, arm: Sequence[Joint], world: str, root: str) -> tuple[Joint, ...]:
        """The joints of the base from the link `world`, then NAME_mount to the arm's `root`, then the arm's.

        Raises BadInput when the arm has a joint or link of the same name.
        """
        stand = self.name if self._moving else world
        mount = Joint(
            name=f"{self.name}_mount", type="fixed", link=root, parent=stand, xyz=self.mount_xyz, rpy=self.mount_rpy
        )
        below = (*self._moving, mount)
        self._refuse_names_of(arm, below, world)
        return (*below, *arm)

    @property
    def _moving(self) -> tuple[Joint, ...]:
        if self.kind == "fixed":
            return ()
        x, y, *yaw = zip(self.lower, self.upper, strict=True)
        slide = {"type": "prismatic", "velocity": self.velocity}
        along_x = {"name": f"{self.name}_x", "link": "slide_x", "axis": (1, 0, 0), "lower": x[0], "upper": x[1]}
        along_y = {"name": f"{self.name}_y", "link": "slide_y", "axis": (0, 1, 0), "lower": y[0], "upper": y[1]}
        turn: dict[str, Any] = {"name": f"{self.name}_yaw", "type": "continuous", "link": self.name}
        if yaw:
            turn |= {"type": "revolute", "lower": yaw[0][0], "upper": yaw[0][1]}
        turn |= {"velocity": self.yaw_velocity, "outline": self.outline}
        return tuple(Joint.parse(joint, "base") for joint in (along_x | slide, along_y | slide, turn))

    def _refuse_names_of(self, arm: Sequence[Joint], below: Sequence[Joint], world: str) -> None:
        """Say which name is there twice before the robot as a whole does, which knows no way out."""
        root = below[-1].link
        links = {root, *(joint.link for joint in arm)}
        if world in links:
            raise BadInput(
                f"base: the arm has a link '{world}' too; call the one below the base otherwise: root = 'map'"
            )
        for ours in below[:-1]:
            if ours.link in links:
                raise BadInput(f"base: the arm has a link '{ours.link}' too; {self._way_out(ours.link)}")
        for ours in below:
            if ours.name in [joint.name for joint in arm]:
                raise BadInput(f"base: the arm has a joint '{ours.name}' too; {self._way_out(self.name)}")

    def _way_out(self, link: str) -> str:
        return "call the base otherwise, with base.name" if link == self.name else "call the arm's otherwise"
