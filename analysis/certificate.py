"""The nonlinear certificate of the loop: how far gain, filter and sampling time may go, and the error left.

The step is q⁺ = q + τ u with u = J^#(ṙ + K e) + P w, e = r − f(q), J^# = Jᵀ(J Jᵀ + λ²I)⁻¹, τ = βT where the
filter acts (the filtered position is the state) and τ = T without it. On a set that holds every segment [q, q⁺]
let σ ≤ σ_min(J), ‖D²f‖ ≤ L, |ṙ| ≤ v, |r̈| ≤ a, |P w| ≤ w. With s = σ²/(σ² + λ²) and g = sup σ_i/(σ_i² + λ²),
Taylor's remainder of f along the step and of r over the period give

|e⁺| ≤ c2|e|² + c1|e| + c0,   c2 = L τ² g² k_M²/2,   c1 = α + L τ² g² v k_M,
c0 = (1 − βs)T v + (L/2)τ²(g²v² + w²) + T²a/2,   α = sup ‖I − τ J J^# K‖.

If c1 < 1 and (1−c1)² > 4 c0 c2, with the two fixed points e∓ every ball of a radius in [e−, e+] is invariant, and
|e| < e+ once implies limsup |e| ≤ e−. The term T²a/2 is that of the feedforward: the step takes ṙ(t_k) for the
mean of ṙ over the period, and (r(t_k+T) − r(t_k))/T in its place would make it zero.

Sliding joints do not curve f. Where they alone span the task, J = [J_p A] with J_p constant, only the others count
in g: ‖Aᵀ(J Jᵀ + λ²I)⁻¹‖ ≤ 1/(2√(σ_p² + λ²)), since x/(1 + x²) ≤ 1/2. That is half of 1/σ, so that c2 is four times
smaller and, where a = 0, the loop may be sampled four times slower.

Everything is computed from compiled functions.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc

from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.tracking import damping_at, greatest_damping
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.manifest import Manifest
from clikgen.runtime.simulation import Rollout, Run

Array = NDArray[np.float64]

SAMPLES = 2048  # of a set of configurations; a power of two, as Sobol's sequence wants
STARTS = 4  # of local searches, from the worst samples
DIFFERENCE = 1e-4  # [joint unit] step of central differences: h²/6 and rounding/h are both below 1e-8
SINGULAR = 1e-4  # of σ_max: a smaller σ_min is taken for a singularity
CONSTANT = 1e-9  # [m, rad, 1/s of these] what rounding may make of nothing, or of a difference of equals
FOREVER = 1e6  # [s], or [1/s]: a limit beyond this is none


# ---- What the theorem asks of a task: σ and L ----


@dataclass(frozen=True, slots=True)
class Bounds:
    """Bounds of a tracking task over a set of configurations, described by `where`.

    An exact bound is a closed form and holds without doubt; one that is not exact is an estimate, the worst of
    many samples and of local searches from there.
    """

    task: str
    sigma_min: float
    """σ, at most the least singular value of J [m per joint unit]."""
    sigma_max: float
    """At least the largest singular value of J [m per joint unit]."""
    hessian: float
    """L, at least ‖D²f‖ = sup over |w| = 1 of ‖Σ w_i ∂²f_i/∂q²‖₂ [m per joint unit²]."""
    sigma_exact: bool
    hessian_exact: bool
    sliding: bool
    """Whether σ is that of sliding joints, which do not curve f: J^# then counts half (see above) where w = 0."""
    where: str

    @property
    def exact(self) -> bool:
        """Whether both bounds are closed forms: the certificate is then a proof."""
        return self.sigma_exact and self.hessian_exact


@dataclass(frozen=True, slots=True, eq=False)
class PlanarChain:
    """f(q) = p(q) + Σ_i l_i u(θ_i + φ_i), θ_i = b_iᵀq: sliding joints, then revolute ones, in the plane.

    `sliding` (m, n) is the constant part of J; `lengths` l_i (k,) [m]; `angles` b_i (k, n), entries 0 and ±1.
    """

    sliding: Array
    lengths: Array
    angles: Array

    @property
    def hessian(self) -> float:
        """L = λ_max(Σ l_i b_i b_iᵀ): attained where all segments point the same way."""
        return float(np.linalg.eigvalsh((self.angles.T * self.lengths) @ self.angles)[-1])

    @property
    def sigma_min(self) -> float:
        """σ_min of the sliding joints alone, which σ_min(J) never falls below: J Jᵀ = J_p J_pᵀ + A Aᵀ."""
        return float(_singular_values(self.sliding)[-1])

    @property
    def sigma_max(self) -> float:
        """√(‖J_p‖² + |Σ l_i |b_i||²), at least σ_max(J)."""
        reach = self.lengths @ np.abs(self.angles)
        return float(np.hypot(np.linalg.norm(self.sliding, 2), np.linalg.norm(reach)))


