"""The paper's planner without its bumps and its lag: λ is continuous, and the filter knows the previous velocity."""

from typing import TYPE_CHECKING, Literal

import casadi as ca

from clikgen.runtime.documents import Positive
from clikgen.symbolic.planner import Motion, Plan, PlannerSpec
from clikgen.symbolic.signals import Signal, result, symbol

if TYPE_CHECKING:
    from clikgen.symbolic.filters.first_order import Spec as AnyFilter


class Spec(PlannerSpec):
    """λ goes from lam_free at the clearance `width` [m] to lam_event at 0; q_{i−1} of eq. 16 goes on as it moved.

    With q_{i−1} + (q_{i−1} − q_{i−2}) in place of q_{i−1}, eqs. 16-17 are a low-pass of the input velocity,
    u_i = b u_law,i + (1 − b) u_{i−1}, b = 1 − λ(1 − β): the robot goes on from the velocity that it has, whatever λ
    does, and of a jump of the law it takes the share b. With τ = (1 − b) T/b, which at λ = 1 is 1/(2π f_c), and
    r = √(1 − b):

    - a loop of gain K has the poles z² − (2 − b − b K T) z + (1 − b): it is stable iff K T < 2 (2 − b)/b, and from
      rest without overshoot iff K T <= (1 − r)/(1 + r), even while λ varies, b then being its least;
    - it follows a ramp without lag, an acceleration a with the error a (τ + T/2)/K, a T/(2 K) of it without a filter;
    - where the law stops an approach at v_n, the robot goes on by τ v_n: it intrudes by less than (τ + T) v_n;
    - of white noise in u_law the share b/(2 − b) of the variance is left.

    What the law keeps in every period, a barrier's joint limits among them, is therefore overrun while λ > 0, by less
    than (τ + T) v_n too; a barrier of rate γ is a loop of that gain, kept where γ T <= (1 − r)/(1 + r).
    """

    kind: Literal["smooth"]
    width: Positive = 0.05

    def build(self, motion: Motion, chosen: "AnyFilter") -> Plan:
        """Eqs. 16, 18 and 17, in this order, with the velocity that was run as a state."""
        free, at_event = self.shares()
        width = symbol("planner_width", (), "m", "clearance where λ is lam_free", "parameter", (1e-6, 1e3), self.width)
        u_previous = _velocity_state(motion)
        coasting = motion.velocity_map @ u_previous.expression
        share = nearness(motion.clearance, width.expression)
        lam = (1 - share) * free.expression + share * at_event.expression  # eq. 18
        kept, filter_inputs = motion.share(lam, chosen)  # eqs. 16 and 17
        dq = kept * motion.dq_law + (1 - kept) * coasting
        u = motion.velocity_map.T @ dq  # SᵀS = I
        text = "u of this period, the next one's u_previous"
        u_next = result("u_next", u, u_previous.info.shape, u_previous.info.unit, text, "state", "u_previous")
        return Plan(dq, lam, (u_previous, *filter_inputs, free, at_event, width), (u_next,))


def nearness(clearance: ca.SX | None, width: ca.SX) -> ca.SX:
    """s(c): 1 for c <= 0, 0 for c >= width, once continuously differentiable; 0 where there is nothing to meet."""
    if clearance is None:
        return ca.SX(0)
    t = ca.fmin(ca.fmax(1 - clearance / width, 0), 1)
    return t**2 * (3 - 2 * t)


def _velocity_state(motion: Motion) -> Signal:
    """The input velocity u (n_u,) of the period before: for a differential drive it turns with the base."""
    moved = motion.robot.inputs
    return symbol(
        "u_previous",
        (len(moved),),
        ", ".join(f"{one.unit}/s" for one in moved),
        "u of the period before, q̇ = S(q) u: " + ", ".join(one.name for one in moved),
        "state",
        (-1e6, 1e6),
    )
