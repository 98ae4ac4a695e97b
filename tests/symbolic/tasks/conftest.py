"""A two-armed robot and its poses by SciPy, a controller of one task, and its loop."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.symbolic.controller import Controller, build
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.spec import ControllerSpec

Array = NDArray[np.float64]

# ---- Robots ----


def _joint(name: str, kind: str, **others: Any) -> dict[str, Any]:
    limits = {} if kind in ("fixed", "continuous") else {"lower": -3.0, "upper": 3.0}
    return {"name": name, "type": kind, "link": f"{name}_link", **limits, **others}


@pytest.fixture(scope="session")
def two_arms() -> Robot:
    """A lift and a waist that carry two arms: 11 coordinates of every type of joint, oblique axes, two mimics."""
    return Robot.parse(
        {
            "joints": [
                _joint("lift", "prismatic", xyz=[0.1, -0.05, 0.4]),
                _joint("waist", "continuous", rpy=[0.1, -0.2, 0.3]),
                _joint("l1", "revolute", xyz=[0.0, 0.3, 0.5], axis=[0, 1, 0]),
                _joint("l2", "revolute", xyz=[0.05, 0.1, 0.0], axis=[0.6, 0, 0.8]),
                _joint("l3", "revolute", xyz=[0.4, 0.0, 0.05], rpy=[0.4, 0.2, -0.3], axis=[0, 1, 0]),
                _joint("l4", "revolute", xyz=[0.0, 0.05, 0.3], axis=[0, 0, 1]),
                _joint("l5", "revolute", xyz=[0.02, 0.0, 0.2], axis=[1, 0, 0]),
                _joint("l_flange", "fixed", xyz=[0.0, 0.0, 0.1], rpy=[0.0, 1.0, 0.5]),
                _joint("r1", "revolute", parent="waist_link", xyz=[0.0, -0.3, 0.5], axis=[0, 1, 0]),
                _joint("r2", "revolute", xyz=[0.3, 0.0, 0.1], axis=[0, 0.6, 0.8]),
                _joint("r3", "prismatic", xyz=[0.1, 0.0, 0.2], rpy=[0.5, 0.0, 0.2], axis=[1, 0, 0]),
                _joint("r4", "revolute", axis=[0, 1, 0], mimic={"joint": "r2", "multiplier": -0.7, "offset": 0.2}),
                _joint("r5", "revolute", xyz=[0.2, 0.1, 0.0], axis=[1, 0, 0]),
                _joint("finger", "prismatic", axis=[0, 1, 0], mimic={"joint": "r5", "multiplier": 0.05}),
            ],
            "frames": [
                {"name": "left", "link": "l_flange_link", "xyz": [0.05, 0.02, 0.1], "rpy": [0.7, -0.4, 1.9]},
                {"name": "right", "link": "finger_link", "xyz": [0.1, 0.0, -0.03], "rpy": [-1.2, 0.3, 0.1]},
            ],
        },
        "two_arms",
    )


@pytest.fixture(scope="session")
def planar_robot() -> Robot:
    """The planar mobile manipulator of planar5, with a frame on its base that is turned against it."""
    slide = {"lower": -10.0, "upper": 10.0}
    turn = {"lower": -6.3, "upper": 6.3, "axis": [0, 0, 1]}
    return Robot.parse(
        {
            "space": "planar",
            "joints": [
                {"name": "base_x", "type": "prismatic", "link": "slide_x", "axis": [1, 0, 0], **slide},
                {"name": "base_y", "type": "prismatic", "link": "slide_y", "axis": [0, 1, 0], **slide},
                {"name": "base_yaw", "type": "revolute", "link": "base", **turn},
                {"name": "shoulder", "type": "revolute", "link": "upper_arm", "xyz": [0.2, 0, 0], **turn},
                {"name": "elbow", "type": "revolute", "link": "forearm", "xyz": [0.5, 0, 0], **turn},
            ],
            "frames": [
                {"name": "tool", "link": "forearm", "xyz": [0.4, 0, 0], "rpy": [0, 0, 0.3]},
                {"name": "camera", "link": "base", "xyz": [0.1, 0.2, 0], "rpy": [0, 0, -0.8]},
                {"name": "tilted", "link": "base", "rpy": [0.1, 0, 0]},
            ],
        },
        "planar",
    )


@pytest.fixture(scope="session")
def pose_by_scipy() -> Callable[[Robot, str, Array], tuple[Array, Array]]:
    """Rotation (3, 3) and position (3,) [m] of a frame at q, from homogeneous transforms and SciPy's rotations."""

    def pose(robot: Robot, name: str, q: Array) -> tuple[Array, Array]:
        value = dict(zip((joint.name for joint in robot.coordinates), q, strict=True))
        links = {robot.root: np.eye(4)}
        last = robot.root
        for joint in robot.joints:
            if joint.mimic:
                value[joint.name] = joint.mimic.multiplier * value[joint.mimic.joint] + joint.mimic.offset
            moved = np.zeros(3)
            turned = Rotation.identity()
            if joint.type == "prismatic":
                moved = value[joint.name] * np.array(joint.axis)
            elif joint.type != "fixed":
                turned = Rotation.from_rotvec(value[joint.name] * np.array(joint.axis))
            fixed = _transform(Rotation.from_euler("xyz", joint.rpy), joint.xyz)
            links[joint.link] = links[joint.parent or last] @ fixed @ _transform(turned, moved)
            last = joint.link
        frame = next(frame for frame in robot.frames if frame.name == name)
        place = links[frame.link] @ _transform(Rotation.from_euler("xyz", frame.rpy), frame.xyz)
        return place[:3, :3], place[:3, 3]

    return pose


