"""A controller spec as CasADi functions: kinematics, Jacobians and the step of the fixed-rate loop."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import import_module

import casadi as ca

from clikgen.runtime.documents import BadInput
from clikgen.symbolic import laws
from clikgen.symbolic.obstacles import Loop, Obstacles, Sensing
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.spec import ControllerSpec
from clikgen.symbolic.stack import stack_notes
from clikgen.symbolic.task import Task
from clikgen.symbolic.tree import KinematicTree


@dataclass(frozen=True, slots=True, eq=False)
class ControllerFunction:
    """A function to generate: every argument is a dense column, row by row of the signal's shape."""

    name: str
    description: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    casadi: ca.Function
    instructions: int  # carried out in one evaluation


@dataclass(frozen=True, slots=True, eq=False)
class Controller:
    """A spec and the functions it stands for: kinematics, jacobians, step."""

    spec: ControllerSpec
    functions: tuple[ControllerFunction, ...]
    tasks: tuple[Task, ...]
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
    built = ((task, task.build(tree, sensing)) for task in spec.tasks)
    tasks = [one.limited(task.speed) if task.speed else one for task, one in built]
    inputs, outputs = _step(spec, tree, q, sensing, tasks)
    loop = sensing.loop if sensing else None
    jacobians = _jacobians(tree, tasks)
    return Controller(
        spec,
        (
            _function(spec, "kinematics", "where everything is at q", inputs, _positions(tree, tasks)),
            _function(spec, "jacobians", "how everything moves with q̇ at q", inputs, jacobians, loop),
            _function(spec, "step", "one period of the loop (eqs. 4-19)", inputs, outputs, loop),
        ),
        tuple(tasks),
        _notes(spec, tree, tasks),
    )


def _notes(spec: ControllerSpec, tree: KinematicTree, tasks: Sequence[Task]) -> tuple[str, ...]:
    if spec.law != "augmented":
        return ()
    always = [task for table, task in zip(spec.tasks, tasks, strict=True) if table.equality]
    return stack_notes(always, tree.velocity_map()) if always else ()


def _step(
    spec: ControllerSpec, tree: KinematicTree, q: Signal, sensing: Sensing | None, tasks: Sequence[Task]
) -> tuple[list[Signal], list[Signal]]:
    """Law (eq. 11), limits, Euler step (eq. 13), filter (eq. 16), planner (eq. 17): all inputs, all outputs."""
    period = symbol("period", (), "s", "sampling time T", "parameter", (1e-6, 10.0), spec.period)
    u, limit_inputs = _velocity(spec, tree, tasks)
    dq_law = tree.velocity_map() @ u
    q_raw = q.expression + period.expression * dq_law  # eq. 13
    q_filtered, filter_inputs = spec.filter.build(q_raw, q.expression, period.expression, spec.robot.input_of)
    event = sensing.event if sensing else ca.SX(0)
    q_next, lam, planner_inputs = spec.planner.build(q_filtered, q_raw, event)
    dq = (q_next - q.expression) / period.expression

    n, rate = q.info.shape, ", ".join(f"{joint.unit}/s" for joint in spec.robot.coordinates)
    outputs = [
        result("q_next", q_next, n, q.info.unit, "joint position one period on (eq. 19)", "state", feeds="q"),
        result("dq", dq, n, rate, "joint velocity that leads there, (q_next − q)/T", "command"),
        *_drive(tree, dq),
        result("dq_law", dq_law, n, rate, "joint velocity of the law alone (eq. 11)"),
        *(signal for task in tasks for signal in task.diagnostics),
        result("lam", lam, (), "1", "λ, the share of the filter (eq. 17)"),
    ]
    inputs = [q, *(signal for task in tasks for signal in task.inputs)]
    if sensing:
        inputs += sensing.inputs
        points = (len(sensing.contacts),)
        outputs += [
            result("active", event, (), "1", "1 while d <= s for some point of interest, else 0"),
            result("distance", sensing.distance, points, "m", "d, each point to its closest obstacle"),
            result("clearance", sensing.clearance, (), "m", "least d − s; negative is intrusion"),
        ]
    return [*inputs, *limit_inputs, *filter_inputs, *planner_inputs, period], outputs


