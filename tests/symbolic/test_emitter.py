"""The C that we write against CasADi's own evaluation: to rounding, for every compiler, with nothing of libm but sqrt.

Both carry out the same operations and round them differently. By how much at most is known from the instructions of
CasADi's function alone: beside every value runs an error bound B to which each operation adds u |result|, u = 2^-53
(2^-24 in floats), and through which it hands on those of its operands by its derivatives (Higham, Accuracy and
Stability of Numerical Algorithms, section 3.3). Two things depend on the order of operations, which is not the same:

- A sum of n terms costs u |sum| for its last addition and at most u Σ|term| for each of the n - 2 before, whatever
  their order (section 4.2). B counts that, so it holds of either order.
- Where a comparison is closer than 4 B it may go either way. Nothing is lost where both ways lead to the same number;
  states in which they do not are left out, and there have to be few of them.

CasADi errs by B at most: libm's sine, cosine and arcus tangent err by 1.01 u. Ours err by 3 B at most: a quotient that
is a product with a reciprocal is rounded twice, 2 u; sine and cosine err by 2.3 u (and 1e-20 near multiples of a right
angle, which B has too), the arcus tangent by 3.1 u, where B counts 2. Together, 1.01 + 2.3 = 3.3 B to first order. So

    |ours - CasADi's| <= 4 B.

A step with a barrier has a solver in it, of which B says nothing: there the tolerance is the solver's.

`CLIKGEN_STATES=1000000` in the environment tries as many states instead of the few of a common test run.
"""

import functools
import itertools
import os
import platform
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import cffi
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from pycparser import c_ast, c_generator, c_parser

from clikgen.runtime import controller as runtime
from clikgen.runtime.compiler import FLAGS, NATIVE, available_compilers, compile_library, find_compiler
from clikgen.runtime.controller import CompiledController, CompiledFunction, load_library
from clikgen.runtime.manifest import load_manifest
from clikgen.symbolic.controller import build
from clikgen.symbolic.emitter import IN_FLOAT, LANES, LEAST_FLOAT, Names, function_text, module_text
from clikgen.symbolic.generate import generate, shipped_folder
from clikgen.symbolic.rotations import quaternion_of
from clikgen.symbolic.spec import read_spec, shipped_specs
from clikgen.symbolic.stage import Procedure

STATES = int(os.environ.get("CLIKGEN_STATES", "4000"))
AT_ONCE = 4096  # states of which the bounds are computed together: they stay in the cache
SPECS = {path.stem: path for path in shipped_specs()}
SMALL = ["planar3", "planar5"]  # without a barrier
GUARDED = [name for name in SPECS if name not in SMALL]
UNIT = {"double": 2.0**-53, "float": 2.0**-24}
NUMBER = {"double": np.float64, "float": np.float32}


# ---- The bound ----


@dataclass(frozen=True, eq=False)
class Number:
    """Values of N states and what bounds their errors; a sum's own rounding is not in its error yet."""

    value: np.ndarray
    error: np.ndarray
    terms: np.ndarray  # how many numbers it is the sum of, zeros not counted
    mass: np.ndarray  # the sum of their magnitudes


@dataclass(frozen=True, eq=False)
class Condition:
    """What holds in N states, where that is in doubt, and what it is the opposite of."""

    holds: np.ndarray
    doubt: np.ndarray
    opposite: object = None


@dataclass(frozen=True, eq=False)
class Half:
    """`condition ? number : 0`, of which CasADi makes choices: the other half is added to it."""

    asked: object
    condition: Condition
    number: tuple[np.ndarray, np.ndarray]


class Analysis:
    """The outputs of a CasADi function of N states, (rows, N) each, the bounds B of their errors, and the states
    in which a comparison may go either way and that makes a difference."""

    def __init__(self, function, columns, real="double"):
        self.unit, self.real = UNIT[real], real
        self.smallest = float(np.finfo(NUMBER[real]).tiny)
        self.near = 1e-20 if real == "double" else 1e-12
        count = columns[0].shape[1]
        self.doubtful = np.zeros(count, dtype=bool)
        shapes = [(function.size1_out(k), count) for k in range(function.n_out())]
        self.values, self.bounds = [np.zeros(shape) for shape in shapes], [np.zeros(shape) for shape in shapes]
        with np.errstate(all="ignore"):
            self._run(function, columns)

    def _run(self, function, columns):
        work, zero = {}, np.zeros(columns[0].shape[1])
        for k in range(function.n_instructions()):
            code, into, given = (
                function.instruction_id(k),
                function.instruction_output(k),
                function.instruction_input(k),
            )
            if code == ca.OP_INPUT:
                work[into[0]] = self.number(columns[given[0]][given[1]], zero)
            elif code == ca.OP_CONST:
                value = function.instruction_constant(k)
                work[into[0]] = self.number(zero + value, zero + abs(float(NUMBER[self.real](value)) - value))
            elif code == ca.OP_OUTPUT:
                value, error = self.rounded(work[given[0]])
                self.values[into[0]][into[1]] = value
                self.bounds[into[0]][into[1]] = np.where(np.isfinite(error), error, np.inf)
            elif code in WHOLE:
                work[into[0]] = WHOLE[code](self, *(work[i] for i in given))
            else:
                work[into[0]] = ROUNDED[code](self, *(self.rounded(work[i]) for i in given))

    def number(self, value, error):
        """Of these values and errors."""
        return Number(value, error, (value != 0) | (error > 0), np.abs(value))

    def result(self, value, error, *operands, times=1.0):
        """The same, rounded once; below the smallest normal number that is no longer relative."""
        tiny = np.abs(value) < self.smallest
        for operand in operands:
            tiny = tiny & (operand != 0)
        return self.number(value, error + times * self.unit * np.abs(value) + tiny * self.unit * self.smallest)

    def settled(self, x):
        """What is there as a number."""
        if isinstance(x, Half):
            return self.chosen(x.condition, x.number, (0.0, 0.0))
        if isinstance(x, Condition):
            self.doubtful |= x.doubt
            return self.number(x.holds.astype(float), 0.0 * x.holds)
        return x

    def rounded(self, x):
        """Its value and its bound, with all that a sum costs."""
        x = self.settled(x)
        own = np.where(x.terms > 1, self.unit * (np.abs(x.value) + (x.terms - 2) * x.mass), 0.0)
        return x.value, x.error + own

    def condition(self, x):
        """What is there as a condition."""
        if isinstance(x, Condition):
            return x
        value, error = self.rounded(x)
        return Condition(value != 0, (error > 0) & (np.abs(value) <= 4 * error))

    def chosen(self, condition, one, other):
        """The one where the condition holds, else the other; in doubt, as far apart as they are."""
        (a, of_a), (b, of_b) = one, other
        apart = np.abs(a - b)
        self.doubtful |= condition.doubt & ~(apart <= 4 * (of_a + of_b))
        error = np.where(condition.holds, of_a, of_b)
        return self.number(np.where(condition.holds, a, b), np.where(condition.doubt, of_a + of_b + apart, error))

    def added(self, x, y, sign=1.0):
        """The sum or the difference, of which the terms are kept; of two halves, the whole."""
        if isinstance(x, Half) and isinstance(y, Half) and sign > 0:
            for one, other in ((x, y), (y, x)):
                if other.condition.opposite is one.asked:
                    return self.chosen(one.condition, one.number, other.number)
        x, y = self.settled(x), self.settled(y)
        return Number(x.value + sign * y.value, x.error + y.error, 1.0 * x.terms + y.terms, x.mass + y.mass)


