"""The measurement itself, in the environment of the peers: `python -m peers.measure`, started by peers.py."""

import argparse
import json
import statistics
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import metadata
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from common import compiler, machine, per_call
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledFunction
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import read_spec
from peers import batches, native, report
from peers.aims import reached
from peers.environments import ENVIRONMENTS
from peers.libraries import LIBRARIES, Setup
from peers.ours import IN_PYTHON, ways
from peers.pinocchio_numpy import LAWS
from peers.timing import Function, Remote, Runner, Stateful
from peers.work import CENTERS, HERE, HOME, INFLUENCE, RADII, STEPS, Robot, robots

Array = NDArray[np.float64]

ROUNDS = 25
PART = 80  # steps of the path in a round
LEAST = 4e6  # [ns] that a part is walked for, again and again
SAME = 1e-9  # the same law: no number deviates by more, relative to 1 or to the largest of its kind in that state
OURS_IN_C = "ours, C"
FLAGS_IN_C = {OURS_IN_C: (), "ours, C, without FMA": ("-DCLIKGEN_FMA=0",)}
ELSEWHERE = {"PlaCo": "placo"}  # libraries in an environment of their own
NOT_THERE = {"oink": "on PyPI that is another thing, a budgeting tool; OInK comes as roboplan-oink"}


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """Who is measured: `law` is ours, same or unlike, and `against` says which of ours it is compared with."""

    name: str
    robot: str
    law: str
    language: str
    does: str
    runner: Runner
    against: str = IN_PYTHON
    results: Callable[[], Array] | None = None  # in the states at random, (count, size), where the law is the same
    at_random: Callable[[], float] | None = None  # nanoseconds per step there


@dataclass(slots=True)
class Times:
    """Nanoseconds per step: of every round, of single steps, and of rounds in the states at random."""

    rounds: list[float] = field(default_factory=list)
    single: list[int] = field(default_factory=list)
    random: list[float] = field(default_factory=list)


def main() -> None:
    asked = arguments()
    missing = NOT_THERE | dict(one.split(": ", 1) for one in asked.missing)
    with tempfile.TemporaryDirectory() as place:
        document = measured(Path(place), asked.rounds, missing)
    if asked.save:
        report.save(document)
    print(json.dumps(document, indent=2) if asked.json else report.text(document))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="peers.py")
    parser.add_argument("--json", action="store_true", help="print one document")
    parser.add_argument("--save", action="store_true", help="write results.json, summary.png and the README's table")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"of the measurement, {ROUNDS} by default")
    parser.add_argument("--missing", action="append", default=[], help=argparse.SUPPRESS)
    return parser.parse_args()


def measured(place: Path, rounds: int, missing: dict[str, str]) -> dict[str, Any]:
    write_arm7(place)
    both = list(robots(place))
    checks = [check_urdf(robot) for robot in both]
    candidates = list(all_candidates(both, place, missing))
    named = {robot.name: robot for robot in both}
    checks += [check_law(one, named[one.robot]) for one in candidates if one.results]
    went = [went_along(one, named[one.robot]) for one in candidates]
    times = timed(candidates, rounds)
    for one in candidates:
        if isinstance(one.runner, Remote):
            one.runner.close()
    steps, many = step_rows(candidates, times, went), batch_rows(both[0], rounds, missing)
    return {
        "machine": machine(),
        "compiler": compiler(),
        "compiler of C++": f"{native.cpp_version()} -std=c++20",
        "rounds": rounds,
        "versions": versions(),
        "checks": checks,
        "steps": steps,
        "batches": many,
        "aims": list(reached(steps, many)),
        "missing": missing,
    }


def write_arm7(place: Path) -> None:
    folder = place / "arm7"
    folder.mkdir()
    for name, text in generate(read_spec(HERE / "arm7.toml")).items():
        (folder / name).write_text(text, encoding="utf-8")


def versions() -> dict[str, str]:
    """Of what is measured and of what it computes with."""
    names = ("numpy", "scipy", "pin", "cmeel-eigen", "pin-pink", "mink", "mujoco", "roboplan-oink", "embodik")
    found = {name: metadata.version(name) for name in (*names, "qpsolvers", "quadprog", "jax", "casadi")}
    pinned = ENVIRONMENTS["placo"].requirements.read_text(encoding="utf-8").splitlines()
    return found | {"placo": next(line.split("==")[1] for line in pinned if line.startswith("placo=="))}


