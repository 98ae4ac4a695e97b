"""A task, as the laws see it, and what its files have in common."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, Document, Identifier, Number, Positive
from clikgen.runtime.manifest import Space
from clikgen.symbolic.damping import Damping, SelectiveDamping
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.tree import KinematicTree

GainSpec = Number | tuple[Number, ...] | tuple[tuple[Number, ...], ...]
Yield = Annotated[float, Field(strict=True, ge=1e-4, le=1)]
NEAR_SINGULARITY = SelectiveDamping(maximum=0.05, near=0.05)  # what a task is damped with unless its table says


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What a task follows: the signals `<name>_reference` and `<name>_reference_velocity`.

    In a `rotation` space the value is a unit quaternion (w, x, y, z) and the velocity the angular velocity in the
    world [rad/s]; else both are vectors. One that is not `required` stays at its default when nothing is given.
    """

    name: str
    space: Space
    required: bool
    value: Signal
    velocity: Signal


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Level:
    """What every task is to the controller: its name and its signals."""

    name: str
    parameters: tuple[Signal, ...]
    diagnostics: tuple[Signal, ...]
    values: tuple[Signal, ...] = ()  # what depends on q (and targets) alone, for _kinematics
    jacobians: tuple[Signal, ...] = ()  # for _jacobians
    references: tuple[Reference, ...] = ()

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The signals the task has to be given: references, then parameters."""
        return (*(signal for one in self.references for signal in (one.value, one.velocity)), *self.parameters)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Task(Level):
    """ẋ = J q̇ is wanted to be feedforward + gain·error; J = 0 where the task is not active."""

    jacobian: ca.SX  # (m, n)
    error: ca.SX  # (m, 1)
    feedforward: ca.SX  # (m, 1)
    gain: ca.SX  # (m, m) [1/s], or a scalar
    damping: Damping
    speed: ca.SX | None = None
    yields: float | None = None  # ε of `symbolic/barrier.py`; None leaves it to the barrier

    @property
    def velocity(self) -> ca.SX:
        """The task velocity that closes the loop, ẋ_d + K e with |K e| brought down to `speed`, shape (m, 1)."""
        feedback = self.gain @ self.error
        if self.speed is not None:
            feedback = feedback * (self.speed / ca.sqrt(ca.fmax(ca.sumsqr(feedback), self.speed**2)))
        return self.feedforward + feedback

    def limited(self, speed: float) -> "Task":
        """The task with its feedback limited: the parameter `<task>_speed` is the largest |K e|."""
        text = "largest norm of the feedback K e"
        limit = symbol(f"{self.name}_speed", (), "1/s of the error", text, "parameter", (1e-6, 1e6), speed)
        return replace(self, parameters=(*self.parameters, limit), speed=limit.expression)


class TaskSpec(Document, ABC):
    """What a spec file says of a task; each file in `tasks/` holds one kind, found by its name.

    `speed` limits the feedback, |K e| <= speed, so that a target far away or out of reach does not ask for more
    than the arm can do in a step. At the edge of the reach, where the damping is λ₀ and ‖D²f‖ <= L, the step is
    δq ← (I − (T |K e| / λ₀²) H) δq with 0 <= H <= L: it settles without overshoot where T · speed · L < λ₀² and
    oscillates from twice that on.
    """

    kind: str
    name: Identifier
    speed: Positive | None = None

    @property
    @abstractmethod
    def equality(self) -> bool:
        """True for a task that holds always, False for one that acts only on one side of a boundary."""

    def tracked_axes(self, robot: Robot) -> tuple[int, ...]:
        """The world axes (0, 1, 2) along which it makes a frame's position follow a reference; none by default."""
        return ()

    @abstractmethod
    def dimension(self, robot: Robot) -> int:
        """m, how many rows the task has."""

    @abstractmethod
    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Level:
        """The task's expressions; `sensing` is None for a controller without obstacles.

        Raises BadInput when the robot lacks what the task needs.
        """


def vector_reference(
    name: str, size: int, unit: str, description: str, default: Sequence[float] | None = None
) -> Reference:
    """A reference of `size` coordinates in `unit`, one or a list; with a `default` it need not be given."""
    rate = ", ".join(f"{one}/s" for one in unit.split(", "))
    return Reference(
        name,
        "vector",
        default is None,
        symbol(f"{name}_reference", (size,), unit, description, "signal", (-1e6, 1e6), default or 0.0),
        symbol(f"{name}_reference_velocity", (size,), rate, "its time derivative", "signal", (-1e6, 1e6)),
    )


def rotation_reference(name: str, description: str) -> Reference:
    """A reference for an orientation: a quaternion (w, x, y, z), normalised before use, and ω in the world."""
    value = symbol(f"{name}_reference", (4,), "1", f"{description}, quaternion (w, x, y, z)", "signal", (-1e3, 1e3))
    velocity = symbol(
        f"{name}_reference_velocity", (3,), "rad/s", "its angular velocity in the world", "signal", (-1e6, 1e6)
    )
    return Reference(name, "rotation", True, value, velocity)


def gain_signal(task: str, size: int, spec: GainSpec, description: str = "gain K") -> Signal:
    """The parameter `<task>_gain` [1/s]: a number k for k·I, a list for a diagonal, or a full SPD matrix."""
    return symbol(
        f"{task}_gain",
        (size, size),
        "1/s",
        f"{description}, symmetric positive definite",
        "parameter",
        (-1e4, 1e4),
        spec,
        positive_definite=True,
    )


def jacobian_result(task: str, jacobian: ca.SX, unit: str, description: str) -> Signal:
    """The output `<task>_jacobian`, a vector when it has one row."""
    rows, n = jacobian.shape
    return result(f"{task}_jacobian", jacobian, (n,) if rows == 1 else (rows, n), f"{unit} per joint unit", description)


def selected_joints(robot: Robot, joints: Sequence[str] | None) -> list[int]:
    """Where the named joints are in q, all of them for None; raises BadInput for an unknown or a repeated name."""
    if joints is None:
        return list(range(len(robot.coordinates)))
    for name in joints:
        if joints.count(name) > 1:
            raise BadInput(f"joint '{name}' is there twice")
    return [robot.coordinate(name) for name in joints]


def joint_units(robot: Robot, joints: Sequence[int]) -> str:
    """The units of these coordinates, in order: "m, rad, rad"."""
    return ", ".join(robot.coordinates[i].unit for i in joints)
