/* The bare step: the same call again and again, nothing around it. */
typedef int (*step_function)(const double **arg, double **res, long long int *iw, double *w, int mem);

int clikgen_repeat(step_function step, long long times, const double **arg, double **res) {
  int failed = 0;
  for (long long k = 0; k < times; ++k) failed |= step(arg, res, 0, 0, 0);
  return failed;
}