# ---- Who is measured ----


def all_candidates(both: Sequence[Robot], place: Path, missing: dict[str, str]) -> Iterator[Candidate]:
    loop = native.loop_library()
    ours_in_c = {name: native.ours(both, loop, flags) for name, flags in FLAGS_IN_C.items()}
    for robot in both:
        yield from ours_in_python(robot)
        for name, steps in ours_in_c.items():
            yield native_candidate(name, robot, "ours", "C", steps[robot.name])
    for robot in both:
        yield from in_numpy(robot)
        yield from in_cpp(robot, loop, missing)
        yield from libraries(robot, place, missing)


def ours_in_python(robot: Robot) -> Iterator[Candidate]:
    names = native.RESULTS[robot.name]

    def candidate(name: str, step: CompiledFunction, taken: Callable[..., Array]) -> Candidate:
        def results() -> Array:
            found = []
            for q, item in zip(robot.random.q, robot.random.items(), strict=True):
                taken(q, *item)
                found.append(np.concatenate([step.outputs[one].ravel() for one in names]))
            return np.array(found)

        return in_python(name, robot, "ours", taken, results)

    for name, (step, taken) in ways(robot).items():
        yield candidate(name, step, taken)


def in_python(
    name: str, robot: Robot, law: str, taken: Callable[..., Array], results: Callable[[], Array]
) -> Candidate:
    runner = Function(taken, robot.path.q, robot.path.items())
    at_random = Function(taken, robot.random.q, robot.random.items()).visit
    return Candidate(name, robot.name, law, "Python", "the law", runner, results=results, at_random=at_random)


def in_numpy(robot: Robot) -> Iterator[Candidate]:
    def candidate(name: str, law: Any) -> Candidate:
        def results() -> Array:
            items = zip(robot.random.q, robot.random.items(), strict=True)
            return np.array([np.concatenate([law.step(q, *item), law.results()]) for q, item in items])

        return in_python(name, robot, "same", law.step, results)

    for name, law in LAWS[robot.name].items():
        yield candidate(name, law(robot))


def native_candidate(name: str, robot: Robot, law: str, language: str, step: native.Native) -> Candidate:
    return Candidate(name, robot.name, law, language, "the law", step, OURS_IN_C, step.results, step.at_random)


def in_cpp(robot: Robot, loop: Any, missing: dict[str, str]) -> Iterator[Candidate]:
    """In two ways, each with two sets of flags, of which the slower one is left out of the table."""
    for by_hand, name in ((False, "Pinocchio + Eigen"), (True, "Pinocchio + Eigen by hand")):
        for flags in native.CPP_FLAGS:
            full = f"{name}, {' '.join(flags)}"
            try:
                step = native.same_law(flags, robot, loop, by_hand=by_hand)
            except native.CompileError as error:
                missing[full] = str(error)
                continue
            yield native_candidate(full, robot, "same", "C++", step)


def libraries(robot: Robot, place: Path, missing: dict[str, str]) -> Iterator[Candidate]:
    """Each library that runs here, with avoidance and without on planar5."""
    planar = robot.name == "planar5"
    for name in LIBRARIES:
        for avoid in (False, True) if planar else (False,):
            posture = None if planar else tuple(HOME.tolist())
            period = float(robot.controller.step.inputs["period"])
            setup = Setup(str(robot.urdf), robot.tool, period, posture, avoid)
            does = ("position, avoidance" if avoid else "position") if planar else "pose, posture"
            try:
                runner = library_runner(name, setup, robot, place)
                runner.along(0, PART, 1)
            except Exception as error:  # whatever a library does where it does not run: the table says so
                missing[f"{name}: {does}"] = f"{type(error).__name__}: {error}"
                continue
            yield Candidate(name, robot.name, "unlike", "Python", does, runner)


