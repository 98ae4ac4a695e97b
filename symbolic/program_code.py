"""The quadratic program in C: the same method as in `quadratic_program`, with loops and branches instead of selects."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from clikgen.symbolic.quadratic_program import (
    FIRM,
    KEPT,
    MOST_STEPS,
    REFINEMENTS,
    SLACK,
    SPARE,
    TOLERANCE,
    Program,
    Solution,
)

if TYPE_CHECKING:
    from clikgen.symbolic.emitter import Array, Block, Scalars

IN_DOUBLE = {"tolerance": TOLERANCE, "kept": KEPT, "slack": SLACK, "nothing": 1e300}
IN_FLOAT = {"tolerance": 1e-5, "kept": 1e-4, "slack": 1e-5, "nothing": 1e30}  # above the rounding of 2^-24

TYPES = """\
enum {{ QP_N = {n}, QP_ROWS = {rows}, QP_BOUNDS = {bounds}, QP_ALL = {all}, QP_HELD = {slots}, QP_STEPS = {steps} }};

/* min 1/2 (u - u0)' M^-1 (u - u0) such that A u <= b and lower <= u <= upper */
typedef struct {{
  {real} u0[QP_N], A[QP_ROWS + 1][QP_N], b[QP_ROWS + 1], lower[QP_BOUNDS + 1], upper[QP_BOUNDS + 1];
  {real} M[QP_N][QP_N];
}} qp_program;

/* u, by how much each row and bound is violated, how many steps it took, and whether it was solved */
typedef struct {{
  {real} u[QP_N], slack[QP_ALL + 1], steps, solved;
}} qp_solution;
"""

FUNCTIONS = """\
/* By how much u violates row i, or the bounds of variable i - QP_ROWS; negative where it does not. */
static {real} qp_violation(const qp_program *p, const {real} *u, int i) {{
  if (i < QP_ROWS) {{
    {real} sum = {zero};
    for (int j = 0; j < QP_N; ++j) sum += p->A[i][j] * u[j];
    return sum - p->b[i];
  }}
  const {real} above = u[i - QP_ROWS] - p->upper[i - QP_ROWS], below = p->lower[i - QP_ROWS] - u[i - QP_ROWS];
  return above > below ? above : below;
}}

/* The free row that u violates most, -1 for none. */
static int qp_most_violated(const qp_program *p, const {real} *u, const char *held) {{
  {real} worst = {tolerance};
  int row = -1;
  for (int i = 0; i < QP_ALL; ++i) {{
    const {real} violation = qp_violation(p, u, i);
    if (!held[i] && violation > worst) worst = violation, row = i;
  }}
  return row;
}}

static void qp_within_bounds(const qp_program *p, {real} *u) {{
  for (int j = 0; j < QP_BOUNDS; ++j) {{
    const {real} most = u[j] < p->upper[j] ? u[j] : p->upper[j];
    u[j] = most > p->lower[j] ? most : p->lower[j];
  }}
}}

/* The largest share of u that keeps the rows which u = 0 keeps. */
static {real} qp_share_kept(const qp_program *p, const {real} *u) {{
  {real} share = {one};
  for (int i = 0; i < QP_ROWS; ++i) {{
    const {real} along = qp_violation(p, u, i) + p->b[i], most = p->b[i] + {kept};
    if (p->b[i] >= {zero} && along > most && most < share * along) share = most / along;
  }}
  return share;
}}

/* Goldfarb and Idnani's dual method from the row that u0 violates most, on Z = [[H, N'], [N, -K]]: with the rows
 * held a, K = (a M a' + delta)^-1, N = K a M, H = M - M a' N. A row taken in or let go of is one symmetric update of
 * rank one. Rows give way by delta times their multiplier y. */
