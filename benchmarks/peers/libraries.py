"""Libraries for inverse kinematics, each as its users call it in a loop: set the target, solve, integrate.

Other work than ours, and labelled so: a quadratic program with joint and velocity limits, gains as the library has
them, no feedforward; where there is avoidance, it is the library's own between the spheres of planar5.urdf. A library
is imported where it is used: not all of them live in one environment.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import mujoco
    import pinocchio as pin

Array = NDArray[np.float64]
POINTS = tuple(f"point_{i}" for i in range(1, 7))
OBSTACLES = tuple(f"obstacle_{k}" for k in range(1, 4))
PAIRS = tuple((point, obstacle) for point in POINTS for obstacle in OBSTACLES)
CLOSEST = 3  # pairs that are kept apart at once, where a library wants to be told
POSTURE_COST = 1e-3  # against 1 of the tool: what weighs instead of a strict priority
DAMPING = 1e-6  # of a program whose tasks leave joints free


@dataclass(frozen=True, slots=True)
class Setup:
    """What to do: a robot, its tool frame, the period, a posture or none, obstacles avoided or not."""

    urdf: str
    tool: str
    period: float
    posture: tuple[float, ...] | None = None
    avoid: bool = False


class Library(Protocol):
    """A library at work on a setup; `q` is where the robot is."""

    def start(self, q: Array) -> None:
        """Begin at q."""

    def advance(self, place: Array, rotation: Array) -> None:
        """One period: the tool toward this place (3,) and this rotation (3, 3)."""

    @property
    def q(self) -> Array:
        """Joint positions now."""


class Pink:
    """pink.solve_ik with quadprog, the faster of the solvers that it was tried with; SelfCollisionBarrier."""

    package = "pin-pink"

    def __init__(self, setup: Setup) -> None:
        import pinocchio as pin
        from pink import Configuration, solve_ik
        from pink.barriers import SelfCollisionBarrier
        from pink.tasks import FrameTask, PostureTask

        self.model = pin.buildModelFromUrdf(setup.urdf)
        self.shapes = pin.buildGeomFromUrdf(self.model, setup.urdf, pin.GeometryType.COLLISION)
        for first, second in PAIRS if setup.avoid else ():
            pair = [self.shapes.getGeometryId(f"{name}_0") for name in (first, second)]
            self.shapes.addCollisionPair(pin.CollisionPair(*pair))
        given = {"collision_model": self.shapes, "collision_data": pin.GeometryData(self.shapes)} if setup.avoid else {}
        self.configuration = Configuration(self.model, self.model.createData(), pin.neutral(self.model), **given)
        self.task = FrameTask(setup.tool, position_cost=1.0, orientation_cost=0.0 if setup.posture is None else 1.0)
        self.tasks = [self.task]
        if setup.posture is not None:
            posture = PostureTask(cost=POSTURE_COST)
            posture.set_target(np.array(setup.posture))
            self.tasks.append(posture)
        self.barriers = [SelfCollisionBarrier(n_collision_pairs=CLOSEST, d_min=0.0)] if setup.avoid else []
        self.period, self.solve, self.SE3 = setup.period, solve_ik, pin.SE3

    def start(self, q: Array) -> None:
        self.configuration.update(q)

    def advance(self, place: Array, rotation: Array) -> None:
        self.task.set_target(self.SE3(rotation, place))
        velocity = self.solve(
            self.configuration, self.tasks, self.period, solver="quadprog", damping=DAMPING, barriers=self.barriers
        )
        self.configuration.integrate_inplace(velocity, self.period)

    @property
    def q(self) -> Array:
        return self.configuration.q


class Mink:
    """mink.solve_ik with quadprog, the faster of the solvers that it was tried with; CollisionAvoidanceLimit."""

    package = "mink"

    def __init__(self, setup: Setup) -> None:
        import mink
        import pinocchio as pin

        urdf = pin.buildModelFromUrdf(setup.urdf)
        model = mujoco_model(urdf, setup)
        self.configuration = mink.Configuration(model)
        turning = 0.0 if setup.posture is None else 1.0
        self.task = mink.FrameTask(setup.tool, "site", position_cost=1.0, orientation_cost=turning)
        self.tasks = [self.task]
        if setup.posture is not None:
            posture = mink.PostureTask(model, cost=POSTURE_COST)
            posture.set_target(np.array(setup.posture))
            self.tasks.append(posture)
        speeds = dict(zip(list(urdf.names)[1:], urdf.velocityLimit, strict=True))
        self.limits = [mink.ConfigurationLimit(model), mink.VelocityLimit(model, speeds)]
        if setup.avoid:
            apart = {"minimum_distance_from_collisions": 0.0, "collision_detection_distance": 0.1}
            self.limits.append(mink.CollisionAvoidanceLimit(model, [(list(POINTS), list(OBSTACLES))], **apart))
        self.period, self.mink = setup.period, mink

    def start(self, q: Array) -> None:
        self.configuration.update(q)

    def advance(self, place: Array, rotation: Array) -> None:
        mink = self.mink
        self.task.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), place))
        velocity = mink.solve_ik(
            self.configuration, self.tasks, self.period, "quadprog", damping=DAMPING, limits=self.limits
        )
        self.configuration.integrate_inplace(velocity, self.period)

    @property
    def q(self) -> Array:
        return self.configuration.q.copy()


def mujoco_model(urdf: "pin.Model", setup: Setup) -> "mujoco.MjModel":
    """The robot of a URDF for MuJoCo: its joints, the tool as a site and, to avoid obstacles, its spheres."""
    import mujoco
    import pinocchio as pin

    def placed(place: pin.SE3) -> dict[str, list[float]]:
        x, y, z, w = pin.Quaternion(place.rotation).coeffs()
        return {"pos": list(place.translation), "quat": [w, x, y, z]}

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = [spec.worldbody]
    for i in range(1, urdf.njoints):
        weight = {"mass": 1.0, "inertia": [0.01] * 3, "explicitinertial": True}
        body = bodies[urdf.parents[i]].add_body(name=f"body_{i}", **placed(urdf.jointPlacements[i]), **weight)
        kind, joint = urdf.joints[i].shortname(), mujoco.mjtJoint
        axis = [float(kind.endswith(name)) for name in "XYZ"]
        limits = [urdf.lowerPositionLimit[i - 1], urdf.upperPositionLimit[i - 1]]
        slides = kind.startswith("JointModelP")
        body.add_joint(
            name=urdf.names[i], type=joint.mjJNT_SLIDE if slides else joint.mjJNT_HINGE, axis=axis, range=limits
        )
        bodies.append(body)
    tool = urdf.frames[urdf.getFrameId(setup.tool)]
    bodies[tool.parentJoint].add_site(name=setup.tool, **placed(tool.placement))
    shapes = pin.buildGeomFromUrdf(urdf, setup.urdf, pin.GeometryType.COLLISION).geometryObjects
    for one in shapes if setup.avoid else ():
        size, name = [one.geometry.radius, 0, 0], one.name.removesuffix("_0")
        sphere = mujoco.mjtGeom.mjGEOM_SPHERE
        bodies[one.parentJoint].add_geom(name=name, type=sphere, size=size, **placed(one.placement))
    return spec.compile()


class Oink:
    """OInK of RoboPlan, in C++ under Python; a posture at the second priority; SelfCollisionBarrier."""

    package = "roboplan-oink"

    def __init__(self, setup: Setup) -> None:
        from roboplan import core, optimal_ik

        scene = core.Scene("scene", core.loadUrdfSceneDescription(setup.urdf))
        links = [*POINTS, *OBSTACLES] if setup.avoid else []
        for i, first in enumerate(links):
            for second in links[i + 1 :]:
                scene.setCollisions(first, second, (first, second) in PAIRS)
        self.solver = optimal_ik.Oink(scene)
        self.target = np.eye(4, order="F")
        start = core.CartesianConfiguration(base_of(setup), setup.tool, self.target)
        options = optimal_ik.FrameTaskOptions(orientation_cost=0.0 if setup.posture is None else 1.0)
        self.task = optimal_ik.FrameTask(self.solver, scene, start, options)
        self.tasks = [self.task]
        if setup.posture is not None:
            q, second = np.array(setup.posture), optimal_ik.ConfigurationTaskOptions(priority=2)
            self.tasks.append(optimal_ik.ConfigurationTask(self.solver, q, np.ones(len(q)), second))
        speeds = scene.getVelocityLimitVectors()[1]
        self.limits = [
            optimal_ik.PositionLimit(self.solver),
            optimal_ik.VelocityLimit(self.solver, setup.period, speeds),
        ]
        apart = optimal_ik.SelfCollisionBarrierOptions(n_collision_pairs=CLOSEST, d_min=0.0)
        barrier = optimal_ik.SelfCollisionBarrier
        self.barriers = [barrier(self.solver, scene, setup.period, apart)] if setup.avoid else []
        self.scene, self.change = scene, np.zeros(self.solver.num_variables)
        self.q = np.zeros(len(self.change))

    def start(self, q: Array) -> None:
        self.q = np.array(q)

    def advance(self, place: Array, rotation: Array) -> None:
        self.target[:3, :3], self.target[:3, 3] = rotation, place
        self.task.setTargetFrameTransform(self.target)
        self.solver.solveIk(self.q, self.tasks, self.limits, self.barriers, self.change, DAMPING)
        self.q = self.scene.integrate(self.q, self.change)


def base_of(setup: Setup) -> str:
    """The URDF's root link."""
    import pinocchio as pin

    return pin.buildModelFromUrdf(setup.urdf).frames[1].name


