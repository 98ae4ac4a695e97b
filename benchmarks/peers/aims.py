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
    """A row each: the aim, and what came out against `step(q=...)`, for C++ against our C."""
    for aim in AIMS:
        for row in steps:
            if row["robot"] == aim.robot and row["name"].startswith(aim.peer):
                name = row["name"].partition(",")[0] + (f", {row['does']}" if row["law"] == "unlike" else "")
                yield outcome(aim, name, row["times_ours"])
    for aim in BATCHES:
        for row in batches:
            if row["name"].startswith(aim.peer):
                yield outcome(aim, row["name"], row["times_ours"])


def outcome(aim: Aim, name: str, times: float) -> dict[str, Any]:
    verdict = "yes" if times >= aim.times else "no"
    return {"robot": aim.robot, "than": name, "wanted": aim.times, "times_ours": times, "reached": verdict}
