"""A task, as the laws see it, and how the kinds of task are found."""

import pkgutil
from abc import ABC, abstractmethod
from dataclasses import dataclass
from importlib import import_module

import casadi as ca

from clikgen.runtime.documents import Document, Identifier
from clikgen.symbolic import tasks as task_modules
from clikgen.symbolic.chain import SerialChain
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """ẋ = J q̇ is wanted to be feedforward + gain·error; J = 0 where the task is not active."""

    name: str
    jacobian: ca.SX  # (m, n)
    error: ca.SX  # (m, 1)
    feedforward: ca.SX  # (m, 1)
    gain: ca.SX  # (m, m) [1/s]
    damping: ca.SX  # scalar, in the unit of the Jacobian
    inputs: tuple[Signal, ...]
    diagnostics: tuple[Signal, ...]
    positions: tuple[Signal, ...]  # what depends on q alone, for _kinematics
    jacobians: tuple[Signal, ...]  # for _jacobians

    @property
    def velocity(self) -> ca.SX:
        """The task velocity that closes the loop, ẋ_d + K e, shape (m, 1)."""
        return self.feedforward + self.gain @ self.error


class TaskSpec(Document, ABC):
    """What a spec file says of a task; each file in `tasks/` holds one kind, found by its name."""

    kind: str
    name: Identifier

    @property
    @abstractmethod
    def equality(self) -> bool:
        """True for a task that holds always, False for one that acts only on one side of a boundary."""

    @abstractmethod
    def dimension(self, robot: Robot) -> int:
        """m, how many rows the task has."""

    @abstractmethod
    def build(self, chain: SerialChain, sensing: Sensing | None) -> Task:
        """The task's expressions; `sensing` is None for a controller without obstacles.

        Raises BadInput when the robot lacks what the task needs.
        """


def task_kinds() -> dict[str, type[TaskSpec]]:
    """Every kind of task by its name, from the files in `tasks/`."""
    names = sorted(module.name for module in pkgutil.iter_modules(task_modules.__path__))
    modules = (import_module(f"{task_modules.__name__}.{name}") for name in names)
    return {name: module.Spec for name, module in zip(names, modules, strict=True)}
