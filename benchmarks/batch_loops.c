/* A step again and again over arrays, `laps` times all of them; and work that waits for arithmetic alone. */

typedef int (*step_one)(const double **arg, double **res, long long int *iw, double *w, int mem);
typedef void (*step_lanes)(const double *const *arg, double *const *res);

enum { MOST = 64 };

/* With a step of one robot, or, where that is null, of many. */
void repeat(step_one one, step_lanes many, long laps, long times, int inputs, const double **arg, const long *stride,
            double **res) {
  for (long lap = 0; lap < laps; ++lap) {
    const double *at[MOST] = {0};
    for (int i = 0; i < inputs; ++i) at[i] = arg[i];
    for (long k = 0; k < times; ++k) {
      if (one) one(at, res, 0, 0, 0);
      else many(at, res);
      for (int i = 0; i < inputs; ++i) at[i] += stride[i];
    }
  }
}

/* As many products and sums, in the widest vectors, as a core can do: none of them leaves the registers. */
#ifdef __AVX512F__
typedef double vector __attribute__((vector_size(64)));
#else
typedef double vector __attribute__((vector_size(32)));
#endif

double spin(long times) {
  const vector half = (vector){0.0} + 0.5;
  vector a = half, b = half * 2, c = half * 3, d = half * 4, e = half * 5, f = half * 6, g = half * 7, h = half * 8;
  for (long k = 0; k < times; ++k) {
    a = a * half + half, b = b * half + half, c = c * half + half, d = d * half + half;
    e = e * half + half, f = f * half + half, g = g * half + half, h = h * half + half;
  }
  const vector sum = a + b + c + d + e + f + g + h;
  return sum[0] + sum[1];
}
