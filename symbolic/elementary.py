"""Elementary functions as C99 text: no libm, no branch, no table, so that a loop of them runs side by side.

Largest errors, measured against 80-bit results for double and double results for float, with FMA and without, for
rounding to nearest:

    function   range                                double                float
    sincos     |x| <= 1e6 rad                       1.8e-16               1.0e-7
               and near its zeros, x = n π/2        1.6 ulp + 1.1e-26 n   1.6 ulp + 1.6e-14 n
    atan2      1e-291 <= max(|x|, |y|) <= 8e307     2.5 ulp, 4.3e-16      2.4 ulp, 2.4e-7
               (float: 1e-30, 1e38)
    floor      all                                  exact                 exact
    ceil       all                                  exact                 exact
    choice     all                                  exact                 exact
    fma        all                                  0.5 ulp               0.5 ulp, both with CLIKGEN_FMA

`clikgen_sincos(x, &s, &c)` takes n = x / (π/2) to the nearest whole number by adding and subtracting 1.5 2^52 (2^23),
reduces by r = x - n π/2 in exact steps but for the last one (Cody and Waite: parts of π/2 so short that n times one is
exact), and reads the quadrant from the last bits of that sum. Beyond 1e6 rad the error of the double grows as 1.2e-16
|x|; from 2^30 rad (float: 2^20 rad) on, and for infinities and NaN, both results are NaN. sin(-x) = -sin(x) and
cos(-x) = cos(x) exactly, though sin(-0) is +0.

`clikgen_atan2(y, x)` has one division: atan t with |t| <= tan π/8, t = y/x, -x/y or (y - x)/(y + x), plus a multiple of
π/4. Zeros have the signs that C99 gives them: atan2(0, 0) = 0, atan2(0, -0) = π. Two infinities make NaN, as NaN does.

`clikgen_fma(a, b, c)` is a b + c: rounded once where there is an instruction for it (`CLIKGEN_FMA` is 1, as on x86
from AVX2 on, 64-bit ARM and RISC-V), twice elsewhere or given -DCLIKGEN_FMA=0. The text alone says which products and
sums that are: of each of the two kinds, the results are the same for all compilers, vectors and machines.

`clikgen_choice(clikgen_mask(c), x, y)` is c ? x : y without a branch, so that no processor guesses wrong.

The polynomials are minimax fits (Remez) made for this file, on [-π/4, π/4] and [-tan π/8, tan π/8].
"""

from collections.abc import Collection
from typing import Literal

Real = Literal["double", "float"]

_GUARD = """\
/* These functions stand on rounding as C99 has it and on NaN; flags that give either up are refused where they show.
 * From gcc 12 on all do. Of clang's, -funsafe-math-optimizations and -fassociative-math do not, hence the pragma. */
#if defined __FAST_MATH__ || defined __ASSOCIATIVE_MATH__ || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__)
#error "clikgen: compile without -ffast-math, -Ofast, -funsafe-math-optimizations and -ffinite-math-only"
#endif
#if defined __FLT_EVAL_METHOD__ && (__FLT_EVAL_METHOD__ < 0 || __FLT_EVAL_METHOD__ == 2) && !defined __STRICT_ANSI__
#error "clikgen: the x87 keeps digits that C99 drops: compile with -std=c99 or -msse2 -mfpmath=sse"
#endif
#if defined __clang__ && __clang_major__ >= 11
#pragma clang fp reassociate(off)
#endif
/* From a product in a sum here and in a difference there gcc 12 makes an FMA even where there shall be none. */
#if defined CLIKGEN_FMA && !CLIKGEN_FMA && defined __FMA__ && defined __GNUC__ && !defined __clang__
#pragma GCC target("no-fma")
#endif
"""

_NEEDS = {
    "fma": (),
    "choice": ("bits",),
    "sincos": ("bits", "fma"),
    "atan2": ("bits", "masks", "fma"),
    "floor": ("bits", "masks"),
    "ceil": ("bits", "masks", "floor"),
}

