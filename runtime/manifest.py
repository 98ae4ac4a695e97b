"""The contract between generated C and whatever calls it: names, shapes, units, defaults and limits.

`symbolic` writes `manifest.json` next to the C, `runtime` and `analysis` read it, and nothing else passes
between them. Arrays are row-major, as C and numpy lay them out.
"""

import hashlib
import json
import math
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clikgen.runtime.documents import BadInput, Document, Number, choices, read_text

FAR = 1e6  # [m] the distance reported where there is no obstacle

Space = Literal["vector", "rotation"]
"""Where a reference lives: coordinates, or the orientations of a frame."""

Role = Literal["state", "signal", "parameter", "command", "diagnostic"]
"""What the loop does with a signal.

state: goes in, and comes out as the output whose `feeds` names it; signal: changes from step to step
(references, obstacles); parameter: tuned, constant over a run; command: sent to the robot; diagnostic: watched.
"""


class SignalInfo(Document):
    """One argument of a generated function: C name, shape (empty for a scalar), unit and meaning."""

    name: str
    shape: tuple[int, ...]
    unit: str
    description: str
    role: Role
    default: tuple[Number, ...] = ()
    minimum: Number | None = None
    maximum: Number | None = None
    positive_definite: bool = False
    feeds: str | None = None

    @property
    def size(self) -> int:
        """How many numbers the signal holds."""
        return math.prod(self.shape)

    def value(self, given: ArrayLike, source: str) -> NDArray[np.float64]:
        """`given` as an array of this signal's shape.

        A scalar fills a vector; a scalar k or a list of n stands for k·I or the diagonal of a square matrix
        that has to be symmetric positive definite. Raises BadInput for a wrong shape, a number that is not
        finite or outside the limits, or a matrix that is not symmetric positive definite.
        """
        try:
            array = np.asarray(given, dtype=np.float64)
        except (TypeError, ValueError):
            raise BadInput(f"{source}: wanted numbers of shape {self.shape}, got {given!r}") from None
        array = self._expanded(array)
        if array.shape != self.shape:
            raise BadInput(f"{source}: wanted shape {self.shape}, got {array.shape}")
        if not np.all(np.isfinite(array)):
            raise BadInput(f"{source}: wanted finite numbers, got {given!r}")
        low = -np.inf if self.minimum is None else self.minimum
        high = np.inf if self.maximum is None else self.maximum
        if np.any(array < low) or np.any(array > high):
            raise BadInput(f"{source}: wanted {low:g} to {high:g} {self.unit}, got {given!r}")
        if self.positive_definite and not is_positive_definite(array):
            raise BadInput(f"{source}: wanted a symmetric positive definite matrix, got {given!r}")
        return array

    def _expanded(self, array: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.positive_definite and array.shape in ((), self.shape[:1]):
            return np.diag(np.broadcast_to(array, self.shape[:1]))
        return np.broadcast_to(array, self.shape).copy() if array.ndim == 0 else array


def is_positive_definite(matrix: NDArray[np.float64]) -> bool:
    """Whether a square matrix is symmetric, with every eigenvalue above zero."""
    return bool(np.allclose(matrix, matrix.T, rtol=1e-12, atol=0) and np.linalg.eigvalsh(matrix).min() > 0)


class FunctionInfo(Document):
    """One generated function in CasADi's C calling convention, with what a call needs.

    `operations` are carried out in one evaluation at most; the arrays arg, res, iw and w want room for `sz_...`
    entries.
    """

    name: str
    symbol: str
    description: str
    inputs: tuple[SignalInfo, ...]
    outputs: tuple[SignalInfo, ...]
    operations: int
    sz_arg: int
    sz_res: int
    sz_iw: int
    sz_w: int

    def input(self, name: str) -> SignalInfo:
        """The input called `name`; raises BadInput with the valid names."""
        for signal in self.inputs:
            if signal.name == name:
                return signal
        raise BadInput(f"{self.symbol}: no input '{name}'; {choices(name, (signal.name for signal in self.inputs))}")


Vector = tuple[Number, Number, Number]


class JointInfo(Document):
    """A joint with a coordinate q_i in `unit`: its limits [unit] and velocity limit [unit/s], None for none."""

    name: str
    type: Literal["prismatic", "revolute", "continuous"]
    unit: Literal["m", "rad"]
    link: str
    lower: Number | None = None
    upper: Number | None = None
    velocity: Number | None = None


class InputInfo(Document):
    """A velocity that the controller commands, and its limit [unit/s]: of a joint, or of a differential drive."""

    name: str
    unit: Literal["m", "rad"]
    velocity: Number | None = None


class LinkInfo(Document):
    """A link, in the order of `link_pose`, the link that carries it, and its outline [m] in its own frame."""

    name: str
    parent: str
    outline: tuple[Vector, ...] = ()


class BodyInfo(Document):
    """A ball or capsule of a link: where its axis starts and ends [m] in the link's frame, and its radius [m]."""

    name: str
    link: str
    start: Vector
    end: Vector
    radius: Number


class PointInfo(Document):
    """A point of interest: the link that carries it and its offset [m] in the link's frame."""

    name: str
    link: str
    offset: Vector


class FrameInfo(Document):
    """A frame fixed to a link at `xyz` [m], in the link's frame."""

    name: str
    link: str
    xyz: Vector


class TaskInfo(Document):
    """A task, in priority order: its kind, its number of rows, and whether it `tracks` a position in the world.

    One that does has the outputs `<name>_position` and `<name>_error` and the reference `<name>`, in metres, all
    along its `axes` of the world (0, 1, 2). `frame` is what the task moves, where it moves one. `activation` says
    how a one-sided task, one without `equality`, begins and ends to act.
    """

    name: str
    kind: str
    equality: bool
    activation: str | None = None
    dimension: int
    tracks: bool = False
    axes: tuple[int, ...] = ()
    frame: FrameInfo | None = None


class ReferenceInfo(Document):
    """What a task follows: the inputs `<name>_reference` and `<name>_reference_velocity` of the step.

    `dimension` coordinates in a `vector` space; in a `rotation` space a quaternion (4,) and ω (3,) [rad/s].
    """

    name: str
    task: str
    space: Space
    dimension: int
    required: bool


class Manifest(Document):
    """Everything a caller knows of a generated controller.

    `target` is who wrote the C, and in which numbers: clikgen in double ("c") or float, or CasADi. `lanes` is how many
    robots `<controller>_step_lanes` of `<controller>_lanes.c` steps at once; None where there is no such file.
    """

    generator: Literal["clikgen"]
    controller: str
    description: str
    casadi: str
    target: Literal["c", "float", "casadi"]
    lanes: int | None = None
    spec_sha256: str
    source_sha256: dict[str, str]
    dimension: Literal[2, 3]
    joints: tuple[JointInfo, ...]
    inputs: tuple[InputInfo, ...]
    links: tuple[LinkInfo, ...]
    points: tuple[PointInfo, ...]
    bodies: tuple[BodyInfo, ...]
    obstacles: int
    capsules: int
    half_spaces: int
    tasks: tuple[TaskInfo, ...]
    references: tuple[ReferenceInfo, ...]
    law: str
    velocity_limits: str | None = None
    filter: str
    planner: str
    functions: tuple[FunctionInfo, ...]

    @property
    def limits(self) -> NDArray[np.float64]:
        """Lower and upper limit of every joint, infinite where there is none, (n, 2)."""
        ends = [(joint.lower, joint.upper) for joint in self.joints]
        return np.array([(-np.inf if low is None else low, np.inf if high is None else high) for low, high in ends])

    @property
    def joint_links(self) -> tuple[int, ...]:
        """Where the link that each joint moves stands among the links, (n,)."""
        names = [link.name for link in self.links]
        return tuple(names.index(joint.link) for joint in self.joints)

    @property
    def tracking_tasks(self) -> tuple[TaskInfo, ...]:
        """The tasks by which a frame's position follows a reference, the highest priority first."""
        return tuple(task for task in self.tasks if task.tracks)

    def tracking_task(self) -> TaskInfo:
        """The tracking task of the highest priority; raises BadInput without one."""
        if not self.tracking_tasks:
            raise BadInput(f"{self.controller}: wanted a tracking task, got none")
        return self.tracking_tasks[0]

    def position_task(self) -> TaskInfo:
        """The tracking task of the highest priority that is a position alone; raises BadInput without one."""
        for task in self.tracking_tasks:
            if task.kind == "frame_position":
                return task
        raise BadInput(f"{self.controller}: wanted a task of kind frame_position, got none")

    def check_planner(self, kind: str) -> None:
        """Raises BadInput for another planner than `kind`, of which a theory does not speak."""
        if self.planner != kind:
            raise BadInput(f"{self.controller}: wanted the planner '{kind}', got '{self.planner}'")

    def function(self, name: str) -> FunctionInfo:
        """The generated function called `name` (kinematics, jacobians, step)."""
        return {function.name: function for function in self.functions}[name]


def sha256(content: bytes) -> str:
    """Hexadecimal SHA-256 of `content`."""
    return hashlib.sha256(content).hexdigest()


def load_manifest(folder: Path) -> Manifest:
    """The manifest in a generated controller's folder, once its files are seen to be the ones it describes.

    Raises BadInput when the manifest or a file it names is missing, damaged or of another generation.
    """
    path = folder / "manifest.json"
    try:
        data = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise BadInput(f"{path}: not valid JSON: {error}; run 'clikgen generate'") from None
    if not isinstance(data, dict):
        raise BadInput(f"{path}: wanted a JSON object, got {type(data).__name__}; run 'clikgen generate'")
    manifest = Manifest.parse(data, str(path))
    for name, wanted in manifest.source_sha256.items():
        if sha256(read_text(folder / name).encode()) != wanted:
            raise BadInput(f"{folder / name}: not the file its manifest describes; run 'clikgen generate'")
    return manifest
