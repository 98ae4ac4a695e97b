"""The barrier: the least change of the prioritized velocity such that no contact closes, all contacts at once.

With u₀ the velocity of the tasks that hold always, in their order of priority,

    min ½ (u − u₀)ᵀ M⁻¹ (u − u₀)   such that   ḋ >= −γ (d − s) for every pair,   −v <= u <= v.

M says what a change costs: M = N + ε² (I − N), with N = I − Jᵀ(J Jᵀ + μ²I)⁻¹ J the damped null-space projector of the
first task; the next one splits N in the same way, with a greater ε. A change along the rows of the first task costs
1/ε² as much as one in its null space: a contact that null-space motion can clear costs next to no tracking, one that
it cannot is kept by the least joint velocity. For one contact j: u = u₀ − M j max(0, excess)/(jᵀ M j).
M is positive definite, so the solution is unique, and continuous in all it depends on, through every singularity of
the tasks. What is not continuous: a contact already entered that the joints hardly move (|j| → 0) asks for all that
the limits give.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import casadi as ca

from clikgen.symbolic.activation import Guard
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.quadratic_program import MOST_STEPS, Program, Solution
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import Task

YIELD = 0.02  # ε of the first task
FURTHER = 10.0  # times as much for each further task
SINGULAR = 0.01  # μ, the damping of the null-space projectors, in the unit of a task's Jacobian
FEASIBLE = 1e-8  # [m/s, rad/s] a row violated by less is kept
UNBOUND = 1e6  # [m/s, rad/s] the bound of a velocity without limits


@dataclass(frozen=True, slots=True, eq=False)
class Barrier:
    """The program as a stage, its solution u, and the signals around it."""

    stage: Solution
    velocity: ca.SX  # u (n_u, 1)
    parameters: tuple[Signal, ...]
    diagnostics: tuple[Signal, ...]

    @classmethod
    def of(cls, guards: Sequence[Guard], tasks: Sequence[Task], u: ca.SX, limit: ca.SX | None) -> Self:
        """The change of u (n_u, 1) that keeps the guards, tasks and guards in terms of u; `limit` bounds |u|."""
        yields, parameters = _yields(tasks)
        pairs = [(contact, guard.rate) for guard in guards for contact in guard.contacts]
        single = {i: _single(contact) for i, (contact, _) in enumerate(pairs)}
        lower, upper = _bounds(u.numel(), limit, [(pairs[i], one) for i, one in single.items() if one])
        rows = [pair for i, pair in enumerate(pairs) if not single[i]]
        names = [guard.name for guard in guards for contact in guard.contacts if not _single(contact)]
        program = Program(
            u,
            _metric_inverse(yields, u.numel()),
            ca.vertcat(ca.SX(0, u.numel()), *(contact.approach for contact, _ in rows)),
            ca.vertcat(ca.SX(0, 1), *(_room(*pair) for pair in rows)),
            lower,
            upper,
        )
        names += ["the bounds of the velocities"] * lower.numel()
        solution = Solution.of(program)
        velocity, *reported = solution.symbols
        return cls(solution, velocity, parameters, _diagnostics(names, *reported))


def _diagnostics(names: Sequence[str], slack: ca.SX, steps: ca.SX, solved: ca.SX) -> tuple[Signal, ...]:
    """What the program says of itself; `names` say whose each row is."""
    worst, row = ca.SX(0), ca.SX(-1)
    for i in range(slack.numel()):
        row = ca.if_else(slack[i] > worst, i, row)
        worst = ca.fmax(slack[i], worst)
    feasible = worst <= FEASIBLE
    whose = ", ".join(
        f"{names.index(name)}-{names.index(name) + names.count(name) - 1} {name}" for name in dict.fromkeys(names)
    )
    text = f"the row violated most, −1 for none: {whose}"
    return (
        result("barrier_excess", worst, (), "m/s, rad/s", "largest violation of a row; 0 where all can be kept"),
        result("barrier_row", ca.if_else(feasible, -1, row), (), "1", text),
        result("barrier_steps", steps, (), "1", f"steps of the quadratic program, at most {MOST_STEPS}"),
        result("barrier_solved", solved, (), "1", "1, or 0 where those steps were not enough"),
    )


def _yields(tasks: Sequence[Task]) -> tuple[list[tuple[Task, ca.SX]], tuple[Signal, ...]]:
    """Each task that the metric knows with its ε, and the parameters; one at ε = 1 yields like the null space."""
    known = []
    for k, task in enumerate(tasks):
        value = YIELD * FURTHER**k if task.yields is None else task.yields
        if value < 1:
            text = "ε, how far the barrier lets the task yield, its null space 1"
            known.append((task, symbol(f"{task.name}_yields", (), "1", text, "parameter", (1e-4, 1.0), value)))
    return [(task, signal.expression) for task, signal in known], tuple(signal for _, signal in known)


def _metric_inverse(yields: Sequence[tuple[Task, ca.SX]], n: int) -> ca.SX:
    """M (n, n): per task M ← (1 − ε²) N + ε² M, N = M − M Jᵀ(J M Jᵀ + μ²I)⁻¹ J M, a row of J after the other."""
    M = ca.SX.eye(n)
    for task, share in yields:
        N = M
        for i in range(task.jacobian.shape[0]):
            j = task.jacobian[i, :].T
            image = N @ j
            N -= image @ image.T / (SINGULAR**2 + ca.dot(j, image))
        M = N + share**2 * (M - N)
    return M


def _single(contact: Contact) -> tuple[int, int] | None:
    """The variable and the sign of a contact that one variable alone closes, ±e_i; None for another one."""
    entries = [i for i in range(contact.approach.numel()) if not contact.approach[i].is_zero()]
    if len(entries) != 1 or not contact.approach[entries[0]].is_constant():
        return None
    value = float(contact.approach[entries[0]])
    return (entries[0], round(value)) if abs(value) == 1 else None


def _room(contact: Contact, rate: ca.SX) -> ca.SX:
    """How fast the contact may be approached [m/s]: γ (d − s) + ∂d/∂t."""
    return rate * (contact.distance - contact.margin) + contact.opening


def _bounds(
    n: int, limit: ca.SX | None, single: Sequence[tuple[tuple[Contact, ca.SX], tuple[int, int]]]
) -> tuple[ca.SX, ca.SX]:
    """Lower and upper bounds of u: its limits, and contacts that one variable closes; none where there are none."""
    if limit is None and not single:
        return ca.SX(0, 1), ca.SX(0, 1)
    widest = UNBOUND * ca.SX.ones(n) if limit is None else limit
    lower, upper = -widest, +widest
    for (contact, rate), (i, sign) in single:
        room = ca.fmax(_room(contact, rate), -widest[i])  # no faster than the limit, not even back
        if sign > 0:
            upper[i] = ca.fmin(upper[i], room)
        else:
            lower[i] = ca.fmax(lower[i], -room)
    return lower, upper