def _negated(run, x):
    x = run.settled(x)
    return Number(-x.value, x.error, x.terms, x.mass)


def _opposite(run, x):
    condition = run.condition(x)
    return Condition(~condition.holds, condition.doubt, x)


def _both(run, x, y):
    a, b = run.condition(x), run.condition(y)
    return Condition(a.holds & b.holds, (a.doubt & (b.holds | b.doubt)) | (b.doubt & (a.holds | a.doubt)))


def _either(run, x, y):
    a, b = run.condition(x), run.condition(y)
    return Condition(a.holds | b.holds, (a.doubt & (~b.holds | b.doubt)) | (b.doubt & (~a.holds | a.doubt)))


WHOLE: dict[int, Callable] = {
    ca.OP_ASSIGN: lambda run, x: x,
    ca.OP_ADD: lambda run, x, y: run.added(x, y),
    ca.OP_SUB: lambda run, x, y: run.added(x, y, -1.0),
    ca.OP_TWICE: lambda run, x: run.added(run.settled(x), run.settled(x)),
    ca.OP_NEG: _negated,
    ca.OP_NOT: _opposite,
    ca.OP_AND: _both,
    ca.OP_OR: _either,
    ca.OP_IF_ELSE_ZERO: lambda run, c, x: Half(c, run.condition(c), run.rounded(x)),
}


def _product(run, x, y):
    (a, of_a), (b, of_b) = x, y
    return run.result(a * b, np.abs(a) * of_b + np.abs(b) * of_a + of_a * of_b, a, b)


def _quotient(run, x, y):
    (a, of_a), (b, of_b) = x, y
    room = np.abs(b) - of_b
    error = np.where(room > 0, (of_a + np.abs(a / b) * of_b) / room, np.where(of_b > 0, np.inf, 0.0))
    return run.result(a / b, error, a)


def _root(run, x):
    a, error = x
    root = np.sqrt(a)
    up, down = error / (root + np.sqrt(a + error)), np.minimum(error, a) / (root + np.sqrt(np.maximum(a - error, 0)))
    return run.result(root, np.where(error > 0, np.fmax(up, down), 0.0))


def _turned(value, slope):
    def run_it(run, x):
        a, error = x
        # n right angles are taken off exactly to `near`, of which the documentation of `elementary` speaks
        near = np.where(np.abs(a) <= 1e6, run.near, 1.2e-16 * np.abs(a) if run.real == "double" else np.inf)
        moved = np.minimum(error * np.abs(slope(a)) + error**2 / 2, 2.0) + np.where(np.abs(a) > 0.75, near, 0.0)
        return run.result(value(a), np.where(np.abs(a) + error <= 1e9, moved, np.inf))

    return run_it


def _angle(run, y, x):
    (b, of_b), (a, of_a) = y, x
    run.doubtful |= (a <= 4 * of_a) & (np.abs(b) <= 4 * of_b)  # from π to -π
    error = np.where(of_a + of_b > 0, (np.abs(a) * of_b + np.abs(b) * of_a) / (a**2 + b**2), 0.0)
    return run.result(np.arctan2(b, a), error, b, times=2.0)


def _extreme(extreme):
    def run_it(run, x, y):
        (a, of_a), (b, of_b) = x, y
        value = extreme(a, b)
        own = np.where(value == a, of_a, of_b)
        return run.number(value, np.where(np.abs(a - b) > 4 * (of_a + of_b), own, np.maximum(of_a, of_b)))

    return run_it


def _signed(run, x, y):
    (a, of_a), (b, of_b) = x, y
    run.doubtful |= (np.abs(b) <= 4 * of_b) & (a != 0)  # a zero has either sign
    return run.number(np.copysign(a, b), of_a)


def _relation(relation):
    def run_it(run, x, y):
        (a, of_a), (b, of_b) = x, y
        error = of_a + of_b
        return Condition(relation(a, b), (error > 0) & ~(np.abs(a - b) > 4 * error))

    return run_it


def _whole(whole):
    def run_it(run, x):
        a, error = x
        run.doubtful |= (error > 0) & ~(np.abs(a - np.round(a)) > 4 * error)
        return run.number(whole(a), 0.0 * a)

    return run_it


ROUNDED: dict[int, Callable] = {
    ca.OP_MUL: _product,
    ca.OP_SQ: lambda run, x: _product(run, x, x),
    ca.OP_DIV: _quotient,
    ca.OP_INV: lambda run, x: _quotient(run, (np.ones_like(x[0]), 0.0), x),
    ca.OP_SQRT: _root,
    ca.OP_SIN: _turned(np.sin, np.cos),
    ca.OP_COS: _turned(np.cos, np.sin),
    ca.OP_ATAN2: _angle,
    ca.OP_FABS: lambda run, x: run.number(np.abs(x[0]), x[1]),
    ca.OP_COPYSIGN: _signed,
    ca.OP_FMAX: _extreme(np.fmax),
    ca.OP_FMIN: _extreme(np.fmin),
    ca.OP_FLOOR: _whole(np.floor),
    ca.OP_CEIL: _whole(np.ceil),
    ca.OP_LT: _relation(np.less),
    ca.OP_LE: _relation(np.less_equal),
    ca.OP_EQ: _relation(np.equal),
    ca.OP_NE: _relation(np.not_equal),
}


@dataclass(frozen=True)
class Comparison:
    """Two outputs of N states, and the bound."""

    ratio: float  # the greatest |ours - CasADi's| / B
    doubtful: float  # the share of states left out
    bounded: float  # the share of numbers that B knows to half of u's digits: it is below √u of them, or below √u


