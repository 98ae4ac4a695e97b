"""Tasks that act only on one side of a boundary: what their tables in a spec file have in common."""

from abc import abstractmethod
from typing import TYPE_CHECKING

from pydantic import Field

from clikgen.symbolic import activations
from clikgen.symbolic.activation import ActivationSpec, Boundary
from clikgen.symbolic.kinds import kinds_in, one_of
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.task import Level, TaskSpec
from clikgen.symbolic.tree import KinematicTree

if TYPE_CHECKING:
    AnyActivation = ActivationSpec
else:
    AnyActivation = one_of(activations)


class OneSidedSpec(TaskSpec):
    """What a spec file says of a one-sided task: which boundary, and how it acts there, by default as a barrier."""

    activation: AnyActivation = Field(default_factory=lambda: kinds_in(activations)["barrier"](kind="barrier"))

    @property
    def equality(self) -> bool:
        """It acts only on one side of its boundary."""
        return False

    def dimension(self, robot: Robot) -> int:
        """As many rows as the activation makes of its contacts."""
        return self.activation.rows(self.contacts(robot))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Level:
        """The activation at the boundary; raises BadInput when the robot lacks what the task needs."""
        return self.activation.build(self.boundary(tree, sensing))

    @abstractmethod
    def contacts(self, robot: Robot) -> int:
        """How many contacts it watches."""

    @abstractmethod
    def boundary(self, tree: KinematicTree, sensing: Sensing | None) -> Boundary:
        """The contacts; raises BadInput when the robot lacks what the task needs."""