def library_runner(name: str, setup: Setup, robot: Robot, place: Path) -> Runner:
    if name not in ELSEWHERE:
        return Stateful(LIBRARIES[name](setup), robot.path.q, robot.targets())
    environment = ENVIRONMENTS[ELSEWHERE[name]]
    if not environment.is_ready():
        raise RuntimeError(f"{environment.requirements.name} is not installed")
    path = place / f"{robot.name}.npz"
    places, rotations = map(np.array, zip(*robot.targets(), strict=True))
    np.savez(path, q=robot.path.q, places=places, rotations=rotations)
    return Remote(environment.python, name, json.dumps(asdict(setup)), path)


# ---- Checks, before anything is timed ----


def check_urdf(robot: Robot) -> dict[str, Any]:
    """The URDF that peers read is our robot: tool, points and obstacles are where ours are."""
    model = pin.buildModelFromUrdf(str(robot.urdf))
    data = model.createData()
    q = robot.random.q
    ours, points = robot.positions(q), robot.controller.kinematics.map(len(q), {"q": q}).get("point_position")
    worst = 0.0
    for k in range(len(q)):
        pin.framesForwardKinematics(model, data, q[k])
        worst = max(worst, np.abs(data.oMf[model.getFrameId(robot.tool)].translation - ours[k]).max())
        for i, point in enumerate(points[k] if points is not None else ()):
            worst = max(worst, np.abs(data.oMf[model.getFrameId(f"point_{i + 1}")].translation[:2] - point).max())
    if robot.name == "planar5":
        worst = max(worst, scene_deviation(model, str(robot.urdf)))
    wanted(worst <= 1e-12, f"{robot.urdf.name} is another robot than {robot.name}: {worst:.2g} m apart")
    return {"what": f"{robot.urdf.name}: positions", "robot": robot.name, "states": len(q), "deviation": float(worst)}


def scene_deviation(model: pin.Model, urdf: str) -> float:
    """How far the URDF's obstacles, and the radii of its spheres, are from ours [m]."""
    shapes = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION)
    radius = {one.name: one.geometry.radius for one in shapes.geometryObjects}
    names = [f"point_{i + 1}_0" for i in range(6)] + [f"obstacle_{k + 1}_0" for k in range(3)]
    radii = np.array([radius[name] for name in names]) - np.concatenate([INFLUENCE, RADII])
    places = [model.frames[model.getFrameId(f"obstacle_{k + 1}")].placement.translation[:2] for k in range(3)]
    return float(max(np.abs(radii).max(), np.abs(np.array(places) - CENTERS).max()))


def check_law(one: Candidate, robot: Robot) -> dict[str, Any]:
    """Who claims the law gives its numbers, in every state at random: all of ours.c's, one after the other."""
    assert one.results is not None
    step, given = robot.controller.step, dict(robot.random.given)
    if robot.name == "planar5":
        given |= {"obstacle_radius": RADII, "obstacle_count": np.array(float(len(RADII)))}
    count = len(robot.random.q)
    ours = step.map(count, {"q": robot.random.q, **given})
    found, worst, at = one.results(), 0.0, 0
    for name in native.RESULTS[robot.name]:
        value = ours[name].reshape(count, -1)
        size = value.shape[1]
        scale = np.maximum(np.abs(value).max(axis=1), 1)
        worst = max(worst, float((np.abs(found[:, at : at + size] - value).max(axis=1) / scale).max()))
        at += size
    contact = float(np.mean(ours["active"])) if "active" in ours else None
    wanted(worst <= SAME, f"{one.name} is another law than ours on {robot.name}: {worst:.2g} apart")
    return {"what": one.name, "robot": robot.name, "states": count, "in contact": contact, "deviation": worst}


def went_along(one: Candidate, robot: Robot) -> dict[str, float]:
    """How closely the tool followed the path, and how near the points came to the obstacles.

    Where the law is ours, a step goes on with the target's velocity, so it ends where the next target is.
    """
    q = one.runner.way()
    targets = np.array([place for place, _ in robot.targets()])
    if one.law != "unlike":
        q, targets = q[:-1], targets[1:]
    apart = np.linalg.norm(robot.positions(q) - targets, axis=1)
    found = {"tracking_rms": float(np.sqrt(np.mean(apart**2)))}
    if robot.name == "planar5":
        found["min_clearance"] = float(robot.distances(q).min())
    return found


