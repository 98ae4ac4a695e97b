"""How the step grows: what every shipped controller costs, and the cost against points, obstacles and DoF.

`python benchmarks/growth.py [--quick] [--json]`

Each controller is generated, compiled into an empty cache with the flags that ship, and stepped in C through states
at random within the joint limits, with obstacles around the edge of the points' influence regions. `ns` is a step in
a state that stays for many steps, as nearly in a loop; `ns new` one in a state that has nothing to do with the one
before, so that the processor guesses its branches wrong. Controllers of one table are stepped in turn, round after
round; ns are medians of the rounds. Under a sweep: the exponents p of cost ~ size^p, the least-squares lines through
the logarithms of all its sizes, and of the largest alone.
"""

import json
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np
from common import compiler, machine, per_call
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledController
from clikgen.symbolic.generate import generate
from clikgen.symbolic.robot import PointOfInterest
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs

QUICK = "--quick" in sys.argv
SWITCHED = {"kind": "switched", "gain": 50.0, "damping": 1e-3}
ROUNDS = 5 if QUICK else 25
STATES = 4096  # at random: so many that no branch predictor learns them by heart
STAYS = 256  # steps in one state, for `ns`
BATCH = 5e6  # [ns] that one timed call into C takes at least: the 50 us of Python around it are 1 %
LARGEST = 3  # sizes of a sweep through which its last line goes
COLUMNS = ("operations", "C_kB", "generate_s", "compile_s", "ns", "ns_new")
NOT_FASTER = "wanted: ns no faster than linear, p <= 1"

Array = NDArray[np.float64]
Batch = tuple[Callable[[], object], int]
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Table:
    title: str
    size: str | None  # what is swept
    requirement: str
    specs: tuple[tuple[int, ControllerSpec], ...]  # (size, spec)


@dataclass(frozen=True, slots=True)
class Row:
    controller: str
    size: int
    joints: int
    tasks: int
    points: int
    obstacles: int  # of every kind
    operations: int  # of the step alone
    C_kB: float  # the C file, with kinematics and Jacobians
    generate_s: float
    compile_s: float
    ns: float  # in a state that stays
    ns_new: float  # in another state every time


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    controller: CompiledController
    c_bytes: int
    generate_s: float
    compile_s: float


def tables() -> Iterator[Table]:
    shipped = [read_spec(path) for path in shipped_specs()]
    yield Table("Shipped controllers", None, "", tuple((0, spec) for spec in shipped))
    planar5 = next(spec for spec in shipped if spec.name == "planar5")
    sizes = (6, 12, 24) if QUICK else (6, 12, 24, 48, 96, 192, 384)
    specs = tuple((count, with_points(planar5, count)) for count in sizes)
    yield Table("Points of interest: planar5, 3 obstacles, nsb", "points", NOT_FASTER, specs)
    sizes = (1, 3, 10) if QUICK else (1, 3, 10, 30, 100)
    specs = tuple((count, with_obstacles(planar5, count)) for count in sizes)
    yield Table("Obstacles: planar5, 6 points, nsb", "obstacles", NOT_FASTER, specs)
    sizes = (5, 10, 20) if QUICK else (5, 10, 20, 35, 50)
    for law in ("nsb", "augmented"):
        specs = tuple((count, serial_arm(count, law)) for count in sizes)
        yield Table(f"DoF: spatial arm, 6 points, 3 obstacles, {law}", "joints", "wanted: ns near linear", specs)


def with_points(spec: ControllerSpec, count: int) -> ControllerSpec:
    """Its points replaced by `count` others, spread over the links that have some."""
    old = spec.robot.points_of_interest
    points = tuple(
        PointOfInterest(
            name=f"point_{i + 1}",
            link=old[i % len(old)].link,
            offset=(old[i % len(old)].offset[0] * (1 - 0.5 * i / count), old[i % len(old)].offset[1], 0.0),
            influence_radius=old[i % len(old)].influence_radius,
        )
        for i in range(count)
    )
    robot = spec.robot.model_copy(update={"points_of_interest": points})
    return spec.model_copy(update={"name": f"points_{count}", "robot": robot})


def with_obstacles(spec: ControllerSpec, count: int) -> ControllerSpec:
    obstacles = spec.obstacles.model_copy(update={"maximum": count})
    return spec.model_copy(update={"name": f"obstacles_{count}", "obstacles": obstacles})


