"""Joint limits: every joint keeps a margin from its lower and its upper limit."""

from typing import Literal

import casadi as ca

from clikgen.runtime.documents import BadInput, Positive
from clikgen.symbolic.activation import Boundary
from clikgen.symbolic.contact import Contact
from clikgen.symbolic.obstacles import Sensing
from clikgen.symbolic.one_sided import OneSidedSpec
from clikgen.symbolic.robot import Robot
from clikgen.symbolic.signals import Signal, result, symbol
from clikgen.symbolic.task import joint_units
from clikgen.symbolic.tree import KinematicTree


class Spec(OneSidedSpec):
    """Every joint i with limits keeps a margin s_i from them: x_i = max(0, q̲_i + s_i − q_i, q_i − q̄_i + s_i).

    `margin` is s_i in the joint's unit, a number or a list with one per joint with limits. A margin that is entered
    before anything acts (all activations but the barrier) is entered by T v at most in one step, so keep it wider
    than T times the greatest velocity.
    """

    kind: Literal["joint_limits"]
    margin: Positive | tuple[Positive, ...]

    def contacts(self, robot: Robot) -> int:
        """One a joint with limits."""
        return len(_limited(robot))

    def boundary(self, tree: KinematicTree, sensing: Sensing | None) -> Boundary:
        """A contact a joint, with the nearer limit; raises BadInput where no joint has limits or two margins meet."""
        joints = self._limited_joints(tree.robot)
        inputs = self._inputs(tree.robot, joints)
        lower, upper, margin = (signal.expression for signal in inputs)
        above, below = tree.q[joints] - lower, upper - tree.q[joints]  # how far from each
        axes = ca.SX.eye(tree.q.numel())[joints, :]
        nearest, pairs = list[Contact](), list[Contact]()
        for i in range(len(joints)):
            sides = (Contact(above[i], margin[i], -axes[i, :]), Contact(below[i], margin[i], axes[i, :]))
            at_lower = above[i] < below[i]
            toward = ca.if_else(at_lower, -1, 1) * axes[i, :]
            nearest.append(Contact(ca.if_else(at_lower, above[i], below[i]), margin[i], toward))
            pairs += sides
        unit = joint_units(tree.robot, joints)
        depth = ca.vertcat(*(contact.depth for contact in nearest))
        text = "x, depth into the margin, of each limited joint"
        diagnostic = result(f"{self.name}_depth", depth, depth.shape[:1], unit, text)
        return Boundary(self.name, unit, tuple(nearest), inputs, (diagnostic,), pairs=lambda: pairs)

    def _limited_joints(self, robot: Robot) -> list[int]:
        joints = _limited(robot)
        if not joints:
            raise BadInput("wanted a joint with limits, got none")
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
                    f"joint '{joint.name}' moves from {low:g} to {high:g} {joint.unit}: "
                    f"wanted a margin of at most half of that, got {s:g}"
                )
        return lower, upper, margin


def _limited(robot: Robot) -> list[int]:
    """Where the joints with limits are in q."""
    return [i for i, joint in enumerate(robot.coordinates) if joint.lower is not None]