def compared(function, given, ours, real="double"):
    """The outputs `ours`, (N, rows) each, of inputs `given`, (N, rows) each, with CasADi's."""
    ratio, doubtful, bounded, numbers, count = 0.0, 0, 0, 0, len(given[0])
    for start in range(0, count, AT_ONCE):
        part = slice(start, min(start + AT_ONCE, count))
        columns = [np.ascontiguousarray(array[part].T, dtype=float) for array in given]
        run = Analysis(function, columns, real)
        expected = function.map(part.stop - part.start).call([ca.DM(column) for column in columns])
        doubtful += np.sum(run.doubtful)
        kept = ~run.doubtful
        for mine, other, bound in zip(ours, expected, run.bounds, strict=True):
            value, error = np.array(other)[:, kept], bound[:, kept]
            apart = np.abs(np.asarray(mine[part], dtype=float).T[:, kept] - value)
            assert not np.any(np.isnan(apart[np.isfinite(error)]))
            some = (apart > 0) & np.isfinite(error)
            with np.errstate(divide="ignore"):
                ratio = max(ratio, np.max(apart[some] / error[some], initial=0.0))
            bounded += np.sum(error <= run.unit**0.5 * np.maximum(1, np.abs(value)))
            numbers += error.size
    return Comparison(float(ratio), doubtful / count, bounded / max(numbers, 1))


# ---- Compiled functions of either type ----

REPEAT = """
typedef int (*function)(const REAL **arg, REAL **res, long long int *iw, REAL *w, int mem);

int repeat(function one, int times, int inputs, const REAL **arg, const int *in, int outputs, REAL **res,
           const int *out) {
  for (int k = 0; k < times; ++k) {
    if (one(arg, res, 0, 0, 0)) return 1;
    for (int i = 0; i < inputs; ++i) arg[i] += in[i];
    for (int i = 0; i < outputs; ++i) res[i] += out[i];
  }
  return 0;
}
"""


class Library:
    """Functions in the calling convention of CasADi, of N states at once."""

    def __init__(self, source, symbols, real="double", extra=()):
        repeat = source.parent / "repeat.c"
        repeat.write_text(REPEAT.replace("REAL", real), encoding="utf-8")
        self.real, self._ffi = real, cffi.FFI()
        self._ffi.cdef(
            f"typedef int (*function)(const {real} **, {real} **, long long *, {real} *, int);"
            f"int repeat(function, int, int, const {real} **, const int *, int, {real} **, const int *);"
            + "".join(f"int {symbol}(const {real} **, {real} **, long long *, {real} *, int);" for symbol in symbols)
        )
        self._library = self._ffi.dlopen(str(compile_library([source, repeat], extra=extra)))

    def __call__(self, symbol, given, sizes):
        """The outputs, (N, size) each, of inputs (N, rows)."""
        arrays = [np.ascontiguousarray(array, dtype=NUMBER[self.real]) for array in given]
        results = [np.empty((len(arrays[0]), size), dtype=NUMBER[self.real]) for size in sizes]
        arg = [self._ffi.cast(f"{self.real} *", array.ctypes.data) for array in arrays]
        res = [self._ffi.cast(f"{self.real} *", array.ctypes.data) for array in results]
        widths, all_sizes = [array.shape[1] for array in arrays], list(sizes)
        one = self._ffi.addressof(self._library, symbol)
        assert not self._library.repeat(one, len(arrays[0]), len(arg), arg, widths, len(res), res, all_sizes)
        return results


@functools.cache
def controller(name):
    """A shipped controller as CasADi's functions, by their names."""
    return {one.name: one for one in build(read_spec(SPECS[name])).functions}


@functools.cache
def casadi(name, function):
    return controller(name)[function].casadi


def flat(function, values):
    """The inputs of a CasADi function, (N, rows) each."""
    return [np.reshape(values[name], (len(values[name]), -1)) for name in function.name_in()]


def near(name, count, seed):
    """Joints within their limits, references and obstacles close by, parameters as they ship: (N, *shape) each."""
    rng, compiled = np.random.default_rng(seed), CompiledController.load(shipped_folder() / name)
    lower, upper = compiled.manifest.limits.T
    q = rng.uniform(np.maximum(lower, -3), np.minimum(upper, 3), (count, len(lower)))
    values = {"q": q}
    for signal in compiled.step.info.inputs[1:]:
        shape = (count, *signal.shape)
        if signal.role == "parameter":
            values[signal.name] = np.broadcast_to(np.reshape(signal.default, signal.shape), shape)
        elif signal.name.endswith("_count"):
            values[signal.name] = rng.integers(0, int(signal.maximum) + 1, count).astype(float)
        elif signal.name.endswith("_radius"):
            values[signal.name] = rng.uniform(0, 0.3, shape)
        else:
            values[signal.name] = rng.uniform(-1, 1, shape)
            if signal.name == "half_space_normal":
                values[signal.name] /= np.linalg.norm(values[signal.name], axis=-1, keepdims=True)
    if "obstacle_center" in values:
        place = compiled.kinematics.map(count, {"q": q})["point_position"]
        radius, reach = values["obstacle_radius"], values["influence_radius"]
        chosen = rng.integers(0, place.shape[1], radius.shape)
        away = rng.normal(size=values["obstacle_center"].shape)
        away /= np.linalg.norm(away, axis=-1, keepdims=True)
        apart = radius + np.take_along_axis(reach, chosen, axis=1) + rng.uniform(-0.03, 0.2, radius.shape)
        values["obstacle_center"] = np.take_along_axis(place, chosen[..., None], axis=1) + apart[..., None] * away
    return values


def info(name, function):
    """What a shipped function takes and gives."""
    return load_manifest(shipped_folder() / name).function(function)


def ours(name, function, values):
    """The outputs of a shipped function, compiled, (N, rows) each."""
    return mapped(getattr(CompiledController.load(shipped_folder() / name), function), values)


def mapped(one, values):
    """The outputs of a compiled function, (N, rows) each."""
    outputs = one.map(len(values["q"]), {key: value for key, value in values.items() if key in one.inputs})
    return [array.reshape(len(array), -1) for array in outputs.values()]


# ---- In doubles ----

FUNCTIONS = [(name, one) for name in SMALL for one in ("kinematics", "jacobians", "step")]
FUNCTIONS += [(name, one) for name in GUARDED for one in ("kinematics", "jacobians")]


def expect_within_four_bounds(name, function, values, in_doubt):
    one = casadi(name, function)
    found = compared(one, flat(one, values), ours(name, function, values))
    print(f"{name}_{function}: {found.ratio:.2f} B, {found.doubtful:.1e} in doubt")
    assert found.ratio <= 4
    assert found.doubtful < in_doubt
    return found


