/* Rollouts of many robots: LANES of them side by side in a block, and metrics that are brought up to date after every
 * step where a trajectory would have to be kept.
 *
 * Entry e of a value of the robot in lane i is at [e * LANES + i]. What comes out for a rollout depends on its own
 * inputs alone: not on its lane, its neighbours, the width of the vectors, or where the work is interrupted.
 */

#include <math.h>
#include <stddef.h>
#include <string.h>

#ifndef LANES
#define LANES 16
#endif

/* CasADi's calling convention, and the one for LANES robots at once. */
typedef int (*clikgen_function)(const double **arg, double **res, long long int *iw, double *w, int mem);
typedef void (*clikgen_step_lanes)(const double *const *arg, double *const *res);

/* An input of the step: entry e of rollout r in step k is data[r * by_rollout + k * by_step + e]. */
typedef struct {
  const double *data;
  long long by_rollout, by_step;
  int size;
} clikgen_value;

/* The results, one number per rollout. KEPT is how many steps they are measured over. */
enum {
  SWITCHES, SWITCH_RATE, HF_RMS, REVERSAL_RATE, MAX_VELOCITY_STEP, TOTAL_VARIATION, TRACKING_RMS, TRACKING_MAX,
  FINAL_ERROR, MIN_CLEARANCE, MIN_DISTANCE, DIVERGED_AT, KEPT
};

/* What is run and measured; the same for all threads, which only read it. */
typedef struct {
  clikgen_function step;
  clikgen_step_lanes step_lanes; /* null: `step` is called for one lane after the other */
  int inputs, outputs, sz_arg, sz_res, sz_iw, sz_w;
  const clikgen_value *input;
  const int *size;    /* of every output */
  const int *feeds;   /* the input that is every output in the next step, or -1 */
  const int *watched; /* whether an output feeds an input or is measured */
  long long steps;
  const long long *rollout; /* the LANES rollouts of every block; one may stand there more than once */
  int q, period;                      /* inputs */
  int dq, error, clearance, distance; /* outputs; the last three may be -1 */
  int flags;                          /* so many outputs say, above 0, that a one-sided task acts: */
  const int *flag;
  double lost, far, encounter_gap, dead_band;
  long long segment;     /* samples in a Welch segment */
  int bins;              /* so many of its frequencies, from 0 Hz on, do not count */
  const double *cosine;  /* cos 2 pi j / segment */
  const double *sine;
  const double *weight;  /* the window squared, and one 0 more */
  double total_weight;
  double **result;       /* by the names above; null where it is not wanted */
  double **final;        /* of every input: where to put the last state, or null */
} clikgen_batch;

/* A block on its way. What vectors are loaded from comes first, where it is aligned. */
typedef struct {
  double period[LANES], well[LANES], counts[LANES], kept[LANES], lost_at[LANES];
  double active[LANES], last_active[LANES], switches[LANES], encounter[LANES];
  double largest_step[LANES], variation[LANES], reversals[LANES], segments[LANES];
  double error_sum[LANES], error_max[LANES], error_last[LANES], clearance[LANES], distance[LANES];
  long long at, end, k; /* block, first block that is another's, step */
  const long long *rollout;
  const double **arg;
  double **res, **in, **out;  /* in, out: side by side */
  double **own_in, **own_out; /* of one robot, where `step` is called for one after the other */
  long long *iw;
  double *w;
  double *now, *before;                          /* dq in this step and in the one before it */
  double *sign, *extreme, *low, *peaks;          /* of dq: see follow_reversals */
  double *sums[2], *energy[2], *power, *recent;  /* of dq: see follow_spectrum */
  double *transform;
  int fresh; /* so many samples in `recent` are not in the sums yet */
} clikgen_block;

/* ---- Room ---- */

enum { ALIGNMENT = 64, TOGETHER = 4 };

