"""Sine, cosine, atan2, floor and ceil in C without libm: how accurate, for which arguments, and under which flags.

The oracle is integer arithmetic: numbers are counted in units of 2^-400, π is Machin's sum, sine and cosine are their
series on an exactly reduced argument.
"""

import math
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import cffi
import numpy as np
import pytest

from clikgen.runtime.compiler import FLAGS, available_compilers, find_compiler
from clikgen.symbolic.elementary import NAMES, text

WARNINGS = ["-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wdouble-promotion", "-Wfloat-conversion", "-Werror"]
COMPILERS = pytest.mark.parametrize("compiler", [one.command for one in available_compilers()], ids=" ".join)
REALS = pytest.mark.parametrize("real", ["double", "float"])
TWICE = "-DCLIKGEN_FMA=0"  # rounds a product, and then its sum
BUILDS = {
    "scalar": (TWICE, "-fno-tree-vectorize"),
    "side_by_side": (TWICE, "-O3", "-march=native", "-fopenmp-simd"),
    "fused": ("-march=native", "-fno-tree-vectorize"),
    "fused_side_by_side": ("-O3", "-march=native", "-fopenmp-simd"),
    "contracted": ("-march=native", "-ffp-contract=fast"),
}
EACH_BUILD = pytest.mark.parametrize("build", BUILDS)
# those side by side are the others, bit for bit
EACH_ROUNDING = pytest.mark.parametrize("build", ["scalar", "fused", "contracted"])
LOOPS = {
    "fma": (
        "void fma_each(const REAL *restrict x, const REAL *restrict y, const REAL *restrict z, REAL *restrict r, "
        "int n)",
        "r[i] = clikgen_fma(x[i], y[i], z[i]);",
    ),
    "choice": (
        "void choice_each(const REAL *restrict x, const REAL *restrict y, REAL *restrict r, int n)",
        "r[i] = clikgen_choice(clikgen_mask(x[i] < y[i]), x[i], y[i]);",
    ),
    "sincos": (
        "void sincos_each(const REAL *restrict x, REAL *restrict s, REAL *restrict c, int n)",
        "REAL sine, cosine; clikgen_sincos(x[i], &sine, &cosine); s[i] = sine; c[i] = cosine;",
    ),
    "atan2": (
        "void atan2_each(const REAL *restrict y, const REAL *restrict x, REAL *restrict angle, int n)",
        "angle[i] = clikgen_atan2(y[i], x[i]);",
    ),
    "floor": (
        "void floor_each(const REAL *restrict x, REAL *restrict whole, int n)",
        "whole[i] = clikgen_floor(x[i]);",
    ),
    "ceil": (
        "void ceil_each(const REAL *restrict x, REAL *restrict whole, int n)",
        "whole[i] = clikgen_ceil(x[i]);",
    ),
}


def source(real, names=NAMES, count="n"):
    """A file of these functions and a loop over each."""
    loops = "".join(
        f"{LOOPS[name][0]};\n{LOOPS[name][0]} {{\n  (void)n;\n"
        f"#pragma omp simd\n  for (int i = 0; i < {count}; ++i) {{ {LOOPS[name][1]} }}\n}}\n"
        for name in names
    )
    return "#include <math.h>\n" + text(real, names) + loops.replace("REAL", real)


@dataclass(frozen=True)
class Functions:
    """The compiled loops, on arrays."""

    real: str
    ffi: cffi.FFI
    compiled: object

    @property
    def dtype(self):
        return np.dtype({"double": np.float64, "float": np.float32}[self.real])

    def called(self, name, inputs, outputs):
        arrays = [np.ascontiguousarray(one, self.dtype) for one in np.broadcast_arrays(*inputs)]
        results = [np.empty_like(arrays[0]) for _ in range(outputs)]
        pointers = [self.ffi.from_buffer(f"{self.real}[]", one) for one in arrays + results]
        getattr(self.compiled, name)(*pointers, arrays[0].size)
        return results

    def fma(self, a, b, c):
        return self.called("fma_each", [np.atleast_1d(a), np.atleast_1d(b), np.atleast_1d(c)], 1)[0]

    def choice(self, x, y):
        """The lesser of the two, y where they cannot be compared."""
        return self.called("choice_each", [np.atleast_1d(x), np.atleast_1d(y)], 1)[0]

    def sincos(self, x):
        return self.called("sincos_each", [np.atleast_1d(x)], 2)

    def atan2(self, y, x):
        return self.called("atan2_each", [np.atleast_1d(y), np.atleast_1d(x)], 1)[0]

    def floor(self, x):
        return self.called("floor_each", [np.atleast_1d(x)], 1)[0]

    def ceil(self, x):
        return self.called("ceil_each", [np.atleast_1d(x)], 1)[0]