@pytest.mark.parametrize(("name", "function"), FUNCTIONS)
def test_c_is_within_four_bounds_of_casadi_in_states_as_they_occur(name, function):
    found = expect_within_four_bounds(name, function, near(name, STATES, 30), 1e-3)
    assert found.bounded > 0.99  # it says something


@pytest.mark.parametrize("function", ["kinematics", "jacobians", "step"])
def test_c_is_within_four_bounds_of_casadi_in_contact_and_where_the_arm_is_singular(function, states_near_contact):
    found = expect_within_four_bounds("planar5", function, states_near_contact(STATES, 32), 1e-3)
    assert found.bounded > 0.99


@pytest.mark.parametrize(("name", "function"), FUNCTIONS)
def test_c_is_within_four_bounds_of_casadi_all_over_the_limits(name, function, anything):
    """Among them gains of 1e4, damping of 1e-9, and numbers that are 0 or as great as another."""
    expect_within_four_bounds(name, function, anything(info(name, function), STATES, 31), 1e-2)


@pytest.mark.parametrize("function", ["kinematics", "jacobians", "step"])
def test_c_is_within_four_bounds_of_casadi_a_thousand_kilometres_away(function, states_within_limits):
    """Half of the obstacles sit on a point, known there to 1e-10 m, so that many directions are noise."""
    expect_within_four_bounds("planar5", function, states_within_limits(STATES, 32), 0.4)


def test_the_bound_sees_a_link_that_is_a_picometre_too_long(planar5_spec):
    """Or it would not say much."""
    robot = planar5_spec.robot
    frames = tuple(one.model_copy(update={"xyz": (one.xyz[0] + 1e-12, *one.xyz[1:])}) for one in robot.frames)
    other = build(planar5_spec.model_copy(update={"robot": robot.model_copy(update={"frames": frames})}))
    values = near("planar5", 500, 33)
    for function in ("kinematics", "jacobians", "step"):
        one = other.function(function)
        assert compared(one, flat(one, values), ours("planar5", function, values)).ratio > 100


# ---- With a barrier ----


@pytest.mark.parametrize("name", GUARDED)
def test_c_takes_the_steps_of_casadi_s_solver_to_the_same_velocity(name):
    """Rounding of 1e-16 is magnified by the metric, 1/yields² up to 2500, and by rows nearly parallel to each other:

    the worst of a million states is 3e-9. Rows that contradict each other have, to rounding over the slack of 1e-11,
    any of many solutions.
    """
    one, values = casadi(name, "step"), near(name, STATES, 34)
    expected = dict(zip(one.name_out(), one.map(STATES).call([ca.DM(a.T) for a in flat(one, values)]), strict=True))
    expected = {key: np.array(value).T for key, value in expected.items()}
    found = dict(zip(one.name_out(), ours(name, "step", values), strict=True))
    whole = ("barrier_solved", "barrier_steps", "barrier_row")
    alike = np.all([found[key] == expected[key] for key in whole], axis=0)[:, 0]
    solved = (expected["barrier_solved"][:, 0] == 1) & (expected["barrier_excess"][:, 0] <= 1e-8)
    acting = expected["barrier_steps"][:, 0] > 0
    assert np.sum(solved & acting) > STATES / 50
    worst = {key: np.max(np.abs(found[key] - expected[key])[solved & alike]) for key in found}
    print(f"{name}: {np.mean(~alike):.1e} otherwise, apart by {max(worst.values()):.1e}, {np.mean(acting):.0%} act")
    assert np.mean(alike) > 0.999
    assert max(worst.values()) < 1e-7


# ---- In floats ----


@pytest.fixture(scope="module")
def in_floats(tmp_path_factory):
    """`in_floats(name, function, values)`: outputs of a shipped controller in floats, (N, rows) each."""
    made = {}

    def library(name):
        folder = tmp_path_factory.mktemp("float")
        for file, text in generate(read_spec(SPECS[name]), "float").items():
            (folder / file).write_text(text, encoding="utf-8")
        return Library(folder / f"{name}.c", [f"{name}_{one}" for one in ("kinematics", "jacobians", "step")], "float")

    def run(name, function, values):
        one = casadi(name, function)
        made[name] = made.get(name) or library(name)
        sizes = [one.size1_out(k) for k in range(one.n_out())]
        return made[name](f"{name}_{function}", flat(one, values), sizes)

    return run


@pytest.mark.parametrize(("name", "function"), [pair for pair in FUNCTIONS if pair[0] in SMALL])
def test_floats_are_within_four_bounds_of_casadi_in_doubles(name, function, in_floats):
    """B with u = 2^-24, and constants rounded; of what is given, the nearest float is given to both."""
    one = casadi(name, function)
    values = {key: value.astype(np.float32).astype(float) for key, value in near(name, STATES, 35).items()}
    found = compared(one, flat(one, values), in_floats(name, function, values), "float")
    print(f"{name}_{function} in floats: {found.ratio:.2f} B, {found.doubtful:.1e} in doubt")
    assert found.ratio <= 4
    assert found.doubtful < 0.05
    assert found.bounded > 0.9


@pytest.mark.parametrize("name", SMALL)
def test_floats_are_finite_where_the_arm_is_stretched_or_folded(name, in_floats):
    """Guards against 0/0 have to be there in floats, too."""
    values = near(name, 400, 36)
    values["q"] = values["q"] * (np.arange(400) % 4 > 0)[:, None]
    values["q"][1::4] = np.round(values["q"][1::4] / np.pi) * np.pi
    for function in ("kinematics", "jacobians", "step"):
        for array in in_floats(name, function, values):
            assert np.all(np.isfinite(array))


# ---- Many robots side by side ----

X86 = platform.machine() in ("x86_64", "AMD64")
CAN = set(Path("/proc/cpuinfo").read_text(encoding="utf-8").split()) if X86 else set()
HAS_FMA = "fma" in CAN or platform.machine() in ("aarch64", "arm64")
VECTORS = {"native": NATIVE, "no vectors": ("-O1", "-march=native", "-UCLIKGEN_OPENMP")}
if {"avx2", "fma"} <= CAN:
    VECTORS["AVX2"] = ("-O3", "-mavx2", "-mfma")
TWICE = "-DCLIKGEN_FMA=0"  # rounds a product, and then its sum
TWICE_ROUNDED = {f"{vectors}, twice rounded": (*flags, TWICE) for vectors, flags in VECTORS.items()}
TWICE_ROUNDED |= {"plain": ("-O3", TWICE), "no vectors, plain": ("-O1", "-UCLIKGEN_OPENMP", TWICE)}
if X86:
    TWICE_ROUNDED["SSE2"] = ("-O3", "-msse2", "-mno-avx")