static void *take(char *room, size_t *used, size_t bytes) {
  void *here = room ? room + *used : NULL;
  *used += (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
  return here;
}

static double *take_lanes(char *room, size_t *used, long long entries) {
  return take(room, used, (size_t)entries * LANES * sizeof(double));
}

static int wants(const clikgen_batch *batch, int first, int last) {
  for (int i = first; i <= last; ++i)
    if (batch->result[i]) return 1;
  return 0;
}

/* So many terms X_b of the transform are summed up: one more than lie below f_h, and X_2 in any case. */
static int transforms(const clikgen_batch *batch) { return (batch->bins > 2 ? batch->bins : 2) + 1; }

/* Finds room for everything; without a room it only says how much. */
static size_t lay_out(const clikgen_batch *batch, char *room, clikgen_block *block) {
  size_t used = 0;
  const int n = batch->size[batch->dq];
  take(room, &used, sizeof(clikgen_block));
  block->arg = take(room, &used, (size_t)batch->sz_arg * sizeof(double *));
  block->res = take(room, &used, (size_t)batch->sz_res * sizeof(double *));
  block->in = take(room, &used, (size_t)batch->inputs * sizeof(double *));
  block->out = take(room, &used, (size_t)batch->outputs * sizeof(double *));
  block->own_in = take(room, &used, (size_t)batch->inputs * sizeof(double *));
  block->own_out = take(room, &used, (size_t)batch->outputs * sizeof(double *));
  for (int s = 0; s < batch->inputs; ++s) {
    double *in = take_lanes(room, &used, batch->input[s].size);
    double *own = take(room, &used, (size_t)batch->input[s].size * sizeof(double));
    if (room) block->in[s] = in, block->own_in[s] = own;
  }
  for (int o = 0; o < batch->outputs; ++o) {
    double *out = take_lanes(room, &used, batch->size[o]);
    double *own = take(room, &used, (size_t)batch->size[o] * sizeof(double));
    if (room) block->out[o] = out, block->own_out[o] = own;
  }
  block->iw = take(room, &used, (size_t)batch->sz_iw * sizeof(long long));
  block->w = take(room, &used, (size_t)batch->sz_w * sizeof(double));
  block->now = take_lanes(room, &used, n);
  block->before = take_lanes(room, &used, n);
  block->sign = take_lanes(room, &used, n);
  block->extreme = take_lanes(room, &used, n);
  block->low = take_lanes(room, &used, n);
  block->peaks = take_lanes(room, &used, n);
  if (batch->result[HF_RMS]) {
    for (int half = 0; half < 2; ++half) {
      block->sums[half] = take_lanes(room, &used, 2LL * n * transforms(batch));
      block->energy[half] = take_lanes(room, &used, 2LL * n);
    }
    block->power = take_lanes(room, &used, n);
    block->recent = take_lanes(room, &used, (long long)n * TOGETHER);
    block->transform = take_lanes(room, &used, 2LL * transforms(batch));
  }
  return used;
}

long long clikgen_batch_room(const clikgen_batch *batch) {
  clikgen_block block;
  return (long long)lay_out(batch, NULL, &block);
}

/* ---- The step ---- */

static const double *value_of(const clikgen_value *value, long long rollout, long long k) {
  return value->data + rollout * value->by_rollout + k * value->by_step;
}

static void spread(const double *restrict one, int size, int lane, double *restrict lanes) {
  for (int e = 0; e < size; ++e) lanes[e * LANES + lane] = one[e];
}

static void gather(const double *restrict lanes, int size, int lane, double *restrict one) {
  for (int e = 0; e < size; ++e) one[e] = lanes[e * LANES + lane];
}

static void load(const clikgen_value *value, const clikgen_block *block, double *restrict lanes) {
  if (value->by_rollout) {
    for (int i = 0; i < LANES; ++i) spread(value_of(value, block->rollout[i], block->k), value->size, i, lanes);
    return;
  }
  const double *one = value_of(value, 0, block->k);
  for (int e = 0; e < value->size; ++e) {
    const double x = one[e];
#pragma omp simd
    for (int i = 0; i < LANES; ++i) lanes[e * LANES + i] = x;
  }
}

static void step_side_by_side(const clikgen_batch *batch, clikgen_block *block) {
  for (int s = 0; s < batch->inputs; ++s) {
    if (batch->input[s].by_step) load(&batch->input[s], block, block->in[s]);
    block->arg[s] = block->in[s];
  }
  for (int o = 0; o < batch->outputs; ++o) block->res[o] = block->out[o];
  batch->step_lanes(block->arg, block->res);
}

static int step_one_by_one(const clikgen_batch *batch, clikgen_block *block) {
  for (int o = 0; o < batch->outputs; ++o) block->res[o] = block->own_out[o];
  for (int i = 0; i < LANES; ++i) {
    for (int s = 0; s < batch->inputs; ++s)
      block->arg[s] = value_of(&batch->input[s], block->rollout[i], block->k);
    for (int o = 0; o < batch->outputs; ++o) {
      const int fed = batch->feeds[o];
      if (fed < 0) continue;
      gather(block->in[fed], batch->size[o], i, block->own_in[fed]);
      block->arg[fed] = block->own_in[fed];
    }
    if (batch->step(block->arg, block->res, block->iw, block->w, 0)) return 1;
    for (int o = 0; o < batch->outputs; ++o)
      if (batch->watched[o]) spread(block->own_out[o], batch->size[o], i, block->out[o]);
  }
  return 0;
}

static void go_on_from_next_state(const clikgen_batch *batch, clikgen_block *block) {
  for (int o = 0; o < batch->outputs; ++o) {
    const int fed = batch->feeds[o];
    if (fed < 0) continue;
    double *next = block->out[o];
    block->out[o] = block->in[fed];
    block->in[fed] = next;
  }
}

/* ---- What is measured: one pass over the lanes for each entry, without branches ---- */

/* A step counts until q leaves the limits of the state or is not finite any more; the first two count in any case. */
static void look_for_divergence(const clikgen_batch *batch, clikgen_block *block) {
  const double *restrict q = block->in[batch->q];
  const double k = (double)block->k, early = block->k < 2 ? 1.0 : 0.0, limit = batch->lost;
  const int n = batch->input[batch->q].size;
  double well[LANES];
  memcpy(well, block->well, sizeof well);
  for (int e = 0; e < n; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i) well[i] = fabs(q[e * LANES + i]) <= limit ? well[i] : 0.0;
  }
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    block->lost_at[i] = block->well[i] > well[i] ? k : block->lost_at[i];
    block->well[i] = well[i];
    block->counts[i] = well[i] > early ? well[i] : early;
    block->kept[i] += block->counts[i];
  }
}

