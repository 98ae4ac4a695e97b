"""A controller spec as CasADi functions: kinematics, Jacobians and the step of the fixed-rate loop."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise

import casadi as ca

from clikgen.runtime.documents import BadInput
from clikgen.symbolic import laws
from clikgen.symbolic.activation import Correction, Guard
from clikgen.symbolic.barrier import Barrier
from clikgen.symbolic.obstacles import Obstacles, Sensing
from clikgen.symbolic.planner import Motion
from clikgen.symbolic.points import places, position_jacobians
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.spec import ControllerSpec
from clikgen.symbolic.stack import stack_notes
from clikgen.symbolic.stage import Procedure, Stage
from clikgen.symbolic.task import Level, Task, TaskSpec
from clikgen.symbolic.tree import KinematicTree

_ACTS_ABOVE: tuple[type[Level], ...] = (Guard, Correction, Task)


@dataclass(frozen=True, slots=True, eq=False)
class ControllerFunction:
    """A function to generate: every argument is a dense column, row by row of the signal's shape."""

    name: str
    description: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    procedure: Procedure

    @property
    def casadi(self) -> ca.Function:
        """The same as CasADi's function."""
        labels = [signal.info.name for signal in self.inputs], [signal.info.name for signal in self.outputs]
        return self.procedure.straightened().casadi(labels)


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """A spec and the functions it stands for: kinematics, jacobians, step."""

    spec: ControllerSpec
    functions: tuple[ControllerFunction, ...]
    tasks: tuple[Level, ...]
    notes: tuple[str, ...]  # what the spec's writer should know, a line each

    def function(self, name: str) -> ca.Function:
        """The CasADi function called `name`."""
        return {function.name: function.casadi for function in self.functions}[name]


def build(spec: ControllerSpec) -> Controller:
    """All functions of a controller; raises BadInput when a task asks for what the robot does not have."""
    coordinates = spec.robot.coordinates
    q = symbol(
        "q",
        (len(coordinates),),
        ", ".join(joint.unit for joint in coordinates),
        "joint position: " + ", ".join(joint.name for joint in coordinates),
        "state",
        (-1e6, 1e6),
    )
    tree = KinematicTree.at(spec.robot, q.expression)
    sensing = (
        Sensing.of(tree, Obstacles.up_to(spec.obstacles, spec.robot.dimension))
        if spec.robot.points_of_interest and spec.obstacles.any
        else None
    )
    tasks = [_built(task, tree, sensing) for task in spec.tasks]
    _check_order(tasks)
    command = _velocity(spec, tree, tasks)
    inputs, outputs = _step(spec, tree, q, sensing, tasks, command)
    stages = [*(sensing.stages if sensing else ()), *command.stages]
    where, how = list[Stage](), list(stages)
    positions, jacobians = _positions(tree, tasks, where), _jacobians(tree, sensing, tasks, how)
    return Controller(
        spec,
        (
            _function(spec, "kinematics", "where everything is at q", inputs, positions, where),
            _function(spec, "jacobians", "how everything moves with q̇ at q", inputs, jacobians, how),
            _function(spec, "step", "one period of the loop (eqs. 4-19)", inputs, outputs, stages),
        ),
        tuple(tasks),
        _notes(spec, tree, tasks),
    )


def _built(spec: TaskSpec, tree: KinematicTree, sensing: Sensing | None) -> Level:
    try:
        task = spec.build(tree, sensing)
    except BadInput as error:
        raise BadInput(f"task '{spec.name}': {error}") from None
    if spec.speed and not isinstance(task, Task):
        raise BadInput(
            f"task '{spec.name}': wanted no speed, its activation has no feedback to limit; got {spec.speed:g}"
        )
    return task.limited(spec.speed) if spec.speed and isinstance(task, Task) else task