static void qp_solve(const qp_program *p, int row, qp_solution *out) {{
  enum {{ SIZE = QP_N + QP_HELD }};
  {real} Z[SIZE][SIZE], y[QP_HELD], delta[QP_HELD], u[QP_N], a[QP_N], image[SIZE], vector[SIZE], turned[QP_N];
  int slot_row[QP_HELD], top = 0, steps = 0;
  char held[QP_ALL + 1] = {{0}};
  {real} multiplier = {zero};
  for (int i = 0; i < QP_N; ++i) {{
    u[i] = turned[i] = p->u0[i];
    for (int j = 0; j < QP_N; ++j) Z[i][j] = p->M[i][j];
  }}
  do {{
    /* the row and its limit, seen from the side on which it is violated: in `turned`, where the last step led */
    {real} limit, give = {slack};
    if (row < QP_ROWS) {{
      for (int j = 0; j < QP_N; ++j) a[j] = p->A[row][j];
      limit = p->b[row];
    }} else {{
      const int k = row - QP_ROWS;
      const int upper = turned[k] - p->upper[k] >= p->lower[k] - turned[k];
      for (int j = 0; j < QP_N; ++j) a[j] = {zero};
      a[k] = upper ? {one} : -{one};
      limit = upper ? p->upper[k] : -p->lower[k];
      give *= {firm};
    }}
    const int size = QP_N + top;
    for (int i = 0; i < size; ++i) {{
      image[i] = {zero};
      for (int j = 0; j < QP_N; ++j) image[i] += Z[i][j] * a[j];
    }}
    {real} pivot = give, gap = -limit - give * multiplier, ratio = {nothing};
    for (int j = 0; j < QP_N; ++j) pivot += a[j] * image[j], gap += a[j] * u[j];
    const {real} full = gap / pivot;
    int leaving = -1, empty = -1;
    for (int j = 0; j < top; ++j) {{
      if (slot_row[j] < 0) {{
        if (empty < 0) empty = j;
      }} else if (image[QP_N + j] > {zero} && y[j] < ratio * image[QP_N + j]) {{
        ratio = y[j] / image[QP_N + j];
        leaving = j;
      }}
    }}
    const int drop = leaving >= 0 && ratio < full;
    if (!drop && empty < 0) {{
      if (top == QP_HELD) {{ /* no slot is left: take what there is */
        ++steps;
        row = -2;
        break;
      }}
      empty = top++;
      for (int i = 0; i < QP_N + top; ++i) Z[i][QP_N + empty] = Z[QP_N + empty][i] = {zero};
      image[QP_N + empty] = y[empty] = {zero};
    }}
    const {real} length = drop ? ratio : full;
    const int now = QP_N + top, slot = drop ? leaving : empty;
    for (int j = 0; j < QP_N; ++j) u[j] -= length * image[j];
    for (int j = 0; j < top; ++j) y[j] -= length * image[QP_N + j];
    multiplier += length;
    for (int i = 0; i < now; ++i) vector[i] = drop ? Z[i][QP_N + slot] : image[i];
    if (drop) {{
      pivot = Z[QP_N + slot][QP_N + slot];
    }} else {{
      vector[QP_N + slot] -= {one};
    }}
    for (int i = 0; i < now; ++i) {{
      const {real} scaled = vector[i] / pivot;
      for (int j = 0; j < now; ++j) Z[i][j] -= scaled * vector[j];
    }}
    if (drop) {{ /* what it leaves is rounding noise */
      for (int i = 0; i < now; ++i) Z[i][QP_N + slot] = Z[QP_N + slot][i] = {zero};
      held[slot_row[slot]] = 0;
      slot_row[slot] = -1;
      y[slot] = delta[slot] = {zero};
    }} else {{
      held[row] = 1;
      slot_row[slot] = row;
      y[slot] = multiplier;
      delta[slot] = give;
      for (int j = 0; j < QP_N; ++j) {{ /* without the bias of the slack, or rows parallel to those held come in, too */
        turned[j] = u[j];
        for (int k = 0; k < top; ++k) turned[j] -= Z[QP_N + k][j] * (delta[k] * y[k]);
      }}
      row = qp_most_violated(p, turned, held);
      multiplier = {zero};
    }}
    ++steps;
  }} while (row >= 0 && steps < QP_STEPS);
  {real} residual[QP_HELD];
  for (int k = 0; k < top; ++k) residual[k] = delta[k] * y[k];
  for (int round = 0; round < {refinements}; ++round) {{
    {real} next[QP_HELD];
    for (int j = 0; j < QP_N; ++j)
      for (int k = 0; k < top; ++k) u[j] -= Z[QP_N + k][j] * residual[k];
    for (int i = 0; i < top; ++i) {{
      next[i] = {zero};
      for (int k = 0; k < top; ++k) next[i] -= Z[QP_N + i][QP_N + k] * residual[k];
      next[i] *= delta[i];
    }}
    for (int i = 0; i < top; ++i) residual[i] = next[i];
  }}
  qp_within_bounds(p, u);
  if (row != -1) {{
    const {real} share = qp_share_kept(p, u);
    for (int j = 0; j < QP_N; ++j) u[j] *= share;
    qp_within_bounds(p, u); /* which need not hold u = 0 */
  }}
  for (int j = 0; j < QP_N; ++j) out->u[j] = u[j];
  for (int i = 0; i < QP_ALL; ++i) {{
    const {real} violation = qp_violation(p, u, i);
    out->slack[i] = violation > {zero} ? violation : {zero};
  }}
  out->steps = ({real})steps;
  out->solved = row == -1 ? {one} : {zero};
}}
"""


def program_call(block: "Block", stage: Solution, arguments: Sequence[Sequence[int]]) -> "list[Array | Scalars]":
    """Write the program's solution; the metric is computed only where some row is violated. Where its symbols are."""
    from clikgen.symbolic.emitter import Array, Scalars, Text

    program, names = stage.program, block.names
    n, rows, bounds = program.start.numel(), program.limits.numel(), program.lower.numel()
    names.functions.add(_functions(program, names.real))
    start, triangle, entries, limits, lower, upper = arguments
    qp, solution, row = (names.new(name) for name in ("qp", "solution", "row"))
    block.line(f"qp_program {qp};")
    block.line(f"qp_solution {solution};")
    for j, i in enumerate(start):
        block.line(f"{qp}.u0[{j}] = {solution}.u[{j}] = {block.value(i)};")
    sparsity, zero = program.rows.sparsity(), block.constant(0.0)
    places = dict(zip(zip(*sparsity.get_triplet(), strict=True), entries, strict=True))
    for i in range(rows):
        values = [block.value(places[i, j]) if (i, j) in places else zero for j in range(n)]
        for j, value in enumerate(values):
            block.line(f"{qp}.A[{i}][{j}] = {value};")
    for name, column in (("b", limits), ("lower", lower), ("upper", upper)):
        for j, i in enumerate(column):
            block.line(f"{qp}.{name}[{j}] = {block.value(i)};")
    block.line(f"for (int i = 0; i < {rows + bounds}; ++i) {solution}.slack[i] = {zero};")
    block.line(f"{solution}.steps = {zero};")
    block.line(f"{solution}.solved = {block.constant(1.0)};")
    block.line(f"static const char none[{rows + bounds + 1}] = {{0}};")
    block.line(f"const int {row} = qp_most_violated(&{qp}, {qp}.u0, none);")
    with block.braces(f"if ({row} >= 0)"):
        lower_triangle = iter(triangle)
        for i in range(n):
            for j in range(i + 1):
                value = block.value(next(lower_triangle))
                both = f"{qp}.M[{i}][{j}] = " + (f"{qp}.M[{j}][{i}] = " if i != j else "")
                block.line(f"{both}{value};")
        block.line(f"qp_solve(&{qp}, {row}, &{solution});")
    u, slack = Array(f"{solution}.u", n, 1, 0), Array(f"{solution}.slack", rows + bounds, 1, 0)
    return [u, slack, *(Scalars((Text(f"{solution}.{name}"),)) for name in ("steps", "solved"))]


def _functions(program: Program, real: str) -> str:
    """The solver for programs of this size."""
    n, rows, bounds = program.start.numel(), program.limits.numel(), program.lower.numel()
    suffix = "f" if real == "float" else ""
    numbers = {"firm": FIRM, "one": 1.0, "zero": 0.0} | (IN_DOUBLE if real == "double" else IN_FLOAT)
    return (TYPES + "\n" + FUNCTIONS).format(
        n=n,
        rows=rows,
        bounds=bounds,
        all=rows + bounds,
        slots=min(n + SPARE, rows + bounds),
        steps=MOST_STEPS,
        refinements=REFINEMENTS,
        real=real,
        **{name: f"{value!r}{suffix}" for name, value in numbers.items()},
    )
