"""The paper's: the task is there or not, with the depth in its Jacobian (eqs. 8-11)."""

from typing import Literal

from clikgen.runtime.documents import NonNegative, Positive
from clikgen.symbolic.activation import ActivationSpec, Boundary
from clikgen.symbolic.potential import Combine, potential_task
from clikgen.symbolic.task import Task


class Spec(ActivationSpec):
    """q̇_o = J_o⁺ K_o (0 − V), eq. 10, with V = Σ ½ x² (eq. 8), J_o = ∂V/∂q (eq. 9): a task like the others.

    At the boundary the velocity jumps by |v_n|/ν, v_n = j·q̇_g what the tasks below want there and j = −∂d/∂q,
    ν = |j|: the null space of J_o loses j at any depth. It also takes motion away from the obstacle out, and so can
    stick. `gain` is K_o [1/s]. `damping` [m²] is that of the pseudo-inverse: J_o goes to zero with the depth, so below
    damping/ν the task fades; a tiny one keeps the paper's switch. `combine` is "sum" for the paper's one row, or
    "rows" for one a contact, which holds several contacts at once.
    """

    kind: Literal["switched"]
    gain: NonNegative = 20.0
    damping: Positive = 1e-9
    combine: Combine = "sum"

    def rows(self, contacts: int) -> int:
        """One for the sum, else one a contact."""
        return 1 if self.combine == "sum" else contacts

    def build(self, boundary: Boundary) -> Task:
        """The task toward V = 0."""
        return potential_task(boundary, self.gain, self.damping, self.combine)
