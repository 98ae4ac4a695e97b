"""Workspace walls: points of the robot stay on the inner side of walls."""

import math
from typing import Annotated, Literal, Self

import casadi as ca
from pydantic import Field, model_validator

from clikgen.runtime.documents import BadInput, Document, NonNegative, Number, Positive
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.potential import Combine, potential_task
from clikgen.symbolic.robot import Robot, Vector
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import Task, TaskSpec
from clikgen.symbolic.tree import KinematicTree


class Wall(Document):
    """The inner side of a wall: all points p with normalᵀp >= offset [m]; the unit normal points inwards."""

    normal: Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]
    offset: Number

    @model_validator(mode="after")
    def _normal_is_a_unit_vector(self) -> Self:
        if not math.isclose(math.hypot(*self.normal), 1.0, abs_tol=1e-9):
            raise ValueError(f"wanted normal to be a unit vector, got {list(self.normal)}")
        return self


class Spec(TaskSpec):
    """q̇_w = J_w⁺ K_o (0 − V), eq. 10, with V = ½ x² (eq. 8), x = s − d where d < s, d = nᵀp − o.

    There is one contact for each of the `walls` and each of the points: the origins of `frames`, by default the
    robot's points of interest. `margin` is s [m], a number or a list with one per wall; `gain` is K_o [1/s];
    `damping` [m²] that of the pseudo-inverse, as for obstacle_avoidance; `combine` is "rows" for a row a contact,
    or "sum" for one in all. n, o and s are parameters: keep n a unit vector.
    """

    kind: Literal["workspace_walls"]
    walls: Annotated[tuple[Wall, ...], Field(min_length=1)]
    frames: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    margin: Positive | tuple[Positive, ...]
    gain: NonNegative
    damping: Positive
    combine: Combine = "rows"

    @property
    def equality(self) -> bool:
        """It acts only near a wall or behind it."""
        return False

    def dimension(self, robot: Robot) -> int:
        """One row a wall and point; or one, however many."""
        return 1 if self.combine == "sum" else len(self.walls) * len(self._points(robot))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """V = ½ x² and J_w = ∂V/∂q; raises BadInput without points, or for a normal of the wrong length."""
        points = self._points(tree.robot)
        inputs = self._inputs(tree.robot.dimension)
        normal, offset, margin = (signal.expression for signal in inputs)
        contacts = []
        for k in range(len(self.walls)):
            for link, place in points.values():
                distance = normal[k, :] @ tree.position(link, place) - offset[k]
                approach = -normal[k, :] @ tree.position_jacobian(link, place)
                contacts.append(Contact.of(distance, margin[k], approach))
        distances = ca.reshape(ca.vertcat(*(contact.distance for contact in contacts)), len(points), len(self.walls)).T
        text = f"d to each wall (row) of each point: {', '.join(points)}"
        diagnostic = result(f"{self.name}_distance", distances, distances.shape, "m", text)
        return potential_task(self.name, contacts, self.gain, self.damping, self.combine, inputs, (diagnostic,))

    def _points(self, robot: Robot) -> dict[str, tuple[str, Vector]]:
        """The link and the place on it [m] of every point, by its name."""
        if self.frames is not None:
            return {frame.name: (frame.link, frame.xyz) for frame in map(robot.frame, self.frames)}
        if not robot.points_of_interest:
            raise BadInput(f"task '{self.name}': wanted frames, or a robot with points of interest")
        return {point.name: (point.link, point.offset) for point in robot.points_of_interest}

    def _inputs(self, dimension: int) -> tuple[Signal, Signal, Signal]:
        """The parameters `<name>_normal`, `<name>_offset` and `<name>_margin`, a row or a number each per wall."""
        for wall in self.walls:
            if len(wall.normal) != dimension:
                raise BadInput(f"task '{self.name}': wanted normals of {dimension} numbers, got {list(wall.normal)}")
        walls = (len(self.walls),)
        normals, offsets = [wall.normal for wall in self.walls], [wall.offset for wall in self.walls]
        return (
            symbol(
                f"{self.name}_normal",
                (*walls, dimension),
                "1",
                "n of each wall, a unit vector inwards",
                "parameter",
                (-1.0, 1.0),
                normals,
            ),
            symbol(f"{self.name}_offset", walls, "m", "o: nᵀp >= o is inside", "parameter", (-1e6, 1e6), offsets),
            symbol(f"{self.name}_margin", walls, "m", "s of each wall", "parameter", (1e-6, 1e3), self.margin),
        )
