"""Many planar5 robots at once: every way to take STEPS steps of ROBOTS robots, each past obstacles of its own.

To add a way, write a function from a `Batch` to work that returns where the robots end, (ROBOTS, 5), and name it in
`WAYS`: it is checked and timed with the others.
"""

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.batch import simulate_batch
from peers.work import INFLUENCE, RADII, Robot

Array = NDArray[np.float64]
Work = Callable[[], Array]

ROBOTS = 4096
STEPS = 100
PERIOD, GAIN, DAMPING, TOOL_GAIN, TOOL_DAMPING = 0.01, 250.0, 1e-9, 4.0, 1e-3
BETA = (x := 2 * np.pi * PERIOD * 4.0) / (1 + x)


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """Where the robots start, (ROBOTS, 5), where their tools should go, (ROBOTS, 2), their obstacles (ROBOTS, 3, 2)."""

    robot: Robot
    steps: int
    q: Array
    reference: Array
    centers: Array

    @property
    def given(self) -> dict[str, Array]:
        """What is each robot's own, but q."""
        return {"tool_reference": self.reference, "obstacle_center": self.centers}

    @property
    def columns(self) -> list[Array]:
        """The same with the robots last: what is one robot's beside what is the next one's."""
        return [np.ascontiguousarray(np.moveaxis(one, 0, -1)) for one in (self.q, self.reference, self.centers)]


def batch_of(robot: Robot, steps: int = STEPS) -> Batch:
    """Drawn from the robot's states at random, the targets 0.5 m or less from the tools."""
    rng = np.random.default_rng(11)
    which = np.arange(ROBOTS) % len(robot.random.q)
    q = robot.random.q[which] + rng.uniform(-0.01, 0.01, (ROBOTS, 5))
    reference = robot.positions(q)[:, :2] + rng.uniform(-0.35, 0.35, (ROBOTS, 2))
    return Batch(robot, steps, q, reference, robot.random.given["obstacle_center"][which])


FIXED = {"obstacle_radius": RADII, "obstacle_count": float(len(RADII))}


def by_map(batch: Batch) -> Work:
    """controller.step.map, once a period: the C step of one robot after the other."""
    step = batch.robot.controller.step

    def work() -> Array:
        q = batch.q
        for _ in range(batch.steps):
            q = step.map(len(q), {"q": q, **batch.given, **FIXED})["q_next"]
        return q

    return work


def by_lanes(batch: Batch, threads: int | None) -> Work:
    """runtime/batch.py: the C step of many robots side by side; None takes a thread for each core."""
    each = {"q": batch.q, **batch.given}

    def work() -> Array:
        ends = simulate_batch(batch.robot.controller, batch.steps, ROBOTS, FIXED, each, ("final_q",), threads=threads)
        return ends["final_q"]

    return work


def by_numpy(batch: Batch) -> Work:
    """numpy, vectorised over the robots."""
    start, reference, centers = batch.columns

    def work() -> Array:
        q = start
        for _ in range(batch.steps):
            q = step(np, q, reference, centers)
        return q.T

    return work


def by_jax(batch: Batch) -> Work:
    """jit(vmap(...)) of the whole way of a robot."""
    import jax

    return jax_work(batch, jax.vmap(way(batch.steps), in_axes=-1, out_axes=-1))


def by_jax_on_arrays(batch: Batch) -> Work:
    """jit of the same on arrays of all robots, without vmap: the layout that it chooses is slower."""
    return jax_work(batch, way(batch.steps))


def way(steps: int) -> Callable[..., Any]:
    """So many steps in JAX."""
    import jax
    import jax.numpy as jnp

    def taken(q: Any, reference: Any, centers: Any) -> Any:
        return jax.lax.fori_loop(0, steps, lambda _, now: step(jnp, now, reference, centers), q)

    return taken


def jax_work(batch: Batch, function: Callable[..., Any]) -> Work:
    """Compiled beforehand, in double, on the cores that XLA takes."""
    import jax

    jax.config.update("jax_enable_x64", True)
    given = [jax.device_put(one) for one in batch.columns]
    compiled = jax.jit(function).lower(*given).compile()
    return lambda: np.asarray(compiled(*given)).T