def _velocity(spec: ControllerSpec, tree: KinematicTree, tasks: Sequence[Task]) -> tuple[ca.SX, list[Signal]]:
    """The law's input velocity u (n_u, 1), q̇ = S(q) u, within its limits; and the inputs the limits need."""
    if spec.robot.drive:
        tasks = [replace(task, jacobian=task.jacobian @ tree.velocity_map()) for task in tasks]
    u = import_module(f"{laws.__name__}.{spec.law}").combine(tasks)
    if spec.velocity_limits is None:
        return u, []
    u, limit = spec.velocity_limits.build(spec.robot, u)
    return u, [limit]


def _drive(tree: KinematicTree, dq: ca.SX) -> list[Signal]:
    """What a differential drive is commanded: its forward and turning velocity, from q̇ = S(q) u."""
    drive = tree.robot.drive
    if drive is None:
        return []
    x, y, yaw = (tree.robot.coordinate(name) for name in (drive.x, drive.y, drive.yaw))
    forward = ca.cos(tree.q[yaw]) * dq[x] + ca.sin(tree.q[yaw]) * dq[y]
    text = "forward and turning velocity of the base"
    return [result("base_velocity", ca.vertcat(forward, dq[yaw]), (2,), "m/s, rad/s", text, "command")]


def _positions(tree: KinematicTree, tasks: Sequence[Task]) -> list[Signal]:
    """Task values, points of interest, and the pose of every link as the rows [R | p] of world_T_link."""
    outputs = [signal for task in tasks for signal in task.values]
    points = tree.robot.points_of_interest
    if points:
        places = ca.vertcat(*(tree.position(point.link, point.offset).T for point in points))
        shape = (len(points), tree.robot.dimension)
        outputs.append(result("point_position", places, shape, "m", "r of every point of interest"))
    poses = [tree.poses[joint.link] for joint in tree.robot.joints]
    rows = ca.vertcat(*(ca.horzcat(pose.rotation, pose.position) for pose in poses))
    pose_shape = (len(poses), 3, 4)
    return [*outputs, result("link_pose", rows, pose_shape, "1, m", "rows [R | p] of world_T_link, per link")]


def _jacobians(tree: KinematicTree, tasks: Sequence[Task]) -> list[Signal]:
    """∂(task)/∂q for every task, ∂r/∂q for every point of interest."""
    outputs = [signal for task in tasks for signal in task.jacobians]
    points = tree.robot.points_of_interest
    if points:
        rows = ca.vertcat(*(tree.position_jacobian(point.link, point.offset) for point in points))
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
    loop: Loop | None = None,
) -> ControllerFunction:
    """The function of the state and the inputs it depends on, common subexpressions shared; raises BadInput."""
    columns = [signal.column for signal in outputs]
    together = ca.vertcat(*columns)
    if loop and not ca.depends_on(together, ca.vertcat(ca.vec(loop.distance), ca.vec(loop.toward))):
        loop = None
    needed = ca.vertcat(together, *map(ca.vec, loop.shapes.arrays)) if loop else together
    used = tuple(signal for signal in inputs if signal.info.role == "state" or ca.depends_on(needed, signal.column))
    names = [signal.info.name for signal in (*used, *outputs)]
    for signal_name in names:
        if names.count(signal_name) > 1:
            raise BadInput(f"two signals are called '{signal_name}': give the task another name")
    symbol_name, given = f"{spec.name}_{name}", [signal.column for signal in used]
    labels = [signal.info.name for signal in used], [signal.info.name for signal in outputs]
    if loop is None:
        function = ca.Function(symbol_name, given, ca.cse(columns), *labels)
        return ControllerFunction(name, description, used, tuple(outputs), function, function.n_instructions())
    before = ca.Function("before_sensing", given, ca.cse([loop.places, *loop.shapes.arrays]))
    after = ca.Function("after_sensing", [*given, loop.distance, loop.toward], ca.cse(columns))
    values = [ca.MX.sym(label, column.numel()) for label, column in zip(labels[0], given, strict=True)]
    places, *shapes = before.call(values)
    function = ca.Function(symbol_name, values, after.call([*values, *loop.run(places, shapes)]), *labels)
    instructions = before.n_instructions() + places.shape[1] * loop.closest.n_instructions() + after.n_instructions()
    return ControllerFunction(name, description, used, tuple(outputs), function, instructions)