static void follow_switches(const clikgen_batch *batch, clikgen_block *block) {
  double on[LANES] = {0};
  for (int j = 0; j < batch->flags; ++j) {
    const double *restrict flag = block->out[batch->flag[j]];
    for (int e = 0; e < batch->size[batch->flag[j]]; ++e) {
#pragma omp simd
      for (int i = 0; i < LANES; ++i) on[i] = flag[e * LANES + i] > 0.0 ? 1.0 : on[i];
    }
  }
  const double k = (double)block->k, after_first = block->k > 0 ? 1.0 : 0.0;
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const double now = block->counts[i] > 0.0 ? on[i] : block->active[i];
    const double acts = block->counts[i] * on[i];
    const double since = k - block->last_active[i]; /* infinite before the first contact */
    const double joined = since * block->period[i] > batch->encounter_gap ? 1.0 : since;
    block->switches[i] += now != block->active[i] ? after_first : 0.0;
    block->encounter[i] += acts > 0.0 ? joined : 0.0;
    block->last_active[i] = acts > 0.0 ? k : block->last_active[i];
    block->active[i] = now;
  }
}

/* dq of this step and of the one before; what does not count any more stays at the last that did. */
static void take_velocity(const clikgen_batch *batch, clikgen_block *block) {
  const double *restrict dq = block->out[batch->dq];
  double *before = block->k > 0 ? block->now : block->out[batch->dq], *now = block->before;
  const int n = batch->size[batch->dq];
  for (int e = 0; e < n; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i)
      now[e * LANES + i] = block->counts[i] > 0.0 ? dq[e * LANES + i] : before[e * LANES + i];
  }
  block->before = block->now;
  block->now = now;
}