def twice_rounded(name, function, values):
    """The outputs of a shipped function without FMA, (N, rows) each."""
    what = info(name, function)
    sources = [shipped_folder() / name / f"{name}.c", Path(runtime.__file__).with_name("calls.c")]
    code = load_library(compile_library(sources, extra=(*NATIVE, TWICE)), [what.symbol])
    return mapped(CompiledFunction(what, code), values)


def in_lanes(name, flags, values):
    """The outputs of the shipped step of many robots at once, (N, rows) each; N is a multiple of LANES."""
    ffi, one = cffi.FFI(), casadi(name, "step")
    ffi.cdef(f"void {name}_step_lanes(const double *const *arg, double *const *res);")
    source = shipped_folder() / name / f"{name}_lanes.c"
    step = getattr(ffi.dlopen(str(compile_library([source], extra=flags))), f"{name}_step_lanes")

    def blocks(array):
        return np.ascontiguousarray(array.reshape(-1, LANES, array.shape[1]).transpose(0, 2, 1), dtype=float)

    given = list(map(blocks, flat(one, values)))
    results = [np.empty((len(given[0]), one.size1_out(k), LANES)) for k in range(one.n_out())]
    for k in range(len(given[0])):
        arg, res = ([ffi.from_buffer("double[]", array[k]) for array in arrays] for arrays in (given, results))
        step(ffi.new("double *[]", arg), ffi.new("double *[]", res))
    return [array.transpose(0, 2, 1).reshape(-1, array.shape[1]) for array in results]


def expect_the_same_bits(arrays, others):
    for array, other in zip(arrays, others, strict=True):
        np.testing.assert_array_equal(array.view(np.uint64), np.ascontiguousarray(other).view(np.uint64))


@pytest.mark.parametrize("name", SMALL)
def test_many_robots_at_once_step_like_one_bit_for_bit_whatever_vectors_there_are(name, states_near_contact):
    count = 128 * LANES
    samples = [near(name, count, 37), *([states_near_contact(count, 37)] if name == "planar5" else [])]
    for values in samples:
        for flags in VECTORS.values():
            expect_the_same_bits(in_lanes(name, flags, values), ours(name, "step", values))
        for flags in TWICE_ROUNDED.values():
            expect_the_same_bits(in_lanes(name, flags, values), twice_rounded(name, "step", values))


@pytest.mark.parametrize(("name", "function"), FUNCTIONS)
def test_c_of_processors_without_fma_is_within_four_bounds_of_casadi_too(name, function):
    one, values = casadi(name, function), near(name, STATES, 39)
    found = compared(one, flat(one, values), twice_rounded(name, function, values))
    assert found.ratio <= 4
    assert found.doubtful < 1e-3


@pytest.mark.skipif(not HAS_FMA, reason="wanted a processor with FMA")
def test_products_are_added_in_one_operation_where_the_processor_can():
    """Or the comparisons above would be of one thing with itself."""
    values = near("planar5", 100, 40)
    pairs = zip(ours("planar5", "step", values), twice_rounded("planar5", "step", values), strict=True)
    assert any(np.any(one != other) for one, other in pairs)


@pytest.mark.parametrize("name", GUARDED)
def test_a_step_with_a_barrier_has_no_form_for_many_robots(name):
    assert not (shipped_folder() / name / f"{name}_lanes.c").exists()


# ---- Random expressions ----

OPERATIONS: dict[str, Callable] = {
    "add": lambda x, y, _: x + y,
    "sub": lambda x, y, _: x - y,
    "mul": lambda x, y, _: x * y,
    "div": lambda x, y, _: x / y,
    "neg": lambda x, *_: -x,
    "square": lambda x, *_: x**2,
    "inverse": lambda x, *_: 1 / x,
    "sqrt": lambda x, *_: ca.sqrt(ca.fabs(x)),
    "sin": lambda x, *_: ca.sin(x),
    "cos": lambda x, *_: ca.cos(x),
    "atan2": lambda x, y, _: ca.atan2(x, y),
    "abs": lambda x, *_: ca.fabs(x),
    "copysign": lambda x, y, _: ca.copysign(x, y),
    "max": lambda x, y, _: ca.fmax(x, y),
    "min": lambda x, y, _: ca.fmin(x, y),
    "floor": lambda x, *_: ca.floor(x),
    "ceil": lambda x, *_: ca.ceil(x),
    "less": lambda x, y, _: ca.if_else(x < y, x, y * y),
    "if_else": lambda x, y, z: ca.if_else(ca.logic_and(x <= y, ca.logic_not(y == z)), x, z),
    "either": lambda x, y, z: ca.logic_or(x != y, y < z),
}
numbers = st.integers(0, 10**6)
programs = st.lists(st.tuples(st.sampled_from(sorted(OPERATIONS)), numbers, numbers, numbers), min_size=3, max_size=20)
TOGETHER = 60  # programs in one library


def carried_out(program):
    """Two columns of symbols, and all that comes of a program: the last three are its results."""
    inputs = [ca.SX.sym("p", 2), ca.SX.sym("q", 1)]
    found = [*ca.vertsplit(inputs[0]), inputs[1], *map(ca.SX, (0.1, 3.0, -0.7))]
    for operation, *at in program:
        found.append(OPERATIONS[operation](*(found[i % len(found)] for i in at)))
    return inputs, found


def is_finite(made):
    """Whether all constants are: CasADi computes 1/0 at once."""
    function = ca.Function("f", made[0], [ca.vertcat(*made[1])])
    constants = (k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CONST)
    return all(np.isfinite(function.instruction_constant(k)) for k in constants)


@pytest.mark.parametrize("extra", [(), NATIVE], ids=["plain", "native"])
@pytest.mark.parametrize("real", ["double", "float"])
@settings(max_examples=3, phases=[Phase.generate])
@given(st.lists(programs, min_size=TOGETHER, max_size=TOGETHER), st.integers(0, 2**32 - 1))
def test_the_c_of_any_expressions_is_within_four_bounds_of_casadi(tmp_path_factory, real, extra, batch, seed):
    names, procedures, texts, everything = Names(real), [], [], []
    for k, (inputs, found) in enumerate(filter(is_finite, map(carried_out, batch))):
        procedure = Procedure(f"f{k}", tuple(inputs), (ca.vertcat(*found[-3:-1]), found[-1]))
        texts.append(function_text(procedure, ["p", "q"], ["r", "s"], names))
        procedures.append(procedure)
        everything.append(ca.Function("all", inputs, [ca.vertcat(*found)]))
    source = tmp_path_factory.mktemp("random") / "random.c"
    source.write_text(module_text(texts, names), encoding="utf-8")
    library = Library(source, [one.name for one in procedures], real, extra)
    rng, used = np.random.default_rng(seed), 0
    for procedure, function in zip(procedures, everything, strict=True):
        p, q = (rng.choice([rng.uniform(-3, 3, (256, n)), rng.integers(-3, 4, (256, n)) / 2]) for n in (2, 1))
        values = np.array(function.map(256).call([ca.DM(p.T), ca.DM(q.T)])[0])
        some = np.all(np.abs(values) < 1e12, axis=0)  # not infinite, nor NaN
        if np.any(some):
            given = [p.astype(NUMBER[real])[some], q.astype(NUMBER[real])[some]]
            found = compared(procedure.casadi(), given, library(procedure.name, given, [2, 1]), real)
            assert found.ratio <= 4, procedure.results
            used += np.sum(some) * (1 - found.doubtful)
    assert used > 100 * TOGETHER


