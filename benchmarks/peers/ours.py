"""Our step from Python, arrays by name; it returns the next q, which the following step takes."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledFunction
from peers.work import Robot

Array = NDArray[np.float64]
Step = Callable[..., Array]

IN_PYTHON, WITHOUT_HEADERS = "ours, step(q=...)", "ours, step(q=...), no Python.h"


def ways(robot: Robot) -> dict[str, tuple[CompiledFunction, Step]]:
    """Name -> the function that is called and the step: as it is, and as it is where Python's headers are missing."""
    step, taken = robot.controller.step, planar5 if robot.name == "planar5" else arm7
    functions = {IN_PYTHON: step, WITHOUT_HEADERS: CompiledFunction(step.info, step.code)}
    for name, array in step.inputs.items():
        functions[WITHOUT_HEADERS].inputs[name][...] = array
    return {name: (function, taken(function)) for name, function in functions.items()}


def planar5(step: CompiledFunction) -> Step:
    def taken(q: Array, reference: Array, velocity: Array, centers: Array) -> Array:
        return step(q=q, tool_reference=reference, tool_reference_velocity=velocity, obstacle_center=centers)["q_next"]

    return taken


def arm7(step: CompiledFunction) -> Step:
    def taken(q: Array, reference: Array, velocity: Array, orientation: Array, turning: Array) -> Array:
        return step(
            q=q,
            hand_reference=reference,
            hand_reference_velocity=velocity,
            hand_orientation_reference=orientation,
            hand_orientation_reference_velocity=turning,
        )["q_next"]

    return taken
