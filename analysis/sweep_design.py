"""The file of a sweep, and its design: row i is a function of the file and i alone, whoever asks for it and when."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Discriminator, Field, Tag, field_validator, model_validator
from scipy.stats import qmc, truncnorm

from clikgen.runtime.documents import Document, Number, Positive

Array = NDArray[np.float64]

LARGEST = 10_000_000  # rollouts; more is taken for a slip of the pen
CHUNK = 16_384  # rollouts that are run, and kept, together
Count = Annotated[int, Field(strict=True, ge=1, le=LARGEST)]
Pair = tuple[Number, Number]

# ---- Axes: what varies, and over what ----


class Axis(Document, ABC):
    """One thing that varies: `key` is what the step is given, as in tool_gain, q[2] or obstacles[0].center[1]."""

    key: str

    @property
    @abstractmethod
    def points(self) -> Array | None:
        """Its values in a grid, (k, ...); None where it has none, but a distribution."""

    @abstractmethod
    def pick(self, u: Array) -> Array:
        """The values that belong to the quantiles u (k,) in [0, 1], (k, ...)."""

    @property
    @abstractmethod
    def ends(self) -> Array:
        """Values, (k, ...), between which all others lie."""

    @property
    def heads(self) -> list[str]:
        """The names of its columns: the key, or one with an index for every entry of an array."""
        return [self.key + "".join(f"[{i}]" for i in index) for index in np.ndindex(self.ends.shape[1:])]


class ListedAxis(Axis):
    """The values of a list: numbers, or arrays of one shape; drawn at random, each is as likely as the others."""

    values: Annotated[tuple[Any, ...], Field(min_length=1)]

    @field_validator("values")
    @classmethod
    def _of_one_shape(cls, values: tuple[Any, ...]) -> tuple[Any, ...]:
        try:
            array = np.array(values)
        except ValueError:
            array = np.array("ragged")
        if array.dtype.kind not in "if" or not array.size or not np.all(np.isfinite(array)):
            raise ValueError("wanted finite numbers, or arrays of them of one shape")
        return values

    @property
    def points(self) -> Array:
        """All of them."""
        return np.array(self.values, dtype=np.float64)

    @property
    def ends(self) -> Array:
        """All of them."""
        return self.points

    def pick(self, u: Array) -> Array:
        """The i-th of n for u in [i/n, (i + 1)/n)."""
        n = len(self.values)
        return self.points[np.minimum((u * n).astype(np.int64), n - 1)]


class RangeAxis(Axis):
    """From the one end of `range` to the other: in a grid at `count` points, else uniform; evenly on its `scale`."""

    range: Pair
    scale: Literal["linear", "log"] = "linear"
    count: Annotated[int, Field(strict=True, ge=2, le=LARGEST)] | None = None

    @model_validator(mode="after")
    def _increases(self) -> Self:
        _check_range(self.range)
        if self.scale == "log" and self.range[0] <= 0:
            raise ValueError(f"wanted positive ends on a log scale, got {list(self.range)}")
        return self

    @property
    def points(self) -> Array | None:
        """`count` of them, the ends included."""
        spaced = np.geomspace if self.scale == "log" else np.linspace
        return None if self.count is None else np.asarray(spaced(*self.range, self.count), dtype=np.float64)

    @property
    def ends(self) -> Array:
        """Those of the range."""
        return np.array(self.range)

    def pick(self, u: Array) -> Array:
        """a + u (b − a), or a (b/a)^u on a log scale."""
        low, high = self.range
        drawn = np.exp(math.log(low) + u * math.log(high / low)) if self.scale == "log" else low + u * (high - low)
        return np.clip(drawn, low, high)  # an end is met exactly, never passed by rounding


class NormalAxis(Axis):
    """Normally distributed about `mean`, cut off at the ends of `range`: by default, the limits of what is set."""

    mean: Number
    deviation: Positive
    range: Pair | None = None

    @model_validator(mode="after")
    def _increases(self) -> Self:
        if self.range:
            _check_range(self.range)
        return self

    @property
    def points(self) -> None:
        """None: it has no place in a grid."""

    @property
    def ends(self) -> Array:
        """Where it is cut off."""
        return np.array(self.range or (-math.inf, math.inf))

    def pick(self, u: Array) -> Array:
        """The quantiles of the distribution that is cut off."""
        low, high = self.ends
        a, b = (low - self.mean) / self.deviation, (high - self.mean) / self.deviation
        drawn = truncnorm.ppf(np.clip(u, 2.0**-54, 1 - 2.0**-53), a, b, loc=self.mean, scale=self.deviation)
        return np.clip(np.asarray(drawn, dtype=np.float64), low, high)


def _check_range(ends: Pair) -> None:
    if ends[0] >= ends[1]:
        raise ValueError(f"wanted a range of two numbers that increase, got {list(ends)}")


def _kind_of_axis(data: Any) -> str | None:
    """Told by its keys: a mistake in an axis is then a mistake in one kind of axis. None where they tell nothing."""
    keys = data if isinstance(data, Mapping) else getattr(data, "model_fields_set", ())
    kinds = {"values": "listed", "mean": "normal", "deviation": "normal", "range": "range"}
    return next((kind for key, kind in kinds.items() if key in keys), None)


AnyAxis = Annotated[
    Annotated[ListedAxis, Tag("listed")] | Annotated[RangeAxis, Tag("range")] | Annotated[NormalAxis, Tag("normal")],
    Discriminator(
        _kind_of_axis,
        custom_error_type="axis",
        custom_error_message="wanted 'values', 'range', or 'mean' and 'deviation'",
    ),
]

# ---- Designs: which combinations of them ----


class Grid(Document):
    """Every combination; the last axis changes fastest."""

    kind: Literal["grid"]

    def size(self, axes: Sequence[Axis]) -> int:
        """The product of the numbers of points."""
        return math.prod(len(_points(axis)) for axis in axes)

    def check(self, axes: Sequence[Axis]) -> None:
        """Raises ValueError where an axis has no points."""
        for i, axis in enumerate(axes):
            if axis.points is None:
                raise ValueError(f"axes.{i}: a grid wants 'values', or 'range' and 'count', for {axis.key!r}")

    def rows(self, axes: Sequence[Axis], first: int, count: int) -> list[Array]:
        """Rows first .. first + count − 1: an array (count, ...) for every axis."""
        points = [_points(axis) for axis in axes]
        indices = np.unravel_index(np.arange(first, first + count), [len(one) for one in points])
        return [one[index] for one, index in zip(points, indices, strict=True)]


def _points(axis: Axis) -> Array:
    points = axis.points
    assert points is not None, "Grid.check lets no other axis through"
    return points


class Drawn(Document):
    """`count` rows drawn at random, or spread evenly by one of SciPy's quasi-random designs (scrambled)."""

    kind: Literal["random", "latin_hypercube", "sobol"]
    count: Count
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63, description="another one gives other rows")] = 0

    def size(self, axes: Sequence[Axis]) -> int:
        """As many as are wanted, of however many axes."""
        return self.count

    def check(self, axes: Sequence[Axis]) -> None:
        """Raises ValueError for an axis with a number of points, which is for a grid."""
        for i, axis in enumerate(axes):
            if isinstance(axis, RangeAxis) and axis.count is not None:
                raise ValueError(f"axes.{i}.count: wanted in a grid only; here [design] count says how many")

    def rows(self, axes: Sequence[Axis], first: int, count: int) -> list[Array]:
        """Rows first .. first + count − 1: an array (count, ...) for every axis."""
        return [axis.pick(u) for axis, u in zip(axes, self._quantiles(len(axes), first, count).T, strict=True)]

    def _quantiles(self, dimension: int, first: int, count: int) -> Array:
        """Points of the unit cube, (count, dimension)."""
        if self.kind == "latin_hypercube":
            return _latin_hypercube(self.count, dimension, self.seed)[first : first + count]
        if self.kind == "sobol":
            return _sobol(dimension, self.seed, first, count)
        return np.column_stack([_uniform(self.seed, stream, first, count) for stream in range(dimension)])


