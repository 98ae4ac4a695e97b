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

double spin(long times) {
  double a = 0.5, b = 0.25, c = 0.125, d = 0.75;
  for (long k = 0; k < times; ++k) {
    a = a * 0.999999 + 0.5;
    b = b * 0.999998 + 0.5;
    c = c * 0.999997 + 0.5;
    d = d * 0.999996 + 0.5;
  }
  return a + b + c + d;
}
