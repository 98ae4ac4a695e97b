"""The steps in C and in C++: compiled, checked for being there, and called by the loop of loop.c."""

import hashlib
import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter_ns
from typing import Any

import cffi
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from clikgen.runtime.compiler import FLAGS, NATIVE, find_compiler
from peers.environments import BUILD, ENVIRONMENTS
from peers.work import HERE, HOME, INFLUENCE, RADII, Robot

Array = NDArray[np.float64]

CPP_FLAGS = (("-O2",), ("-O3", "-march=native"))  # the faster one is reported
DEFINITIONS = ("-DNDEBUG", "-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS")
LAPS = 4  # through the states at random, per round
RESULTS = {  # names of our outputs in the order of ours.c
    "planar5": (
        *("q_next", "dq", "dq_law", "obstacles_potential", "tool_position", "tool_error"),
        *("lam", "active", "distance", "clearance"),
    ),
    "arm7": (
        *("q_next", "dq", "dq_law"),
        *("hand_position", "hand_orientation", "hand_error", "hand_orientation_error"),
    ),
}

_NEW = "int, int, const int *, const double *, int, const int *, const double *"
_ffi = cffi.FFI()
_ffi.cdef(f"""
void nothing(void *, const double *, const double *, double *);
void follow(void *, void *, const double *, int, const double *, int, double *, long, long, long long *);
void visit(void *, void *, const double *, int, const double *, int, double *, int, long, long);
void ours_prepare(const double *, const double *);
void ours_planar5(void *, const double *, const double *, double *);
void ours_arm7(void *, const double *, const double *, double *);
void *planar5_new({_NEW}, const double *, const double *);
void *planar5_step(int);
void *arm7_new({_NEW}, const double *);
void *arm7_step(int);
""")


class CompileError(RuntimeError):
    """A peer in C++ could not be compiled; the message is one line."""


class Native:
    """A step in C or C++ of a robot, as a runner: its function and the object that it works on."""

    def __init__(self, robot: Robot, loop: Any, library: Any, function: Any, itself: Any = _ffi.NULL) -> None:
        self.loop, self.kept = loop, library
        self.step = _ffi.cast("void *", function), itself
        self.q, self.rows = robot.path.q, robot.path.rows
        self.random_q, self.random_rows = robot.random.q, robot.random.rows
        self.size = sum(robot.controller.step.outputs[name].size for name in RESULTS[robot.name])

    def along(self, first: int, last: int, laps: int) -> int:
        return self._follow(self.step, self.q[first], self.rows[first:last], laps, None)[1]

    def each(self, first: int, last: int) -> list[int]:
        ns, clock = np.zeros((2, last - first), dtype=np.int64)
        nothing = _ffi.cast("void *", self.loop.nothing), _ffi.NULL
        self._follow(nothing, self.q[first], self.rows[first:last], 1, clock)
        self._follow(self.step, self.q[first], self.rows[first:last], 1, ns)
        return np.maximum(ns - int(np.median(clock)), 0).tolist()

    def way(self) -> Array:
        q, found = self.q[0], []
        for row in self.rows:
            q = self._follow(self.step, q, row[None], 1, None)[0]
            found.append(q)
        return np.array(found)

    def results(self) -> Array:
        """What it gives in each of the states at random, (count, size)."""
        return self._visit(1)[0]

    def at_random(self) -> float:
        """Nanoseconds per step where every step has a q of its own."""
        return self._visit(LAPS)[1] / (LAPS * len(self.random_q))

    def _follow(self, step: tuple[Any, Any], q: Array, rows: Array, laps: int, ns: Any) -> tuple[Array, int]:
        """Where it ends, and nanoseconds."""
        result = np.zeros(self.size)
        clock = _ffi.NULL if ns is None else _ffi.from_buffer("long long *", ns)
        given = _doubles(q), len(q), _doubles(rows), rows.shape[1], _doubles(result), len(rows), laps, clock
        start = perf_counter_ns()
        self.loop.follow(*step, *given)
        return result[: len(q)], perf_counter_ns() - start

    def _visit(self, laps: int) -> tuple[Array, int]:
        q, rows = self.random_q, self.random_rows
        result = np.zeros((len(q), self.size))
        given = _doubles(q), q.shape[1], _doubles(rows), rows.shape[1], _doubles(result), self.size, len(q), laps
        start = perf_counter_ns()
        self.loop.visit(*self.step, *given)
        return result, perf_counter_ns() - start


def _doubles(array: Array) -> Any:
    return _ffi.from_buffer("double *", np.ascontiguousarray(array))