def _check_order(tasks: Sequence[Level]) -> None:
    """Raises BadInput where a barrier does not stand above corrections, or one of these above the law's tasks.

    In this order they act on the velocity, whatever their priorities.
    """
    for above, below in pairwise(tasks):
        if _ACTS_ABOVE.index(type(above)) > _ACTS_ABOVE.index(type(below)):
            raise BadInput(
                f"task '{below.name}': wanted it above task '{above.name}': first barriers, then hysteresis, ramp and "
                "damped, then all others"
            )


def _notes(spec: ControllerSpec, tree: KinematicTree, tasks: Sequence[Level]) -> tuple[str, ...]:
    if spec.law != "augmented":
        return ()
    always = _holding_always(spec, tasks)
    return stack_notes(always, tree.velocity_map()) if always else ()


def _holding_always(spec: ControllerSpec, tasks: Sequence[Level]) -> list[Task]:
    """The tasks that hold always, the highest first."""
    return [task for table, task in zip(spec.tasks, tasks, strict=True) if table.equality and isinstance(task, Task)]


def _step(
    spec: ControllerSpec,
    tree: KinematicTree,
    q: Signal,
    sensing: Sensing | None,
    tasks: Sequence[Level],
    command: "_Command",
) -> tuple[list[Signal], list[Signal]]:
    """Law (eq. 11), limits, Euler step (eq. 13), filter (eq. 16), planner (eq. 17): all inputs, all outputs."""
    period = symbol("period", (), "s", "sampling time T", "parameter", (1e-6, 10.0), spec.period)
    S = tree.velocity_map()
    dq_law = S @ command.u
    event, clearance = (sensing.event, sensing.closest.clearance) if sensing else (ca.SX(0), None)
    motion = Motion(
        robot=spec.robot,
        dq_law=dq_law,
        period=period.expression,
        velocity_map=S,
        event=event,
        clearance=clearance,
    )
    plan = spec.planner.build(motion, spec.filter)  # eqs. 16-19
    q_next = q.expression + period.expression * plan.dq

    n, rate = q.info.shape, ", ".join(f"{joint.unit}/s" for joint in spec.robot.coordinates)
    outputs = [
        result("q_next", q_next, n, q.info.unit, "joint position one period on (eq. 19)", "state", feeds="q"),
        result("dq", plan.dq, n, rate, "joint velocity that leads there, (q_next − q)/T", "command"),
        *_drive(tree, plan.dq),
        result("dq_law", dq_law, n, rate, "joint velocity of the law alone (eq. 11)"),
        *(signal for task in tasks for signal in task.diagnostics),
        *command.diagnostics,
        result("lam", plan.lam, (), "1", "λ, the share of the filter (eq. 17)"),
        *plan.outputs,
    ]
    inputs = [q, *(signal for task in tasks for signal in task.inputs)]
    if sensing:
        inputs += sensing.inputs
        points = (len(sensing.closest.contacts),)
        outputs += [
            result("active", event, (), "1", "1 while d <= s for some point of interest, else 0"),
            result("distance", sensing.distance, points, "m", "d, each point to its closest obstacle"),
            result("clearance", sensing.closest.clearance, (), "m", "least d − s; negative is intrusion"),
        ]
    return [*inputs, *command.parameters, *plan.inputs, period], outputs


@dataclass(frozen=True, slots=True, eq=False)
class _Command:
    """The input velocity u (n_u, 1), q̇ = S(q) u, that tasks and limits make, and what they need and tell."""

    u: ca.SX
    parameters: tuple[Signal, ...] = ()
    diagnostics: tuple[Signal, ...] = ()
    stages: tuple[Stage, ...] = ()