def _uniform(seed: int, stream: int, first: int, count: int) -> Array:
    """Numbers first .. first + count − 1 of a stream in [0, 1): Philox counts, so none before them need be drawn."""
    block, offset = divmod(first, 4)  # one count of Philox4x64 makes four numbers
    generator = np.random.Generator(np.random.Philox(key=np.array([seed, stream], np.uint64), counter=block))
    return generator.random(offset + count)[offset:]


def _sobol(dimension: int, seed: int, first: int, count: int) -> Array:
    sampler = qmc.Sobol(dimension, rng=seed)
    if first:
        sampler.fast_forward(first)
    # SciPy warns of numbers of points other than powers of two, of which a chunk is no sign
    return np.asarray(sampler.random(1 << (count - 1).bit_length())[:count], dtype=np.float64)


@lru_cache(maxsize=1)
def _latin_hypercube(count: int, dimension: int, seed: int) -> Array:
    """The whole design: a row of it is a matter of all others."""
    return np.asarray(qmc.LatinHypercube(dimension, rng=seed).random(count), dtype=np.float64)


class SweepFile(Document):
    """A sweep: rollouts of a scenario, one for every row of a design, and what to measure of each."""

    scenario: str
    case: Literal[1, 2, 3] | None = None
    settings: Mapping[str, Any] = {}
    steps: Count | None = None
    metrics: Annotated[tuple[str, ...], Field(min_length=1)]
    format: Literal["parquet", "csv"] = "parquet"
    chunk: Annotated[int, Field(strict=True, ge=1, le=65536)] = CHUNK
    design: Annotated[Grid | Drawn, Field(discriminator="kind")]
    axes: Annotated[tuple[AnyAxis, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for name, keys in (("axes", [axis.key for axis in self.axes]), ("metrics", list(self.metrics))):
            for key in keys:
                if keys.count(key) > 1:
                    raise ValueError(f"{name}: wanted each once, got {key!r} {keys.count(key)} times")
        self.design.check(self.axes)
        if self.count > LARGEST:
            raise ValueError(f"axes: wanted at most {LARGEST:,} rollouts, got {self.count:,}")
        return self

    @property
    def count(self) -> int:
        """How many rollouts there are."""
        return self.design.size(self.axes)

    @property
    def chunks(self) -> int:
        """How many chunks they are run in; the last one may be smaller."""
        return -(-self.count // self.chunk)

    def span(self, chunk: int) -> range:
        """The rows of a chunk."""
        return range(chunk * self.chunk, min((chunk + 1) * self.chunk, self.count))

    def rows(self, chunk: int) -> list[Array]:
        """What the axes are set to in the rows of a chunk: an array (rows, ...) for every axis."""
        span = self.span(chunk)
        return self.design.rows(self.axes, span.start, len(span))