class Embodik:
    """embodiK's velocity solver, in C++ under Python; a posture at the second priority; its collision constraint."""

    package = "embodik"

    def __init__(self, setup: Setup) -> None:
        import embodik

        self.robot = embodik.RobotModel(setup.urdf)
        self.solver = embodik.KinematicsSolver(self.robot)
        self.solver.dt = setup.period
        kinds = embodik.TaskType
        kind = kinds.FRAME_POSITION if setup.posture is None else kinds.FRAME_POSE
        self.task = self.solver.add_frame_task("tool", setup.tool, kind)
        self.task.weight = 1 / setup.period  # the whole error in a period, as the others do
        if setup.posture is not None:
            posture = self.solver.add_posture_task("posture")
            posture.set_target_configuration(np.array(setup.posture))
        if setup.avoid:
            pairs = [(f"{first}_0", f"{second}_0") for first, second in PAIRS]
            self.solver.configure_collision_constraint(0.0, include_pairs=pairs, max_constraints=CLOSEST)
        self.period, self.poses = setup.period, setup.posture is not None
        self.q = np.zeros(self.robot.nq)

    def start(self, q: Array) -> None:
        self.q = np.array(q)

    def advance(self, place: Array, rotation: Array) -> None:
        if self.poses:
            self.task.set_target_pose(place, rotation)
        else:
            self.task.set_target_position(place)
        self.q = self.robot.integrate(self.q, self.solver.solve_velocity_dq(self.q), self.period)


