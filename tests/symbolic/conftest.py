"""Fixtures of the symbolic tests: small robots, and controllers on them as CasADi evaluates them."""

import numpy as np
import pytest

from clikgen.symbolic.controller import build
from clikgen.symbolic.spec import ControllerSpec


class Evaluated:
    """The functions of a controller: arguments by name, N at once where q is (N, n), else at their defaults."""

    def __init__(self, robot, *tasks, period=0.01, lam=0.0, **more):
        table = {
            "name": "tried",
            "description": "a controller under test",
            "period": period,
            "robot": robot,
            "tasks": tasks,
            "filter": {"kind": "first_order", "cutoff": 4.0},
            "planner": {"lam_free": lam, "lam_event": lam},
        }
        self.period = period
        self.controller = build(ControllerSpec.parse(table | more, "the test"))
        self._functions = {one.name: one for one in self.controller.functions}

    def __call__(self, function="step", **values):
        one = self._functions[function]
        q = np.asarray(values["q"], dtype=float)
        count, columns = len(np.atleast_2d(q)), []
        for info in (signal.info for signal in one.inputs):
            value = values.get(info.name, np.reshape(info.default, info.shape) if info.default else 0.0)
            columns.append(np.broadcast_to(value, (count, *info.shape)).reshape(count, -1).T)
        outputs = one.casadi.call([np.array(column) for column in columns])
        shaped = {
            signal.info.name: np.array(output).T.reshape(count, *signal.info.shape)
            for signal, output in zip(one.outputs, outputs, strict=True)
        }
        return shaped if q.ndim == 2 else {name: value[0] for name, value in shaped.items()}

    def infos(self, function="step"):
        """What it takes, by name."""
        return {signal.info.name: signal.info for signal in self._functions[function].inputs}

    def operations(self, function="step"):
        return self._functions[function].procedure.operations

    def run(self, steps, q, **values):
        """q over time (steps + 1, n), and all outputs over time (steps, ...); a value may be a function of t."""
        one, columns, t = self._functions["step"], [], self.period * np.arange(steps)
        for info in (signal.info for signal in one.inputs[1:]):
            value = values.get(info.name, np.reshape(info.default, info.shape) if info.default else 0.0)
            over_time = np.array([value(now) for now in t]) if callable(value) else value
            columns.append(np.broadcast_to(over_time, (steps, *info.shape)).reshape(steps, -1).T)
        outputs = one.casadi.mapaccum(steps).call([np.asarray(q, dtype=float), *map(np.array, columns)])
        shaped = {
            signal.info.name: np.array(output).T.reshape(steps, *signal.info.shape)
            for signal, output in zip(one.outputs, outputs, strict=True)
        }
        return np.vstack([q, shaped["q_next"]]), shaped

    def derivative(self, name, q, h=1e-6, function="step", **values):
        """Central differences of an output by q, (N, *shape, n)."""
        q, ends = np.atleast_2d(q), []
        for i in range(q.shape[1]):
            ahead, behind = (self(function, q=q + way * h * np.eye(q.shape[1])[i], **values)[name] for way in (1, -1))
            ends.append((ahead - behind) / (2 * h))
        return np.stack(ends, axis=-1)


@pytest.fixture(scope="session")
def evaluated():
    """`evaluated(robot, *tasks, ...)`: a controller, tried without a compiler; λ = 0 unless `lam` says else."""
    return Evaluated


@pytest.fixture(scope="session")
def plane_arm():
    """`plane_arm(lengths)`: revolute joints j0, j1, ... of a planar arm, a frame `tool` at its end."""

    def robot(lengths, **more):
        starts = [0.0, *lengths[:-1]]
        return {
            "space": "planar",
            "joints": [
                {"name": f"j{i}", "type": "revolute", "link": f"link{i}", "xyz": [x, 0.0, 0.0]}
                | {"lower": -3.0, "upper": 3.0, "velocity": 2.0}
                for i, x in enumerate(starts)
            ],
            "frames": [{"name": "tool", "link": f"link{len(lengths) - 1}", "xyz": [lengths[-1], 0.0, 0.0]}],
        } | more

    return robot


@pytest.fixture(scope="session")
def space_arm():
    """`space_arm(seed)`: a lift and six turning joints about arbitrary axes through arbitrary places."""

    def robot(seed=0, **more):
        rng = np.random.default_rng(seed)

        def numbers(low, high):
            return rng.uniform(low, high, 3).tolist()

        joints = [{"name": "lift", "type": "prismatic", "link": "link0", "lower": -0.5, "upper": 0.5, "velocity": 0.5}]
        for i in range(1, 7):
            axis = rng.normal(size=3)
            axis /= np.linalg.norm(axis)
            joints.append(
                {"name": f"j{i}", "type": "revolute", "link": f"link{i}", "axis": axis.tolist()}
                | {"xyz": numbers(-0.4, 0.4), "rpy": numbers(-1, 1), "lower": -2.5, "upper": 2.5, "velocity": 2.0}
            )
        frames = [{"name": "tool", "link": "link6", "xyz": numbers(-0.3, 0.3)}]
        return {"space": "spatial", "joints": joints, "frames": frames} | more

    return robot
