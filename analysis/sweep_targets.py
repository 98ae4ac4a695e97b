"""What the axes of a sweep set: entries of the step's inputs, by the keys that a user knows them by."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clikgen.analysis.sweep_design import AnyAxis
from clikgen.runtime.documents import BadInput, choices
from clikgen.runtime.manifest import Manifest, SignalInfo
from clikgen.runtime.scenario import CASES, Scenario

Array = NDArray[np.float64]

BY_CASE = ("lam_free", "lam_event")  # the inputs that a case stands for


@dataclass(frozen=True, slots=True)
class Target:
    """The entries of an input of the step that an axis sets: those at `index`, of the signal's shape."""

    signal: SignalInfo
    index: tuple[int, ...] = ()

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of these entries."""
        return self.signal.shape[len(self.index) :]

    @property
    def is_matrix(self) -> bool:
        """Whether a number k stands for k·I, and a list for the diagonal."""
        return self.signal.positive_definite and not self.index

    @property
    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """The shapes that a value may have."""
        return tuple(dict.fromkeys([(), *([self.shape[:1]] if self.is_matrix else []), self.shape]))

    def entries(self, values: Array) -> Array:
        """Values (k, ...) as (k, *shape): a number fills the entries, or the diagonal of a matrix."""
        if self.is_matrix and values.ndim < 3:
            matrices = np.zeros((len(values), *self.shape))
            diagonal = np.arange(self.shape[0])
            matrices[:, diagonal, diagonal] = values.reshape(len(values), -1)
            return matrices
        room = (len(values), *(1,) * (1 + len(self.shape) - values.ndim), *values.shape[1:])
        return np.broadcast_to(values.reshape(room), (len(values), *self.shape))

    def put(self, array: Array, values: Array) -> None:
        """Set these entries of `array`, (k, *signal.shape) or over time (k, steps, *signal.shape)."""
        time = array.ndim - 1 - len(self.signal.shape)
        entries = self.entries(values).reshape(len(values), *(1,) * time, *self.shape)
        array[(slice(None),) * (1 + time) + self.index] = entries

    def meets(self, other: "Target") -> bool:
        """Whether they have an entry in common."""
        common = min(len(self.index), len(other.index))
        return self.signal.name == other.signal.name and self.index[:common] == other.index[:common]


_PLACED = {  # what the obstacles of a scenario are to the step
    ("obstacles", "center"): "obstacle_center",
    ("obstacles", "radius"): "obstacle_radius",
    ("capsules", "start"): "capsule_start",
    ("capsules", "end"): "capsule_end",
    ("capsules", "radius"): "capsule_radius",
    ("half_spaces", "offset"): "half_space_offset",
}
_KEY = re.compile(r"([a-z]\w*)(?:\[(\d{1,9})\]\.(\w+))?((?:\[\d{1,9}\])*)", re.ASCII)


def find_targets(key: str, manifest: Manifest, scenario: Scenario, source: str) -> tuple[Target, ...]:
    """What an axis of that key sets; raises BadInput with the valid choices."""
    inputs = {signal.name: signal for signal in manifest.function("step").inputs}
    if key == "case" and (shares := [Target(inputs[name]) for name in BY_CASE if name in inputs]):
        return tuple(shares)
    valid = {name: Target(one) for name, one in inputs.items() if name == "q" or one.role == "parameter"}
    valid |= {
        f"{group}[{i}].{field}": Target(inputs[name], (i,))
        for (group, field), name in _PLACED.items()
        for i in range(len(getattr(scenario, group)))
    }
    name, place, field, index = parsed.groups("") if (parsed := _KEY.fullmatch(key)) else (key, "", "", "")
    wanted = f"{name}[{int(place)}].{field}" if place else name
    if wanted not in valid:
        raise BadInput(f"{source}: no input '{wanted}'; {choices(wanted, [*valid, 'case'])}")
    if field == "center" and scenario.obstacles[int(place)].center is None:
        raise BadInput(f"{source}: wanted an obstacle with a 'center', got {name}[{place}], which moves along a 'path'")
    whole = valid[wanted]
    own = tuple(int(one) for one in re.findall(r"\d+", index))
    sizes = whole.shape[:1] if whole.is_matrix else whole.shape
    if len(own) > len(sizes) or any(i >= size for i, size in zip(own, sizes, strict=False)):
        limits = "".join(f"[0 to {size - 1}]" for size in sizes)
        of = " (of the diagonal)" if whole.is_matrix else ""
        raise BadInput(f"{source}: wanted {wanted}{f' or {wanted}{limits}{of}' if sizes else ''}, got {key}")
    return (Target(whole.signal, whole.index + (own * 2 if whole.is_matrix else own)),)


@dataclass(frozen=True, slots=True)
class Setting:
    """An axis with what it sets: of the case, its two shares λ."""

    axis: AnyAxis
    targets: tuple[Target, ...]

    def values(self, drawn: Array) -> Iterator[tuple[Target, Array]]:
        """Every target and what it is set to, where the design has the values `drawn` (k, ...) for the axis."""
        for target in self.targets:
            if self.axis.key == "case":
                shares = np.array([getattr(case, target.signal.name) for case in CASES.values()])
                yield target, shares[np.searchsorted(list(CASES), drawn)]
            else:
                yield target, drawn