static void follow_steps(const clikgen_batch *batch, clikgen_block *block) {
  const double *restrict now = block->now, *restrict before = block->before;
  const int n = batch->size[batch->dq];
  double square[LANES] = {0}, sum[LANES] = {0};
  for (int e = 0; e < n; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i) {
      const double step = now[e * LANES + i] - before[e * LANES + i];
      square[i] += step * step;
      sum[i] += fabs(step);
    }
  }
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const double so_far = block->largest_step[i];
    const double largest = (square[i] > so_far) | (square[i] != square[i]) ? square[i] : so_far;
    block->largest_step[i] = block->counts[i] > 0.0 ? largest : so_far;
    block->variation[i] += block->counts[i] > 0.0 ? sum[i] : 0.0;
  }
}

/* Turning points that stand out by the dead-band: those of a zigzag that turns back by the dead-band every time.
 *
 * z = sign * dq rises to `extreme`. Once it has come down from there by the dead-band, the extreme was a turning point
 * (so were all its equals that it had left and come back to, `peaks` of them), and sign changes. At the start the first
 * extreme is none before it stands by the dead-band above `low`, the least so far: the end of a signal is no turning
 * point. Later low is without bound.
 */
static void follow_reversals(const clikgen_batch *batch, clikgen_block *block) {
  const double band = batch->dead_band;
  for (int e = 0; e < batch->size[batch->dq]; ++e) {
    const double *restrict now = block->now + e * LANES, *restrict before = block->before + e * LANES;
    double *restrict sign = block->sign + e * LANES, *restrict extreme = block->extreme + e * LANES;
    double *restrict low = block->low + e * LANES, *restrict peaks = block->peaks + e * LANES;
#pragma omp simd
    for (int i = 0; i < LANES; ++i) {
      const double z = sign[i] * now[i], last = sign[i] * before[i];
      const double least = z < low[i] ? z : low[i];
      const double stands = z - least >= band ? 1.0 : 0.0, again = peaks[i] > 0.0 ? peaks[i] + 1.0 : 0.0;
      const int turns = extreme[i] - z >= band, higher = z > extreme[i];
      const int equal = (z == extreme[i]) & (last < extreme[i]);
      block->reversals[i] += turns ? peaks[i] : 0.0;
      peaks[i] = turns ? 1.0 : higher ? stands : equal ? again : peaks[i];
      extreme[i] = turns ? -z : higher ? z : extreme[i];
      low[i] = turns ? -INFINITY : least;
      sign[i] = turns ? -sign[i] : sign[i];
    }
  }
}

static void start_reversals(const clikgen_batch *batch, clikgen_block *block) {
  const double *restrict dq = block->out[batch->dq];
#pragma omp simd
  for (int i = 0; i < batch->size[batch->dq] * LANES; ++i) {
    block->sign[i] = 1.0;
    block->extreme[i] = block->low[i] = dq[i];
    block->peaks[i] = 0.0;
  }
}

/* The power of a segment above f_h, for joint e, once its last sample is in.
 *
 * By Parseval's theorem it is the energy of the windowed samples less that of the few frequencies below f_h. The Hann
 * window only mixes neighbours: Y_b = X_b / 2 - (X_{b-1} + X_{b+1}) / 4, where X is the transform without a window,
 * and taking off the mean is X_0 = 0. The sum of w^2 x is 3/8 X_0 - 1/2 X_1 + 1/8 X_2, the real parts.
 */