def jacobians(controller: CompiledController, q: Array) -> Array:
    """J of the tracking task at q (N, n), shape (N, m, n)."""
    J = controller.jacobians.map(len(q), {"q": q})[f"{controller.manifest.tracking_task().name}_jacobian"]
    return J.reshape(len(q), -1, q.shape[1])  # a task of one row has a vector


def singular_values(controller: CompiledController, q: Array) -> Array:
    """Singular values of J at q (N, n), the largest first, shape (N, m)."""
    return _singular_values(jacobians(controller, q))


def _singular_values(J: Array) -> Array:
    """All m singular values of J (..., m, n), those that too few joints leave at zero included, (..., m)."""
    values = np.linalg.svd(J, compute_uv=False)
    missing = J.shape[-2] - values.shape[-1]
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, missing)])


def hessians(controller: CompiledController, q: Array) -> Array:
    """∂²f_i/∂q_j∂q_k at q (N, n) by central differences of the compiled Jacobian, shape (N, m, n, n)."""
    offsets = DIFFERENCE * np.eye(q.shape[1])
    ahead, behind = (jacobians(controller, (q[:, None] + side * offsets).reshape(-1, q.shape[1])) for side in (1, -1))
    slope = ((ahead - behind) / (2 * DIFFERENCE)).reshape(*q.shape, *ahead.shape[1:])  # (N, k, m, j)
    second = slope.transpose(0, 2, 3, 1)
    return np.asarray((second + second.swapaxes(2, 3)) / 2)


def hessian_norms(controller: CompiledController, q: Array) -> Array:
    """‖D²f‖ at q (N, n), shape (N,): the largest |D²f[x, x]| over unit x.

    From the best of some directions w, alternately x the eigenvector of Σ w_i H_i and w along D²f[x, x].
    """
    H = hessians(controller, q)
    directions = _directions(H.shape[1])
    norms = np.abs(np.linalg.eigvalsh(np.einsum("wm,cmjk->cwjk", directions, H))).max(axis=2)
    w = directions[np.argmax(norms, axis=1)]
    value = norms.max(axis=1)
    for _ in range(10):
        values, vectors = np.linalg.eigh(np.einsum("cm,cmjk->cjk", w, H))
        which = np.abs(values).argmax(axis=1)
        x = np.take_along_axis(vectors, which[:, None, None], axis=2)[:, :, 0]
        along = np.einsum("cmjk,cj,ck->cm", H, x, x)
        value = np.linalg.norm(along, axis=1)
        w = along / np.maximum(value, np.finfo(float).tiny)[:, None]
    return np.asarray(value)


def _directions(m: int) -> Array:
    """Unit vectors of R^m, (8 m, m), the axes among them."""
    some = np.random.default_rng(0).standard_normal((7 * m, m))
    return np.concatenate([np.eye(m), some / np.linalg.norm(some, axis=1, keepdims=True)])


def planar_chain(controller: CompiledController) -> PlanarChain | None:
    """The closed form of f, read from the compiled kinematics; None where the robot is not such a chain.

    Checked at random configurations: columns of sliding joints, segments seen from their links, and angles.
    """
    manifest = controller.manifest
    revolute = np.array([joint.unit == "rad" for joint in manifest.joints])
    if manifest.dimension != 2 or np.any(np.diff(revolute.astype(int)) < 0):
        return None
    n, first = len(revolute), int(np.count_nonzero(~revolute))
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (32, n))
    q[:2] = np.zeros(n), np.full(n, 0.1)
    J = jacobians(controller, q)
    acting = np.flatnonzero(np.abs(J).max(axis=(0, 1)) > CONSTANT)
    turning = slice(first, max(first, 1 + max(acting, default=-1)))
    where = controller.kinematics.map(len(q), {"q": q})
    pose = where["link_pose"][:, list(manifest.joint_links)]
    tip = where[f"{manifest.tracking_task().name}_position"]
    corners = np.concatenate([pose[:, turning, :2, 3], tip[:, None]], axis=1)
    rotation = pose[:, turning, :2, :2]
    segments = np.einsum("ckij,cki->ckj", rotation, np.diff(corners, axis=1))  # seen from their links
    angles = _cumulative(rotation, n, first)
    if not (_constant(J[:, :, :first]) and _constant(segments) and _turned_by(rotation, q @ angles.T)):
        return None
    sliding = np.where(revolute, 0.0, J[0])
    return PlanarChain(sliding, np.linalg.norm(segments[0], axis=1), angles)