def _transform(rotation: Rotation, translation: Any) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation.as_matrix(), translation
    return matrix


# ---- A controller of one task ----


@dataclass(frozen=True)
class OneTask:
    """A controller of one task without filter or limits, so that q⁺ = q + T q̇."""

    controller: Controller

    def __call__(self, name: str, **values: Any) -> dict[str, Array]:
        """The outputs of `kinematics`, `jacobians` or `step`; what is not given stays at its default."""
        function = next(one for one in self.controller.functions if one.name == name)
        arguments = {signal.info.name: self._columns(signal.info, values)[:, 0] for signal in function.inputs}
        outputs = function.casadi(**arguments)
        return {
            signal.info.name: np.array(outputs[signal.info.name]).reshape(signal.info.shape)
            for signal in function.outputs
        }

    def run(self, q: Array, steps: int, **values: Any) -> dict[str, Array]:
        """The outputs of `steps` steps from q, (steps, ...); a value has its shape, or one row a step."""
        function = next(one for one in self.controller.functions if one.name == "step")
        inputs = {signal.info.name: self._columns(signal.info, values, steps) for signal in function.inputs[1:]}
        outputs = function.casadi.mapaccum(steps)(q=q, **inputs)
        return {
            signal.info.name: np.array(outputs[signal.info.name]).T.reshape(steps, *signal.info.shape)
            for signal in function.outputs
        }

    @staticmethod
    def _columns(info: Any, values: Mapping[str, Any], steps: int = 1) -> Array:
        """The signal's value over the steps, (size, steps) row by row of its shape."""
        if info.name not in values:
            return np.tile(np.reshape(info.default, (-1, 1)), steps)
        given = np.asarray(values[info.name], dtype=float)
        return np.broadcast_to(given, (steps, *info.shape)).reshape(steps, -1).T


@pytest.fixture(scope="session")
def one_task() -> Callable[..., OneTask]:
    """A controller of one task called `aim`, from the robot and the task's table."""

    def make(robot: Robot, **task: Any) -> OneTask:
        spec = {
            "name": "one_task",
            "description": "one task alone",
            "period": 0.01,
            "robot": robot,
            "tasks": [{"name": "aim", "gain": 5.0, **task}],
            "filter": {"kind": "first_order", "cutoff": 10.0},
            "planner": {"lam_free": 0.0, "lam_event": 0.0},
        }
        return OneTask(build(ControllerSpec.parse(spec, "a spec")))

    return make


# ---- What the tests have in common ----


@pytest.fixture(scope="session")
def differences() -> Callable[[Callable[[Array], Array], Array], Array]:
    """∂f/∂q (m, n) at q by central differences of f(q) (m,), within 1e-8 for lengths of metres.

    h = 1e-5: h²/6 of a third derivative below 100 is 2e-9, rounding of 1e-14 over 2h is 5e-10.
    """

    def jacobian(f: Callable[[Array], Array], q: Array, h: float = 1e-5) -> Array:
        return np.stack([(f(q + h * e) - f(q - h * e)) / (2 * h) for e in np.eye(len(q))], axis=-1)

    return jacobian


@pytest.fixture(scope="session")
def joint_positions() -> Callable[[Robot, int, int], Array]:
    """Random joint positions (count, n) of a robot [m, rad]."""

    def draw(robot: Robot, count: int, seed: int) -> Array:
        return np.random.default_rng(seed).uniform(-2, 2, (count, len(robot.coordinates)))

    return draw


@dataclass(frozen=True)
class Ramp:
    """A reference that moves at a constant rate, followed from rest at the sampling times T, T/2 and T/4."""

    task: OneTask
    q: Array
    motion: Callable[[Array], Mapping[str, Array]]  # times (k,) -> what the step is given
    error: str = "aim_error"

    def errors(self, *, feedforward: bool, periods: tuple[float, ...] = (0.02, 0.01, 0.005), end: float = 3.0) -> Array:
        """|e| at time `end` [s], once the start is forgotten, for each of the periods."""
        lengths = []
        for period in periods:
            steps = round(end / period) + 1
            values = dict(self.motion(period * np.arange(steps)))
            if not feedforward:
                values = {name: value for name, value in values.items() if not name.endswith("_velocity")}
            outputs = self.task.run(self.q, steps, period=period, **values)
            lengths.append(np.linalg.norm(outputs[self.error][-1]))
        return np.array(lengths)


@pytest.fixture(scope="session")
def ramp() -> type[Ramp]:
    """How closely a task follows a reference that moves at a constant rate."""
    return Ramp


@pytest.fixture(scope="session")
def expect_first_order() -> Callable[[Ramp], None]:
    """The claim: with feedforward the error is O(T), without it stays at about the rate over the gain."""

    def expect(motion: Ramp) -> None:
        with_it, without = motion.errors(feedforward=True), motion.errors(feedforward=False)
        # the second order in T is a share of about T times the joint rates of 1/s: some per cent
        np.testing.assert_allclose(with_it[:-1] / with_it[1:], 2, rtol=0.1)
        np.testing.assert_allclose(without[:-1] / without[1:], 1, rtol=0.1)
        assert with_it[-1] < 0.1 * without[-1]

    return expect