def wanted(holds: bool, otherwise: str) -> None:
    if not holds:
        raise SystemExit(otherwise)


# ---- Times ----


def timed(candidates: Sequence[Candidate], rounds: int) -> list[Times]:
    """Everybody in turn, round after round: a part of the path, single steps of it, the states at random."""
    times = [Times() for _ in candidates]
    laps = [max(1, int(LEAST / max(one.runner.along(0, PART, 1), 1))) for one in candidates]
    starts = np.linspace(0, STEPS - PART, ROUNDS).astype(int).tolist()
    for first in islice(cycle(starts), rounds):
        for one, lap, time in zip(candidates, laps, times, strict=True):
            one.runner.along(first, first + PART // 8, 1)  # what it needs is in the cache again
            time.rounds.append(one.runner.along(first, first + PART, lap) / (lap * PART))
            time.single += one.runner.each(first, first + PART)
            if one.at_random:
                time.random.append(one.at_random())
    return times


def step_rows(
    candidates: Sequence[Candidate], times: Sequence[Times], went: Sequence[Mapping[str, float]]
) -> list[dict[str, Any]]:
    """A row each, the slower build of the C++ left out; `times ours` is the median ratio of the rounds."""
    found = {(one.robot, one.name, one.does): time for one, time in zip(candidates, times, strict=True)}
    rows = []
    for one, time, along in zip(candidates, times, went, strict=True):
        ours = found[one.robot, one.against, "the law"]
        row: dict[str, Any] = {"robot": one.robot, "name": one.name, "law": one.law, "does": one.does}
        row |= {"language": one.language, "us": statistics.median(time.rounds) / 1e3}
        row |= {"p99_us": float(np.quantile(time.single, 0.99)) / 1e3}
        row |= {"random_us": statistics.median(time.random) / 1e3 if time.random else None}
        row |= {"against": one.against, "times_ours": ratio(time.rounds, ours.rounds), **along}
        rows.append(row)
    return [row for row in rows if not slower_build(row, rows)]


def ratio(rounds: Sequence[float], ours: Sequence[float]) -> float:
    return statistics.median(mine / yours for mine, yours in zip(rounds, ours, strict=True))


def slower_build(row: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> bool:
    """Whether the same C++ is faster with other flags."""

    def way(one: Mapping[str, Any]) -> tuple[str, str]:
        return one["robot"], one["name"].partition(",")[0]

    return row["language"] == "C++" and any(way(other) == way(row) and other["us"] < row["us"] for other in rows)


def batch_rows(robot: Robot, rounds: int, missing: dict[str, str]) -> list[dict[str, Any]]:
    """Nanoseconds per step of a robot in each way, in turn; how far from ours after one step, and at the end."""
    once, batch = batches.batch_of(robot, 1), batches.batch_of(robot)
    works: dict[str, batches.Work] = {}
    rows: dict[str, dict[str, Any]] = {}
    for name, way in batches.WAYS.items():
        try:
            first, work = way(once)(), way(batch)
            end = work()
        except Exception as error:  # as with the libraries
            missing[name] = f"{type(error).__name__}: {error}"
            continue
        if not works:
            ours, our_end = first, end
        deviation = float(np.abs(first - ours).max())
        wanted(deviation <= SAME, f"{name} is another law than ours in a batch: {deviation:.2g} apart")
        together = float(np.mean(np.abs(end - our_end).max(axis=1) < SAME))
        law = "ours" if name.startswith("ours") else "same"
        works[name], rows[name] = work, {"name": name, "law": law, "deviation": deviation, "together_at_end": together}
    costs: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            costs[name].append(per_call(work, batches.ROBOTS * batches.STEPS))
    best = min((name for name in works if rows[name]["law"] == "ours"), key=lambda name: statistics.median(costs[name]))
    for name, row in rows.items():
        row |= {"ns": statistics.median(costs[name]), "times_ours": ratio(costs[name], costs[best]), "against": best}
    return list(rows.values())


if __name__ == "__main__":
    main()
