/* What one operation costs, in nanoseconds: `rate` many that do not wait for each other, `delay` one after the other. */
#include <math.h>
#include <time.h>

static double now(void) {
  struct timespec t;
  clock_gettime(CLOCK_MONOTONIC, &t);
  return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

#if defined(__x86_64__)
#define REGISTER "+x"
#else
#define REGISTER "+w"
#endif
#define KEEP8 __asm__ volatile("" : REGISTER(a), REGISTER(b), REGISTER(c), REGISTER(d), REGISTER(e), REGISTER(f), REGISTER(g), REGISTER(h), REGISTER(z))
#define KEEP1 __asm__ volatile("" : REGISTER(a), REGISTER(z))
#define UNIT(name, x_of)                                                                                 \
  double rate_##name(long n, double z) {                                                                 \
    double a = 1.1, b = 1.2, c = 1.3, d = 1.4, e = 1.5, f = 1.6, g = 1.7, h = 1.8;                       \
    const double start = now();                                                                          \
    for (long k = 0; k < n / 8; ++k) {                                                                   \
      a = x_of(a), b = x_of(b), c = x_of(c), d = x_of(d), e = x_of(e), f = x_of(f), g = x_of(g), h = x_of(h); \
      KEEP8;                                                                                             \
    }                                                                                                    \
    return (now() - start) / (double)n;                                                                  \
  }                                                                                                      \
  double delay_##name(long n, double z) {                                                                \
    double a = 1.1;                                                                                      \
    const double start = now();                                                                          \
    for (long k = 0; k < n; ++k) {                                                                       \
      a = x_of(a);                                                                                       \
      KEEP1;                                                                                             \
    }                                                                                                    \
    return (now() - start) / (double)n;                                                                  \
  }

#define ADD(x) ((x) + z)
#define MUL(x) ((x) * z)
#define FMA(x) ((x) * z + z) /* -ffp-contract=fast: one operation where there is one for it */
#define DIV(x) (z / (x))
#define SQRT(x) (sqrt(x))
#define SELECT(x) ((x) < z ? z : (x))
UNIT(add, ADD)
UNIT(mul, MUL)
UNIT(fma, FMA)
UNIT(div, DIV)
UNIT(sqrt, SQRT)
UNIT(select, SELECT)
