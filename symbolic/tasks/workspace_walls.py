"""Workspace walls: points of the robot stay on the inner side of walls."""

from typing import Annotated, Literal

import casadi as ca
from pydantic import Field

from clikgen.runtime.documents import BadInput, Document, Number, Positive, UnitVector
from clikgen.symbolic.activation import Boundary
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.robot import Robot, Vector
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.tree import KinematicTree


class Wall(Document):
    """The inner side of a wall: all points p with normalᵀp >= offset [m]; the unit normal points inwards."""

    normal: UnitVector[Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]]
    offset: Number


class Spec(OneSidedSpec):
    """Every point keeps a distance s from each wall, d = nᵀp − o.

    There is one contact for each of the `walls` and each of the points: the origins of `frames`, by default the
    robot's points of interest. `margin` is s [m], a number or a list with one per wall. n, o and s are parameters:
    keep n a unit vector.
    """

    kind: Literal["workspace_walls"]
    walls: Annotated[tuple[Wall, ...], Field(min_length=1)]
    frames: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    margin: Positive | tuple[Positive, ...]

    def contacts(self, robot: Robot) -> int:
        """One a wall and point."""
        return len(self.walls) * len(self._points(robot))

    def boundary(self, tree: KinematicTree, sensing: Sensing | None) -> Boundary:
        """A contact a wall and point; raises BadInput without points, or for a normal of the wrong length."""
        points = self._points(tree.robot)
        inputs = self._inputs(tree.robot.dimension)
        normal, offset, margin = (signal.expression for signal in inputs)
        contacts = []
        for k in range(len(self.walls)):
            for link, place in points.values():
                distance = normal[k, :] @ tree.position(link, place) - offset[k]
                approach = -normal[k, :] @ tree.position_jacobian(link, place)
                contacts.append(Contact(distance, margin[k], approach))
        distances = ca.reshape(ca.vertcat(*(contact.distance for contact in contacts)), len(points), len(self.walls)).T
        text = f"d to each wall (row) of each point: {', '.join(points)}"
        diagnostic = result(f"{self.name}_distance", distances, distances.shape, "m", text)
        return Boundary(self.name, "m", tuple(contacts), inputs, (diagnostic,))

    def _points(self, robot: Robot) -> dict[str, tuple[str, Vector]]:
        """The link and the place on it [m] of every point, by its name."""
        if self.frames is not None:
            return {frame.name: (frame.link, frame.xyz) for frame in map(robot.frame, self.frames)}
        if not robot.points_of_interest:
            raise BadInput("wanted frames, or a robot with points of interest")
        return {point.name: (point.link, point.offset) for point in robot.points_of_interest}

    def _inputs(self, dimension: int) -> tuple[Signal, Signal, Signal]:
        """The parameters `<name>_normal`, `<name>_offset` and `<name>_margin`, a row or a number each per wall."""
        for wall in self.walls:
            if len(wall.normal) != dimension:
                raise BadInput(f"wanted normals of {dimension} numbers, got {list(wall.normal)}")
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
