"""Joint limits: every joint keeps a margin from its lower and its upper limit."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import BadInput, NonNegative, Positive
from clikgen.symbolic.damping import LIMITS, FadingDamping
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import Task, TaskSpec, jacobian_result, joint_units
from clikgen.symbolic.tree import KinematicTree


class Spec(TaskSpec):
    """q̇_l = J_l⁺ K (0 − V), eq. 10, with a row for each joint i that has limits.

    V_i = ½ (x̲_i² + x̄_i²) and J_i = ∂V_i/∂q_i = x̄_i − x̲_i, eqs. 8-9, where x̲_i = max(0, q̲_i + s_i − q_i) and
    x̄_i = max(0, q_i − q̄_i + s_i) are the depths into the margin s_i at the lower and the upper limit. So q̇_i is
    ∓K x_i/2 inside a margin and free outside. One sum for all joints, as obstacle_avoidance has it, would hold
    one direction only and let a lower task push some joints on while others yield; with a row each, every joint
    inside its margin is held, and takes one degree of freedom from the tasks below.

    `margin` is s_i in the joint's unit, a number or a list with one per joint with limits; `gain` is K [1/s];
    `damping` d in the joint's unit that of the pseudo-inverse: under the law `nsb` a task below gets the share
    d²/(x_i² + d²) of its velocity through, so a push with v is held at the depth x = (2 d² v/K)^⅓. Before that
    it takes a joint into the margin by T v at most, in one step, so keep margins wider than T times the greatest
    velocity. x shrinks by 1 − K T/2 a step, so K T <= 2 keeps it monotone. The Jacobian is diagonal: O(n) operations.
    """

    kind: Literal["joint_limits"]
    margin: Positive | tuple[Positive, ...]
    gain: NonNegative
    damping: Positive

    @property
    def equality(self) -> bool:
        """It acts only inside a margin."""
        return False

    def dimension(self, robot: Robot) -> int:
        """One row a joint with limits."""
        return len(_limited(robot))

    def build(self, tree: KinematicTree, sensing: Sensing | None) -> Task:
        """−V as the error, J_l diagonal; raises BadInput where no joint has limits or two margins meet."""
        name, joints = self.name, self._limited_joints(tree.robot)
        shape, unit = (len(joints),), joint_units(tree.robot, joints)
        inputs = self._inputs(tree.robot, joints)
        lower, upper, margin = (signal.expression for signal in inputs)
        q = tree.q[joints]
        below, above = ca.fmax(0, lower + margin - q), ca.fmax(0, q - upper + margin)  # x̲ and x̄
        potential, slope = (below**2 + above**2) / 2, above - below
        jacobian = ca.diag(slope) @ ca.SX.eye(tree.q.numel())[joints, :]
        gain = symbol(f"{name}_gain", (), "1/s", "K (eq. 10)", "parameter", (0.0, 1e6), self.gain)
        constant = symbol(f"{name}_damping", (), unit, "damping of J⁺", "parameter", LIMITS, self.damping)
        squared = ", ".join(f"{one}^2" for one in unit.split(", "))
        return Task(
            name=name,
            jacobian=jacobian,
            error=-potential,
            feedforward=ca.SX.zeros(len(joints)),
            gain=gain.expression,
            damping=FadingDamping(constant.expression),
            parameters=(gain, constant, *inputs),
            diagnostics=(
                result(f"{name}_depth", below + above, shape, unit, "x, depth into the margin, of each limited joint"),
                result(f"{name}_potential", potential, shape, squared, "V, eq. 8 of each limited joint"),
            ),
            values=(),
            jacobians=(jacobian_result(name, jacobian, unit, "J_l = ∂V/∂q, eq. 9 of each limited joint"),),
        )

    def _limited_joints(self, robot: Robot) -> list[int]:
        joints = _limited(robot)
        if not joints:
            raise BadInput(f"task '{self.name}': wanted a joint with limits, got none")
        return joints

    def _inputs(self, robot: Robot, joints: list[int]) -> tuple[Signal, Signal, Signal]:
        """The parameters `<name>_lower`, `<name>_upper` and `<name>_margin`, one number each per limited joint."""
        limited = [robot.coordinates[i] for i in joints]
        unit, names = joint_units(robot, joints), ", ".join(joint.name for joint in limited)
        given = (
            ("lower", "lower limits", (-1e6, 1e6), [joint.lower or 0.0 for joint in limited]),
            ("upper", "upper limits", (-1e6, 1e6), [joint.upper or 0.0 for joint in limited]),
            ("margin", "margins s", (1e-6, 1e6), self.margin),
        )
        lower, upper, margin = (
            symbol(f"{self.name}_{key}", (len(joints),), unit, f"{text}: {names}", "parameter", limits, default)
            for key, text, limits, default in given
        )
        for joint, low, high, s in zip(limited, *(one.info.default for one in (lower, upper, margin)), strict=True):
            if 2 * s > high - low:
                raise BadInput(
                    f"task '{self.name}': joint '{joint.name}' moves from {low:g} to {high:g} {joint.unit}: "
                    f"wanted a margin of at most half of that, got {s:g}"
                )
        return lower, upper, margin


def _limited(robot: Robot) -> list[int]:
    """Where the joints with limits are in q."""
    return [i for i, joint in enumerate(robot.coordinates) if joint.lower is not None]
