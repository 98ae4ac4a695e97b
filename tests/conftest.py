"""Fixtures of several tests: the shipped controller in every form, a model of it by hand, and random states."""

import math
from collections.abc import Callable, Iterator, Mapping
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from clikgen.runtime.controller import CompiledController
from clikgen.runtime.manifest import FunctionInfo, Manifest, SignalInfo, load_manifest
from clikgen.runtime.scenario import CASES, find_scenario, read_scenario
from clikgen.runtime.simulation import Run, prepare
from clikgen.symbolic.controller import Controller, build
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec, read_spec, shipped_specs

Array = NDArray[np.float64]
EvaluateMany = Callable[[str, Mapping[str, Array]], dict[str, Array]]
Sampler = Callable[[int, int], dict[str, Array]]

# A test run is the same every time, and a slow machine is no reason to fail.
settings.register_profile("clikgen", derandomize=True, deadline=None)
settings.load_profile("clikgen")


@pytest.fixture(scope="session", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Compiled libraries of this test run stay in a folder of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CLIKGEN_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def planar5_folder() -> Path:
    """The folder of the generated planar5 that ships."""
    return Path(str(resources.files("clikgen.generated"))) / "planar5"


@pytest.fixture(scope="session")
def planar5_manifest(planar5_folder: Path) -> Manifest:
    """What the generated planar5 says of itself."""
    return load_manifest(planar5_folder)


@pytest.fixture
def planar5(planar5_folder: Path) -> CompiledController:
    """The shipped planar5, compiled, every input at its default."""
    return CompiledController.load(planar5_folder)


@pytest.fixture(scope="session")
def planar5_spec_file() -> Path:
    """The spec that planar5 is generated from."""
    return {path.stem: path for path in shipped_specs()}["planar5"]


@pytest.fixture(scope="session")
def planar5_spec(planar5_spec_file: Path) -> ControllerSpec:
    """The same, read."""
    return read_spec(planar5_spec_file)


@pytest.fixture(scope="session")
def planar5_casadi(planar5_spec: ControllerSpec) -> Controller:
    """Planar5 as CasADi functions, built from its spec."""
    return build(planar5_spec)


@pytest.fixture(scope="session")
def evaluate_many(planar5_folder: Path) -> EvaluateMany:
    """Planar5's `kinematics`, `jacobians` or `step` on n independent states in one call of compiled C.

    Inputs are (n, *shape), named as in the manifest; those the function does not have are left out.
    """
    planar5 = CompiledController.load(planar5_folder)
    functions = {"kinematics": planar5.kinematics, "jacobians": planar5.jacobians, "step": planar5.step}

    def evaluate(name: str, inputs: Mapping[str, Array]) -> dict[str, Array]:
        function = functions[name]
        n = len(next(iter(inputs.values())))
        return function.map(n, {own: inputs[own] for own in function.inputs})

    return evaluate


class PlanarModel:
    """planar5 and its controller by hand, in numpy: cumulative angles, explicit inverses, explicit projectors.

    It shares neither code nor data with the project: the lengths stand here once more. A point is the base
    position plus segments (x, y), each turned by the sum of the first `count` revolute joints.
    """

    SHOULDER, ELBOW = (0.20, 0.0), (0.50, 0.0)
    POINTS = (
        [((0.15, 0.15), 1)],
        [((0.15, -0.15), 1)],
        [(SHOULDER, 1), ((0.25, 0.0), 2)],
        [(SHOULDER, 1), (ELBOW, 2)],
        [(SHOULDER, 1), (ELBOW, 2), ((0.20, 0.0), 3)],
        [(SHOULDER, 1), (ELBOW, 2), ((0.40, 0.0), 3)],
    )
    TOOL = POINTS[5]
    INFLUENCE_RADIUS = (0.25, 0.25, 0.15, 0.15, 0.15, 0.15)

    @staticmethod
    def _turned(q: Array, segment: tuple[float, float], count: int) -> Array:
        angle = sum(q[2 : 2 + count])
        x, y = segment
        return np.array([x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle)])

    def position(self, q: Array, point: list) -> Array:
        """Where a point is, (2,) [m]."""
        return q[:2] + sum(self._turned(q, segment, count) for segment, count in point)

    def jacobian(self, q: Array, point: list) -> Array:
        """Its Jacobian, (2, 5): a revolute joint turns every segment behind it by a right angle."""
        J = np.zeros((2, 5))
        J[:, :2] = np.eye(2)
        for segment, count in point:
            x, y = self._turned(q, segment, count)
            J[:, 2 : 2 + count] += np.array([[-y], [x]])
        return J

    def link_poses(self, q: Array) -> Array:
        """[R | p] of the five links, (5, 3, 4)."""
        origins = [[], [], [], [(self.SHOULDER, 1)], [(self.SHOULDER, 1), (self.ELBOW, 2)]]
        poses = np.zeros((5, 3, 4))
        for i, (segments, turns) in enumerate(zip(origins, (0, 0, 1, 2, 3), strict=True)):
            angle = sum(q[2 : 2 + turns])
            poses[i, :2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
            poses[i, 2, 2] = 1
            poses[i, :2, 3] = self.position(q, segments)
        poses[0, 1, 3] = 0  # the first slide has not moved along y yet
        return poses

    def sensed(self, values: Mapping[str, Array]) -> tuple[Array, Array]:
        """D (6,) [m] and u (6, 2) of every point of interest to its closest obstacle, far away without one."""
        distance, toward = np.full(6, 1e6), np.tile([1.0, 0.0], (6, 1))
        for i, point in enumerate(self.POINTS):
            r = self.position(values["q"], point)
            for k in range(math.ceil(values["obstacle_count"])):
                way = values["obstacle_center"][k] - r
                d = np.linalg.norm(way) - values["obstacle_radius"][k]
                if d < distance[i]:
                    distance[i], toward[i] = d, way / np.linalg.norm(way)
        return distance, toward

    def potential(self, values: Mapping[str, Array]) -> tuple[float, Array]:
        """V and J_o of eqs. 8-9, summed over the points of interest."""
        distance, toward = self.sensed(values)
        V, J_o = 0.0, np.zeros((1, 5))
        for i, point in enumerate(self.POINTS):
            if distance[i] <= values["influence_radius"][i]:
                V += 0.5 * (distance[i] - values["influence_radius"][i]) ** 2
                J_r = self.jacobian(values["q"], point)
                J_o -= (distance[i] - values["influence_radius"][i]) * toward[i] @ J_r
        return V, J_o

    @staticmethod
    def inverse(J: Array, damping: float) -> Array:
        """The damped pseudo-inverse as a matrix."""
        return J.T @ np.linalg.inv(J @ J.T + damping**2 * np.eye(len(J)))

    def step(self, values: Mapping[str, Array]) -> dict[str, Array]:
        """Eqs. 4-19, as they are printed."""
        q, T = values["q"], values["period"]
        V, J_o = self.potential(values)
        distance, _ = self.sensed(values)
        J_g, f_g = self.jacobian(q, self.TOOL), self.position(q, self.TOOL)
        error = values["tool_reference"] - f_g
        dq_g = self.inverse(J_g, values["tool_damping"]) @ (
            values["tool_reference_velocity"] + values["tool_gain"] @ error
        )  # eq. 4
        inverse_o = self.inverse(J_o, values["obstacles_damping"])
        dq_o = inverse_o @ np.array([values["obstacles_gain"] * (0 - V)])  # eq. 10
        dq_law = dq_o + (np.eye(5) - inverse_o @ J_o) @ dq_g  # eq. 11
        q_raw = q + dq_law * T  # eq. 13
        beta = 2 * np.pi * T * values["filter_cutoff"] / (1 + 2 * np.pi * T * values["filter_cutoff"])
        A_beta = np.diag(beta)
        q_filtered = A_beta @ q_raw + (np.eye(5) - A_beta) @ q  # eq. 16
        active = bool(np.any(distance <= values["influence_radius"]))
        lam = values["lam_event"] if active else values["lam_free"]  # eq. 18
        q_next = lam * q_filtered + (1 - lam) * q_raw  # eq. 17
        return {
            "q_next": q_next,
            "dq": (q_next - q) / T,
            "dq_law": dq_law,
            "obstacles_potential": np.array(V),
            "tool_position": f_g,
            "tool_error": error,
            "lam": np.array(lam),
            "active": np.array(float(active)),
            "distance": distance,
            "clearance": np.min(distance - values["influence_radius"]),
        }


@pytest.fixture(scope="session")
def planar_model() -> PlanarModel:
    """The model by hand."""
    return PlanarModel()


@pytest.fixture(scope="session")
def states_near_contact(planar5_manifest: Manifest, evaluate_many: EvaluateMany) -> Sampler:
    """Sampler (n, seed) of step inputs as they occur: the arm anywhere, obstacles about the points of interest.

    A quarter of the arms is stretched or folded to within 1e-9 rad, and a quarter of the obstacles sits exactly
    on a point of interest; a third are points; from none to all of them are there.
    """

    def sample(n: int, seed: int) -> dict[str, Array]:
        rng = np.random.default_rng(seed)
        values = {
            signal.name: np.full((n, *signal.shape), np.reshape(signal.default, signal.shape))
            for signal in planar5_manifest.function("step").inputs
        }
        q = rng.uniform(-3, 3, (n, 5))
        singular = rng.random(n) < 0.25
        straight = rng.choice([0.0, math.pi, -math.pi], (n, 2)) + rng.choice([0.0, 1e-9, -1e-12], (n, 2))
        q[singular, 3:] = straight[singular]
        values["q"] = q
        seen = evaluate_many("kinematics", {"q": q})
        chosen = rng.integers(0, 6, (n, 3))
        center = np.take_along_axis(seen["point_position"], chosen[:, :, None], axis=1)
        apart = rng.random((n, 3)) < 0.75
        center[apart] += rng.uniform(-0.5, 0.5, (n, 3, 2))[apart]
        values["obstacle_center"] = center
        values["obstacle_radius"] = rng.uniform(0, 0.3, (n, 3)) * (rng.random((n, 3)) < 2 / 3)
        values["obstacle_count"] = rng.integers(0, 4, n).astype(float)
        values["tool_reference"] = seen["tool_position"] + rng.uniform(-1, 1, (n, 2))
        values["tool_reference_velocity"] = rng.uniform(-1, 1, (n, 2))
        root = rng.uniform(-2, 2, (n, 2, 2))
        values["tool_gain"] = root @ root.transpose(0, 2, 1) + 0.5 * np.eye(2)
        values["filter_cutoff"] = rng.uniform(0.5, 20, (n, 5))
        values["influence_radius"] = rng.uniform(0.05, 0.4, (n, 6))
        values["obstacles_gain"] = rng.uniform(0, 500, n)
        values["lam_free"], values["lam_event"] = rng.random((2, n))
        values["period"] = 10 ** rng.uniform(-3.5, -1, n)
        return values

    return sample


@pytest.fixture(scope="session")
def states_within_limits(planar5_manifest: Manifest, evaluate_many: EvaluateMany) -> Sampler:
    """Sampler (n, seed) of step inputs over the manifest's whole limits, every order of magnitude alike.

    Half of the obstacles sit on top of a point of interest; counts need not be whole numbers; a few of all
    numbers are exactly 0 or exactly at a limit.
    """

    def sample(n: int, seed: int) -> dict[str, Array]:
        rng = np.random.default_rng(seed)
        values = {signal.name: _within(signal, n, rng) for signal in planar5_manifest.function("step").inputs}
        seen = evaluate_many("kinematics", {"q": values["q"]})
        chosen = rng.integers(0, 6, (n, 3))
        on_top = np.take_along_axis(seen["point_position"], chosen[:, :, None], axis=1)
        values["obstacle_center"] = np.where(
            rng.random((n, 3, 1)) < 0.5, np.clip(on_top, -1e6, 1e6), values["obstacle_center"]
        )
        values["obstacle_count"] = np.where(rng.random(n) < 0.5, rng.integers(0, 4, n), rng.uniform(0, 3, n))
        angle, (k1, k2) = rng.uniform(0, math.pi, n), 10 ** rng.uniform(-6, 4, (2, n))
        c, s = np.cos(angle), np.sin(angle)
        off = (k1 - k2) * c * s  # R diag(k1, k2) Rᵀ: entries lie within ±max(k1, k2)
        gain = np.array([[k1 * c**2 + k2 * s**2, off], [off, k1 * s**2 + k2 * c**2]])
        values["tool_gain"] = gain.transpose(2, 0, 1)
        return values

    return sample


def _within(signal: SignalInfo, n: int, rng: np.random.Generator) -> Array:
    """Numbers within a signal's limits, (n, *shape), their magnitude log-uniform."""
    low, high = signal.minimum, signal.maximum
    assert low is not None
    assert high is not None
    shape = (n, *signal.shape)
    smallest = low if low > 0 else 1e-12 * high
    array = np.exp(rng.uniform(math.log(smallest), math.log(high), shape))
    if low < 0:
        array *= rng.choice([-1.0, 1.0], shape)
    kind = rng.random(shape)
    array[kind < 0.02] = low
    array[kind > 0.98] = high
    array[(kind > 0.48) & (kind < 0.52)] = max(low, 0.0)
    return np.clip(array, low, high)


@pytest.fixture(scope="session")
def anything() -> Callable[[FunctionInfo, int, int], dict[str, Array]]:
    """Sampler (function, n, seed) of its inputs over their whole limits, every order of magnitude alike.

    Matrices are symmetric positive definite with eigenvalues from 1e-3 to 8e3.
    """

    def sample(info: FunctionInfo, n: int, seed: int) -> dict[str, Array]:
        rng = np.random.default_rng(seed)
        values = {}
        for signal in info.inputs:
            if signal.positive_definite:
                m = signal.shape[0]
                rotation = np.linalg.qr(rng.standard_normal((n, m, m)))[0]
                eigenvalues = 10 ** rng.uniform(-3, 3.9, (n, m))
                values[signal.name] = np.einsum("nij,nj,nkj->nik", rotation, eigenvalues, rotation)
            else:
                values[signal.name] = _within(signal, n, rng)
        return values

    return sample


@pytest.fixture(scope="session")
def one_state() -> Callable[[Mapping[str, Array], int], dict[str, Array]]:
    """State i of many, as the arguments of a single call."""
    return lambda values, i: {name: array[i] for name, array in values.items()}


@pytest.fixture
def paper_run(planar5: CompiledController) -> Callable[[int], Run]:
    """The paper's scenario on the compiled planar5, by the number of the case."""
    scenario = read_scenario(find_scenario("paper"))
    return lambda number: prepare(planar5, scenario, CASES[number])


# ---- A small arm in space ----


def _small_arm(base: bool) -> ControllerSpec:
    turning = {"type": "revolute", "lower": -3.0, "upper": 3.0, "velocity": 3.0}
    sliding = {"type": "prismatic", "lower": -5.0, "upper": 5.0, "velocity": 1.0}
    feet = [
        {"name": "along", "link": "sledge", "axis": [1, 0, 0]},
        {"name": "aside", "link": "base", "axis": [0, 1, 0]},
    ]
    joints = [
        {"name": "turn", "link": "column", "axis": [0, 0, 1]},
        {"name": "lift", "link": "upper", "axis": [0, 1, 0], "xyz": [0, 0, 0.4]},
        {"name": "bend", "link": "lower", "axis": [0, 1, 0], "xyz": [0.5, 0, 0]},
    ]
    return ControllerSpec.parse(
        {
            "name": "small_arm",
            "description": "an arm of three joints in space",
            "period": 0.01,
            "robot": {
                "joints": [sliding | joint for joint in feet if base] + [turning | joint for joint in joints],
                "frames": [{"name": "tip", "link": "lower", "xyz": [0.3, 0, 0]}],
                "points_of_interest": [
                    {"name": "elbow", "link": "lower", "influence_radius": 0.15},
                    {"name": "end", "link": "lower", "offset": [0.3, 0, 0], "influence_radius": 0.1},
                ],
                "bodies": [
                    {"name": "forearm", "link": "lower", "end": [0.3, 0, 0], "radius": 0.05},
                    {"name": "shoulder", "link": "column", "start": [0, 0, 0.4], "radius": 0.08},
                ],
            },
            "obstacles": {"maximum": 2, "capsules": 1, "half_spaces": 1},
            "tasks": [
                {
                    "name": "keep_off",
                    "kind": "obstacle_avoidance",
                    "activation": {"kind": "switched", "gain": 20.0, "damping": 1e-3},
                },
                {"name": "tip", "kind": "frame_position", "frame": "tip", "gain": 4.0},
                {"name": "wrist", "kind": "frame_orientation", "frame": "tip", "gain": 1.0},
            ],
            "filter": {"kind": "first_order", "cutoff": 4.0},
        },
        "small_arm",
    )


@pytest.fixture(scope="session")
def small_arm(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., CompiledController]:
    """An arm of three turning joints, compiled; with a `base` it stands on two sliding ones.

    Its tip and its wrist follow references, past two balls, a capsule and a half-space.
    """

    def load(base: bool = False) -> CompiledController:
        folder = tmp_path_factory.mktemp("small_arm")
        for file, text in generate(_small_arm(base)).items():
            (folder / file).write_text(text)
        return CompiledController.load(folder)

    return load


@pytest.fixture(scope="session")
def small_arm_by_hand() -> Callable[[Array, Array], tuple[Array, Array]]:
    """Shoulder, elbow and tip of the arm that stands at `foot`, (3, 3) [m], and how its wrist is turned, (3, 3)."""

    def places(q: Array, foot: Array) -> tuple[Array, Array]:
        turn, lift, bend = q
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        up = np.array([0.0, 0.0, 1.0])

        def along(angle: float) -> Array:  # a positive turn about y lowers the arm
            return np.cos(angle) * out - np.sin(angle) * up

        shoulder = foot + 0.4 * up
        elbow = shoulder + 0.5 * along(lift)
        wrist = Rotation.from_euler("ZY", [turn, lift + bend]).as_matrix()
        return np.array([shoulder, elbow, elbow + 0.3 * along(lift + bend)]), wrist

    return places
