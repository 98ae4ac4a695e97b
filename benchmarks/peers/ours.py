"""Our step from Python in the ways that a user has; each returns the next q, which the following step copies."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from peers.work import Robot

Array = NDArray[np.float64]
Step = Callable[..., Array]

KEYWORDS, IN_PLACE, EVALUATE = "ours, step(q=...)", "ours, in place, step()", "ours, in place, evaluate()"


def ways(robot: Robot) -> dict[str, Step]:
    """Name -> step: arrays by name, or written into the input buffers first, which are then taken as they are."""
    step = robot.controller.step
    if robot.name == "planar5":
        return {
            KEYWORDS: planar5(robot),
            IN_PLACE: planar5_in_place(robot, step),
            EVALUATE: planar5_in_place(robot, step.evaluate),
        }
    return {KEYWORDS: arm7(robot), IN_PLACE: arm7_in_place(robot, step), EVALUATE: arm7_in_place(robot, step.evaluate)}


def planar5(robot: Robot) -> Step:
    step = robot.controller.step

    def taken(q: Array, reference: Array, velocity: Array, centers: Array) -> Array:
        return step(q=q, tool_reference=reference, tool_reference_velocity=velocity, obstacle_center=centers)["q_next"]

    return taken


def planar5_in_place(robot: Robot, evaluate: Callable[[], object]) -> Step:
    names = ("q", "tool_reference", "tool_reference_velocity", "obstacle_center")
    q_in, reference_in, velocity_in, centers_in = (robot.controller.step.inputs[name] for name in names)
    q_next = robot.controller.step.outputs["q_next"]

    def taken(q: Array, reference: Array, velocity: Array, centers: Array) -> Array:
        q_in[...] = q
        reference_in[...] = reference
        velocity_in[...] = velocity
        centers_in[...] = centers
        evaluate()
        return q_next

    return taken


def arm7(robot: Robot) -> Step:
    step = robot.controller.step

    def taken(q: Array, reference: Array, velocity: Array, orientation: Array, turning: Array) -> Array:
        return step(
            q=q,
            hand_reference=reference,
            hand_reference_velocity=velocity,
            hand_orientation_reference=orientation,
            hand_orientation_reference_velocity=turning,
        )["q_next"]

    return taken


def arm7_in_place(robot: Robot, evaluate: Callable[[], object]) -> Step:
    names = (
        *("q", "hand_reference", "hand_reference_velocity"),
        *("hand_orientation_reference", "hand_orientation_reference_velocity"),
    )
    q_in, reference_in, velocity_in, orientation_in, turning_in = (robot.controller.step.inputs[name] for name in names)
    q_next = robot.controller.step.outputs["q_next"]

    def taken(q: Array, reference: Array, velocity: Array, orientation: Array, turning: Array) -> Array:
        q_in[...] = q
        reference_in[...] = reference
        velocity_in[...] = velocity
        orientation_in[...] = orientation
        turning_in[...] = turning
        evaluate()
        return q_next

    return taken
