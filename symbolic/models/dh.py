"""A robot from a table of Denavit-Hartenberg parameters, of either convention."""

from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from clikgen.runtime.documents import Document, NonNegative, Number
from clikgen.symbolic.robot import Joint, Name


class DHRow(Document):
    """One row: a moving joint, `a` and `d` in m, `alpha` and `theta` in rad.

    The joint's coordinate adds to `theta` (revolute, continuous) or to `d` (prismatic).
    """

    name: Name
    type: Literal["prismatic", "revolute", "continuous"] = "revolute"
    link: Name | None = Field(default=None, description="the link whose frame is the row's; default: NAME_link")
    a: Number = 0.0
    alpha: Number = 0.0
    d: Number = 0.0
    theta: Number = 0.0
    lower: Number | None = None
    upper: Number | None = None
    velocity: NonNegative | None = None

    @model_validator(mode="after")
    def _makes_a_joint(self) -> Self:
        try:
            _moving(self, "link")
        except ValidationError as error:
            raise ValueError(error.errors()[0]["msg"].removeprefix("Value error, ")) from None
        return self


class DHTable(Document):
    """Rows from the base to the tool.

    standard (Denavit & Hartenberg 1955): frame i from frame i−1 is Rz(theta) Tz(d) Tx(a) Rx(alpha), with the
    joint before a and alpha; modified (Craig 1986): Tx(a) Rx(alpha) Rz(theta) Tz(d), with the joint after them.
    """

    convention: Literal["standard", "modified"]
    rows: Annotated[tuple[DHRow, ...], Field(min_length=1)]

    def joints(self) -> tuple[Joint, ...]:
        """The same robot as joints: one that moves per row and, where a or alpha is not 0, one that is fixed.

        Splitting the row so keeps every number as it was written: no matrix is turned back into angles.
        """
        return tuple(joint for row in self.rows for joint in self._expanded(row))

    def _expanded(self, row: DHRow) -> list[Joint]:
        link = row.link or f"{row.name}_link"
        if row.a == row.alpha == 0:
            return [_moving(row, link)]
        axis = f"{link}_axis"  # the link of which z is the joint's axis
        offset = {"name": f"{row.name}_offset", "type": "fixed", "xyz": (row.a, 0, 0), "rpy": (row.alpha, 0, 0)}
        if self.convention == "standard":
            return [_moving(row, axis), Joint.model_validate(offset | {"link": link})]
        return [Joint.model_validate(offset | {"link": axis}), _moving(row, link)]


def _moving(row: DHRow, link: str) -> Joint:
    return Joint(
        name=row.name,
        type=row.type,
        link=link,
        xyz=(0.0, 0.0, row.d),
        rpy=(0.0, 0.0, row.theta),
        lower=row.lower,
        upper=row.upper,
        velocity=row.velocity,
    )
