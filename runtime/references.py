"""Reference trajectories: a value and its exact velocity over time, for tasks and moving obstacles.

A vector has the unit of its task: a position [m], joints [m, rad], a heading [rad]. A rotation is the unit
quaternion (w, x, y, z) of world_R_frame; its velocity is the angular velocity in the world frame [rad/s].
"""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, model_validator
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from clikgen.runtime.documents import BadInput, Document, NonNegative, Number, Positive, read_text

Array = NDArray[np.float64]
Position = Annotated[tuple[Number, ...], Field(min_length=1)]
Triple = Annotated[tuple[Number, ...], Field(min_length=3, max_length=3)]


class Trajectory(Document, ABC):
    """A motion that starts after `delay` [s]; it holds its first and last value before and after."""

    kind: str
    delay: NonNegative = 0.0

    @property
    @abstractmethod
    def space(self) -> Literal["vector", "rotation"]:
        """What its values are: vectors of coordinates, or unit quaternions."""

    @property
    @abstractmethod
    def dimension(self) -> int:
        """How many coordinates a velocity has: as many as the vector, 3 for a rotation."""

    @abstractmethod
    def _moving(self, t: Array) -> tuple[Array, Array]:
        """Value and velocity `t` [s] after the delay, where 0 <= t <= `_end`."""

    @property
    @abstractmethod
    def _end(self) -> float:
        """How long the motion lasts [s], without the delay."""

    def sample(self, t: Array) -> tuple[Array, Array]:
        """Value and velocity at the times t (k,) [s].

        A vector of m coordinates: (k, m) in the unit of the task, and (k, m) in that unit per second.
        A rotation: unit quaternions (k, 4), whose sign is continuous over time, and (k, 3) [rad/s].
        """
        since = t - self.delay
        value, velocity = self._moving(np.clip(since, 0.0, self._end))
        resting = (since < 0) | (since > self._end)
        velocity[resting] = 0.0
        return value, velocity


def _quintic(tau: Array) -> tuple[Array, Array]:
    """The time law 10τ³ − 15τ⁴ + 6τ⁵ and its slope, for τ from 0 to 1: at rest, unaccelerated, at both ends."""
    return 10 * tau**3 - 15 * tau**4 + 6 * tau**5, 30 * tau**2 - 60 * tau**3 + 30 * tau**4


def _check_knots(times: Array, waypoints: Array) -> None:
    """Raises ValueError unless there are two knots or more, at times that start at zero and increase."""
    if len(times) < 2 or len(times) != len(waypoints):
        raise ValueError(f"wanted two or more waypoints and as many times, got {len(waypoints)} and {len(times)}")
    if times[0] != 0 or np.any(np.diff(times) <= 0):
        raise ValueError(f"wanted times that start at 0 and increase, got {times.tolist()}")


# ---- Vectors ----


class _VectorTrajectory(Trajectory):
    """A motion of one or more coordinates, in the unit of the task."""

    @property
    def space(self) -> Literal["vector"]:
        """Vectors of coordinates."""
        return "vector"


class Fixed(_VectorTrajectory):
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


class _Straight(_VectorTrajectory):
    """From `start` to `end` in `duration` [s]."""

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
        share, slope = _quintic(t / self.duration)
        return self._along(share, slope / self.duration)


class Circle(_VectorTrajectory):
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


class _Interpolated(_VectorTrajectory):
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


class Spline(_Interpolated):
    """A cubic spline through `waypoints` at `times` [s], the first of which is 0."""

    kind: Literal["spline"]
    waypoints: tuple[Position, ...]
    times: tuple[Number, ...]

    @model_validator(mode="after")
    def _knots_are_sound(self) -> Self:
        lengths = [len(waypoint) for waypoint in self.waypoints]
        if len(set(lengths)) > 1:
            raise ValueError(f"wanted waypoints of one length, got {lengths}")
        _check_knots(*self._knots())
        return self

    def _knots(self) -> tuple[Array, Array]:
        return np.asarray(self.times, dtype=float), np.asarray(self.waypoints, dtype=float)


class Csv(_Interpolated):
    """A cubic spline through the rows of a CSV `file`: a header line, then time [s] and coordinates."""

    kind: Literal["csv"]
    file: str
    _rows: tuple[Array, Array] = PrivateAttr()

    @model_validator(mode="after")
    def _file_is_read_once(self) -> Self:
        lines = read_text(Path(self.file)).splitlines()[1:]
        try:
            rows = np.array([[float(cell) for cell in line.split(",")] for line in lines if line.strip()])
        except ValueError as error:
            raise BadInput(f"{self.file}: wanted rows of numbers 't,x,...' of one length: {error}") from None
        if rows.ndim != 2 or rows.shape[1] < 2 or not np.all(np.isfinite(rows)):
            raise BadInput(f"{self.file}: wanted a header, then rows of finite numbers 't,x,...'")
        self._rows = rows[:, 0], rows[:, 1:]
        _check_knots(*self._rows)
        return self

    def _knots(self) -> tuple[Array, Array]:
        return self._rows


# ---- Rotations ----


def _from_rpy(rpy: tuple[float, ...]) -> Rotation:
    """Rz(yaw) Ry(pitch) Rx(roll) [rad]: roll, pitch, yaw about the fixed axes, as in a URDF."""
    return Rotation.from_euler("xyz", rpy)


