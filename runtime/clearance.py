"""How far points are from the obstacles of a scenario, whatever a controller was told of them."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.manifest import FAR
from clikgen.runtime.scenario import Capsule, Scenario

Array = NDArray[np.float64]


def distances(points: Array, centers: Array, scenario: Scenario) -> Array:
    """The distance d of every point to its closest obstacle, with the formulas of the step, (N, p) [m].

    d = min over balls ‖r − o‖ − ρ, capsules ‖r − nearest point of the axis‖ − ρ and half-spaces nᵀr − offset:
    negative inside one, FAR without any. `points` r are (N, p, dimension) [m]; the balls have the radii of the
    scenario and the `centers` o, (N, balls, dimension) [m].
    """
    closest = np.full(points.shape[:2], FAR)
    with np.errstate(over="ignore", invalid="ignore"):  # joints may have diverged; a point that is nowhere is FAR
        for distance in _each(points, centers, scenario):
            closest = np.fmin(closest, distance)
    return closest


def _each(points: Array, centers: Array, scenario: Scenario) -> Iterator[Array]:
    """Of every obstacle its distance to every point, (N, p) [m]."""
    for i, ball in enumerate(scenario.obstacles):
        yield np.linalg.norm(points - centers[:, None, i], axis=2) - ball.radius
    for capsule in scenario.capsules:
        yield np.linalg.norm(points - _nearest_on_axis(capsule, points), axis=2) - capsule.radius
    for wall in scenario.half_spaces:
        yield points @ np.asarray(wall.normal) - wall.offset


def _nearest_on_axis(capsule: Capsule, points: Array) -> Array:
    """The point of the capsule's axis that is nearest to each point, (N, p, dimension) [m]."""
    start = np.asarray(capsule.start)
    along = np.asarray(capsule.end) - start
    share = (points - start) @ along / max(along @ along, np.finfo(float).tiny)  # 0 / tiny where start and end coincide
    nearest: Array = start + np.clip(share, 0, 1)[:, :, None] * along
    return nearest
