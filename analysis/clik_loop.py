"""The discrete CLIK loop, linear: closed loops for the readings of eq. 16, gain bounds, margins, ramp lag.

One direction of the task is one scalar loop with gain K [1/s]: command v = ṙ + K e, position by Euler (eq. 13).
The paper leaves open what the filtered joint position of eq. 16 does; the three readings:

A  it is the state that the next step starts from (what the generated step does);
B  it goes to the robot, while the loop runs on the unfiltered position;
C  it is measured back, while the integrator goes on from the unfiltered position.
"""

from dataclasses import dataclass
from typing import Literal

import control
import numpy as np
import numpy.polynomial.polynomial as poly
from numpy.typing import NDArray
from scipy.optimize import brentq

from clikgen.runtime.documents import BadInput

Array = NDArray[np.floating]
Reading = Literal["A", "B", "C"]
READINGS: tuple[Reading, ...] = ("A", "B", "C")


@dataclass(frozen=True, slots=True)
class Loop:
    """What is in the loop besides the gain.

    `period` T [s]; `beta` of the filter (1: none); `delay` [samples] of transport from command to position;
    `servo` time constant τ [s] of a first-order velocity servo (0: ideal).
    """

    reading: Reading
    period: float
    beta: float = 1.0
    delay: int = 0
    servo: float = 0.0

    def __post_init__(self) -> None:
        if self.reading not in READINGS:
            raise BadInput(f"reading: wanted one of {', '.join(READINGS)}, got {self.reading!r}")
        if not (np.isfinite(self.period) and self.period > 0):
            raise BadInput(f"period: wanted T > 0 s, got {self.period:g}")
        if not 0 < self.beta <= 1:
            raise BadInput(f"beta: wanted β in (0, 1], got {self.beta:g}")
        if self.delay < 0 or self.delay != int(self.delay):
            raise BadInput(f"delay: wanted a whole number of samples, 0 or more, got {self.delay}")
        if not (np.isfinite(self.servo) and self.servo >= 0):
            raise BadInput(f"servo: wanted τ >= 0 s, got {self.servo:g}")

    def plant(self) -> tuple[Array, Array]:
        """From commanded velocity to the position the loop closes on, gain 1: numerator, denominator in z.

        Coefficients from the constant upward. T/(z − 1) for an ideal servo, else with E = e^{−T/τ}
        (b1 z + b0)/((z − 1)(z − E)), b1 = T − τ + τE, b0 = τ − (T + τ)E; times β in reading A; over z^n.
        """
        T, tau = self.period, self.servo
        if tau == 0:
            numerator, denominator = np.array([T]), np.array([-1.0, 1.0])
        else:
            E = np.exp(-T / tau)
            # the same b1 and b0 without the cancellation of large τ/T: expm1 keeps what is left of 1 − E
            lag = -np.expm1(-T / tau)
            numerator = np.array([tau * lag - T * E, T - tau * lag])
            denominator = poly.polymul([-1.0, 1.0], [-E, 1.0])
        if self.reading == "A":
            numerator = self.beta * numerator
        return numerator, poly.polymul(denominator, [0.0] * self.delay + [1.0])

    def open_loop(self) -> tuple[Array, Array]:
        """L(z)/K, from error to what is subtracted from the reference: numerator, denominator in z, upward."""
        numerator, denominator = self.plant()
        if self.reading == "C":
            filter_numerator, filter_denominator = self._filter()
            return poly.polymul(numerator, filter_numerator), poly.polymul(denominator, filter_denominator)
        return numerator, denominator

    def _filter(self) -> tuple[Array, Array]:
        """β z/(z − (1 − β)), upward."""
        return np.array([0.0, self.beta]), np.array([self.beta - 1.0, 1.0])


def open_loop(loop: Loop, gain: float) -> control.TransferFunction:
    """L(z) = K·plant (times the filter in reading C)."""
    numerator, denominator = loop.open_loop()
    return _transfer_function(gain * numerator, denominator, loop.period)


def closed_loop(loop: Loop, gain: float, *, feedforward: bool = True) -> control.TransferFunction:
    """From the reference to the position that comes out (eq. 4 with or without ṙ_g as feedforward).

    The feedforward ṙ is (r⁺ − r)/T. A without delay or servo: β(z − 1 + TK)/(z − 1 + βTK).
    """
    plant_numerator, _ = loop.plant()
    numerator, denominator = loop.open_loop()
    command = np.array([gain - 1 / loop.period, 1 / loop.period]) if feedforward else np.array([gain])
    closed = poly.polyadd(denominator, gain * numerator)  # 1 + L = closed / denominator
    out = poly.polymul(command, plant_numerator)
    if loop.reading == "C":  # denominator = plant denominator · filter denominator; the filter cancels once
        out = poly.polymul(out, loop._filter()[0])
    elif loop.reading == "B":
        out, closed = poly.polymul(out, loop._filter()[0]), poly.polymul(closed, loop._filter()[1])
    return _transfer_function(out, closed, loop.period)


def pole_radius(loop: Loop, gain: float) -> float:
    """Largest |z| among the poles of the loop that the gain closes: below 1 is stable."""
    numerator, denominator = loop.open_loop()
    return float(np.max(np.abs(poly.polyroots(poly.polyadd(denominator, gain * numerator)))))


