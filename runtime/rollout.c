/* A whole rollout in C: the same step function called `steps` times over arrays.
 *
 * Every argument is a pointer and a stride in doubles from one step to the next: 0 for a constant, the
 * signal's size for one that changes. A state's output is the next step's input in one array, so nothing is
 * copied between steps.
 */
typedef int (*step_function)(const double **arg, double **res, long long int *iw, double *w, int mem);

int clikgen_rollout(step_function step, long long steps, int inputs, const double **arg,
                    const long long *arg_stride, int outputs, double **res, const long long *res_stride) {
  for (long long k = 0; k < steps; ++k) {
    const int failed = step(arg, res, 0, 0, 0);
    if (failed) return failed;
    for (int i = 0; i < inputs; ++i) arg[i] += arg_stride[i];
    for (int i = 0; i < outputs; ++i) res[i] += res_stride[i];
  }
  return 0;
}
