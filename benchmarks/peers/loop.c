/* How the steps in C and in C++ are called and timed: by the same loop, through the same pointer. */

#define _POSIX_C_SOURCE 199309L

#include <stddef.h>
#include <time.h>

typedef void (*step_function)(void *self, const double *q, const double *given, double *result);

static long long now(void) {
  struct timespec time;
  clock_gettime(CLOCK_MONOTONIC, &time);
  return time.tv_sec * 1000000000LL + time.tv_nsec;
}

/* What the clock alone takes is measured with this. */
void nothing(void *self, const double *q, const double *given, double *result) {
  (void)self, (void)q, (void)given, (void)result;
}

/* `count` steps from `start` (n), each going on from the q that the one before left as the first n numbers of its
 * `result`; a row of `given` is `width` numbers. All of it `laps` times. With `ns` (count) every call is timed. */
void follow(step_function step, void *self, const double *start, int n, const double *given, int width, double *result,
            long count, long laps, long long *ns) {
  double q[64];
  for (long lap = 0; lap < laps; ++lap) {
    for (int i = 0; i < n; ++i) q[i] = start[i];
    for (long k = 0; k < count; ++k) {
      long long before = ns ? now() : 0;
      step(self, q, given + k * width, result);
      if (ns) ns[k] = now() - before;
      for (int i = 0; i < n; ++i) q[i] = result[i];
    }
  }
}

/* `count` steps, each from a state of its own, row by row of `q` (count, n), into rows of `result` (count, size). */
void visit(step_function step, void *self, const double *q, int n, const double *given, int width, double *result,
           int size, long count, long laps) {
  for (long lap = 0; lap < laps; ++lap)
    for (long k = 0; k < count; ++k) step(self, q + k * n, given + k * width, result + k * size);
}