_DOUBLE = {
    "bits": """\
#include <stdint.h>

static inline uint64_t clikgen_bits(double x) {
  union { double real; uint64_t bits; } both;
  both.real = x;
  return both.bits;
}

static inline double clikgen_real(uint64_t x) {
  union { uint64_t bits; double real; } both;
  both.bits = x;
  return both.real;
}
""",
    "fma": """\
/* a b + c: rounded once where this processor does that in one instruction, else twice. -DCLIKGEN_FMA=0 has it twice. */
#if !defined CLIKGEN_FMA && (defined __FP_FAST_FMA || defined __FMA__ || (defined __riscv_flen && __riscv_flen >= 64))
#define CLIKGEN_FMA 1
#elif !defined CLIKGEN_FMA && defined __ARM_FEATURE_FMA && defined __ARM_FP
#define CLIKGEN_FMA (__ARM_FP & 8 ? 1 : 0)
#elif !defined CLIKGEN_FMA
#define CLIKGEN_FMA 0
#endif

static inline double clikgen_fma(double a, double b, double c) {
#if CLIKGEN_FMA
  return fma(a, b, c);
#else
  return a * b + c;
#endif
}
""",
    "choice": """\
/* All ones where the condition holds, else 0. */
static inline uint64_t clikgen_mask(int condition) { return 0 - (uint64_t)condition; }

/* x where the mask is all ones, y where it is 0. */
static inline double clikgen_choice(uint64_t mask, double x, double y) {
  return clikgen_real((clikgen_bits(x) & mask) | (clikgen_bits(y) & ~mask));
}
""",
    "masks": """\
/* All ones for x < 0 (and -0), else 0: choices that no compiler turns into branches. */
static inline uint64_t clikgen_negative(double x) { return 0 - (clikgen_bits(x) >> 63); }

static inline double clikgen_masked(double x, uint64_t mask) { return clikgen_real(clikgen_bits(x) & mask); }
""",
    "sincos": """\
/* Sine and cosine of x [rad] to 1.8e-16 for |x| <= 1e6; NaN from 2^30 on. */
static inline void clikgen_sincos(double x, double *sine, double *cosine) {
  const double shift = 6755399441055744.0; /* 1.5 * 2^52: a sum with it is a whole number */
  const uint64_t quadrant = clikgen_bits(clikgen_fma(x, 0.6366197723675814, shift)); /* in its last two bits */
  const double n = clikgen_real(quadrant) - shift; /* quarter turns */
  const double away = x * 0x1p+994, fence = away * 0.0; /* from 2^30 on infinite, and NaN; else 0 */
  /* pi/2 in two parts: the first has 31 bits, so that n times it is exact. */
  const double most = clikgen_fma(-n, 0x1.921fb544p+0, x);
  const double r = most - clikgen_fma(n, 0x1.0b4611a626331p-34, fence); /* |r| <= pi/4 */
  const double z = r * r, z2 = z * z, z4 = z2 * z2;
  const double p = clikgen_fma(z4, clikgen_fma(z, 1.5888058090339975e-10, -2.505059086768978e-08),
                               clikgen_fma(z2, clikgen_fma(z, 2.755731248237617e-06, -0.00019841269825742733),
                                           clikgen_fma(z, 0.008333333333316218, -0.166666666666666)));
  const double q = clikgen_fma(z4, clikgen_fma(z, -1.1359934243820215e-11, 2.0875729281370876e-09),
                               clikgen_fma(z2, clikgen_fma(z, -2.755731440103197e-07, 2.480158728967154e-05),
                                           clikgen_fma(z, -0.0013888888888874474, 0.0416666666666666)));
  const uint64_t s = clikgen_bits(clikgen_fma(r * z, p, r)); /* sin r */
  const uint64_t c = clikgen_bits(clikgen_fma(z2, q, clikgen_fma(-0.5, z, 1.0))); /* cos r */
  const uint64_t swap = (s ^ c) & (0 - (quadrant & 1));
  const uint64_t sign = UINT64_C(1) << 63;
  *sine = clikgen_real(s ^ swap ^ ((quadrant << 62) & sign));
  *cosine = clikgen_real(c ^ swap ^ (((quadrant + 1) << 62) & sign));
}
""",
    "atan2": """\
/* The angle of (x, y) [rad], -pi to pi, to 2.5 units in the last place. */
static inline double clikgen_atan2(double y, double x) {
  const double quarter = 0.7853981633974483; /* pi/4 */
  const double width = fabs(x), height = fabs(y);
  const uint64_t over = clikgen_negative(clikgen_fma(0.41421356237309503, width, -height)); /* above pi/8 */
  const uint64_t high = clikgen_negative(clikgen_fma(-0.41421356237309503, height, width)); /* above 3 pi/8 */
  const double above = clikgen_masked(height, ~high) - clikgen_masked(width, over);
  const double along = clikgen_masked(height, over) + clikgen_masked(width, ~high);
  const double t = above / (along + 0x1p-1022); /* no 0/0 */
  const double z = t * t, z2 = z * z, z4 = z2 * z2;
  const double p = clikgen_fma(
      z4 * z4,
      clikgen_fma(z2, -0.01791009115654968, clikgen_fma(z, 0.038067648405380294, -0.050394447102604156)),
      clikgen_fma(z4,
                  clikgen_fma(z2, clikgen_fma(z, 0.05847924541171357, -0.066631094589356),
                              clikgen_fma(z, 0.07692060738371383, -0.09090897789544128)),
                  clikgen_fma(z2, clikgen_fma(z, 0.1111111078463026, -0.14285714280220516),
                              clikgen_fma(z, 0.19999999999953819, -0.333333333333332))));
  /* For x < 0 everything is pi less, and its magnitude the angle. */
  const double rest = clikgen_masked(quarter, ~over) + clikgen_masked(quarter, ~high);
  const double base = copysign(2 * quarter, x) - rest;
  return copysign(base + clikgen_fma(t * z, p, t), y);
}
""",
    "floor": """\
static inline double clikgen_floor(double x) {
  const double size = fabs(x), whole = 4503599627370496.0; /* 2^52: from here on all numbers are */
  const double shift = clikgen_masked(whole, clikgen_negative(size - whole));
  const double nearest = copysign((size + shift) - shift, x);
  return nearest - clikgen_masked(1.0, clikgen_negative(x - nearest));
}
""",
    "ceil": """\
static inline double clikgen_ceil(double x) { return -clikgen_floor(-x); }
""",
}