def serial_arm(n: int, law: str) -> ControllerSpec:
    """A spatial arm of 2 m, its axes in turn about z and y: obstacles first, then the tool's position."""
    length = 2.0 / n
    joints = [
        {
            "name": f"joint_{i + 1}",
            "type": "revolute",
            "link": f"link_{i + 1}",
            "xyz": [0.0, 0.0, length if i else 0.0],
            "axis": [0.0, 1.0, 0.0] if i % 2 else [0.0, 0.0, 1.0],
            "lower": -2.0,
            "upper": 2.0,
            "velocity": 3.0,
        }
        for i in range(n)
    ]
    points = [
        {
            "name": f"point_{i + 1}",
            "link": f"link_{-(-(i + 1) * n // 6)}",
            "offset": [0.01 * i, 0.0, length / 2],
            "influence_radius": 0.15,
        }
        for i in range(6)
    ]
    robot = {
        "joints": joints,
        "frames": [{"name": "tool", "link": f"link_{n}", "xyz": [0.0, 0.0, length]}],
        "points_of_interest": points,
    }
    spec = {
        "name": f"arm_{n}_{law}",
        "description": f"spatial arm with {n} joints",
        "period": 0.01,
        "law": law,
        "robot": robot,
        "obstacles": {"maximum": 3},
        "tasks": [
            {"name": "obstacles", "kind": "obstacle_avoidance", "activation": SWITCHED},
            {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 4.0},
        ],
        "filter": {"kind": "first_order", "cutoff": 4.0},
    }
    return ControllerSpec.parse(spec, "growth.py")


def measured(table: Table, folder: Path) -> list[Row]:
    built = [build(spec, folder) for _, spec in table.specs]
    batches = [batch for one in built for batch in (steady(one.controller), random(one.controller))]
    costs: list[list[float]] = [[] for _ in batches]
    for _ in range(ROUNDS):
        for cost, (work, steps) in zip(costs, batches, strict=True):
            cost.append(per_call(work, steps))
    medians = [statistics.median(cost) for cost in costs]
    return [
        row(size, one, ns, ns_new)
        for (size, _), one, ns, ns_new in zip(table.specs, built, medians[::2], medians[1::2], strict=True)
    ]


def build(spec: ControllerSpec, folder: Path) -> Built:
    """Generated into `folder` and compiled, both timed; three times where once takes less than a second."""
    progress(spec.name)
    generate_s, files = repeatedly(lambda: generate(spec))
    place = folder / spec.name
    place.mkdir()
    for name, text in files.items():
        (place / name).write_text(text, encoding="utf-8")

    def load() -> CompiledController:
        with empty_cache(folder):
            return CompiledController.load(place)

    compile_s, controller = repeatedly(load)
    return Built(controller, len(files[f"{spec.name}.c"].encode()), generate_s, compile_s)


def repeatedly(work: Callable[[], Result]) -> tuple[float, Result]:
    """Seconds, the median of three where the first is below one, and what it gave."""
    spent = []
    for _ in range(3):
        start = time.perf_counter()
        result = work()
        spent.append(time.perf_counter() - start)
        if spent[0] > 1:
            break
    return statistics.median(spent), result


@contextmanager
def empty_cache(parent: Path) -> Iterator[None]:
    """A cache without anything in it; the user's own is not touched."""
    before = os.environ.get("CLIKGEN_CACHE")
    with TemporaryDirectory(dir=parent) as cache:
        os.environ["CLIKGEN_CACHE"] = cache
        try:
            yield
        finally:
            del os.environ["CLIKGEN_CACHE"]
            if before is not None:
                os.environ["CLIKGEN_CACHE"] = before


def random(controller: CompiledController) -> Batch:
    """Steps in another state every time."""
    return batch(controller, states(controller))


def steady(controller: CompiledController) -> Batch:
    """As many steps, in each of a few states for a while."""
    few = {name: np.repeat(value[::STAYS], STAYS, axis=0) for name, value in states(controller).items()}
    return batch(controller, few)


def batch(controller: CompiledController, values: Mapping[str, Array]) -> Batch:
    """Work that steps through the states in C, again and again until it takes long enough, and its count of steps."""
    once = STATES * per_call(lambda: controller.step.map(STATES, values), STATES)
    repeats = max(1, round(BATCH / once))
    tiled = {name: np.tile(value, (repeats, *[1] * (value.ndim - 1))) for name, value in values.items()}
    return (lambda: controller.step.map(repeats * STATES, tiled)), repeats * STATES


def states(controller: CompiledController) -> dict[str, Array]:
    """Joint positions within their limits, references at random, obstacles around the edge of contact."""
    rng = np.random.default_rng(0)
    low, high = np.clip(controller.manifest.limits, -np.pi, np.pi).T
    q = rng.uniform(low, high, (STATES, len(low)))
    values: dict[str, Array] = {"q": q}
    for reference in controller.manifest.references:
        shape = (STATES, *controller.step.info.input(f"{reference.name}_reference").shape)
        value = rng.normal(size=shape)
        unit = value / np.linalg.norm(value, axis=-1, keepdims=True)
        values[f"{reference.name}_reference"] = unit if reference.space == "rotation" else value
    return values | obstacles(controller, q, rng)