def _velocity(spec: ControllerSpec, tree: KinematicTree, tasks: Sequence[Level]) -> _Command:
    """The law of the tasks, what contacts take away of it, the velocity limits, and the barrier, in this order."""
    S = tree.velocity_map()
    in_law = [replace(task, jacobian=task.jacobian @ S) for task in tasks if isinstance(task, Task)]
    u = import_module(f"{laws.__name__}.{spec.law}").combine(in_law) if in_law else ca.SX.zeros(S.shape[1])
    for task in reversed(tasks):
        u = task.corrected(u, S) if isinstance(task, Correction) else u
    parameters: tuple[Signal, ...] = ()
    limit = None
    if spec.velocity_limits is not None:
        u, limit_signal = spec.velocity_limits.build(spec.robot, u)
        parameters, limit = (limit_signal,), limit_signal.expression
    guards = [task.moved_by(S) for task in tasks if isinstance(task, Guard)]
    if not guards:
        return _Command(u, parameters)
    always = [replace(task, jacobian=task.jacobian @ S) for task in _holding_always(spec, tasks)]
    barrier = Barrier.of(guards, always, u, limit)
    return _Command(barrier.velocity, (*parameters, *barrier.parameters), barrier.diagnostics, (barrier.stage,))


def _drive(tree: KinematicTree, dq: ca.SX) -> list[Signal]:
    """What a differential drive is commanded: its forward and turning velocity, from q̇ = S(q) u."""
    drive = tree.robot.drive
    if drive is None:
        return []
    x, y, yaw = (tree.robot.coordinate(name) for name in (drive.x, drive.y, drive.yaw))
    forward = ca.cos(tree.q[yaw]) * dq[x] + ca.sin(tree.q[yaw]) * dq[y]
    text = "forward and turning velocity of the base"
    return [result("base_velocity", ca.vertcat(forward, dq[yaw]), (2,), "m/s, rad/s", text, "command")]


def _positions(tree: KinematicTree, tasks: Sequence[Level], stages: list[Stage]) -> list[Signal]:
    """Task values, points of interest, and the pose of every link as the rows [R | p] of world_T_link.

    The loops for the points are added to the stages.
    """
    outputs = [signal for task in tasks for signal in task.values]
    points = tree.robot.points_of_interest
    if points:
        shape = (len(points), tree.robot.dimension)
        outputs.append(result("point_position", places(tree, stages).T, shape, "m", "r of every point of interest"))
    poses = [tree.poses[joint.link] for joint in tree.robot.joints]
    rows = ca.vertcat(*(ca.horzcat(pose.rotation, pose.position) for pose in poses))
    pose_shape = (len(poses), 3, 4)
    return [*outputs, result("link_pose", rows, pose_shape, "1, m", "rows [R | p] of world_T_link, per link")]


def _jacobians(
    tree: KinematicTree, sensing: Sensing | None, tasks: Sequence[Level], stages: list[Stage]
) -> list[Signal]:
    """∂(task)/∂q for every task, ∂r/∂q for every point of interest, whose loops are added to the stages."""
    outputs = [signal for task in tasks for signal in task.jacobians]
    points = tree.robot.points_of_interest
    if points:
        where = sensing.closest.places if sensing else places(tree, stages)
        rows = position_jacobians(tree, where, stages)
        shape = (len(points), tree.robot.dimension, tree.q.numel())
        text = "J_r = ∂r/∂q of every point of interest"
        outputs.append(result("point_jacobian", rows, shape, "m per joint unit", text))
    return outputs


def _function(
    spec: ControllerSpec,
    name: str,
    description: str,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    stages: Sequence[Stage] = (),
) -> ControllerFunction:
    """The function of the state and the inputs it depends on, common subexpressions shared; raises BadInput."""
    columns = [signal.column for signal in outputs]
    all_inputs = Procedure.of(f"{spec.name}_{name}", [], columns, stages)
    used = tuple(signal for signal in inputs if signal.info.name == "q" or all_inputs.depends_on(signal.column))
    names = [signal.info.name for signal in (*used, *outputs)]
    for signal_name in names:
        if names.count(signal_name) > 1:
            raise BadInput(f"two signals are called '{signal_name}': give the task another name")
    procedure = replace(all_inputs, given=tuple(signal.column for signal in used))
    return ControllerFunction(name, description, used, tuple(outputs), procedure)