def loop_library() -> Any:
    command = [*find_compiler().command, "-O2", "-std=c99", "-fPIC", "-shared"]
    return _ffi.dlopen(str(compiled("loop", command, [HERE / "loop.c"], [])))


def ours(robots: Sequence[Robot], loop: Any, flags: Sequence[str]) -> dict[str, Native]:
    """Our generated C of all robots, compiled as clikgen compiles it, with `flags` after its own."""
    sources = [one.controller.folder / f"{one.name}.c" for one in robots]
    include = [f"-I{source.parent}" for source in sources]
    files = [HERE / "ours.c", *sources]
    library = _ffi.dlopen(str(compiled("ours", [*find_compiler().command, *FLAGS, *NATIVE, *flags], files, include)))
    library.ours_prepare(_doubles(RADII), _doubles(HOME))
    return {one.name: Native(one, loop, library, getattr(library, f"ours_{one.name}")) for one in robots}


def same_law(flags: Sequence[str], robot: Robot, loop: Any, *, by_hand: bool) -> Native:
    """same_law.cpp against the headers of the wheels, in one of its two ways; raises CompileError."""
    prefix = next(ENVIRONMENTS["main"].folder.glob("lib/python3*/site-packages/cmeel.prefix"), None)
    if prefix is None:
        raise CompileError("no headers of Pinocchio in the environment")
    include = [f"-isystem{prefix / 'include'}", f"-isystem{prefix / 'include' / 'eigen3'}"]
    command = [cpp_compiler(), "-std=c++20", *flags, *DEFINITIONS, "-fPIC", "-shared"]
    library = _ffi.dlopen(str(compiled("same_law", command, [HERE / "same_law.cpp"], include, pin.__version__)))
    model = pin.buildModelFromUrdf(str(robot.urdf))
    names = [f"point_{i}" for i in range(1, 7)] if robot.name == "planar5" else [robot.tool]
    more = [RADII, INFLUENCE] if robot.name == "planar5" else [HOME]
    made = getattr(library, f"{robot.name}_new")(by_hand, *_chain(model, names), *map(_doubles, more))
    return Native(robot, loop, library, getattr(library, f"{robot.name}_step")(by_hand), made)


def _chain(model: pin.Model, names: Sequence[str]) -> tuple[Any, ...]:
    """Joints and frames of a chain, as plain numbers."""
    kinds = {"JointModelPX": 0, "JointModelPY": 1, "JointModelRZ": 2}
    joints = range(1, model.njoints)
    assert [model.parents[i] for i in joints] == [i - 1 for i in joints], "wanted a chain"
    frames = [model.frames[model.getFrameId(name)] for name in names]
    return (
        len(joints),
        _ffi.new("int[]", [kinds[model.joints[i].shortname()] for i in joints]),
        _doubles(np.array([_placement(model.jointPlacements[i]) for i in joints])),
        len(frames),
        _ffi.new("int[]", [frame.parentJoint for frame in frames]),
        _doubles(np.array([_placement(frame.placement) for frame in frames])),
    )


def _placement(place: pin.SE3) -> Array:
    return np.concatenate([place.rotation.ravel(), place.translation])


def cpp_compiler() -> str:
    """$CXX, else c++, g++ or clang++; raises CompileError."""
    for name in (os.environ.get("CXX"), "c++", "g++", "clang++"):
        if name and shutil.which(name):
            return name
    raise CompileError("no C++ compiler: wanted $CXX, c++, g++ or clang++ on the PATH, found none")


def cpp_version() -> str:
    """The first line that the compiler says of itself."""
    try:
        command = [cpp_compiler(), "--version"]
    except CompileError as error:
        return str(error)
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[0]


def compiled(
    name: str, command: Sequence[str], sources: Sequence[Path], include: Sequence[str], version: str = ""
) -> Path:
    """The shared library, kept by the content of its sources and headers, the command and `version`."""
    headers = [source.with_suffix(".h") for source in sources if source.with_suffix(".h").exists()]
    key = hashlib.sha256("\0".join([*command, version]).encode())
    for path in (*sources, *headers):
        key.update(path.read_bytes())
    library = BUILD / f"{name}-{key.hexdigest()[:24]}.so"
    if not library.exists():
        BUILD.mkdir(parents=True, exist_ok=True)
        made = library.with_suffix(".tmp")
        paths = [*include, "-o", str(made), *map(str, sources), "-lm"]
        done = subprocess.run([*command, *paths], capture_output=True, text=True, check=False)
        if done.returncode:
            error = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr[-200:])
            raise CompileError(f"{' '.join(command)} does not compile {sources[0].name}: {error}")
        made.replace(library)
    return library