# ---- Many angles, and choices ----


@pytest.mark.parametrize("real", ["double", "float"])
def test_sines_are_those_of_their_angles_wherever_these_lie(real, tmp_path):
    """All runs of 2 to 12 angles, alone, with others before or after them, and every other one of them."""
    names, texts, procedures = Names(real), [], {}
    for count, before, after, step in itertools.product(range(2, 13), (0, 1), (0, 1), (1, 2)):
        x = ca.SX.sym("x", before + step * count + after)
        angles = x[before : before + step * count : step]
        name = f"f_{count}_{before}_{after}_{step}"
        procedures[name] = Procedure(name, (x,), (ca.vertcat(ca.sin(angles), ca.cos(angles)),))
        texts.append(function_text(procedures[name], ["x"], ["y"], names))
    source = tmp_path / "sines.c"
    source.write_text(module_text(texts, names), encoding="utf-8")
    library, rng = Library(source, list(procedures), real), np.random.default_rng(5)
    for name, procedure in procedures.items():
        given = [rng.uniform(-10, 10, (50, procedure.given[0].numel())).astype(NUMBER[real])]
        ours = library(name, given, [procedure.results[0].numel()])
        assert compared(procedure.casadi(), given, ours, real).ratio <= 4


JUMP = re.compile(r"^\s+(?:j(?!mp)[a-z]+|b\.[a-z]+|cbn?z|tbn?z)\s", re.MULTILINE)  # of x86 and 64-bit ARM


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64", "aarch64", "arm64"), reason="other jumps")
@pytest.mark.parametrize("level", ["-O2", "-O3"])
@pytest.mark.parametrize("command", [one.command for one in available_compilers()], ids=lambda command: command[-1])
def test_a_quaternion_is_chosen_without_a_jump(level, command, tmp_path):
    R, names = ca.SX.sym("R", 3, 3), Names("double")
    procedure = Procedure("quaternion", (ca.vec(R),), (quaternion_of(R),))
    source, assembly = tmp_path / "quaternion.c", tmp_path / "quaternion.s"
    source.write_text(module_text([function_text(procedure, ["R"], ["q"], names)], names), encoding="utf-8")
    common = [flag for flag in FLAGS if flag != "-shared"]
    outcome = run([*command, *common, level, "-S", "-o", assembly, source])
    assert outcome.returncode == 0, outcome.stderr
    assert JUMP.findall(assembly.read_text()) == []


# ---- The text ----


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """`files(name, target)`: the folder of a shipped controller in C or in floats."""
    made = {}

    def folder(name, target):
        if target == "c":
            return shipped_folder() / name
        if name not in made:
            made[name] = tmp_path_factory.mktemp("text")
            for file, text in generate(read_spec(SPECS[name]), target).items():
                (made[name] / file).write_text(text, encoding="utf-8")
        return made[name]

    return folder


def in_c99(folder):
    """The C files of a folder."""
    return sorted(map(str, folder.glob("*.c")))


def run(command, **environment):
    everything = {**os.environ, **{name: str(value) for name, value in environment.items()}}
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, env=everything)


STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Wfloat-conversion", "-pedantic"]
SIDE_BY_SIDE = ["-fopenmp-simd", "-DCLIKGEN_OPENMP"]
COMPILERS = list({Path(shutil.which(one.command[0])).resolve(): one.command for one in available_compilers()}.values())


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("command", COMPILERS, ids=lambda command: command[-1])
@pytest.mark.parametrize("more", [[], SIDE_BY_SIDE], ids=["one by one", "side by side"])
@pytest.mark.parametrize("name", SPECS)
def test_c_compiles_without_a_warning_of_any_conversion(name, target, command, more, files, tmp_path):
    for source in in_c99(files(name, target)):
        # zig only compiles
        check = ["-c", "-o", tmp_path / "object.o"] if "ziglang" in command else ["-fsyntax-only"]
        outcome = run([*command, *STRICT, "-Werror", *more, *check, source])
        assert outcome.returncode == 0, outcome.stderr


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("command", COMPILERS, ids=lambda command: command[-1])
@pytest.mark.parametrize("name", ["planar5", "ur6"])
def test_c_compiles_without_a_warning_that_takes_optimization_to_see(name, target, command, files, tmp_path):
    source = files(name, target) / f"{name}.c"
    outcome = run([*command, *STRICT, "-Werror", *SIDE_BY_SIDE, "-O2", "-c", "-o", tmp_path / "object.o", source])
    assert outcome.returncode == 0, outcome.stderr


# processor -> flags of its vectors, and a product of whole ones in its assembly, the narrowest first
PACKED = {
    "x86_64": [
        ([], r"\bmulpd\s.*%xmm"),
        (["-mavx2"], r"\bvmulpd\s.*%ymm"),
        (["-mavx512dq", "-mprefer-vector-width=512"], r"\bvmulpd\s.*%zmm"),
    ],
    "aarch64": [([], r"\bfmul\s+v\d+\.2d")],
}.get(platform.machine(), [])


@pytest.mark.parametrize(("flags", "product"), PACKED)
@pytest.mark.parametrize("command", COMPILERS, ids=lambda command: command[-1])
@pytest.mark.parametrize("name", SMALL)
def test_lanes_are_vectors_for_the_compiler(name, command, flags, product, files, tmp_path):
    """And a root of the text is one root, for gcc, which does not write the loop out."""
    source, assembly = files(name, "c") / f"{name}_lanes.c", tmp_path / "lanes.s"
    common = [flag for flag in FLAGS if flag != "-shared"]
    baseline = ["-mcpu=baseline"] if "ziglang" in command and not flags else []  # zig's own is this processor
    outcome = run([*command, *common, "-O3", *flags, *baseline, "-S", "-o", assembly, source])
    assert outcome.returncode == 0, outcome.stderr
    text = assembly.read_text()
    alone = len(re.findall(r"\bv?mulsd\s|\bfmul\s+d\d", text))
    assert len(re.findall(product, text)) > 10 * max(alone, 1)
    if "clang" not in run([*command, "--version"]).stdout:
        assert len(re.findall(r"\bv?f?sqrt", text)) == source.read_text(encoding="utf-8").count(" sqrt(")


