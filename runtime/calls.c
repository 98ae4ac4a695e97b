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

/* A pointer of an evaluation that goes on by so many doubles from one call to the next. */
typedef struct {
  double **pointer;
  long long stride;
} clikgen_walk;

/* The same function called `times` times over arrays: `walks` are the signals that change, the rest stays where it is.
 *
 * In a rollout a state's output is the next step's input in one array, so nothing is copied between steps.
 */
int clikgen_repeat(const clikgen_evaluation *one, long long times, const clikgen_walk *walks, int count) {
  for (long long k = 0; k < times; ++k) {
    const int failed = clikgen_evaluate(one);
    if (failed) return failed;
    for (int i = 0; i < count; ++i) *walks[i].pointer += walks[i].stride;
  }
  return 0;
}