_FLOAT = {
    "bits": """\
#include <stdint.h>

static inline uint32_t clikgen_bits(float x) {
  union { float real; uint32_t bits; } both;
  both.real = x;
  return both.bits;
}

static inline float clikgen_real(uint32_t x) {
  union { uint32_t bits; float real; } both;
  both.bits = x;
  return both.real;
}
""",
    "fma": """\
/* a b + c: rounded once where this processor does that in one instruction, else twice. -DCLIKGEN_FMA=0 has it twice. */
#if !defined CLIKGEN_FMA && (defined __FP_FAST_FMAF || defined __FMA__ || (defined __riscv_flen && __riscv_flen >= 32))
#define CLIKGEN_FMA 1
#elif !defined CLIKGEN_FMA && defined __ARM_FEATURE_FMA && defined __ARM_FP
#define CLIKGEN_FMA (__ARM_FP & 4 ? 1 : 0)
#elif !defined CLIKGEN_FMA
#define CLIKGEN_FMA 0
#endif

static inline float clikgen_fma(float a, float b, float c) {
#if CLIKGEN_FMA
  return fmaf(a, b, c);
#else
  return a * b + c;
#endif
}
""",
    "choice": """\
/* All ones where the condition holds, else 0. */
static inline uint32_t clikgen_mask(int condition) { return 0 - (uint32_t)condition; }

/* x where the mask is all ones, y where it is 0. */
static inline float clikgen_choice(uint32_t mask, float x, float y) {
  return clikgen_real((clikgen_bits(x) & mask) | (clikgen_bits(y) & ~mask));
}
""",
    "masks": """\
/* All ones for x < 0 (and -0), else 0: choices that no compiler turns into branches. */
static inline uint32_t clikgen_negative(float x) { return 0 - (clikgen_bits(x) >> 31); }

static inline float clikgen_masked(float x, uint32_t mask) { return clikgen_real(clikgen_bits(x) & mask); }
""",
    "sincos": """\
/* Sine and cosine of x [rad] to 1.0e-7 for |x| <= 1e6; NaN from 2^20 on. */
static inline void clikgen_sincos(float x, float *sine, float *cosine) {
  const float shift = 12582912.0f; /* 1.5 * 2^23: a sum with it is a whole number */
  const uint32_t quadrant = clikgen_bits(clikgen_fma(x, 0.636619747f, shift)); /* in its last two bits */
  const float n = clikgen_real(quadrant) - shift; /* quarter turns */
  const float away = x * 0x1p+108f, fence = away * 0.0f; /* from 2^20 on infinite, and NaN; else 0 */
  /* pi/2 in five parts: the first four have at most 4 bits, so that n times each is exact. */
  const float most = clikgen_fma(n, 0x1.2p-18f,
                                 clikgen_fma(-n, 0x1p-11f, clikgen_fma(-n, 0.0703125f, clikgen_fma(-n, 1.5f, x))));
  const float r = most + clikgen_fma(n, 0x1.5dde98p-23f, fence); /* |r| <= pi/4, and 0.04 more near |x| = 1e6 */
  const float z = r * r, z2 = z * z;
  const float p = clikgen_fma(z2, -0.000194570326f, clikgen_fma(z, 0.00833166111f, -0.166666448f));
  const float q = clikgen_fma(z2, 2.43915183e-05f, clikgen_fma(z, -0.00138869474f, 0.0416666381f));
  const uint32_t s = clikgen_bits(clikgen_fma(r * z, p, r)); /* sin r */
  const uint32_t c = clikgen_bits(clikgen_fma(z2, q, clikgen_fma(-0.5f, z, 1.0f))); /* cos r */
  const uint32_t swap = (s ^ c) & (0 - (quadrant & 1));
  const uint32_t sign = UINT32_C(1) << 31;
  *sine = clikgen_real(s ^ swap ^ ((quadrant << 30) & sign));
  *cosine = clikgen_real(c ^ swap ^ (((quadrant + 1) << 30) & sign));
}
""",
    "atan2": """\
/* The angle of (x, y) [rad], -pi to pi, to 2.4 units in the last place. */
static inline float clikgen_atan2(float y, float x) {
  const float quarter = 0.785398185f; /* pi/4, and what it lacks is -2.8e-8 of it */
  const float width = fabsf(x), height = fabsf(y);
  const uint32_t over = clikgen_negative(clikgen_fma(0.414213568f, width, -height)); /* above pi/8 */
  const uint32_t high = clikgen_negative(clikgen_fma(-0.414213568f, height, width)); /* above 3 pi/8 */
  const float above = clikgen_masked(height, ~high) - clikgen_masked(width, over);
  const float along = clikgen_masked(height, over) + clikgen_masked(width, ~high);
  const float t = above / (along + 0x1p-126f); /* no 0/0 */
  const float z = t * t, z2 = z * z;
  const float p = clikgen_fma(z2, clikgen_fma(z, 0.0806075558f, -0.138800085f),
                              clikgen_fma(z, 0.199779436f, -0.333329558f));
  /* For x < 0 everything is pi less, and its magnitude the angle. */
  const float rest = clikgen_masked(quarter, ~over) + clikgen_masked(quarter, ~high);
  const float base = copysignf(2 * quarter, x) - rest;
  return copysignf(base + clikgen_fma(base, -2.78275341e-08f, clikgen_fma(t * z, p, t)), y);
}
""",
    "floor": """\
static inline float clikgen_floor(float x) {
  const float size = fabsf(x), whole = 8388608.0f; /* 2^23: from here on all numbers are */
  const float shift = clikgen_masked(whole, clikgen_negative(size - whole));
  const float nearest = copysignf((size + shift) - shift, x);
  return nearest - clikgen_masked(1.0f, clikgen_negative(x - nearest));
}
""",
    "ceil": """\
static inline float clikgen_ceil(float x) { return -clikgen_floor(-x); }
""",
}

NAMES = tuple(_NEEDS)
"""What there is: `clikgen_<name>` in C."""


def text(real: Real, names: Collection[str]) -> str:
    """The functions `clikgen_<name>` as `static inline` C, after what they need; nothing for no names.

    It wants <math.h> above it, for fabs and copysign, neither of which is a call. Raises ValueError for a name that
    is not in `NAMES`.
    """
    if unknown := set(names) - set(NAMES):
        raise ValueError(f"wanted functions of {', '.join(NAMES)}, got {', '.join(sorted(unknown))}")
    if not names:
        return ""
    bodies = {"double": _DOUBLE, "float": _FLOAT}[real]
    needed = {*names, *(need for name in names for need in _NEEDS[name])}
    return "\n".join((_GUARD, *(body for name, body in bodies.items() if name in needed)))