def _cumulative(rotation: Array, n: int, first: int) -> Array:
    """b_i of every link (k, n) from its rotation at q = 0 and at q = 0.1 everywhere: each joint adds ±1."""
    heading = np.arctan2(rotation[:2, :, 1, 0], rotation[:2, :, 0, 0])
    turned = np.angle(np.exp(1j * np.diff(heading, axis=0)[0])) / 0.1
    signs = np.round(np.diff(turned, prepend=0.0))
    angles = np.zeros((len(signs), n))
    angles[:, first : first + len(signs)] = np.tril(np.broadcast_to(signs, (len(signs), len(signs))))
    return angles


def _constant(values: Array) -> bool:
    """Whether values (N, ...) are the same N times."""
    return bool(np.all(np.ptp(values, axis=0) < CONSTANT))


def _turned_by(rotation: Array, angle: Array) -> bool:
    """Whether links (N, k, 2, 2) stand at their headings at q = 0, the first, plus these angles (N, k) [rad]."""
    heading = np.arctan2(rotation[:, :, 1, 0], rotation[:, :, 0, 0])
    return bool(np.all(np.abs(np.exp(1j * (heading - heading[0] - angle)) - 1) < CONSTANT))


INNER = 0.8  # of the joint ranges: what is regular there does not touch a task that keeps the limits


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """A set of configurations: boxes of half the width `half` (n,) around `centers` (K, n)."""

    centers: Array
    half: Array

    def samples(self, count: int) -> tuple[Array, Array]:
        """Sobol's points of the set, (count, n), and the centre of the box that each is in, (count, n)."""
        points = qmc.Sobol(len(self.half) + 1, rng=np.random.default_rng(0)).random(count)
        centers = self.centers[(points[:, 0] * len(self.centers)).astype(int)]
        return centers + (2 * points[:, 1:] - 1) * self.half, centers

    def largest(self, function: Callable[[Array], Array]) -> tuple[float, Array]:
        """The largest value that is found of a function of q (N, n), shape (N,), and where it is, (n,)."""
        samples, around = self.samples(SAMPLES)
        thinned = self.centers[:: 1 + len(self.centers) // SAMPLES]
        straight = np.clip(0.0, thinned - self.half, thinned + self.half)
        q, centers = np.concatenate([straight, samples]), np.concatenate([thinned, around])
        values = function(q)
        # the straight arm is where σ and L of most are worst, and of many joints no sample is near to it
        worst = np.append(np.argmax(values[: len(straight)]), np.argsort(values)[-STARTS:])
        best, place = float(values[worst[-1]]), np.asarray(q[worst[-1]])

        def negative(x: Array) -> float:
            return -float(function(x[None])[0])

        for i in worst:
            limits = list(zip(centers[i] - self.half, centers[i] + self.half, strict=True))
            start: Array = q[i]
            found = minimize(negative, start, method="L-BFGS-B", bounds=limits)
            if -found.fun > best:
                best, place = -float(found.fun), np.asarray(found.x)
        return best, place


def _joint_limits(manifest: Manifest) -> _Boxes:
    limits = np.where(np.isinf(manifest.limits), [-np.pi, np.pi], manifest.limits)  # a continuous joint: one turn
    return _Boxes(limits.mean(axis=1)[None], np.diff(limits, axis=1)[:, 0] / 2)


def regular_configuration(controller: CompiledController) -> Array:
    """A configuration far from singular ones, (n,): the largest σ_min of many in the inner part of the joint limits."""
    limits = _joint_limits(controller.manifest)
    q, _ = replace(limits, half=INNER * limits.half).samples(SAMPLES)
    return np.asarray(q[np.argmax(singular_values(controller, q)[:, -1])])


def bounds_within_limits(controller: CompiledController) -> Bounds:
    """Bounds over all configurations within the joint limits.

    Closed forms where they exist; then they hold beyond the limits too. Raises BadInput where J is singular.
    """
    return _bounds(controller, _joint_limits(controller.manifest), "within the joint limits")


def bounds_along(controller: CompiledController, rollout: Rollout, margin: float = 0.05) -> Bounds:
    """Bounds over what lies within `margin` [m, rad] of a rollout in every joint.

    The set holds the rollout's own segments, as half of the largest step is added to the margin. They speak of any
    other motion as long as that stays within the set. Raises BadInput where J is singular there.
    """
    if not (np.isfinite(margin) and margin >= 0):
        raise BadInput(f"margin: wanted 0 or more [m, rad], got {margin:g}")
    if not np.all(np.isfinite(rollout.q)):
        raise BadInput(f"{rollout.scenario.name}: the rollout diverged, there are no bounds along it")
    step = np.abs(np.diff(rollout.q, axis=0)).max(axis=0)
    return _bounds(controller, _Boxes(rollout.q, margin + step / 2), f"within {margin:g} m, rad of the rollout")


def _bounds(controller: CompiledController, boxes: _Boxes, where: str) -> Bounds:
    """Closed forms where there are, else the worst that is found in the set; raises BadInput at a singularity."""
    chain = planar_chain(controller)
    slides = chain is not None and chain.sigma_min > CONSTANT
    if chain is not None and slides:
        sigma_min, place = chain.sigma_min, boxes.centers[0]
    else:
        least, place = boxes.largest(lambda q: -(singular_values(controller, q)[:, -1] ** 2))
        sigma_min = float(np.sqrt(max(0.0, -least)))
    sigma_max = chain.sigma_max if chain else boxes.largest(lambda q: singular_values(controller, q)[:, 0])[0]
    name = controller.manifest.controller
    task = controller.manifest.position_task().name
    if sigma_min < SINGULAR * sigma_max:
        raise BadInput(
            f"{name}: the Jacobian of task '{task}' is singular {where}: σ = {sigma_min:.2g} at "
            f"q = [{', '.join(f'{value:.4g}' for value in place)}]; narrow the limits, or stay along a rollout"
        )
    hessian = chain.hessian if chain else boxes.largest(lambda q: hessian_norms(controller, q))[0]
    everywhere = "everywhere" if slides else where
    return Bounds(task, sigma_min, sigma_max, hessian, slides, chain is not None, slides, everywhere)


# ---- The theorem ----


@dataclass(frozen=True, slots=True)
class Motion:
    """What is asked of the task, and what else moves the joints."""

    speed: float
    """v ≥ |ṙ| [m/s]."""
    acceleration: float
    """a ≥ |r̈| [m/s²]."""
    null_velocity: float = 0.0
    """w, the largest joint velocity that lower tasks put into the null space of J [joint units/s]."""
    leak: float = 0.0
    """The largest task velocity that lower tasks cause, as the damped projector is not exact [m/s]."""

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (np.isfinite(value) and value >= 0):
                raise BadInput(f"{name}: wanted 0 or more, got {value:g}")


@dataclass(frozen=True, slots=True)
class Tuning:
    """What one tunes."""

    gains: tuple[float, ...]
    """k_i, the eigenvalues of K [1/s]."""
    period: float
    """T [s]."""
    damping: float = 0.0
    """λ of the pseudo-inverse, in the unit of J."""
    cutoff: float | None = None
    """f_c of the filter, all joints [Hz]; None: no filter."""
    share: float = 1.0
    """The share of the filter (λ of eq. 17), 0 to 1."""

    def __post_init__(self) -> None:
        for name, value in {"period": self.period, "cutoff": self.cutoff}.items():
            if value is not None and not (np.isfinite(value) and value > 0):
                raise BadInput(f"{name}: wanted more than 0, got {value:g}")
        if not self.gains or not all(np.isfinite(gain) and gain > 0 for gain in self.gains):
            raise BadInput(f"gains: wanted one number above 0 or more, got {self.gains}")
        if not (np.isfinite(self.damping) and self.damping >= 0):
            raise BadInput(f"damping: wanted 0 or more, got {self.damping:g}")
        if not 0 <= self.share <= 1:
            raise BadInput(f"share: wanted 0 to 1, got {self.share:g}")

    @property
    def beta(self) -> float:
        """β of the whole step, 1 − share(1 − β) with β of eq. 15; 1 without a filter."""
        if self.cutoff is None:
            return 1.0
        return 1.0 - self.share * (1.0 - beta_of(self.cutoff, self.period))

    def scaled(self, factor: float) -> "Tuning":
        """The same with all gains times `factor`."""
        return replace(self, gains=tuple(factor * gain for gain in self.gains))


@dataclass(frozen=True, slots=True)
class Recursion:
    """|e⁺| ≤ c2|e|² + (1 − rate)|e| + c0, with e in m: `c2` [1/m], `rate` [1] and `c0` [m]."""

    c2: float
    rate: float
    c0: float

    @property
    def discriminant(self) -> float:
        """Δ = rate² − 4 c0 c2; with rate > 0 and Δ > 0 the recursion has two fixed points."""
        return self.rate**2 - 4 * self.c0 * self.c2

    @property
    def contracts(self) -> bool:
        """Whether there is a ball that the error ends in."""
        return self.rate > 0 and self.discriminant > 0

    @property
    def fixed_points(self) -> tuple[float, float]:
        """e− and e+ [m], where it contracts; e+ is infinite for a linear task."""
        both = self.rate + float(np.sqrt(self.discriminant))
        return 2 * self.c0 / both, both / (2 * self.c2) if self.c2 > 0 else np.inf


def recursion(bounds: Bounds, motion: Motion, tuning: Tuning) -> Recursion:
    """c2, 1 − c1 and c0 of the theorem.

    Equal gains: 1 − α = min(τk s_min, 2 − τk s_max). Unequal ones do not commute with J J^#, so
    1 − α = min(τk_m, 2 − τk_M) − τk_M(1 − s_min). A leak ℓ of lower tasks into this one adds τℓ to c0, and ℓ/s_min
    to the speed that the joints have to make.
    """
    T, tau = tuning.period, tuning.beta * tuning.period
    s_min, s_max = (sigma**2 / (sigma**2 + tuning.damping**2) for sigma in (bounds.sigma_min, bounds.sigma_max))
    k_m, k_M = min(tuning.gains), max(tuning.gains)
    if k_m == k_M:
        kept = min(tau * k_M * s_min, 2 - tau * k_M * s_max)
    else:
        kept = min(tau * k_m, 2 - tau * k_M) - tau * k_M * (1 - s_min)
    curved = bounds.hessian * tau**2 / 2
    bent = curved * _largest_inverse(bounds, motion, tuning.damping) ** 2
    speed = motion.speed + motion.leak / s_min
    missed = T * motion.speed * (1 - tuning.beta * s_min) + tau * motion.leak + T**2 * motion.acceleration / 2
    return Recursion(
        c2=bent * k_M**2,
        rate=kept - 2 * bent * speed * k_M,
        c0=missed + bent * speed**2 + curved * motion.null_velocity**2,
    )


def _largest_inverse(bounds: Bounds, motion: Motion, damping: float) -> float:
    """g = ‖J^#‖, the largest σ/(σ² + λ²) for σ from σ_min to σ_max, or the part of it that curves f.

    That part is not orthogonal to what lower tasks add, so it serves only where they add nothing.
    """
    sigma = float(np.clip(damping, bounds.sigma_min, bounds.sigma_max))
    whole = sigma / (sigma**2 + damping**2)
    if not bounds.sliding or motion.null_velocity > 0:
        return whole
    return min(whole, 0.5 / float(np.hypot(bounds.sigma_min, damping)))


@dataclass(frozen=True, slots=True)
class Certificate:
    """What is certified of a loop, as long as no task above the tracking task acts."""

    bounds: Bounds
    motion: Motion
    tuning: Tuning
    beta: float
    """β of the step (the filtered position is the state); 1 without filter."""
    c2: float
    """|e⁺| ≤ c2|e|² + c1|e| + c0: c2 [1/m]."""
    c1: float
    """c1 [1]."""
    c0: float
    """c0 [m]."""
    exists: bool
    """Whether there is a ball: c1 < 1 and (1 − c1)² > 4 c0 c2."""
    e_minus: float | None
    """e−, the ball that the error ends in [m]; None where there is none."""
    e_plus: float | None
    """e+, the error below which it does so [m]; infinite for a linear task, None where there is no ball."""
    largest_period: float
    """T below which this gain is certified, f_c and λ as they are [s]; 0: none."""
    largest_gain: float
    """The largest of the k_i below which this T is certified, their ratios as they are [1/s]; 0: none."""
    period_limit: float
    """T from which no gain, in these ratios, is certified [s]: 1/(2Lg²v) for equal gains and a = w = λ = 0."""

    def bound(self, error: Array) -> Array:
        """The bound on |e⁺| [m] for |e| [m]."""
        return self.c2 * error**2 + self.c1 * error + self.c0

    def as_dict(self) -> dict[str, Any]:
        """Name -> value, nested as the fields are; what is infinite is None."""
        document = asdict(self)
        for name in ("e_plus", "period_limit"):
            document[name] = None if document[name] == np.inf else document[name]
        return document


def certificate(bounds: Bounds, motion: Motion, tuning: Tuning) -> Certificate:
    """The theorem for these bounds, this motion and this tuning."""
    here = recursion(bounds, motion, tuning)
    e_minus, e_plus = here.fixed_points if here.contracts else (None, None)
    return Certificate(
        bounds=bounds,
        motion=motion,
        tuning=tuning,
        beta=tuning.beta,
        c2=here.c2,
        c1=1 - here.rate,
        c0=here.c0,
        exists=here.contracts,
        e_minus=e_minus,
        e_plus=e_plus,
        largest_period=largest_period(bounds, motion, tuning),
        largest_gain=largest_gain(bounds, motion, tuning),
        period_limit=period_limit(bounds, motion, tuning),
    )


def largest_period(bounds: Bounds, motion: Motion, tuning: Tuning) -> float:
    """T [s] below which the loop is certified, gain, f_c and λ as they are; 0 where no T is."""
    return _edge(lambda T: recursion(bounds, motion, replace(tuning, period=T)).contracts, tuning.period)


def largest_gain(bounds: Bounds, motion: Motion, tuning: Tuning) -> float:
    """The largest k_i [1/s] below which the loop is certified, T and the ratios of the k_i as they are, or 0."""
    top = max(tuning.gains)
    return _edge(lambda k: recursion(bounds, motion, tuning.scaled(k / top)).contracts, top)


def period_limit(bounds: Bounds, motion: Motion, tuning: Tuning) -> float:
    """T [s] from which no gain is certified: the largest certified T as the gain goes to 0.

    Equal gains: s² = 2LTg²v + (βLTgw)² + LT²g²a. With g = 1/σ, s = 1: σ²/(2Lv) where a = w = 0. The filter does
    not move it, nor does damping λ ≤ σ with the whole g, as s/g = σ. With a = 0, k_m < k_M shortens it by k_m/k_M.
    """

    def some_gain(T: float) -> bool:
        there = replace(tuning, period=T)
        return recursion(bounds, motion, there.scaled(1e-6 / (T * there.beta * max(there.gains)))).contracts

    return _edge(some_gain, tuning.period)


def set_point_gain(bounds: Bounds, tuning: Tuning, error: float) -> float:
    """The largest k_i [1/s] with which an error of this size [m] at a set point decreases to nothing.

    Equal gains, λ = 0, h = Lg²|e0|/2: τk < 1/h if h ≥ 1, else τk < 4/(1 + √(1 + 8h)), which goes to 2.
    """
    top = max(tuning.gains)
    return _edge(lambda k: _decreases(bounds, tuning.scaled(k / top), error), top)


def set_point_period(bounds: Bounds, tuning: Tuning, error: float) -> float:
    """The largest T [s] with which an error of this size [m] at a set point decreases to nothing."""
    return _edge(lambda T: _decreases(bounds, replace(tuning, period=T), error), tuning.period)


def _decreases(bounds: Bounds, tuning: Tuning, error: float) -> bool:
    at_rest = recursion(bounds, Motion(0.0, 0.0), tuning)
    return at_rest.rate > at_rest.c2 * error


def _edge(holds: Callable[[float], bool], start: float) -> float:
    """The x > 0 up to which something holds, by doubling, halving and bisection; 0 or infinity without an edge."""
    high = start
    while holds(high):
        high *= 2
        if high > FOREVER:
            return float(np.inf)
    low = high / 2
    while not holds(low):
        low /= 2
        if low < 1 / FOREVER**2:
            return 0.0
    high = 2 * low
    for _ in range(52):
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


# ---- The certificate of a run ----


def tuning_of(manifest: Manifest, parameters: Mapping[str, Array], bounds: Bounds) -> Tuning:
    """The tuning that the step's parameters make while nothing is active (λ of eq. 17 is lam_free).

    Selective damping counts as none where the bounds keep it at rest, else at its greatest.

    Raises BadInput where the joints have different cut-offs: J A_β J⁺ is then no multiple of I.
    """
    tracking = manifest.position_task()
    task = tracking.name
    cutoff: float | None = None
    share = float(parameters["lam_free"]) if "lam_free" in parameters else 1.0
    if "filter_cutoff" in parameters and share > 0:
        cutoffs = np.unique(parameters["filter_cutoff"])
        if cutoffs.size > 1:
            raise BadInput(f"filter_cutoff: the certificate wants one f_c for all joints, got {cutoffs.tolist()}")
        cutoff = float(cutoffs[0])
    gains = np.linalg.eigvalsh(np.atleast_2d(parameters[f"{task}_gain"]))
    if np.ptp(gains) < 1e-12 * gains[-1]:  # what rounding makes of equal eigenvalues
        gains = gains[-1:]
    return Tuning(
        gains=tuple(gains.tolist()),
        period=float(parameters["period"]),
        damping=greatest_damping(parameters, task, bounds.sigma_min, tracking.dimension),
        cutoff=cutoff,
        share=share,
    )


def motion_of(controller: CompiledController, rollout: Rollout) -> Motion:
    """The reference's v and a as they were sampled, and what lower tasks did while nothing was active."""
    task = rollout.manifest.position_task().name
    position, velocity = rollout.scenario.references[task].sample(rollout.t)
    null_velocity, leak = _lower_tasks(controller, rollout, task, velocity)
    reference = reference_motion(position, velocity, rollout.period)
    return replace(reference, null_velocity=null_velocity, leak=leak)


def reference_motion(position: Array, velocity: Array, period: float) -> Motion:
    """v and a of a reference sampled every T [s]: position (N, m) [m], velocity (N, m) [m/s].

    a is the larger of 2|r_{k+1} − r_k − Tṙ_k|/T², what the theorem needs, and |ṙ_{k+1} − ṙ_k|/T. A reference whose
    velocity jumps by Δ has a = 2Δ/T: the certificate then holds at this T, its limits on T do not.
    """
    missed = np.linalg.norm(np.diff(position, axis=0) - period * velocity[:-1], axis=1).max(initial=0.0)
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1).max(initial=0.0)
    return Motion(
        speed=float(np.linalg.norm(velocity, axis=1).max()),
        acceleration=float(max(2 * missed / period**2, change / period)),
    )