def gain_bound(loop: Loop) -> float:
    """The largest gain K [1/s] below which the loop is stable: where the first pole reaches the unit circle.

    Candidates are the K with L(z) = −1 on |z| = 1: there L is real, so N(z)D(1/z) − N(1/z)D(z) = 0, which has
    z = −1 among its roots and others in pairs; the closed-loop poles decide which is the bound, and where
    exactly. (Gain margins of python-control miss a phase crossover at z = −1: T/(z − 1) is said to have none,
    while the bound is 2/T.)
    """
    candidates = sorted(_crossing_gains(loop))
    for gain in candidates:
        if pole_radius(loop, gain * (1 + 1e-3)) > 1 > pole_radius(loop, gain * (1 - 1e-3)):
            return float(brentq(lambda k: pole_radius(loop, k) - 1, gain * (1 - 1e-3), gain * (1 + 1e-3), rtol=1e-13))
    raise AssertionError(f"no stability boundary for {loop} among {candidates}")


def _crossing_gains(loop: Loop) -> list[float]:
    """The gains that put a pole on the unit circle, as found from the polynomials."""
    numerator, denominator = loop.open_loop()
    order = len(denominator) - 1
    numerator = np.pad(numerator, (0, order + 1 - len(numerator)))
    real_there = poly.polysub(poly.polymul(numerator, denominator[::-1]), poly.polymul(numerator[::-1], denominator))
    roots = poly.polyroots(np.trim_zeros(real_there, "b"))
    on_circle = [z / abs(z) for z in roots if abs(abs(z) - 1) < 1e-3 and z.imag >= 0]
    gains = []
    for z in [*on_circle, -1.0 + 0j]:
        response = poly.polyval(z, numerator) / poly.polyval(z, denominator) if abs(z - 1) > 1e-6 else 0.0
        if np.real(response) < 0:
            gains.append(float(-1 / np.real(response)))
    return gains


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins of a loop at a gain.

    `gain`: factor by which K may grow; `phase` [rad] and `delay` [samples] that may be added at the gain crossover
    (None without one); `modulus`: least |1 + L|, the distance to −1.
    """

    gain: float
    phase: float | None
    delay: float | None
    modulus: float


def margins(loop: Loop, gain: float) -> Margins:
    """Margins at gain K [1/s], the gain margin from closed-loop poles, which are right at z = −1 too."""
    omega = np.concatenate([np.geomspace(1e-5, 1e-2, 2000), np.linspace(1e-2, np.pi, 20_000)])
    response = _response(loop, gain, omega)
    crossing = np.flatnonzero(np.diff(np.sign(np.abs(response) - 1)))
    phases, delays = [], []
    for i in crossing:
        at = brentq(lambda w: abs(_response(loop, gain, np.array([w]))[0]) - 1, omega[i], omega[i + 1])
        phase = np.angle(-_response(loop, gain, np.array([at]))[0])
        phases.append(float(phase))
        delays.append(float(np.mod(phase, 2 * np.pi) / at))
    return Margins(
        gain=gain_bound(loop) / gain,
        phase=min(phases, key=abs) if phases else None,
        delay=min(delays) if delays else None,
        modulus=float(np.min(np.abs(1 + response))),
    )


def _response(loop: Loop, gain: float, omega: Array) -> NDArray[np.complex128]:
    numerator, denominator = loop.open_loop()
    z = np.exp(1j * omega)
    return np.asarray(gain * poly.polyval(z, numerator) / poly.polyval(z, denominator))


def ramp_lag(loop: Loop, gain: float, *, feedforward: bool = True) -> float:
    """How far the output stays behind a reference of unit speed [m per m/s, that is s].

    lim_{z→1} T(1 − G(z))/(z − 1) = −T G′(1), as G(1) = 1. With feedforward and neither delay nor servo:
    A (1−β)/(βK) = 1/(2πf_cKT), B 1/(2πf_c), C 0 for the position that is filtered.
    """
    system = closed_loop(loop, gain, feedforward=feedforward)
    numerator, denominator = (np.asarray(p[0][0], dtype=float) for p in (system.num, system.den))
    slope = np.polyval(np.polyder(numerator), 1) - np.polyval(np.polyder(denominator), 1)
    return float(-loop.period * slope / np.polyval(denominator, 1))


def oscillation_onset(loop: Loop) -> float:
    """The largest gain [1/s] without oscillation: where the two slowest real poles meet and leave the real axis.

    At a breakaway point of the root locus d(1/L)/dz = 0; with delay n alone, KT = nⁿ/(n+1)^(n+1).
    """
    numerator, denominator = loop.open_loop()
    breakaway = poly.polysub(
        poly.polymul(poly.polyder(denominator), numerator), poly.polymul(denominator, poly.polyder(numerator))
    )
    gains = [
        float(np.real(-poly.polyval(z.real, denominator) / poly.polyval(z.real, numerator)))
        for z in poly.polyroots(np.trim_zeros(breakaway, "b"))
        if abs(z.imag) < 1e-9 and 0 < z.real < 1
    ]
    positive = [gain for gain in gains if gain > 0]
    if positive:
        return min(positive)
    # one real pole alone: it turns negative, and alternates, where it passes z = 0
    return float(-poly.polyval(0.0, denominator) / poly.polyval(0.0, numerator))


def _transfer_function(numerator: Array, denominator: Array, period: float) -> control.TransferFunction:
    """A python-control system from coefficients in z, upward."""
    return control.TransferFunction(np.trim_zeros(numerator, "b")[::-1], denominator[::-1], period)