class _RotationTrajectory(Trajectory):
    """A motion of the orientation world_R_frame."""

    @property
    def space(self) -> Literal["rotation"]:
        """Unit quaternions (w, x, y, z)."""
        return "rotation"

    @property
    def dimension(self) -> int:
        """Three: the angular velocity's."""
        return 3


class Orientation(_RotationTrajectory):
    """An orientation that stays as it is: `rpy` [rad] about the fixed axes, as in a URDF."""

    kind: Literal["orientation"]
    rpy: Triple

    @property
    def _end(self) -> float:
        return 0.0

    def _moving(self, t: Array) -> tuple[Array, Array]:
        quaternion = _from_rpy(self.rpy).as_quat(scalar_first=True)
        return np.tile(quaternion, (t.size, 1)), np.zeros((t.size, 3))


class _AboutOneAxis(_RotationTrajectory):
    """From `start` (rpy [rad]) about an axis that stands still in the world, for `duration` [s].

    R(t) = exp(angle(t) [axis]) R(0), so the angular velocity is axis · d(angle)/dt.
    """

    start: Triple
    duration: Positive

    @property
    def _end(self) -> float:
        return self.duration

    def _about(self, axis: Array, angle: Array, rate: Array) -> tuple[Array, Array]:
        """Quaternion and angular velocity for `axis` (3,) times the angles (k,) and rates (k,) [1/s]."""
        # the quaternion of a rotation vector has cos(angle/2): its sign goes on smoothly past half a turn
        rotation = Rotation.from_rotvec(angle[:, None] * axis) * _from_rpy(self.start)
        return rotation.as_quat(scalar_first=True), rate[:, None] * axis


class Turn(_AboutOneAxis):
    """From `start` to `end` (rpy [rad]) the shortest way, with the time law of point_to_point.

    Half a turn has two shortest ways; it goes one of them.
    """

    kind: Literal["turn"]
    end: Triple

    def _moving(self, t: Array) -> tuple[Array, Array]:
        way = (_from_rpy(self.end) * _from_rpy(self.start).inv()).as_rotvec()  # (3,) [rad], at most π long
        share, slope = _quintic(t / self.duration)
        return self._about(way, share, slope / self.duration)


class Spin(_AboutOneAxis):
    """About the world's `axis` (of any length) at the constant `rate` [rad/s]: a ramp, with a step at either end."""

    kind: Literal["spin"]
    axis: Triple
    rate: Number

    @model_validator(mode="after")
    def _has_an_axis(self) -> Self:
        if not any(self.axis):
            raise ValueError(f"wanted an axis other than zero, got {list(self.axis)}")
        return self

    def _moving(self, t: Array) -> tuple[Array, Array]:
        axis = np.asarray(self.axis) / np.max(np.abs(self.axis))  # first, so that no square under- or overflows
        return self._about(axis / np.linalg.norm(axis), self.rate * t, np.full_like(t, self.rate))


class OrientationSpline(_RotationTrajectory):
    """A smooth way through `waypoints` (rpy [rad]) at `times` [s], the first of which is 0; at rest at both ends.

    R(t) = S(s(t)) with SciPy's RotationSpline S, which cannot start at rest, and a cubic spline s, s(times) = times,
    whose slope is zero at both ends. The angular velocity S'(s) s'(t) is continuous. From each waypoint to the next
    it takes about the shortest way.
    """

    kind: Literal["orientation_spline"]
    waypoints: tuple[Triple, ...]
    times: tuple[Number, ...]

    @model_validator(mode="after")
    def _knots_are_sound(self) -> Self:
        _check_knots(np.asarray(self.times, dtype=float), np.asarray(self.waypoints, dtype=float))
        return self

    @property
    def _end(self) -> float:
        return self.times[-1]

    def _moving(self, t: Array) -> tuple[Array, Array]:
        # Never backwards: with the slopes 1 + e, a clamped cubic spline has e = -1 at its ends and |e| <= 1/2
        # between, so every slope is in the [0, 3] that keeps a cubic monotone (Fritsch & Carlson 1980).
        warp = CubicSpline(self.times, self.times, bc_type="clamped")
        s = warp(t)
        path = RotationSpline(self.times, _of_like_sign(Rotation.from_euler("xyz", self.waypoints)))
        rotation = path(s)
        velocity = rotation.apply(path(s, 1)) * warp(t, 1)[:, None]  # SciPy's rate is in the turning frame
        return rotation.as_quat(scalar_first=True), velocity


def _of_like_sign(rotations: Rotation) -> Rotation:
    """The same rotations; from each to the next, the shortest way changes no quaternion's sign."""
    # the product and not a dot product, as RotationSpline itself takes it: half a turn is decided by rounding
    step = (rotations[:-1].inv() * rotations[1:]).as_quat(scalar_first=True)  # (k - 1, 4)
    signs = np.cumprod(np.append(1.0, np.where(step[:, 0] < 0, -1.0, 1.0)))
    return Rotation.from_quat(signs[:, None] * rotations.as_quat())


AnyTrajectory = Annotated[
    Fixed | Line | PointToPoint | Circle | Spline | Csv | Orientation | Turn | Spin | OrientationSpline,
    Field(discriminator="kind"),
]
"""Every kind of reference: its velocity is the derivative of its value, and it starts and ends as it says."""
