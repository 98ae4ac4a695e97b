"""Reference trajectories: position and its exact time derivative over time, for tasks and moving obstacles."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator
from scipy.interpolate import CubicSpline

from clikgen.runtime.documents import BadInput, Document, NonNegative, Number, Positive, read_text

Array = NDArray[np.float64]
Position = Annotated[tuple[Number, ...], Field(min_length=1, max_length=3)]


class Trajectory(Document, ABC):
    """A motion that starts after `delay` [s]; it holds its first and last position before and after."""

    delay: NonNegative = 0.0

    @property
    @abstractmethod
    def dimension(self) -> int:
        """How many coordinates a position has."""

    @abstractmethod
    def _moving(self, t: Array) -> tuple[Array, Array]:
        """Position and velocity `t` [s] after the delay, where 0 <= t <= `_end`."""

    @property
    @abstractmethod
    def _end(self) -> float:
        """How long the motion lasts [s], without the delay."""

    def sample(self, t: Array) -> tuple[Array, Array]:
        """Position (k, m) [m] and velocity (k, m) [m/s] at the times t (k,) [s]."""
        since = t - self.delay
        position, velocity = self._moving(np.clip(since, 0.0, self._end))
        resting = (since < 0) | (since > self._end)
        velocity[resting] = 0.0
        return position, velocity


class Fixed(Trajectory):
    """A point that stays where it is."""

    kind: Literal["fixed"]
    position: Position

    @property
    def dimension(self) -> int:
        """As many as the position has."""
        return len(self.position)

    @property
    def _end(self) -> float:
        return 0.0

    def _moving(self, t: Array) -> tuple[Array, Array]:
        position = np.broadcast_to(np.asarray(self.position), (t.size, self.dimension)).copy()
        return position, np.zeros_like(position)


class _Straight(Trajectory):
    """From `start` to `end` [m] in `duration` [s]."""

    start: Position
    end: Position
    duration: Positive

    @model_validator(mode="after")
    def _same_dimension(self) -> Self:
        if len(self.start) != len(self.end):
            raise ValueError(f"wanted start and end of one length, got {len(self.start)} and {len(self.end)}")
        return self

    @property
    def dimension(self) -> int:
        """As many as the start has."""
        return len(self.start)

    @property
    def _end(self) -> float:
        return self.duration

    def _along(self, share: Array, rate: Array) -> tuple[Array, Array]:
        """Position and velocity for the share of the way (k,) and its rate (k,) [1/s]."""
        start, way = np.asarray(self.start), np.subtract(self.end, self.start)
        return start + share[:, None] * way, rate[:, None] * way


class Line(_Straight):
    """A straight line at constant speed: a ramp, with a velocity step at either end."""

    kind: Literal["line"]

    def _moving(self, t: Array) -> tuple[Array, Array]:
        return self._along(t / self.duration, np.full_like(t, 1 / self.duration))


class PointToPoint(_Straight):
    """A straight line with the quintic time law 10τ³ − 15τ⁴ + 6τ⁵: at rest, unaccelerated, at both ends."""

    kind: Literal["point_to_point"]

    def _moving(self, t: Array) -> tuple[Array, Array]:
        tau = t / self.duration
        rate = (30 * tau**2 - 60 * tau**3 + 30 * tau**4) / self.duration
        return self._along(10 * tau**3 - 15 * tau**4 + 6 * tau**5, rate)


class Circle(Trajectory):
    """Turns about `center` in the x-y plane, one in `period` [s] (negative: clockwise), from `phase` [rad]."""

    kind: Literal["circle"]
    center: Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)]
    radius: Positive
    period: Number
    phase: Number = 0.0

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if self.period == 0:
            raise ValueError("wanted a period other than 0")
        return self

    @property
    def dimension(self) -> int:
        """As many as the centre has."""
        return len(self.center)

    @property
    def _end(self) -> float:
        return np.inf

    def _moving(self, t: Array) -> tuple[Array, Array]:
        rate = 2 * np.pi / self.period
        angle = self.phase + rate * t
        position = np.tile(np.asarray(self.center, dtype=float), (t.size, 1))
        velocity = np.zeros_like(position)
        position[:, :2] += self.radius * np.column_stack([np.cos(angle), np.sin(angle)])
        velocity[:, :2] = self.radius * rate * np.column_stack([-np.sin(angle), np.cos(angle)])
        return position, velocity


class _Interpolated(Trajectory):
    """A cubic spline through positions at times, at rest at both ends."""

    def _knots(self) -> tuple[Array, Array]:
        """Times (k,) [s] from zero, and positions (k, m) [m]."""
        raise AssertionError("each kind of spline has its own knots")

    @property
    def dimension(self) -> int:
        """As many as a waypoint has."""
        return int(self._knots()[1].shape[1])

    @property
    def _end(self) -> float:
        return float(self._knots()[0][-1])

    def _moving(self, t: Array) -> tuple[Array, Array]:
        spline = CubicSpline(*self._knots(), bc_type="clamped")
        return spline(t), spline(t, 1)


def _check_knots(times: Array, positions: Array) -> None:
    """Raises ValueError unless there are two knots or more, at times that start at zero and increase."""
    if len(times) < 2 or len(times) != len(positions):
        raise ValueError(f"wanted two or more waypoints and as many times, got {len(positions)} and {len(times)}")
    if times[0] != 0 or np.any(np.diff(times) <= 0):
        raise ValueError(f"wanted times that start at 0 and increase, got {times.tolist()}")


class Spline(_Interpolated):
    """A cubic spline through `waypoints` [m] at `times` [s], the first of which is 0."""

    kind: Literal["spline"]
    waypoints: tuple[Position, ...]
    times: tuple[Number, ...]

    @model_validator(mode="after")
    def _knots_are_sound(self) -> Self:
        if len({len(waypoint) for waypoint in self.waypoints}) > 1:
            raise ValueError("wanted waypoints of one length")
        _check_knots(*self._knots())
        return self

    def _knots(self) -> tuple[Array, Array]:
        return np.asarray(self.times, dtype=float), np.asarray(self.waypoints, dtype=float)


class Csv(_Interpolated):
    """A cubic spline through the rows of a CSV `file`: a header line, then time [s] and coordinates [m]."""

    kind: Literal["csv"]
    file: str
    _rows: tuple[Array, Array] = PrivateAttr()

    @model_validator(mode="after")
    def _file_is_read_once(self) -> Self:
        lines = read_text(Path(self.file)).splitlines()[1:]
        try:
            rows = np.array([[float(cell) for cell in line.split(",")] for line in lines if line.strip()])
        except ValueError as error:
            raise BadInput(f"{self.file}: wanted rows of numbers 't,x,y' of one length: {error}") from None
        if rows.ndim != 2 or rows.shape[1] < 2 or not np.all(np.isfinite(rows)):
            raise BadInput(f"{self.file}: wanted a header, then rows of finite numbers 't,x,y'")
        self._rows = rows[:, 0], rows[:, 1:]
        _check_knots(*self._rows)
        return self

    def _knots(self) -> tuple[Array, Array]:
        return self._rows


AnyTrajectory = Annotated[Fixed | Line | PointToPoint | Circle | Spline | Csv, Field(discriminator="kind")]
