"""What the studies of the tracking loop have in common: its damping where it is, and its limits set aside."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import FunctionInfo, Manifest, ReferenceInfo

Array = NDArray[np.float64]


def damping_at(parameters: Mapping[str, Array], task: str, J: Array) -> float:
    """λ of a task's pseudo-inverse where its Jacobian is J (m, n), in the unit of J.

    Constant, or selective: λ₀ (1 − s²/ε²) with s² = 1/trace((J Jᵀ)⁻¹) where s < ε, else 0.
    """
    greatest = float(parameters[f"{task}_damping"])
    if f"{task}_near_singularity" not in parameters:
        return greatest
    sigma = np.linalg.svd(J, compute_uv=False)
    s_squared = 1 / np.sum(sigma**-2.0) if sigma[-1] > 0 else 0.0
    return greatest * max(0.0, 1 - s_squared / float(parameters[f"{task}_near_singularity"]) ** 2)


def greatest_damping(parameters: Mapping[str, Array], task: str, sigma_min: float, rows: int) -> float:
    """A bound on λ where no singular value of J (rows, n) is below sigma_min: 0 where selective damping rests."""
    near = float(parameters.get(f"{task}_near_singularity", np.inf))
    return 0.0 if sigma_min >= near * np.sqrt(rows) else float(parameters[f"{task}_damping"])


def references_at(controller: CompiledController, q: Array) -> dict[str, Array]:
    """Every reference where the robot is at q (n,), so that no task wants to move; a target to look at stays 0."""
    seen = controller.kinematics(q=q)
    return {
        f"{reference.name}_reference": seen[f"{reference.name}_{kind}"].copy()
        for reference in controller.manifest.references
        for kind in ("position", "orientation", "value")
        if f"{reference.name}_{kind}" in seen and _fits(controller, reference, seen[f"{reference.name}_{kind}"])
    }


def _fits(controller: CompiledController, reference: ReferenceInfo, value: Array) -> bool:
    return controller.step.inputs[f"{reference.name}_reference"].shape == value.shape


def without_limits(step: FunctionInfo) -> dict[str, Array]:
    """Velocity limits, and limits on the feedback of tasks, as wide as the step takes them.

    What is studied is the loop itself: at a gain near its bound every limit is met, and hides what the loop does.
    """
    return {
        signal.name: np.full(signal.shape, signal.maximum)
        for signal in step.inputs
        if signal.role == "parameter" and (signal.name == "velocity_limit" or signal.name.endswith("_speed"))
    }


def without_boundaries(manifest: Manifest) -> dict[str, Array]:
    """Joint limits and walls as far away as the step takes them, margins as narrow, and rates of barriers as high.

    A barrier has no gain that could be zero: it acts in every configuration beyond its boundary, and before it.
    """
    names = {
        f"{task.name}_{key}": far
        for task in manifest.tasks
        if not task.equality
        for key, far in (("lower", -1), ("upper", 1), ("offset", -1), ("margin", -1), ("rate", 1))
    }
    return {
        signal.name: np.full(signal.shape, signal.maximum if names[signal.name] > 0 else signal.minimum)
        for signal in manifest.function("step").inputs
        if signal.name in names
    }


def alone(manifest: Manifest) -> dict[str, Array]:
    """The step with limits wide open, nothing to avoid, and the gain of every task but the tracking task at zero.

    What a lower task wants moves the arm in its null space, and the curvature of that would pass for an error.
    """
    step, tracking = manifest.function("step"), manifest.tracking_task().name
    others = {f"{task.name}_gain" for task in manifest.tasks if task.name != tracking}
    gains = {signal.name: np.zeros(signal.shape) for signal in step.inputs if signal.name in others}
    return without_limits(step) | without_boundaries(manifest) | gains
