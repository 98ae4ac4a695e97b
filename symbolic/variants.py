"""Variants of a controller: its spec with another activation of the one-sided tasks, or with another planner."""

from clikgen.runtime.documents import BadInput, choices
from clikgen.symbolic import activations, planners, tasks
from clikgen.symbolic.kinds import kinds_in
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.spec import ControllerSpec
from clikgen.symbolic.task import TaskSpec


def with_activation(spec: ControllerSpec, kind: str) -> ControllerSpec:
    """The spec with every one-sided task acting by the activation `kind`, everything else as it is.

    A task that acts so already keeps its table; the others take the kind's defaults. Raises BadInput for an unknown
    kind, or a spec without a one-sided task.
    """
    kinds = kinds_in(activations)
    if kind not in kinds:
        raise BadInput(f"no activation '{kind}'; {choices(kind, kinds)}")
    if not any(isinstance(task, OneSidedSpec) for task in spec.tasks):
        one_sided = [name for name, table in kinds_in(tasks).items() if issubclass(table, OneSidedSpec)]
        raise BadInput(
            f"{spec.name}: wanted a one-sided task ({', '.join(one_sided)}), "
            f"got {', '.join(sorted({task.kind for task in spec.tasks}))}"
        )

    def acting(task: TaskSpec) -> TaskSpec:
        if not isinstance(task, OneSidedSpec) or task.activation.kind == kind:
            return task
        return task.model_copy(update={"activation": kinds[kind](kind=kind)})

    return spec.model_copy(update={"tasks": tuple(acting(task) for task in spec.tasks)})


def with_planner(spec: ControllerSpec, kind: str) -> ControllerSpec:
    """The spec with a planner of this kind, its two λ and everything else as they are; raises BadInput.

    A planner that is of this kind already keeps its table; another takes the kind's defaults.
    """
    kinds = kinds_in(planners)
    if kind not in kinds:
        raise BadInput(f"no planner '{kind}'; {choices(kind, kinds)}")
    if spec.planner.kind == kind:
        return spec
    planner = kinds[kind](kind=kind, lam_free=spec.planner.lam_free, lam_event=spec.planner.lam_event)
    return spec.model_copy(update={"planner": planner})


def without_one_sided_tasks(spec: ControllerSpec) -> ControllerSpec:
    """The spec with its tasks that hold always alone: nothing to keep off. Raises BadInput where none is left."""
    always = tuple(task for task in spec.tasks if not isinstance(task, OneSidedSpec))
    if not always:
        raise BadInput(f"{spec.name}: wanted a task that holds always, got one-sided ones only")
    return spec.model_copy(update={"tasks": always})
