"""The first-order low-pass filter on the joint positions (eqs. 14-16)."""

import math
from collections.abc import Sequence
from typing import Literal

import casadi as ca

from clikgen.runtime.documents import Document, Positive
from clikgen.symbolic.signals import Signal, symbol


class Spec(Document):
    """q_i = A_β q_i + (I − A_β) q_{i−1}, eq. 16, with β = 2πTf_c / (1 + 2πTf_c) per joint, eq. 15.

    What the filter keeps of q_{i−1}, 1 − β = 1 / (1 + 2πTf_c), is all that the step needs of it.

    `cutoff` is f_c [Hz]: one number for all joints or a list, one per joint (for a differential drive one for v,
    which its x and y share, so that the filtered step still rolls). q_{i−1} is the joint position the step
    started from, so the filtered position is the state: the filter needs no memory of its own.
    """

    kind: Literal["first_order"]
    cutoff: Positive | tuple[Positive, ...]

    def build(self, period: ca.SX, input_of: Sequence[int]) -> tuple[ca.SX, tuple[Signal, ...]]:
        """1 − β (n, 1) and the inputs it needs; `input_of` q_i is the input that moves it."""
        cutoff = symbol(
            "filter_cutoff",
            (max(input_of) + 1,),
            "Hz",
            "f_c of each joint (eq. 15)",
            "parameter",
            (1e-6, 1e6),
            self.cutoff,
        )
        return (1 / (1 + 2 * math.pi * period * cutoff.expression))[list(input_of)], (cutoff,)