def compile_functions(real, folder, flags):
    (folder / "functions.c").write_text(source(real))
    library = folder / "functions.so"
    command = [*find_compiler().command, *FLAGS, *flags, "-o", str(library), str(folder / "functions.c")]
    subprocess.run(command, check=True, capture_output=True)
    ffi = cffi.FFI()
    ffi.cdef("".join(f"{head};\n" for head, _ in LOOPS.values()).replace("REAL", real))
    return Functions(real, ffi, ffi.dlopen(str(library)))


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """`compiled(real, build)`, each compiled once."""
    known = {}

    def load(real, build):
        if (real, build) not in known:
            known[real, build] = compile_functions(real, tmp_path_factory.mktemp("elementary"), BUILDS[build])
        return known[real, build]

    return load


# ---- The oracle ----

ONE = 1 << 400


def _atan_of_reciprocal(k):
    power, total, i = ONE // k, 0, 0
    while power:
        total += (-1) ** i * (power // (2 * i + 1))
        power, i = power // k**2, i + 1
    return total


HALF_PI = 8 * _atan_of_reciprocal(5) - 2 * _atan_of_reciprocal(239)


def exact(x):
    """A floating-point number in units of 2^-400; below 2^-400 it is cut."""
    numerator, denominator = float(x).as_integer_ratio()
    return numerator * ONE // denominator


@cache
def sine_and_cosine(x):
    """Of a number in units of 2^-400, in such units, to about 2^-380."""
    n = (2 * x + HALF_PI) // (2 * HALF_PI)
    r = x - n * HALF_PI
    square, sine, cosine, term, i = r * r // ONE, 0, 0, ONE, 0
    while abs(term) > 1 << 20:
        cosine += term
        odd = term * r // ONE // (i + 1)
        sine += odd
        term = -term * square // ONE // ((i + 1) * (i + 2))
        i += 2
    return [(sine, cosine), (cosine, -sine), (-sine, -cosine), (-cosine, sine)][n % 4]


def spacing(value, dtype):
    """A unit in the last place of numbers like this one, of the type asked for."""
    return float(np.spacing(np.abs(dtype.type(value))))


def of_type(values, dtype):
    return np.asarray(values, dtype=np.float64).astype(dtype)


def angles(dtype):
    """Up to 1e6 rad: everywhere, in every power of ten, and where quadrants meet."""
    rng = np.random.default_rng(1)
    even, powers = rng.uniform(-1e6, 1e6, 700), np.logspace(-12, 6, 300) * rng.choice([-1, 1], 300)
    meet = (rng.integers(0, 636619, 300) + 0.5) * (math.pi / 2)
    near = [1e6, -1e6, *np.linspace(-7, 7, 301)]
    return of_type(np.concatenate([even, powers, meet, near]), dtype)


def zeros(dtype):
    """The numbers around n π/2, and n, up to 1e6 rad."""
    rng = np.random.default_rng(2)
    n = np.unique(np.concatenate([np.arange(1, 60), rng.integers(1, 636619, 140), np.logspace(0, 5.8, 60).astype(int)]))
    middle = of_type([int(k) * HALF_PI / ONE for k in n], dtype)
    step = np.spacing(middle)
    return np.concatenate([middle + i * step for i in (-2, -1, 0, 1, 2)]), np.tile(n, 5)


def directions(dtype):
    """(y, x) all around, near every change of formula, of very different lengths, and the worst of 6e7."""
    rng = np.random.default_rng(3)
    borders = np.repeat(np.arange(16) * np.pi / 8, 60) + rng.normal(0, 0.01, 960)
    theta = np.concatenate([rng.uniform(-np.pi, np.pi, 1500), borders])
    length = np.exp(rng.uniform(-60, 60, theta.size))
    unequal = np.exp(rng.uniform(-40, 40, (2, 500))) * rng.choice([-1, 1], (2, 500))
    worst = [[0.38369890065726137, 0.400787026, 0.362109393], [0.92345825765673295, 0.916171253, 0.86468637]]
    y = np.hstack([length * np.sin(theta), unequal[0], worst[0]])
    x = np.hstack([length * np.cos(theta), unequal[1], worst[1]])
    return of_type(y, dtype), of_type(x, dtype)


# ---- Accuracy ----


@EACH_ROUNDING
@REALS
def test_sine_and_cosine_are_within_their_bound_up_to_a_million_radians(real, build, compiled):
    functions = compiled(real, build)
    # Each is a sum of two roundings of numbers below 1 (2^-54, 2^-25 each), half of one in x^2 and what r lacks.
    bound = {"double": 1.8e-16, "float": 1.0e-7}[real]
    x = angles(functions.dtype)
    for angle, *found in zip(x, *functions.sincos(x), strict=True):
        for value, true in zip(found, sine_and_cosine(exact(angle)), strict=True):
            assert abs(exact(value) - true) / ONE <= bound, f"at {angle!r}"


@EACH_ROUNDING
@REALS
def test_sine_and_cosine_keep_their_digits_near_their_zeros(real, build, compiled):
    functions = compiled(real, build)
    # What the parts of π/2 lack of it (3.6e-27, 5.4e-15) and the rounding of n times the last (half of ulp(last) n).
    lacking = {"double": 1.1e-26, "float": 1.6e-14}[real]
    x, n = zeros(functions.dtype)
    for angle, k, *found in zip(x, n, *functions.sincos(x), strict=True):
        true = sine_and_cosine(exact(angle))[int(k) % 2]
        bound = 1.6 * spacing(true / ONE, functions.dtype) + lacking * int(k)
        assert abs(exact(found[int(k) % 2]) - true) / ONE <= bound, f"at {angle!r}"


@EACH_ROUNDING
@REALS
def test_arctangent_is_within_two_and_a_half_units_in_the_last_place(real, build, compiled):
    functions = compiled(real, build)
    bound = {"double": 2.5, "float": 2.4}[real]  # the largest found in 6e7 random directions
    y, x = directions(functions.dtype)
    for b, a, angle in zip(y, x, functions.atan2(y, x), strict=True):
        sine, cosine = sine_and_cosine(exact(angle))
        across, along = exact(b) * cosine - exact(a) * sine, exact(a) * cosine + exact(b) * sine
        assert along > 0
        off = float(Fraction(across, along))  # the tangent of the error, which is the error
        assert abs(off) <= bound * spacing(angle, functions.dtype), f"at {b!r}, {a!r}"


@REALS
def test_squares_of_sine_and_cosine_add_up_to_one(real, compiled):
    functions = compiled(real, "scalar")
    # 2 (s δs + c δc) with δs, δc as bounded above and |s| + |c| <= √2
    bound = 2 * math.sqrt(2) * {"double": 1.8e-16, "float": 1.0e-7}[real]
    for s, c in zip(*functions.sincos(angles(functions.dtype)), strict=True):
        assert abs(Fraction(float(s)) ** 2 + Fraction(float(c)) ** 2 - 1) <= bound


@EACH_ROUNDING
def test_beyond_a_million_radians_the_error_grows_with_the_angle(build, compiled):
    x = np.random.default_rng(4).uniform(1e6, 2**30, 500)
    for angle, *found in zip(x, *compiled("double", build).sincos(x), strict=True):
        for value, true in zip(found, sine_and_cosine(exact(angle)), strict=True):
            assert abs(exact(value) - true) / ONE <= 1.2e-16 * angle  # n times the first part is rounded: ulp(x) / 2


# ---- What holds exactly ----


@EACH_BUILD
@REALS
def test_sine_is_odd_and_cosine_even(real, build, compiled):
    functions = compiled(real, build)
    x = angles(functions.dtype)
    (s, c), (s_back, c_back) = functions.sincos(x), functions.sincos(-x)
    np.testing.assert_array_equal(s_back, -s)
    np.testing.assert_array_equal(c_back, c)


@EACH_BUILD
@REALS
def test_small_angles_are_their_own_sines(real, build, compiled):
    functions = compiled(real, build)
    tiny = np.finfo(functions.dtype)
    x = of_type([0.0, tiny.smallest_normal, 1e-30, -1e-30, tiny.eps / 8], functions.dtype)
    s, c = functions.sincos(x)
    np.testing.assert_array_equal(s, x)
    np.testing.assert_array_equal(c, 1)


@EACH_BUILD
@REALS
def test_angle_changes_sign_with_y(real, build, compiled):
    functions = compiled(real, build)
    y, x = directions(functions.dtype)
    np.testing.assert_array_equal(functions.atan2(-y, x), -functions.atan2(y, x))


@EACH_BUILD
@REALS
def test_arctangent_of_zeros_is_that_of_c99(real, build, compiled):
    functions = compiled(real, build)
    for y, x in [(b, a) for b in (0.0, -0.0, 2.0, -2.0) for a in (0.0, -0.0, 3.0, -3.0) if b == 0 or a == 0]:
        found = functions.atan2(y, x)[0]
        assert found == functions.dtype.type(math.atan2(y, x))
        assert np.signbit(found) == np.signbit(math.atan2(y, x))


@EACH_BUILD
@REALS
def test_floor_and_ceil_are_those_of_c99(real, build, compiled):
    functions = compiled(real, build)
    whole = np.concatenate([np.arange(-5, 6), 2.0 ** np.arange(20, 60), [1e30, np.inf]])
    halves = np.concatenate([whole, whole + 0.5, [0.3, 0.7, 1e-30]])
    x = of_type(np.concatenate([halves, -halves]), functions.dtype)
    x = np.concatenate([x, np.nextafter(x, functions.dtype.type(np.inf)), np.nextafter(x, functions.dtype.type(0))])
    for found, true in ((functions.floor(x), np.floor(x)), (functions.ceil(x), np.ceil(x))):
        np.testing.assert_array_equal(found, true)
        np.testing.assert_array_equal(np.signbit(found), np.signbit(true))


@EACH_BUILD
@REALS
def test_a_choice_is_one_of_the_two_to_the_last_bit(real, build, compiled):
    functions = compiled(real, build)
    special = of_type([0.0, -0.0, 1.0, -1.5, 1e-30, np.inf, -np.inf, np.nan], functions.dtype)
    x, y = (np.ascontiguousarray(one.ravel()) for one in np.meshgrid(special, special))
    assert functions.choice(x, y).tobytes() == np.where(x < y, x, y).tobytes()


@EACH_BUILD
@REALS
def test_nan_and_infinity_make_nan(real, build, compiled):
    functions = compiled(real, build)
    largest = np.finfo(functions.dtype).max
    beyond = {"double": 2.0**30, "float": 2.0**20}[real]
    for result in functions.sincos(np.array([np.nan, np.inf, -np.inf, largest, -largest, beyond, -beyond])):
        assert np.isnan(result).all()
    y, x = np.array([[np.nan, 1.0], [1.0, np.nan], [np.nan, np.nan], [np.nan, 0.0], [0.0, np.nan]]).T
    assert np.isnan(functions.atan2(y, x)).all()
    assert np.isnan([functions.floor(np.nan), functions.ceil(np.nan)]).all()


@EACH_BUILD
@REALS
def test_a_product_and_a_sum_are_rounded_once_or_twice_and_every_build_knows(real, build, compiled):
    """Whether it is once the text tells the compiler, and the first of the sums shows: it is the product's rounding."""
    functions = compiled(real, build)
    rng = np.random.default_rng(9)
    a, b, c = (of_type(rng.normal(0, 3, 500), functions.dtype) for _ in range(3))
    a[0], b[0] = 1 / functions.dtype.type(3), 3
    c[0] = -(a[0] * b[0])
    found = functions.fma(a, b, c)
    exactly = [Fraction(float(x)) * Fraction(float(y)) + Fraction(float(z)) for x, y, z in zip(a, b, c, strict=True)]
    once = np.array([nearest(one, functions.dtype) for one in exactly], functions.dtype)
    assert once[0] != 0 == (a * b + c)[0]
    if found[0]:
        assert TWICE not in BUILDS[build]
        np.testing.assert_array_equal(found, once)
    else:
        np.testing.assert_array_equal(found, a * b + c)


ALTERNATING = """
void alternating(const REAL *restrict x, const REAL *restrict y, const REAL *restrict z, REAL *restrict r, int n) {
  for (int i = 0; i < n; i += 2) {
    r[i] = clikgen_fma(x[i], y[i], z[i]);
    r[i + 1] = clikgen_fma(x[i + 1], y[i + 1], -z[i + 1]);
  }
}
"""


@REALS
def test_sums_and_differences_in_turn_are_rounded_twice_where_they_shall_be(real, tmp_path):
    """gcc 12 has an instruction for a pair of them, which rounds once."""
    head = ALTERNATING[: ALTERNATING.index(" {")].strip().replace("REAL", real)
    code = f"#include <math.h>\n{text(real, ['fma'])}{head};\n{ALTERNATING}".replace("REAL", real)
    (tmp_path / "alternating.c").write_text(code)
    command = [*find_compiler().command, *FLAGS, "-O3", "-march=native", TWICE, "-o", str(tmp_path / "alternating.so")]
    subprocess.run([*command, str(tmp_path / "alternating.c")], check=True, capture_output=True)
    ffi = cffi.FFI()
    ffi.cdef(f"{head};")
    functions = Functions(real, ffi, ffi.dlopen(str(tmp_path / "alternating.so")))
    rng = np.random.default_rng(4)
    x, y, z = (of_type(rng.normal(0, 3, 1000), functions.dtype) for _ in range(3))
    signs = np.tile(functions.dtype.type([1, -1]), 500)
    np.testing.assert_array_equal(functions.called("alternating", [x, y, z], 1)[0], x * y + signs * z)


def nearest(number, dtype):
    """The number of the type that is nearest to a fraction."""
    about = dtype.type(float(number))
    around = [np.nextafter(about, dtype.type(-np.inf)), about, np.nextafter(about, dtype.type(np.inf))]
    return min(around, key=lambda one: abs(Fraction(float(one)) - number))


@pytest.mark.parametrize("build", ["scalar", "fused"])
@REALS
def test_side_by_side_equals_one_by_one_bit_for_bit(real, build, compiled):
    one, many = compiled(real, build), compiled(real, {"scalar": "side_by_side"}.get(build, "fused_side_by_side"))
    rng = np.random.default_rng(5)
    x = of_type(
        np.concatenate([rng.uniform(-1e6, 1e6, 50_001), rng.normal(0, 3, 50_000), [-0.0, 0.0, np.nan, np.nan]]),
        one.dtype,
    )
    y = of_type(rng.normal(0, 3, x.size), one.dtype)
    for mine, theirs in zip(
        [*one.sincos(x), one.atan2(y, x), one.floor(x), one.ceil(x), one.choice(y, x)],
        [*many.sincos(x), many.atan2(y, x), many.floor(x), many.ceil(x), many.choice(y, x)],
        strict=True,
    ):
        np.testing.assert_array_equal(mine, theirs)
        np.testing.assert_array_equal(np.signbit(mine[:-2]), np.signbit(theirs[:-2]))  # a NaN's sign is nobody's


# ---- The text ----


def test_text_holds_what_is_asked_for_and_what_that_needs():
    def functions(names):
        return set(re.findall(r"^static .*?clikgen_(\w+)\(", text("double", names), flags=re.MULTILINE))

    assert text("double", []) == ""
    assert functions(["fma"]) == {"fma"}
    assert functions(["choice"]) == {"bits", "real", "mask", "choice"}
    assert functions(["sincos"]) == {"bits", "real", "fma", "sincos"}
    assert functions(["atan2"]) == {"bits", "real", "fma", "negative", "masked", "atan2"}
    assert functions(["ceil"]) == {"bits", "real", "negative", "masked", "floor", "ceil"}
    assert text("float", ["sincos", "atan2"]) == text("float", {"atan2", "sincos"})


def test_unknown_function_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match=r"wanted functions of fma, choice, sincos, atan2, floor, ceil, got tangent"):
        text("double", ["tangent", "sincos"])