def obstacles(controller: CompiledController, q: Array, rng: np.random.Generator) -> dict[str, Array]:
    """As many as there can be, each at 0.5 to 1.5 influence radii from one of the points of interest."""
    manifest, values = controller.manifest, {}
    if "influence_radius" not in controller.step.inputs:
        return {}
    points = controller.kinematics.map(STATES, {"q": q})["point_position"]
    reach = np.array(controller.step.info.input("influence_radius").default)

    def near(count: int) -> tuple[Array, Array, Array]:
        """A point of interest, a direction and a distance for each of `count` obstacles, in every state."""
        which = rng.integers(len(reach), size=(STATES, count))
        direction = rng.normal(size=(STATES, count, manifest.dimension))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        distance = reach[which] * rng.uniform(0.5, 1.5, which.shape)
        return np.take_along_axis(points, which[..., None], axis=1), direction, distance[..., None]

    if manifest.obstacles:
        point, direction, distance = near(manifest.obstacles)
        values["obstacle_center"] = point + (distance + 0.05) * direction
        values["obstacle_radius"] = np.full((STATES, manifest.obstacles), 0.05)
        values["obstacle_count"] = np.full(STATES, float(manifest.obstacles))
    if manifest.capsules:
        point, direction, distance = near(manifest.capsules)
        values["capsule_start"] = point + (distance + 0.05) * direction
        values["capsule_end"] = values["capsule_start"] + rng.normal(size=direction.shape)
        values["capsule_radius"] = np.full((STATES, manifest.capsules), 0.05)
        values["capsule_count"] = np.full(STATES, float(manifest.capsules))
    if manifest.half_spaces:
        point, direction, distance = near(manifest.half_spaces)
        values["half_space_normal"] = -direction
        values["half_space_offset"] = -np.sum(direction * point, axis=-1) - distance[..., 0]
        values["half_space_count"] = np.full(STATES, float(manifest.half_spaces))
    return values


def row(size: int, one: Built, ns: float, ns_new: float) -> Row:
    manifest = one.controller.manifest
    return Row(
        controller=manifest.controller,
        size=size,
        joints=len(manifest.joints),
        tasks=len(manifest.tasks),
        points=len(manifest.points),
        obstacles=manifest.obstacles + manifest.capsules + manifest.half_spaces,
        operations=manifest.function("step").operations,
        C_kB=round(one.c_bytes / 1000, 1),
        generate_s=round(one.generate_s, 3),
        compile_s=round(one.compile_s, 3),
        ns=round(ns, 1),
        ns_new=round(ns_new, 1),
    )


def exponents(rows: list[Row]) -> dict[str, dict[str, float]]:
    """The slope p of log(cost) over log(size) through all sizes and through the largest, for every column."""
    by_size = sorted(rows, key=lambda one: one.size)
    return {"all sizes": _slopes(by_size), f"last {LARGEST} sizes": _slopes(by_size[-LARGEST:])}


def _slopes(rows: list[Row]) -> dict[str, float]:
    sizes = np.log([one.size for one in rows])
    return {
        column: round(float(np.polyfit(sizes, np.log([getattr(one, column) for one in rows]), 1)[0]), 2)
        for column in COLUMNS
    }


def report(table: Table, rows: list[Row], grown: dict[str, dict[str, float]]) -> None:
    print(f"{table.title}\n")
    heads = (
        "controller",
        "joints",
        "tasks",
        "points",
        "obst.",
        "operations",
        "C [kB]",
        "gen. [s]",
        "cc [s]",
        "ns",
        "ns new",
    )
    print(f"{heads[0]:<18}" + "".join(f"{head:>{max(8, len(head) + 2)}}" for head in heads[1:]))
    for one in rows:
        print(
            f"{one.controller:<18}{one.joints:8}{one.tasks:8}{one.points:8}{one.obstacles:8}"
            f"{one.operations:14}{one.C_kB:8.0f}{one.generate_s:10.2f}{one.compile_s:8.2f}{one.ns:8.0f}{one.ns_new:8.0f}"
        )
    for which, slopes in grown.items():
        values = "{:14.2f}{:8.2f}{:10.2f}{:8.2f}{:8.2f}{:8.2f}".format(*slopes.values())
        print(f"{f'p of {table.size}^p, {which}':<50}{values}   {table.requirement}")
    print(flush=True)


def progress(name: str) -> None:
    """On the terminal alone: what is being built, overwritten by the next."""
    if sys.stderr.isatty():
        print(f"\r{name:<40}\r", end="", file=sys.stderr, flush=True)


def main() -> None:
    document: dict[str, Any] = {"machine": machine(), "compiler": compiler(), "rounds": ROUNDS, "tables": []}
    written = "--json" in sys.argv
    if not written:
        print(f"{document['machine']}\n{document['compiler']}\nmedians of {ROUNDS} rounds\n")
    for table in tables():
        with TemporaryDirectory() as folder:
            rows = measured(table, Path(folder))
        grown = exponents(rows) if table.size else {}
        document["tables"].append({"title": table.title, "rows": [asdict(one) for one in rows], "exponents": grown})
        if not written:
            report(table, rows, grown)
    if written:
        print(json.dumps(document, indent=2))


if __name__ == "__main__":
    main()