VECTORIZED = re.compile(r":(\d+):\d+: (?:optimized: loop vectorized|remark: vectorized loop)")


@pytest.mark.parametrize("flags", [flags for flags, _ in PACKED[1:2] or PACKED])
@pytest.mark.parametrize("command", COMPILERS, ids=lambda command: command[-1])
@pytest.mark.parametrize("name", SPECS)
def test_loops_that_may_run_side_by_side_are_vectors_for_the_compiler(name, command, flags, files, tmp_path):
    """A choice that becomes a branch would keep them from it."""
    source, common = files(name, "c") / f"{name}.c", [flag for flag in FLAGS if flag != "-shared"]
    clang = "clang" in run([*command, "--version"]).stdout
    tell = "-Rpass=loop-vectorize" if clang else "-fopt-info-vec-optimized"
    check = [*command, *common, "-O3", *flags, tell, "-c", "-o", tmp_path / "one.o", source]
    outcome = run(check, ZIG_LOCAL_CACHE_DIR=tmp_path)  # zig says nothing of what it finds compiled
    assert outcome.returncode == 0, outcome.stderr
    found = {int(line) for line in VECTORIZED.findall(outcome.stderr)}
    lines = source.read_text(encoding="utf-8").splitlines()
    wanted = [k + 2 for k, line in enumerate(lines) if line.strip() == "CLIKGEN_SIMD"]
    assert wanted
    # clang names the pragma, gcc the first line inside
    assert [k for k in wanted if not {k - 1, k, k + 1} & found] == []


FAST = ["-ffast-math", "-ffinite-math-only"]
FAST += ["-Ofast"] if "ziglang" not in find_compiler().command else []  # to zig that is another word for -O3


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("flag", FAST)
@pytest.mark.parametrize("name", SPECS)
def test_flags_that_drop_the_guards_are_refused_in_plain_words(name, target, flag, files):
    for source in in_c99(files(name, target)):
        outcome = run([*find_compiler().command, "-std=c99", flag, "-E", "-o", os.devnull, source])
        assert outcome.returncode != 0
        assert "clikgen: compile without -ffast-math" in outcome.stderr