static void finish_segment(const clikgen_batch *batch, clikgen_block *block, int e) {
  const int terms = transforms(batch), n = batch->size[batch->dq];
  const long long hop = batch->segment - batch->segment / 2;
  const double *restrict first = block->sums[0], *restrict second = block->sums[1];
  double *restrict x = block->transform; /* [b][real, imaginary][lane] */
  long long turn = 0;
  for (int b = 0; b < terms; ++b) {
    const double c = batch->cosine[turn], s = batch->sine[turn]; /* the second half starts hop samples later */
    const long long at = 2LL * (b * n + e) * LANES;
    turn = (turn + hop) % batch->segment;
#pragma omp simd
    for (int i = 0; i < LANES; ++i) {
      const double re = second[at + i], im = second[at + LANES + i];
      x[2 * b * LANES + i] = first[at + i] + (c * re + s * im);
      x[(2 * b + 1) * LANES + i] = first[at + LANES + i] + (c * im - s * re);
    }
  }
  double below[LANES];
#pragma omp simd
  for (int i = 0; i < LANES; ++i) below[i] = 0.25 * x[2 * LANES + i] * x[2 * LANES + i]; /* Y_0 = -Re X_1 / 2 */
  for (int b = 1; b < batch->bins; ++b) {
    const double left = b > 1 ? 0.25 : 0.0;
    for (int part = 0; part < 2; ++part) {
      const double *restrict here = x + (2 * b + part) * LANES;
#pragma omp simd
      for (int i = 0; i < LANES; ++i) {
        const double y = 0.5 * here[i] - (left * here[i - 2 * LANES] + 0.25 * here[i + 2 * LANES]);
        below[i] += 2.0 * y * y; /* and the same at -b */
      }
    }
  }
  const double samples = (double)batch->segment;
  const double *restrict begun = block->energy[0] + 2 * e * LANES;
  const double *restrict ended = block->energy[1] + (2 * e + 1) * LANES;
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const double mean = x[i] / samples;
    const double weighted = 0.375 * x[i] - 0.5 * x[2 * LANES + i] + 0.125 * x[4 * LANES + i];
    const double all = (begun[i] + ended[i]) + mean * (mean * batch->total_weight - 2.0 * weighted);
    const double power = (all - below[i] / samples) / batch->total_weight;
    block->power[e * LANES + i] += block->counts[i] > 0.0 ? power : 0.0;
  }
}

/* Adds the last `samples` of dq, of which the first is at `at` in its span, to the sums: one after the other, but with
 * the sums fetched only once where they are as many as can be.
 */
static void add_to_sums(const clikgen_batch *batch, clikgen_block *block, long long at, int samples) {
  const int n = batch->size[batch->dq], terms = transforms(batch);
  const long long next = (long long)n * LANES;
  for (int b = 0; b < terms; ++b) {
    double c[TOGETHER], s[TOGETHER];
    long long turn = b * at % batch->segment;
    for (int t = 0; t < samples; ++t) {
      c[t] = batch->cosine[turn], s[t] = batch->sine[turn];
      turn += b;
      turn -= turn >= batch->segment ? batch->segment : 0;
    }
    for (int e = 0; e < n; ++e) {
      double *restrict re = block->sums[1] + 2LL * (b * n + e) * LANES, *restrict im = re + LANES;
      const double *restrict x = block->recent + e * LANES;
      if (samples == TOGETHER) {
#pragma omp simd
        for (int i = 0; i < LANES; ++i) {
          const double x0 = x[i], x1 = x[next + i], x2 = x[2 * next + i], x3 = x[3 * next + i];
          re[i] = (((re[i] + c[0] * x0) + c[1] * x1) + c[2] * x2) + c[3] * x3;
          im[i] = (((im[i] - s[0] * x0) - s[1] * x1) - s[2] * x2) - s[3] * x3;
        }
        continue;
      }
      for (int t = 0; t < samples; ++t) {
#pragma omp simd
        for (int i = 0; i < LANES; ++i) {
          re[i] += c[t] * x[t * next + i];
          im[i] -= s[t] * x[t * next + i];
        }
      }
    }
  }
}

/* Welch's method: segments that overlap by half, so that one begins every `hop` samples while the one before it is in
 * its second half. The sums over a span of hop samples serve as the second half of the one and the first of the other;
 * of the energy, which the window weights otherwise, there are two. Samples are added TOGETHER, so that the sums are
 * not fetched for every one of them.
 */
