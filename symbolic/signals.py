"""A named, shaped, documented symbol: what a generated function takes or gives."""

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from clikgen.runtime.manifest import Role, SignalInfo


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """A signal and its expression, flattened row by row into a column as the C array will hold it."""

    info: SignalInfo
    column: ca.SX  # (size, 1)

    @property
    def expression(self) -> ca.SX:
        """The expression in its own shape: a scalar, a column for a vector, a matrix."""
        if len(self.info.shape) < 2:
            return self.column
        rows = self.info.shape[0]
        return ca.reshape(self.column, self.info.size // rows, rows).T


def symbol(
    name: str,
    shape: tuple[int, ...],
    unit: str,
    description: str,
    role: Role,
    limits: tuple[float, float],
    default: ArrayLike = 0.0,
    *,
    positive_definite: bool = False,
) -> Signal:
    """A new input whose entries lie within `limits`; `default` is expanded to `shape` as SignalInfo.value does."""
    info = SignalInfo(
        name=name,
        shape=shape,
        unit=unit,
        description=description,
        role=role,
        minimum=limits[0],
        maximum=limits[1],
        positive_definite=positive_definite,
    )
    values = info.value(default, f"the default of {name}")
    info = info.model_copy(update={"default": tuple(float(value) for value in np.ravel(values))})
    return Signal(info, ca.SX.sym(name, info.size))


def result(
    name: str,
    expression: ca.SX,
    shape: tuple[int, ...],
    unit: str,
    description: str,
    role: Role = "diagnostic",
    feeds: str | None = None,
) -> Signal:
    """A new output of `shape` from an expression with as many entries, taken row by row."""
    if math.prod(shape) != expression.numel():
        raise ValueError(f"{name}: an expression of shape {expression.shape} does not fill {shape}")
    info = SignalInfo(name=name, shape=shape, unit=unit, description=description, role=role, feeds=feeds)
    return Signal(info, ca.densify(ca.vec(expression.T)))