CALLED = re.compile(r"\b([a-z]\w*)\(")
WORDS = {"for", "if", "while", "defined", "off"}
DEFINED = re.compile(r"^(?:static (?:inline )?)?\w+ (\w+)\([^;]*?\) \{", re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("name", SPECS)
def test_c_calls_nothing_but_itself_and_roots_and_what_no_compiler_calls(name, target, files):
    allowed = {"sqrt", "fabs", "copysign", "fma"} if target == "c" else {"sqrtf", "fabsf", "copysignf", "fmaf"}
    for source in in_c99(files(name, target)):
        text = re.sub(
            r"/\*.*?\*/|^ *#.*?$", "", Path(source).read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL
        )
        assert set(CALLED.findall(text)) - set(DEFINED.findall(text)) - WORDS <= allowed | {"UINT64_C", "UINT32_C"}


ALL_IT_NEEDS = """\
#include <stddef.h>
double sqrt(double x) { return x; }
float sqrtf(float x) { return x; }
void *memset(void *to, int value, size_t count) { (void)value, (void)count; return to; }
void *memcpy(void *to, const void *from, size_t count) { (void)from, (void)count; return to; }
"""


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("level", ["-O1", "-O2", "-O3", "-Os"])  # at -O0 copysign is a call
@pytest.mark.parametrize("processor", [[], ["-march=native"]], ids=["plain", "native"])
def test_c_links_without_libm_where_there_is_a_root(real, level, processor, tmp_path):
    """Every operation there is, and nothing of libc but what compilers may call for an assignment."""
    x, names = ca.SX.sym("x", 2), Names(real)
    results = [operation(x[0], x[1], x[0]) for operation in OPERATIONS.values()]
    procedure = Procedure("everything", (x,), (ca.vertcat(*results),))
    source, rest = tmp_path / "everything.c", tmp_path / "rest.c"
    source.write_text(module_text([function_text(procedure, ["x"], ["y"], names)], names), encoding="utf-8")
    rest.write_text(ALL_IT_NEEDS, encoding="utf-8")
    flags = [
        "-std=c99",
        level,
        *processor,
        "-fPIC",
        "-shared",
        "-nostdlib",
        "-Wl,--no-undefined",
        "-fno-stack-protector",
    ]
    flags += ["-fno-sanitize=all"]  # zig checks by itself where it does not optimize
    command = [*find_compiler().command, *flags, "-o", tmp_path / "library.so", source, rest]
    outcome = run(command)
    assert outcome.returncode == 0, outcome.stderr
    with rest.open("a", encoding="utf-8") as more:
        more.write("double cbrt(double x);\ndouble another(double x) { return cbrt(x); }\n")
    assert run(command).returncode != 0  # or this would prove nothing


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("name", SPECS)
def test_no_line_is_longer_than_140_characters(name, target, files):
    for source in files(name, target).glob("*.[ch]"):
        assert max(map(len, source.read_text(encoding="utf-8").splitlines())) <= 140, source.name


@pytest.mark.parametrize("target", ["c", "float"])
@pytest.mark.parametrize("name", ["planar5", "ur6"])
def test_the_same_spec_gives_the_same_text(name, target, files):
    for file, text in generate(read_spec(SPECS[name]), target).items():
        assert text == (files(name, target) / file).read_text(encoding="utf-8")


def body(name, function, folder):
    """The text of a function."""
    text = (folder / f"{name}.c").read_text(encoding="utf-8")
    return re.search(rf"^int {name}_{function}\(.*?^}}\n", text, re.MULTILINE | re.DOTALL)[0]


LITERAL = re.compile(r"(?<![\w.\[])(?:\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)")
STRAIGHT = [(name, one) for name in SPECS for one in ("kinematics", "jacobians")] + [("planar3", "step")]


@pytest.mark.parametrize(("name", "function"), [pair for pair in STRAIGHT if pair != ("planar5", "jacobians")])
def test_every_constant_stands_in_the_text_to_the_last_bit(name, function, files):
    graph = controller(name)[function].procedure.graph()
    wanted = {graph.nodes[i].value for i in graph.needed() if graph.nodes[i].operation == "constant"}
    for target in ("c", "float"):
        found = {float(one) for one in LITERAL.findall(body(name, function, files(name, target)))}
        assert found == {abs(value) if target == "c" or not value else in_float(abs(value)) for value in wanted}


def in_float(value):
    """What stands for a constant in single precision: one that is there for rounding's sake is made for doubles."""
    return max(IN_FLOAT.get(value, value), LEAST_FLOAT)


class Operations:
    """How many operations some C carries out: every distinct one once where there is no loop."""

    def __init__(self):
        self.looped, self._seen, self._written = 0, set(), c_generator.CGenerator()

    @property
    def total(self):
        """All of them."""
        return self.looped + len(self._seen)

    def add(self, node):
        """What a part of the syntax tree carries out."""
        if isinstance(node, c_ast.For):
            inner = Operations()
            inner.add(node.stmt)
            self.looped += int(node.cond.right.value) * inner.total
            return
        parts = [child for _, child in node.children()]
        if isinstance(node, c_ast.ArrayRef):
            parts = []
            self._angle(node, node.name.name)
        elif isinstance(node, c_ast.ID):
            self._angle(node, node.name)
        elif isinstance(node, c_ast.UnaryOp):
            negative = node.op == "-" and isinstance(node.expr, c_ast.Constant)
            parts = [] if node.op == "&" else parts
            self._count(node, node.op in ("-", "!") and not negative)
        elif isinstance(node, c_ast.TernaryOp):
            self._count(node, True)
            if isinstance(node.cond, c_ast.BinaryOp) and self._is_extreme(node):
                parts = parts[1:]
        elif isinstance(node, c_ast.BinaryOp):
            self._count(node, True)
        elif isinstance(node, c_ast.FuncCall):
            turned, masked, fused = (node.name.name == f"clikgen_{name}" for name in ("sincos", "mask", "fma"))
            parts = node.args.exprs[:1] if turned else node.args.exprs
            self._count(node, not turned and not masked)  # a mask is a condition in other words
            if fused:  # a product besides; a sign is none
                self._seen.add(f"product of {self._written.visit(node)}")
                signs = [one for one in parts if isinstance(one, c_ast.UnaryOp) and one.op == "-"]
                parts = [one.expr if one in signs else one for one in parts]
        for part in parts:
            self.add(part)

    def _count(self, node, counts):
        if counts:
            self._seen.add(self._written.visit(node))

    def _angle(self, node, name):
        """A sine or a cosine is one where it is used."""
        self._count(node, re.fullmatch(r"(s|c|sine|cosine)\d+", name))

    def _is_extreme(self, node):
        """Whether it is a > b ? a : b."""
        sides = [self._written.visit(one) for one in (node.cond.left, node.cond.right)]
        return node.cond.op in "<>" and sides == [self._written.visit(one) for one in (node.iftrue, node.iffalse)]


@pytest.mark.parametrize(("name", "function"), [*STRAIGHT, ("planar5", "step")])
def test_the_manifest_counts_the_operations_that_stand_in_the_text(name, function, files):
    text = re.sub(r"^ *CLIKGEN_SIMD\n", "", body(name, function, files(name, "c")), flags=re.MULTILINE)
    counted = Operations()
    counted.add(c_parser.CParser().parse(text.replace("uint64_t", "unsigned long long")).ext[0].body)
    assert counted.total == info(name, function).operations


# ---- Under sanitizers ----

MAIN = """
#include <stdio.h>
#include "NAME.h"

#define ALL(function)                                                                      \\
  do {                                                                                     \\
    function##_input input;                                                                \\
    function##_output output;                                                              \\
    FILE *file = fopen(*++argv, "rb");                                                     \\
    while (fread(&input, sizeof input, 1, file) == 1) {                                    \\
      if (function##_call(&input, &output)) return 1;                                      \\
      const double *value = (const double *)&output;                                       \\
      int finite = 1;                                                                      \\
      for (size_t i = 0; i < sizeof output / sizeof *value; ++i) finite &= value[i] - value[i] == 0; \\
      ++count, all += finite;                                                              \\
    }                                                                                      \\
    fclose(file);                                                                          \\
  } while (0)

int main(int argc, char **argv) {
  int count = 0, all = 0;
  (void)argc;
  ALL(NAME_kinematics);
  ALL(NAME_jacobians);
  ALL(NAME_step);
  printf("%d %d\\n", count, all);
  return 0;
}
"""


@functools.cache
def sanitizers():
    """Those that this compiler has."""
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "main.c"
        source.write_text("int main(void) { return 0; }\n", encoding="utf-8")
        for names in ("address,undefined,float-cast-overflow", "undefined"):
            flags = [f"-fsanitize={names}", "-fno-sanitize-recover=all"]
            if run([*find_compiler().command, *flags, "-o", source.with_suffix(""), source]).returncode == 0:
                return flags
    return []


def corners(signals, count):
    """Everything at its least, everything at its greatest, everything at zero where that is allowed, in turn."""
    values = {}
    for signal in signals:
        ends = np.array([signal.minimum, signal.maximum, np.clip(0.0, signal.minimum, signal.maximum)])
        at = np.arange(count) % 3
        values[signal.name] = np.broadcast_to(ends[at].reshape(-1, *[1] * len(signal.shape)), (count, *signal.shape))
        if signal.positive_definite:
            values[signal.name] = np.broadcast_to(np.reshape(signal.default, signal.shape), (count, *signal.shape))
    return values


@pytest.mark.parametrize("name", SPECS)
def test_sanitizers_find_nothing_wherever_the_state_is(name, anything, tmp_path):
    main, program, folder, count = tmp_path / "main.c", tmp_path / "main", shipped_folder() / name, 60
    main.write_text(MAIN.replace("NAME", name), encoding="utf-8")
    flags = ["-std=c99", "-O0", *sanitizers(), *SIDE_BY_SIDE, "-ffp-contract=off", f"-I{folder}"]
    outcome = run([*find_compiler().command, *flags, "-o", program, main, folder / f"{name}.c", "-lm"])
    assert outcome.returncode == 0, outcome.stderr
    written = []
    for function in ("kinematics", "jacobians", "step"):
        signals, wanted = info(name, function).inputs, casadi(name, function)
        samples = [near(name, count, 40), anything(info(name, function), count, 41), corners(signals, count)]
        rows = [np.hstack(flat(wanted, values)) for values in samples]
        written.append(tmp_path / function)
        np.vstack(rows).astype(float).tofile(written[-1])
    outcome = run([program, *written])
    assert outcome.returncode == 0, outcome.stderr
    assert outcome.stdout.split() == [str(9 * count)] * 2
