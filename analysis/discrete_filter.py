"""The filter of eqs. 15-16 as a discrete system: closed forms, designs to compare with, and its inverse design.

H(z) = β z/(z − (1 − β)) with β = X/(1 + X), X = 2πTf_c: the backward-Euler image of the RC low-pass. Ω = 2πfT is
the frequency in rad per sample, 0 to π.
"""

from dataclasses import dataclass
from typing import Literal

import control
import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.documents import BadInput

Array = NDArray[np.float64]
Method = Literal["backward Euler", "pole-matched", "Tustin"]

EXISTENCE_EDGE = 2 * (np.sqrt(2) - 1)
"""β above which |H| stays above −3 dB up to the Nyquist frequency: 0.8284."""


def beta_of(cutoff: float, period: float) -> float:
    """β = X/(1 + X), X = 2πTf_c (eq. 15), from f_c [Hz] and T [s]; raises BadInput unless both are positive."""
    if not (cutoff > 0 and period > 0):
        raise BadInput(f"wanted f_c > 0 Hz and T > 0 s, got f_c = {cutoff:g} and T = {period:g}")
    x = 2 * np.pi * period * cutoff
    return float(x / (1 + x))


def cutoff_of(beta: float, period: float) -> float:
    """f_c [Hz] that makes eq. 15 give β at T [s]: the inverse of beta_of; raises BadInput unless 0 < β < 1."""
    _check(beta)
    return beta / (1 - beta) / (2 * np.pi * period)


def _check(beta: float) -> None:
    if not 0 < beta < 1:
        raise BadInput(f"wanted β in (0, 1), got {beta:g}")


def system(beta: float, period: float) -> control.TransferFunction:
    """H(z) = β z/(z − (1 − β)) at sampling time T [s]."""
    return control.TransferFunction([beta, 0.0], [1.0, beta - 1.0], period)


def magnitude(beta: float, omega: Array) -> Array:
    """|H(e^{jΩ})| = β/√(1 − 2(1−β)cos Ω + (1−β)²), at Ω [rad/sample]."""
    a = 1 - beta
    # the sum of squares (1 − a)² + 4a sin²(Ω/2) is the same without cancellation at small β and Ω
    return np.asarray(beta / np.sqrt(beta**2 + 4 * a * np.sin(omega / 2) ** 2))


def phase(beta: float, omega: Array) -> Array:
    """arg H(e^{jΩ}) = −atan2((1−β)sin Ω, 1 − (1−β)cos Ω) [rad]; the largest lag is asin(1 − β)."""
    a = 1 - beta
    return np.asarray(-np.arctan2(a * np.sin(omega), 1 - a * np.cos(omega)))


def group_delay(beta: float, omega: Array) -> Array:
    """−d arg H/dΩ = a(cos Ω − a)/(1 − 2a cos Ω + a²), a = 1 − β, in samples; at DC a/β = 1/(2πTf_c)."""
    a = 1 - beta
    return np.asarray(a * (np.cos(omega) - a) / (beta**2 + 4 * a * np.sin(omega / 2) ** 2))


def noise_gain(beta: float) -> float:
    """Variance of the output over that of white noise at the input: β/(2 − β), which also is |H| at Nyquist."""
    return beta / (2 - beta)


def minus_3_db(beta: float) -> float | None:
    """Ω_c = 2 asin(X/(2√(1+X))) [rad/sample] where |H|² = 1/2; None beyond the existence edge.

    In β: X/√(1+X) = β/√(1−β).
    """
    if beta > EXISTENCE_EDGE:
        return None
    return float(2 * np.arcsin(min(1.0, beta / (2 * np.sqrt(1 - beta)))))


def beta_for(cutoff: float, period: float) -> float:
    """β whose true −3 dB frequency is `cutoff` [Hz] at T [s]: −y + √(y² + 2y), y = 1 − cos Ω_d.

    Raises BadInput unless 0 < cutoff <= 1/(2T).
    """
    omega = 2 * np.pi * cutoff * period
    if not 0 < omega <= np.pi:
        raise BadInput(f"wanted a cut-off above 0 and up to the Nyquist frequency {0.5 / period:g} Hz, got {cutoff:g}")
    y = 2 * np.sin(omega / 2) ** 2
    return float(-y + np.sqrt(y * y + 2 * y))


@dataclass(frozen=True, slots=True, eq=False)
class Design:
    """A way to make the RC low-pass of f_c discrete: its system and its −3 dB frequency [Hz], None without."""

    method: Method
    system: control.TransferFunction
    cutoff: float | None


def designs(cutoff: float, period: float) -> list[Design]:
    """The shipped design and the two usual others, for f_c [Hz] at T [s], X = 2πTf_c.

    backward Euler: eq. 15; pole-matched: the same form with β = 1 − e^{−X}, Ω_c = 2 asin(sinh(X/2)); Tustin: a
    zero at Nyquist, Ω_c = 2 atan(X/2).
    """
    x = 2 * np.pi * period * cutoff
    matched = -np.expm1(-x)
    backward = beta_of(cutoff, period)
    tustin = control.TransferFunction([x, x], [2 + x, x - 2], period)
    hertz = 1 / (2 * np.pi * period)
    ends = {
        "backward Euler": minus_3_db(backward),
        "pole-matched": minus_3_db(matched),
        "Tustin": 2 * np.arctan(x / 2),
    }
    systems = {
        "backward Euler": system(backward, period),
        "pole-matched": system(matched, period),
        "Tustin": tustin,
    }
    return [
        Design(method, systems[method], None if ends[method] is None else float(ends[method]) * hertz)
        for method in ("backward Euler", "pole-matched", "Tustin")
    ]


def prototype(cutoff: float) -> control.TransferFunction:
    """The continuous RC low-pass 1/(1 + s/(2πf_c))."""
    return control.TransferFunction([1.0], [1 / (2 * np.pi * cutoff), 1.0])