def step(xp: ModuleType, q: Any, reference: Any, centers: Any) -> Any:
    """The law of planar5: q (5, ...), reference (2, ...), centers (3, 2, ...) -> the next q, robots in the last axes.

    Everything in closed form: forces x u on the points instead of their Jacobians, and the inverse of a 2x2 matrix.
    """
    x, y, yaw, shoulder, elbow = q
    upper, fore = yaw + shoulder, yaw + shoulder + elbow
    ax, ay, bx, by, cx, cy = xp.cos(yaw), xp.sin(yaw), xp.cos(upper), xp.sin(upper), xp.cos(fore), xp.sin(fore)
    sx, sy = x + 0.2 * ax, y + 0.2 * ay  # the shoulder
    ex, ey = sx + 0.5 * bx, sy + 0.5 * by  # the elbow
    tx, ty = ex + 0.4 * cx, ey + 0.4 * cy  # the tool
    left, right = 0.15 * (ax - ay), 0.15 * (ax + ay)
    px = xp.stack([x + left, x + right, sx + 0.25 * bx, ex, ex + 0.2 * cx, tx])
    py = xp.stack([y + right, y - left, sy + 0.25 * by, ey, ey + 0.2 * cy, ty])

    # tracking: J = [I, j1, j2, j3], j_i the lever arms turned by a right angle
    j1x, j1y, j2x, j2y, j3x, j3y = y - ty, tx - x, sy - ty, tx - sx, ey - ty, tx - ex
    g11 = 1 + TOOL_DAMPING**2 + j1x * j1x + j2x * j2x + j3x * j3x
    g22 = 1 + TOOL_DAMPING**2 + j1y * j1y + j2y * j2y + j3y * j3y
    g12 = j1x * j1y + j2x * j2y + j3x * j3y
    wx, wy = TOOL_GAIN * (reference[0] - tx), TOOL_GAIN * (reference[1] - ty)
    determinant = g11 * g22 - g12 * g12
    fx, fy = (g22 * wx - g12 * wy) / determinant, (g11 * wy - g12 * wx) / determinant
    dq = xp.stack([fx, fy, j1x * fx + j1y * fy, j2x * fx + j2y * fy, j3x * fx + j3y * fy])

    # avoidance: the force of every point's closest obstacle, and their torques about the joints
    best = seen(xp, centers[0], RADII[0], px, py)
    for center, radius in zip(centers[1:], RADII[1:], strict=True):
        best = nearer(xp, seen(xp, center, radius, px, py), best)
    distance, dx, dy, length = best
    depth = INFLUENCE.reshape(6, *[1] * (px.ndim - 1)) - distance
    inside = xp.maximum(depth, 0)
    fx, fy = inside / length * dx, inside / length * dy
    turn1 = (px - x) * fy - (py - y) * fx
    turn2 = (px[2:] - sx) * fy[2:] - (py[2:] - sy) * fx[2:]
    turn3 = (px[4:] - ex) * fy[4:] - (py[4:] - ey) * fx[4:]
    J_o = xp.stack([fx.sum(0), fy.sum(0), turn1.sum(0), turn2.sum(0), turn3.sum(0)])
    wanted = GAIN / 2 * (inside * inside).sum(0) + (J_o * dq).sum(0)
    dq = dq - J_o * (wanted / ((J_o * J_o).sum(0) + DAMPING**2))
    return q + xp.where(depth.max(0) >= 0, BETA * PERIOD, PERIOD) * dq


def seen(xp: ModuleType, center: Any, radius: float, px: Any, py: Any) -> tuple[Any, ...]:
    """An obstacle from the points: distance, vector and its length."""
    dx, dy = center[0] - px, center[1] - py
    length = xp.sqrt(dx * dx + dy * dy)
    return length - radius, dx, dy, length


def nearer(xp: ModuleType, one: tuple[Any, ...], other: tuple[Any, ...]) -> tuple[Any, ...]:
    """The nearer of two obstacles, point by point."""
    closer = one[0] < other[0]
    return tuple(xp.where(closer, mine, yours) for mine, yours in zip(one, other, strict=True))


WAYS: dict[str, Callable[[Batch], Work]] = {
    "ours, step.map": by_map,
    "ours, lanes, 1 thread": lambda batch: by_lanes(batch, 1),
    "ours, lanes, all cores": lambda batch: by_lanes(batch, None),
    "JAX, jit(vmap)": by_jax,
    "JAX, jit on arrays": by_jax_on_arrays,
    "numpy": by_numpy,
}