static void follow_spectrum(const clikgen_batch *batch, clikgen_block *block) {
  const int n = batch->size[batch->dq];
  const long long half = batch->segment / 2, hop = batch->segment - half, at = block->k % hop;
  if (at == 0) {
    memset(block->sums[1], 0, 2 * (size_t)(n * transforms(batch)) * LANES * sizeof(double));
    memset(block->energy[1], 0, 2 * (size_t)n * LANES * sizeof(double));
  }
  const double *restrict dq = block->out[batch->dq];
  double *restrict recent = block->recent + block->fresh * n * LANES, *restrict energy = block->energy[1];
  const double rising = batch->weight[at], falling = batch->weight[at + hop];
  for (int e = 0; e < n; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i) {
      const double x = dq[e * LANES + i];
      recent[e * LANES + i] = x;
      energy[2 * e * LANES + i] += rising * (x * x);
      energy[(2 * e + 1) * LANES + i] += falling * (x * x);
    }
  }
  ++block->fresh;
  if (block->fresh == TOGETHER || at + 1 == half || at + 1 == hop) {
    add_to_sums(batch, block, at + 1 - block->fresh, block->fresh);
    block->fresh = 0;
  }
  if (at + 1 == half && block->k >= hop) {
    for (int e = 0; e < n; ++e) finish_segment(batch, block, e);
#pragma omp simd
    for (int i = 0; i < LANES; ++i) block->segments[i] += block->counts[i];
  }
  if (at + 1 == hop) {
    double *sums = block->sums[0];
    block->sums[0] = block->sums[1], block->sums[1] = sums;
    block->energy[1] = block->energy[0], block->energy[0] = energy;
  }
}

static void follow_tracking(const clikgen_batch *batch, clikgen_block *block) {
  const double *restrict error = block->out[batch->error];
  const int m = batch->size[batch->error];
  double square[LANES] = {0};
  for (int e = 0; e < m; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i) square[i] += error[e * LANES + i] * error[e * LANES + i];
  }
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const double now = block->counts[i] > 0.0 ? square[i] : 0.0;
    block->error_sum[i] += now;
    block->error_max[i] = (now > block->error_max[i]) | (now != now) ? now : block->error_max[i];
    block->error_last[i] = block->counts[i] > 0.0 ? square[i] : block->error_last[i];
  }
}

static void follow_least(const clikgen_batch *batch, clikgen_block *block, int signal, double *restrict least) {
  const double *restrict value = block->out[signal];
  const int size = batch->size[signal];
  double now[LANES];
  memcpy(now, value, sizeof now);
  for (int e = 1; e < size; ++e) {
#pragma omp simd
    for (int i = 0; i < LANES; ++i) {
      const double other = value[e * LANES + i];
      now[i] = (other < now[i]) | (other != other) ? other : now[i];
    }
  }
#pragma omp simd
  for (int i = 0; i < LANES; ++i) {
    const double so_far = (now[i] < least[i]) | (now[i] != now[i]) ? now[i] : least[i];
    least[i] = block->counts[i] > 0.0 ? so_far : least[i];
  }
}

static void measure(const clikgen_batch *batch, clikgen_block *block) {
  if (wants(batch, SWITCHES, SWITCH_RATE)) follow_switches(batch, block);
  if (wants(batch, HF_RMS, TOTAL_VARIATION)) {
    take_velocity(batch, block);
    if (block->k == 0) start_reversals(batch, block);
    if (block->k > 0 && wants(batch, MAX_VELOCITY_STEP, TOTAL_VARIATION)) follow_steps(batch, block);
    if (block->k > 0 && batch->result[REVERSAL_RATE]) follow_reversals(batch, block);
    if (batch->result[HF_RMS]) follow_spectrum(batch, block);
  }
  if (wants(batch, TRACKING_RMS, FINAL_ERROR) && batch->error >= 0) follow_tracking(batch, block);
  if (batch->result[MIN_CLEARANCE] && batch->clearance >= 0)
    follow_least(batch, block, batch->clearance, block->clearance);
  if (batch->result[MIN_DISTANCE] && batch->distance >= 0)
    follow_least(batch, block, batch->distance, block->distance);
}

/* ---- A block from its start to its results ---- */

static void start(const clikgen_batch *batch, clikgen_block *block) {
  block->rollout = batch->rollout + block->at * LANES;
  block->fresh = 0;
  for (int s = 0; s < batch->inputs; ++s) load(&batch->input[s], block, block->in[s]);
  memcpy(block->period, block->in[batch->period], sizeof block->period);
  const int n = batch->size[batch->dq];
  if (batch->result[HF_RMS]) memset(block->power, 0, (size_t)n * LANES * sizeof(double));
  for (int i = 0; i < LANES; ++i) {
    block->well[i] = 1.0;
    block->kept[i] = block->active[i] = block->switches[i] = block->encounter[i] = 0.0;
    block->largest_step[i] = block->variation[i] = block->reversals[i] = block->segments[i] = 0.0;
    block->error_sum[i] = block->error_max[i] = block->error_last[i] = 0.0;
    block->lost_at[i] = block->clearance[i] = block->distance[i] = INFINITY;
    block->last_active[i] = -INFINITY;
  }
}

