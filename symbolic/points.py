"""Where the points of interest are and how they move, in one loop a link: many points take no more code than few."""

from dataclasses import replace

import casadi as ca

from clikgen.symbolic.stage import Stage, Symbols, looped
from clikgen.symbolic.tree import KinematicTree


def by_link(tree: KinematicTree) -> dict[str, list[int]]:
    """The numbers of the points of interest on each link that has some."""
    links: dict[str, list[int]] = {}
    for i, point in enumerate(tree.robot.points_of_interest):
        links.setdefault(point.link, []).append(i)
    return links


def places(tree: KinematicTree, stages: list[Stage]) -> ca.SX:
    """f(q), eq. 1, of every point of interest, (dimension, points) [m], in loops that are added to the stages."""
    points, d = tree.robot.points_of_interest, tree.robot.dimension
    found = list[ca.SX]([ca.SX()] * len(points))

    def body(_: Symbols, columns: Symbols, shared: Symbols, __: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        return [], [shared[1] + shared[0] @ columns[0]]

    for link, here in by_link(tree).items():
        pose = tree.poses[link]
        axes = [k for k in range(3) if any(not pose.rotation[i, k].is_zero() for i in range(d))]
        offsets = ca.SX(ca.DM([[points[i].offset[k] for i in here] for k in axes]))
        _, (columns,) = looped("place", body, [], [offsets], [pose.rotation[:d, axes], pose.position[:d]], stages)
        for k, i in enumerate(here):
            found[i] = columns[:, k]
    return ca.horzcat(*found)


def position_jacobians(tree: KinematicTree, where: ca.SX, stages: list[Stage]) -> ca.SX:
    """J(q), eq. 2, of every point of interest, (points · dimension, n) [m per joint unit], row by row of the points.

    `where` they are, (dimension, points) [m], is known; the loops are added to the stages.
    """
    n, d = tree.q.numel(), tree.robot.dimension
    found = list[ca.SX]([ca.SX()] * where.shape[1])
    for link, here in by_link(tree).items():
        columns = _moving(tree, link, where[:, here], stages)
        for k, i in enumerate(here):
            found[i] = ca.reshape(columns[:, k], n, d).T
    return ca.vertcat(*found)


def _moving(tree: KinematicTree, link: str, where: ca.SX, stages: list[Stage]) -> ca.SX:
    """∂r/∂q [m per joint unit], row by row, (dimension · n, points), of points r of the link.

    They are the columns of `where` (dimension, points) [m]. The loop is given what is no constant of the axes that
    carry the link.
    """
    carriers = tree.carriers[link]
    entries = ca.densify(ca.veccat(*(part for axis in carriers for part in (axis.direction, axis.origin))))
    varying = [k for k in range(entries.numel()) if not entries[k].is_constant()]

    def body(_: Symbols, columns: Symbols, shared: Symbols, __: list[Stage]) -> tuple[list[ca.SX], list[ca.SX]]:
        there = ca.SX(entries)
        there[varying] = shared[0]
        parts = iter(ca.vertsplit(there, 3))
        axes = [replace(axis, direction=next(parts), origin=next(parts)) for axis in carriers]
        return [], [ca.vec(tree.jacobian_at(columns[0], axes).T)]

    _, (columns,) = looped("move", body, [], [where], [entries[varying]], stages)
    return columns