@REALS
def test_float_text_has_no_double_and_the_other_way_round(real):
    code = re.sub(r"/\*.*?\*/", "", text(real, NAMES), flags=re.DOTALL)
    numbers = re.findall(r"(?<![\w.])(?:0x[\da-f.]+p[+-]\d+|\d+\.\d*(?:e[+-]\d+)?|\d+e\d+)f?", code)
    assert len(numbers) > 20
    assert {number.endswith("f") for number in numbers} == {real == "float"}


@COMPILERS
@REALS
def test_each_function_compiles_without_a_warning(real, compiler, tmp_path):
    files = [tmp_path / f"{name}.c" for name in NAMES]
    for file in files:
        file.write_text(source(real, [file.stem]))
    command = [*compiler, "-std=c99", *WARNINGS, "-O2", "-fopenmp-simd", "-c", *files]
    outcome = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert outcome.returncode == 0, outcome.stderr


@COMPILERS
@REALS
def test_functions_call_nothing(real, compiler, tmp_path):
    (tmp_path / "functions.c").write_text(source(real))
    command = [*compiler, *FLAGS, "-nostdlib", *(["-Wl,-z,defs"] if sys.platform == "linux" else [])]
    outcome = subprocess.run(
        [*command, "-o", "out.so", "functions.c"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert outcome.returncode == 0, outcome.stderr


@COMPILERS
@REALS
def test_loops_run_side_by_side(real, compiler, tmp_path):
    (tmp_path / "functions.c").write_text(source(real, count="64"))
    command = [*compiler, *FLAGS, "-O3", "-fopenmp-simd", "-S", "functions.c", "-o", "out.s"]
    subprocess.run([flag for flag in command if flag != "-shared"], cwd=tmp_path, check=True, capture_output=True)
    assembly = (tmp_path / "out.s").read_text()
    several, single = {
        "x86_64": (r"\bv?mulp[sd]\b", r"\bv?(?:add|sub|mul|div)s[sd]\b"),
        "aarch64": (r"\bfmul\s+v\d+\.[24][sd]", r"\bf(?:add|sub|mul|div)\s+[sd]\d+"),
    }.get(platform.machine(), ("", r"(?!)"))
    assert re.search(several, assembly)
    assert not re.search(single, assembly)


# ---- Flags ----


@COMPILERS
@pytest.mark.parametrize("flag", ["-ffast-math", "-ffinite-math-only"])
def test_flags_that_change_the_arithmetic_are_refused(flag, compiler, tmp_path):
    (tmp_path / "functions.c").write_text(source("double"))
    command = [*compiler, *FLAGS, flag, "-o", "out.so", "functions.c"]
    outcome = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert outcome.returncode != 0
    assert "clikgen: compile without -ffast-math" in outcome.stderr


@COMPILERS
def test_leave_to_reorder_sums_is_refused_or_not_taken(compiler, tmp_path):
    reorder = ("-fassociative-math", "-fno-signed-zeros", "-fno-trapping-math")
    program = source("double") + (
        "#include <stdio.h>\nint main(void) {\n  volatile double x = 3e5;\n  double s, c;\n"
        '  clikgen_sincos(x, &s, &c);\n  printf("%.17g", s);\n  return 0;\n}\n'
    )
    (tmp_path / "program.c").write_text(program)
    command = [*compiler, "-std=c99", "-O2", *reorder, "-o", "program", "program.c"]
    outcome = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    if outcome.returncode == 0:
        found = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=True).stdout
        assert abs(exact(float(found)) - sine_and_cosine(exact(3e5))[0]) / ONE <= 1.8e-16
    else:
        assert "clikgen: compile without -ffast-math" in outcome.stderr


@REALS
def test_no_argument_makes_undefined_behaviour(real, tmp_path):
    arguments = "0, -0.0, 1e-40, 0.5, -1.5, 7, 1e6, -1e6, 2e6, 1e9, 3e9, 1e30, -1e38, NAN, INFINITY, -INFINITY"
    program = source(real) + (
        f"#include <stdio.h>\nint main(void) {{\n  const {real} x[] = {{{arguments}}};\n"
        f"  enum {{ COUNT = sizeof x / sizeof *x }};\n  {real} s[COUNT], c[COUNT], y[COUNT];\n"
        "  sincos_each(x, s, c, COUNT);\n  for (int i = 0; i < COUNT; ++i) {\n"
        "    for (int j = 0; j < COUNT; ++j) y[j] = x[i];\n"
        "    atan2_each(y, x, s, COUNT);\n    floor_each(y, c, COUNT);\n    ceil_each(y, s, COUNT);\n  }\n"
        '  puts("done");\n  return 0;\n}\n'
    )
    (tmp_path / "program.c").write_text(program)
    compiler = [*find_compiler().command, "-std=c99", "-O1", "-g", "program.c", "-o", "program"]
    # What there is of them: not every compiler can find both kinds of mistake.
    kinds = ["address,undefined,float-cast-overflow", "undefined,float-cast-overflow", "undefined"]
    for kind in kinds:
        checks = [f"-fsanitize={kind}", "-fno-sanitize-recover=all"]
        outcome = subprocess.run([*compiler, *checks], cwd=tmp_path, capture_output=True, text=True, check=False)
        if outcome.returncode == 0:
            break
    assert outcome.returncode == 0, outcome.stderr
    outcome = subprocess.run(
        [tmp_path / "program"], capture_output=True, text=True, check=False, env={"ASAN_OPTIONS": "detect_leaks=0"}
    )
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "done\n", "")