static double hf_rms(const clikgen_batch *batch, const clikgen_block *block, int lane) {
  double sum = 0.0;
  if (block->segments[lane] == 0.0) return sum; /* it ended within the first segment */
  for (int e = 0; e < batch->size[batch->dq]; ++e) {
    const double power = block->power[e * LANES + lane] / block->segments[lane];
    sum += power < 0.0 ? 0.0 : power; /* rounding */
  }
  return sqrt(sum);
}

static double result(const clikgen_batch *batch, const clikgen_block *block, int which, int lane) {
  const double period = block->period[lane], kept = block->kept[lane];
  switch (which) {
    case SWITCHES: return block->switches[lane];
    case SWITCH_RATE:
      return block->encounter[lane] > 0.0 ? block->switches[lane] / (block->encounter[lane] * period) : 0.0;
    case HF_RMS: return hf_rms(batch, block, lane);
    case REVERSAL_RATE: return block->reversals[lane] / (kept * period);
    case MAX_VELOCITY_STEP: return sqrt(block->largest_step[lane]);
    case TOTAL_VARIATION: return block->variation[lane];
    case TRACKING_RMS: return sqrt(block->error_sum[lane] / kept);
    case TRACKING_MAX: return sqrt(block->error_max[lane]);
    case FINAL_ERROR: return sqrt(block->error_last[lane]);
    case MIN_CLEARANCE: return block->clearance[lane] < batch->far / 2.0 ? block->clearance[lane] : NAN;
    case MIN_DISTANCE: return block->distance[lane] < batch->far / 2.0 ? block->distance[lane] : NAN;
    case DIVERGED_AT: return period * block->lost_at[lane];
    default: return kept;
  }
}

static void finish(const clikgen_batch *batch, const clikgen_block *block) {
  for (int i = 0; i < LANES; ++i) {
    const long long rollout = block->rollout[i];
    for (int which = SWITCHES; which <= KEPT; ++which)
      if (batch->result[which]) batch->result[which][rollout] = result(batch, block, which, i);
    for (int s = 0; s < batch->inputs; ++s)
      if (batch->final[s])
        gather(block->in[s], batch->input[s].size, i, batch->final[s] + rollout * batch->input[s].size);
  }
}

/* Whether what is left of the block's steps would change no result. */
static int is_over(const clikgen_batch *batch, const clikgen_block *block) {
  if (block->k == batch->steps) return 1;
  for (int s = 0; s < batch->inputs; ++s)
    if (batch->final[s]) return 0;
  for (int i = 0; i < LANES; ++i)
    if (block->well[i] > 0.0) return 0;
  return block->k >= 2;
}

/* The blocks `first` to `end` - 1 are to be done in this room, whose address is a multiple of ALIGNMENT. */
void clikgen_batch_open(const clikgen_batch *batch, void *room, long long first, long long end) {
  clikgen_block *block = room;
  memset(block, 0, sizeof *block);
  lay_out(batch, room, block);
  block->at = first;
  block->end = end;
}

/* Goes on for so many steps of a block at most: 0 when all is done, 1 when not, -1 when the step failed. */
int clikgen_batch_advance(const clikgen_batch *batch, void *room, long long most) {
  clikgen_block *block = room;
  for (; block->at < block->end; --most) {
    if (most == 0) return 1;
    if (block->k == 0) start(batch, block);
    look_for_divergence(batch, block);
    if (batch->step_lanes)
      step_side_by_side(batch, block);
    else if (step_one_by_one(batch, block))
      return -1;
    measure(batch, block);
    go_on_from_next_state(batch, block);
    ++block->k;
    if (!is_over(batch, block)) continue;
    finish(batch, block);
    block->k = 0;
    ++block->at;
  }
  return 0;
}
