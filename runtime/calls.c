/* Generated functions called from outside C: once, or again and again over arrays. */

/* CasADi's calling convention. */
typedef int (*clikgen_function)(const double **arg, double **res, long long int *iw, double *w, int mem);

/* A function with the buffers it reads and writes: one pointer to pass where five arguments would cost more than
 * the step itself. */
typedef struct {
  clikgen_function function;
  const double **arg;
  double **res;
  long long int *iw;
  double *w;
} clikgen_evaluation;

int clikgen_evaluate(const clikgen_evaluation *one) { return one->function(one->arg, one->res, one->iw, one->w, 0); }

/* The same function called `times` times over arrays, whose pointers it moves.
 *
 * Every argument has a stride in doubles from one call to the next: 0 for a constant, the signal's size for one
 * that changes. In a rollout a state's output is the next step's input in one array, so nothing is copied between
 * steps.
 */
int clikgen_repeat(const clikgen_evaluation *one, long long times, int inputs, const long long *arg_stride,
                    int outputs, const long long *res_stride) {
  for (long long k = 0; k < times; ++k) {
    const int failed = clikgen_evaluate(one);
    if (failed) return failed;
    for (int i = 0; i < inputs; ++i) one->arg[i] += arg_stride[i];
    for (int i = 0; i < outputs; ++i) one->res[i] += res_stride[i];
  }
  return 0;
}