class Placo:
    """PlaCo's KinematicsSolver, in C++ under Python; its avoidance of self-collisions, as a hard constraint."""

    package = "placo"

    def __init__(self, setup: Setup) -> None:
        import placo

        self.robot = placo.RobotWrapper(setup.urdf, 0 if setup.avoid else placo.Flags.ignore_collisions)
        self.solver = placo.KinematicsSolver(self.robot)
        self.solver.mask_fbase(True)
        self.solver.dt = setup.period
        self.solver.enable_joint_limits(True)
        self.solver.enable_velocity_limits(True)
        self.poses, self.target = setup.posture is not None, np.eye(4)
        self.names = list(self.robot.joint_names())
        if setup.posture is None:
            self.task = self.solver.add_position_task(setup.tool, np.zeros(3))
            self.task.configure("tool", "soft", 1.0)
            self.solver.add_regularization_task(DAMPING)
        else:
            self.task = self.solver.add_frame_task(setup.tool, self.target)
            self.task.configure("tool", "soft", 1.0, 1.0)
            posture = self.solver.add_joints_task()
            posture.set_joints(dict(zip(self.names, setup.posture, strict=True)))
            posture.configure("posture", "soft", POSTURE_COST)
        if setup.avoid:
            self._avoid()

    def _avoid(self) -> None:
        """Only the pairs of a point and an obstacle, from a file as PlaCo wants it."""
        from tempfile import TemporaryDirectory

        with TemporaryDirectory() as folder:
            file = Path(folder) / "collisions.json"
            file.write_text(json.dumps(PAIRS))
            self.robot.load_collision_pairs(str(file))
        apart = self.solver.add_avoid_self_collisions_constraint()
        apart.configure("apart", "hard", 1.0)
        apart.self_collisions_margin, apart.self_collisions_trigger = 0.0, 0.1

    def start(self, q: Array) -> None:
        for name, value in zip(self.names, q, strict=True):
            self.robot.set_joint(name, float(value))
        self.robot.update_kinematics()

    def advance(self, place: Array, rotation: Array) -> None:
        if self.poses:
            self.target[:3, :3], self.target[:3, 3] = rotation, place
            self.task.T_world_frame = self.target
        else:
            self.task.target_world = place
        self.solver.solve(True)
        self.robot.update_kinematics()

    @property
    def q(self) -> Array:
        return np.array([self.robot.get_joint(name) for name in self.names])


LIBRARIES: dict[str, Callable[[Setup], Any]] = {
    "Pink": Pink,
    "mink": Mink,
    "OInK": Oink,
    "embodiK": Embodik,
    "PlaCo": Placo,
}