def _lower_tasks(controller: CompiledController, rollout: Rollout, task: str, velocity: Array) -> tuple[float, float]:
    """The largest joint velocity in the null space of J, and J times the largest in its rows, of lower tasks."""
    free = ~rollout.active
    if rollout.manifest.tasks[-1].name == task or not free.any():
        return 0.0, 0.0
    J = jacobians(controller, rollout.q[:-1][free])
    wanted = velocity[free] + rollout.signals[f"{task}_error"][free] @ rollout.parameters[f"{task}_gain"].T
    damping = np.array([damping_at(rollout.parameters, task, one) for one in J])
    damped = J @ J.swapaxes(1, 2) + damping[:, None, None] ** 2 * np.eye(J.shape[1])
    own = np.einsum("cmn,cm->cn", J, np.linalg.solve(damped, wanted[:, :, None])[:, :, 0])
    added = rollout.signals["dq_law"][free] - own
    in_task = np.einsum("cmn,cn->cm", J, added)
    in_null = added - np.einsum("cnm,cm->cn", np.linalg.pinv(J), in_task)
    null_velocity, leak = (float(np.linalg.norm(part, axis=1).max()) for part in (in_null, in_task))
    return (null_velocity if null_velocity > CONSTANT else 0.0), (leak if leak > CONSTANT else 0.0)


Over = Literal["limits", "rollout"]


def certify(
    controller: CompiledController, run: Run | Rollout, over: Over = "limits", margin: float = 0.05
) -> Certificate:
    """The certificate of a run's tracking task, with its tuning and its reference.

    `over` all configurations within the joint limits, or those within `margin` [m, rad] of the rollout. It speaks
    of the time when no task above the tracking task acts. Raises BadInput where J is singular.
    """
    rollout = run.in_c() if isinstance(run, Run) else run
    bounds = bounds_within_limits(controller) if over == "limits" else bounds_along(controller, rollout, margin)
    return certificate(bounds, motion_of(controller, rollout), tuning_of(rollout.manifest, rollout.parameters, bounds))
