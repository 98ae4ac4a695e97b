"""The [robot] table of a spec: one source of joints, a base under them, and what is fixed to the links."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput, Document, Number
from clikgen.symbolic.models.dh import DHTable
from clikgen.symbolic.models.lock import locked
from clikgen.symbolic.models.mobile_base import MobileBase
from clikgen.symbolic.models.snap import snapped
from clikgen.symbolic.models.urdf import UrdfModel, read_urdf
from clikgen.symbolic.robot import Body, Frame, Joint, Name, PointOfInterest, Robot

SOURCES = ("joints", "dh", "urdf")
WORLD = "world"
ARM_ROOT = "arm_root"  # the link on which the arm stands, when it stands on a base and has no URDF to name it


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A robot, and what whoever wrote its table should know, a line each."""

    robot: Robot
    notes: tuple[str, ...]


class _Built(Document):
    robot: Robot  # under this name, so that an error says where: robot.joints.0


class RobotTable(Document):
    """A robot as a spec describes it: exactly one of `joints`, `dh` and `urdf` says how it moves.

    `urdf` is a path from the spec's folder. `base` carries the arm. `lock` holds joints, and those that mimic
    them, at a value [m, rad]. `snap` puts constants that are a little off, 1.5708 for π/2, at what they stand for.
    """

    space: Literal["planar", "spatial"] = "spatial"
    root: Name | None = Field(default=None, description="the link that stands still; default: the URDF's, or world")
    joints: tuple[Joint, ...] = ()
    dh: DHTable | None = None
    urdf: Annotated[str, Field(min_length=1)] | None = None
    base: MobileBase = MobileBase(kind="fixed")
    lock: dict[Name, Number] = Field(default_factory=dict)
    snap: Annotated[bool, Field(strict=True)] = False
    frames: tuple[Frame, ...] = ()
    points_of_interest: tuple[PointOfInterest, ...] = ()
    bodies: tuple[Body, ...] = ()

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        got = [name for name in SOURCES if getattr(self, name)]
        if len(got) != 1:
            raise ValueError(f"wanted exactly one of {', '.join(SOURCES)}, got {' and '.join(got) or 'none'}")
        return self

    def build(self, folder: Path, source: str) -> RobotModel:
        """The robot, for a spec called `source` in `folder`; raises BadInput, one line."""
        try:
            arm = self._arm(folder)
            joints, root = self._on_the_base(arm)
        except BadInput as error:
            raise BadInput(f"{source}: robot: {error}") from None
        if not any(joint.independent for joint in joints):
            where = f"{source}: robot: {self.urdf}" if self.urdf else f"{source}: robot"
            raise BadInput(f"{where}: no joint moves, wanted one at least that is not fixed, here or in a base")
        notes = arm.notes
        robot = self._robot(root, joints, source)
        if self.snap:
            robot, snap_notes = snapped(robot)
            notes += snap_notes
        if self.lock:
            robot = self._locked(robot, source)
            notes += tuple(f"joint '{name}' locked at {value:g}" for name, value in self.lock.items())
        return RobotModel(robot, notes)

    def _arm(self, folder: Path) -> UrdfModel:
        """The joints of the source and the link they start from."""
        if self.urdf is not None:
            return read_urdf(folder / self.urdf)
        joints = self.dh.joints() if self.dh else self.joints
        return UrdfModel((self.root or WORLD) if self.base.absent else ARM_ROOT, joints, ())

    def _on_the_base(self, arm: UrdfModel) -> tuple[tuple[Joint, ...], str]:
        """The joints with those of the base, and the root link below them all."""
        if not self.base.absent:
            world = self.root or WORLD
            return self.base.carrying(arm.joints, world, arm.root), world
        if self.root not in (None, arm.root):
            raise BadInput(f"root: the URDF's root link is '{arm.root}', got '{self.root}'; leave it out")
        return arm.joints, arm.root

    def _locked(self, robot: Robot, source: str) -> Robot:
        try:
            joints = locked(robot, self.lock)
        except BadInput as error:
            raise BadInput(f"{source}: robot: {error}") from None
        return self._robot(robot.root, joints, source, frames=robot.frames)

    def _robot(self, root: str, joints: tuple[Joint, ...], source: str, **others: Any) -> Robot:
        content = {
            "space": self.space,
            "root": root,
            "joints": joints,
            "drive": self.base.drive,
            "frames": self.frames,
            "points_of_interest": self.points_of_interest,
            "bodies": self.bodies,
        }
        return _Built.parse({"robot": content | others}, source).robot
