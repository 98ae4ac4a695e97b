"""What was aimed at, and what came out."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Aim:
    """So many times as fast as a peer on a robot, the peer by how its name begins."""

    robot: str
    peer: str
    times: float


AIMS = (
    Aim("planar5", "Pink", 100),
    Aim("planar5", "mink", 100),
    Aim("planar5", "Pinocchio + numpy", 100),
    Aim("arm7", "Pinocchio + numpy", 30),
    Aim("planar5", "Pinocchio + Eigen", 4),
    Aim("arm7", "Pinocchio + Eigen", 4),
)
BATCHES = (Aim("batches", "JAX", 10), Aim("batches", "numpy", 10))


def reached(steps: Sequence[Row], batches: Sequence[Row]) -> Iterator[dict[str, Any]]:
    """A row each: the aim, what came out against `step(q=...)` (our C for C++), and against the fastest of ours."""
    for aim in AIMS:
        for row in steps:
            if row["robot"] == aim.robot and row["name"].startswith(aim.peer):
                name = row["name"].partition(",")[0] + (f", {row['does']}" if row["law"] == "unlike" else "")
                yield outcome(aim, name, row["times_ours"], row["times_best"])
    for aim in BATCHES:
        for row in batches:
            if row["name"].startswith(aim.peer):
                yield outcome(aim, row["name"], None, row["times_ours"])


def outcome(aim: Aim, name: str, ours: float | None, best: float) -> dict[str, Any]:
    """Both have to be there for a yes."""
    least = min(one for one in (ours, best) if one is not None)
    verdict = "yes" if least >= aim.times else "only the fastest" if best >= aim.times else "no"
    found = {"robot": aim.robot, "than": name, "wanted": aim.times, "times_ours": ours, "times_best": best}
    return found | {"reached": verdict}
