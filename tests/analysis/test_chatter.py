"""Chatter predicted from the compiled functions, against chatter measured in compiled rollouts.

In most sets the point of interest is led around a disc (or a point) by a reference on a smaller circle: in the
frame that turns with it everything stands still, so v_n and v_t stay what they are. Two slides that carry the tool
make the normal map exact but for O(T³); planar5 adds revolute joints and the redundancy.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex

from clikgen.analysis.chatter import (
    NormalMap,
    compare,
    contact,
    contact_in,
    cycles,
    iterate,
    measure,
    point_index,
    predict,
    sojourn,
    sticking,
    two_point_cycle,
)
from clikgen.analysis.chatter_figures import chatter_plates
from clikgen.analysis.discrete_filter import beta_of
from clikgen.analysis.plates import save_plates
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.references import Line
from clikgen.runtime.scenario import CASES, Obstacle, Scenario, find_scenario, read_scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec

SLIDES = {
    "name": "slides",
    "description": "two slides that carry the tool",
    "period": 0.01,
    "law": "nsb",
    "robot": {
        "space": "planar",
        "joints": [
            {
                "name": name,
                "type": "prismatic",
                "link": f"carriage_{name}",
                "axis": axis,
                "lower": -100.0,
                "upper": 100.0,
                "velocity": 100.0,
            }
            for name, axis in (("x", [1, 0, 0]), ("y", [0, 1, 0]))
        ],
        "frames": [{"name": "tool", "link": "carriage_y"}],
        "points_of_interest": [
            {"name": "tool", "link": "carriage_y", "offset": [0, 0, 0], "influence_radius": 0.2},
            {"name": "corner", "link": "carriage_y", "offset": [5, 5, 0], "influence_radius": 1e-6},
        ],
    },
    "obstacles": {"maximum": 2},
    "tasks": [
        {
            "name": "obstacles",
            "kind": "obstacle_avoidance",
            "activation": {"kind": "switched", "gain": 50.0, "damping": 1e-9},
        },
        {"name": "tool", "kind": "frame_position", "frame": "tool", "gain": 1.0, "damping": 1e-6},
    ],
    "filter": {"kind": "first_order", "cutoff": 4.0},
    "planner": {"lam_free": 0.0, "lam_event": 1.0},
}
FREE_OF_AVOIDANCE = {
    **SLIDES,
    "name": "free_slides",
    "robot": {key: value for key, value in SLIDES["robot"].items() if key != "points_of_interest"},
    "tasks": SLIDES["tasks"][1:],
}
del FREE_OF_AVOIDANCE["obstacles"], FREE_OF_AVOIDANCE["planner"]


def generated(table, folder):
    spec = ControllerSpec.parse(table, "a test's table")
    folder = Path(folder) / spec.name
    folder.mkdir()
    for name, text in generate(spec).items():
        (folder / name).write_text(text)
    return CompiledController.load(folder)


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    return generated(SLIDES, tmp_path_factory.mktemp("generated"))


@pytest.fixture(scope="module")
def arm():
    return CompiledController.load("planar5")


@dataclass(frozen=True)
class Setup:
    """A contact whose normal map has the a and about the c/b wanted, at a speed v_t [m/s] along the boundary."""

    gain_period: float  # K_oT
    ratio: float  # c/b
    case: int = 1
    radius: float = 0.3  # R [m]; 0 is a point
    speed: float = 1.0  # v_t [m/s]
    period: float = 0.01  # T [s]
    cutoff: float = 4.0  # f_c [Hz]
    start: float = 0.0  # depth the tool starts at, in units of b
    robot: str = "slides"
    influence: float = 0.2  # s [m]
    steps: int = 1500
    tracking: float = 1.0  # K_g [1/s]
    tail: float = 2 / 3  # the last share of the run, that is looked at

    def __str__(self):
        kind = "point" if self.radius == 0 else "disc"
        return f"{self.robot}-{kind}-case{self.case}-KoT{self.gain_period:g}-c/b{self.ratio:g}-x{self.start:g}"

    @property
    def rho(self):
        return self.influence + self.radius

    @property
    def beta(self):
        return beta_of(self.cutoff, self.period)

    def wanted_map(self):
        """The map of the section on Cases 2 and 3, second order and all; exact for the slides."""
        inside = 1 if self.case == 1 else self.beta
        c = inside**2 * (self.speed * self.period) ** 2 / (2 * self.rho)
        return NormalMap(1 - inside * self.gain_period / 2, c / self.ratio, c, self.period)

    def scenario(self):
        wanted, inside = self.wanted_map(), 1 if self.case == 1 else self.beta
        outside = self.beta if self.case == 2 else 1
        second_order = outside**2 * (self.speed * self.period) ** 2 / (2 * self.rho)
        v_n = (wanted.b + second_order) / (outside * self.period)
        # A filtered sample goes forward by β only: the reference turns at the rate of the mean over a cycle.
        prediction = predict(wanted)
        samples_outside = prediction.amplitude.mean / wanted.b / prediction.period.mean
        turn = (inside + samples_outside * (outside - inside)) * self.speed / self.rho
        # q̇_g = ṙ + K_g(r − p) is v_t along the boundary and v_n toward it: r along the normal, and across.
        along, across = np.linalg.solve(
            [[turn, self.tracking], [-self.tracking, turn]], [self.speed, v_n - self.tracking * self.rho]
        )
        reference = {
            "kind": "circle",
            "center": [0.0, 0.0],
            "radius": math.hypot(along, across),
            "period": 2 * math.pi / turn,
            "phase": math.pi + math.atan2(across, along),
        }
        parameters = {
            "period": self.period,
            "obstacles_gain": self.gain_period / self.period,
            "tool_gain": self.tracking,
            "filter_cutoff": self.cutoff,
        }
        tool = [-(self.rho - self.start * wanted.b), 0.0]
        return scene(self.robot, self.steps * self.period, tool, reference, [(0.0, 0.0, self.radius)], parameters)

    @property
    def settled(self):
        """From and to [s]."""
        return (1 - self.tail) * self.steps * self.period, self.steps * self.period

    def rollout(self, controller):
        return prepare(controller, self.scenario(), CASES[self.case]).in_c()


ARM = (0.6, -1.2)  # shoulder and elbow of planar5 at the start [rad]
ARM_REACH = (0.2 + 0.5 * math.cos(0.6) + 0.4 * math.cos(0.6), 0.5 * math.sin(0.6) - 0.4 * math.sin(0.6))  # [m]


def scene(robot, duration, tool, reference, obstacles, parameters, influence=0.2):
    """A scenario in which the tool alone has an influence region, and starts where told."""
    radii = [influence, 1e-6] if robot == "slides" else [1e-6] * 5 + [influence]
    q0 = tool if robot == "slides" else [tool[0] - ARM_REACH[0], tool[1] - ARM_REACH[1], 0.0, *ARM]
    table = {
        "name": "contact",
        "description": "",
        "controller": robot,
        "duration": duration,
        "q0": tuple(float(value) for value in q0),
        "parameters": {"obstacles_damping": 1e-9, "influence_radius": radii, **parameters},
        "references": {"tool": reference},
        "obstacles": tuple({"center": (x, y), "radius": radius} for x, y, radius in obstacles),
    }
    return Scenario.parse(table, "a test's scenario")


CYCLING = [
    # sawtooth, from long to short
    Setup(0.05, 0.02, tracking=4.0),
    Setup(0.1, 0.1),
    Setup(0.5, 0.02, tracking=4.0),
    Setup(0.5, 0.1),
    Setup(1.0, 0.05, speed=0.5),
    Setup(1.0, 0.2),
    Setup(1.5, 0.1),
    Setup(0.3, 0.3, radius=0.0, speed=0.5),
    Setup(0.8, 0.02, radius=0.0, speed=0.2),
    # every other sample, for K_oT < 2 and > 2
    Setup(1.0, 0.7),
    Setup(1.5, 0.4),
    Setup(1.5, 0.5, radius=0.0, speed=0.5),
    Setup(1.9, 0.2),
    Setup(2.2, 0.05),
    Setup(2.5, 0.02, tracking=4.0),
    Setup(2.5, 0.3, radius=0.0, speed=0.5),
    Setup(3.0, 0.1),
    Setup(3.5, 0.1),
    # long runs outside, for K_oT < 2 and > 2, and next to a two-cycle
    Setup(0.2, 2.5, speed=0.8),
    Setup(1.0, 3.3),
    Setup(1.5, 1.4),
    Setup(1.7, 2.4, radius=0.0, speed=0.6),
    Setup(2.4, 4.5),
    Setup(3.0, 2.3),
    Setup(3.0, 0.75, start=0.9),
    # aperiodic
    Setup(4.5, 0.02, speed=0.5, steps=9000),
    Setup(5.0, 0.3, steps=9000),
    Setup(5.5, 0.1, radius=0.0, speed=0.4, steps=9000),
    Setup(6.5, 0.5, steps=9000),
    # Case 2
    Setup(0.5, 0.1, case=2),
    Setup(2.5, 0.05, case=2),
    Setup(2.5, 0.9, case=2),
    Setup(5.5, 2.5, case=2),
    Setup(14.0, 0.1, case=2),
    Setup(24.0, 0.2, case=2, steps=9000),
    # Case 3
    Setup(0.5, 0.004, case=3, tracking=8.0),
    Setup(2.5, 0.002, case=3, tracking=8.0),
    Setup(2.5, 0.02, case=3, tracking=8.0, cutoff=16.0, radius=0.0, speed=0.4),
    Setup(2.5, 0.4, case=3, tracking=8.0, cutoff=40.0),
    Setup(14.0, 0.01, case=3, tracking=8.0),
    Setup(24.0, 0.002, case=3, speed=0.5, tracking=4.0, steps=9000),
    # planar5, whose base follows the tool along a part of a large disc
    *(
        Setup(gain_period, ratio, case, 2.0, 0.4, tracking=tracking, robot="planar5", steps=480)
        for gain_period, ratio, case, tracking in (
            (0.5, 0.02, 1, 1.0),
            (1.0, 0.1, 1, 1.0),
            (1.5, 0.5, 1, 1.0),
            (2.5, 0.02, 1, 1.0),
            (2.5, 0.05, 2, 1.0),
            (2.5, 0.002, 3, 8.0),
        )
    ),
    # its curvature varies along the way; a short stretch, as more samples outside or fewer are other cycles
    Setup(2.4, 2.2, radius=2.0, speed=0.4, robot="planar5", steps=480, tail=0.2),
    Setup(5.0, 0.1, radius=2.0, speed=0.1, robot="planar5", steps=1920),
]


@pytest.fixture(scope="module")
def robots(slides, arm):
    return {"slides": slides, "planar5": arm}


# ---- Prediction against measurement ----


@pytest.mark.parametrize("setup", CYCLING, ids=str)
def test_regime_period_and_amplitude_are_as_predicted(setup, robots):
    controller = robots[setup.robot]
    (comparison,) = compare(controller, setup.rollout(controller), setup.settled)
    measured, predicted = comparison.measured, comparison.prediction
    assert measured.single
    assert measured.regime == predicted.regime
    assert predicted.period.low - 1 <= measured.period.mean <= predicted.period.high + 1
    if predicted.regime == "Nyquist two-cycle":
        assert measured.period.low == measured.period.high == 2
    # v_n and v_t vary by K_gT·c/b and along the way; what is aperiodic is a mean of a few hundred cycles or more
    assert measured.period.mean == pytest.approx(predicted.period.mean, rel=0.05)
    assert measured.amplitude.mean == pytest.approx(predicted.amplitude.mean, rel=0.05)
    assert measured.frequency == pytest.approx(predicted.frequency, rel=0.05)


def test_sets_cover_every_regime_case_obstacle_and_robot():
    kinds = [predict(setup.wanted_map(), setup.start * setup.wanted_map().b or None).regime for setup in CYCLING]
    for regime in ("sawtooth", "Nyquist two-cycle", "long runs outside", "aperiodic"):
        assert kinds.count(regime) >= 5
    assert len(STAYING) + len(LEAVING) >= 5  # regime "none"
    assert {(setup.case, setup.robot) for setup in CYCLING} == {
        (case, robot) for case in (1, 2, 3) for robot in ("slides", "planar5")
    }
    assert {setup.radius == 0 for setup in CYCLING} == {True, False}
    negative = [setup.wanted_map().a < 0 for setup in CYCLING]
    for regime in ("Nyquist two-cycle", "long runs outside"):  # on both sides of K_oT = 2
        assert {side for side, kind in zip(negative, kinds, strict=True) if kind == regime} == {True, False}


def straight(robot, goal, obstacles, parameters, tool=(-0.55, 0.0), duration=6.0, **options):
    """The tool is drawn to a fixed goal [m]."""
    reference = {"kind": "fixed", "position": tuple(goal)}
    return scene(robot, duration, tool, reference, obstacles, parameters, **options)


DISC = [(0.0, 0.0, 0.3)]
STAYING = {  # c = 0: drawn straight at the obstacle, the point stays where it first got in
    "slides": straight("slides", (-0.4, 0.0), DISC, {"obstacles_gain": 50.0}),
    "slides at a point": straight("slides", (-0.1, 0.0), [(0.0, 0.0, 0.0)], {"obstacles_gain": 20.0}),
    "planar5": straight("planar5", (-0.4, 0.0), DISC, {"obstacles_gain": 50.0}),
}
LEAVING = {  # b < 0: the task pulls away, out of a contact of the start
    "slides": straight("slides", (-0.8, 0.3), DISC, {"obstacles_gain": 100.0}, tool=(-0.499999, 0.0)),
    "slides along": straight("slides", (-0.5, 0.8), DISC, {"obstacles_gain": 20.0}, tool=(-0.4999, 0.0)),
    "planar5": straight("planar5", (-0.8, 0.3), DISC, {"obstacles_gain": 100.0}, tool=(-0.499999, 0.0)),
}


@pytest.mark.parametrize("name", STAYING)
def test_point_drawn_straight_at_an_obstacle_stays_without_chatter(name, robots):
    controller = robots[name.split()[0]]
    rollout = prepare(controller, STAYING[name], CASES[1]).in_c()
    (comparison,) = compare(controller, rollout, (3.0, 6.0))
    assert comparison.map.b > 0
    assert comparison.prediction.regime == comparison.measured.regime == "none"
    # (2 v_n l²/K_o)^(1/3), l = damping/nu: there the damping of J_o⁺ lets through what K_o pushes back
    assert comparison.prediction.settles_at == pytest.approx(comparison.measured.depth[-1], rel=0.05)
    leak, a = comparison.map.leak, comparison.map.a
    assert comparison.measured.depth[-1] == pytest.approx((leak / (1 - a)) ** (1 / 3), rel=0.05)


@pytest.mark.parametrize("name", LEAVING)
def test_point_drawn_away_leaves_without_chatter(name, robots):
    controller = robots[name.split()[0]]
    rollout = prepare(controller, LEAVING[name], CASES[1]).in_c()
    (comparison,) = compare(controller, rollout)
    assert comparison.map.b < 0
    assert comparison.prediction.regime == comparison.measured.regime == "none"
    assert rollout.signals["clearance"][-1] > 0.01


@pytest.mark.parametrize("gain", [10.0, 50.0, 150.0, 250.0])
def test_obstacle_that_comes_nearer_is_held_off_at_the_depth_predicted(gain, slides):
    """c = −T·speed < 0: the point settles inside at 2·speed/K_o, K_oT = 2.5 included: there a is negative."""
    speed = 0.05
    still = straight("slides", (-0.48, 0.0), DISC, {"obstacles_gain": gain}, tool=(-0.5, 0.0))
    path = Line(kind="line", start=(0.0, 0.0), end=(-0.5, 0.0), duration=0.5 / speed)
    scenario = still.model_copy(update={"obstacles": (Obstacle(radius=0.3, path=path),)})
    (comparison,) = compare(slides, prepare(slides, scenario, CASES[1]).in_c(), (3.0, 5.0))
    assert comparison.prediction.regime == comparison.measured.regime == "none"
    assert comparison.prediction.settles_at == pytest.approx(2 * speed / gain, rel=1e-6)
    assert comparison.measured.depth[-1] == pytest.approx(2 * speed / gain, rel=1e-6)


@pytest.mark.parametrize(("start", "regime", "samples"), [(0.3, "Nyquist two-cycle", 2), (0.9, "long runs outside", 3)])
def test_entry_depth_decides_between_two_stable_cycles(start, regime, samples, slides):
    """Above K_oT = 2 a second cycle, of 3 samples and twice the amplitude, is stable for c > (1 − |a|)b."""
    setup = Setup(3.0, 0.75, start=start)
    (comparison,) = compare(slides, setup.rollout(slides))
    assert comparison.prediction.regime == comparison.measured.regime == regime
    assert {comparison.prediction.rival, regime} == {"Nyquist two-cycle", "long runs outside"}
    assert comparison.measured.period.mean == samples
    assert comparison.measured.amplitude.mean == pytest.approx((samples - 1) * comparison.map.b, rel=0.02)
    assert 0.3 < comparison.prediction.divide / comparison.map.b < 0.9


@pytest.mark.parametrize(("damping", "regime"), [(1e-9, "sawtooth"), (3e-7, "sawtooth"), (1e-5, "none")])
def test_damping_of_the_avoidance_task_ends_a_sawtooth_of_little_drift(damping, regime, slides):
    """Where c√c is far below ℓ√b(1 + a)/2 the point stays where leak/x² = c + (1 − a)x."""
    setup = Setup(0.5, 0.02, speed=0.3, tracking=4.0)
    scenario = setup.scenario()
    scenario = scenario.model_copy(update={"parameters": {**scenario.parameters, "obstacles_damping": damping}})
    (comparison,) = compare(slides, prepare(slides, scenario, CASES[1]).in_c(), setup.settled)
    a, b, c = comparison.map.a, comparison.map.b, comparison.map.c
    assert (c**1.5 < damping * math.sqrt(b) * (1 + a) / 2) == (regime == "none")
    assert comparison.prediction.regime == comparison.measured.regime == regime
    if regime == "none":
        assert comparison.measured.depth[-1] == pytest.approx(comparison.prediction.settles_at, rel=0.05)


# ---- What the filter does ----


FILTER_PAIRS = [(0.5, 0.02), (1.0, 0.02), (1.5, 0.01)]  # K_oT, c/b in Case 1


@pytest.mark.parametrize(("gain_period", "ratio"), FILTER_PAIRS)
def test_case_2_scales_the_amplitude_by_beta_and_case_3_leaves_it(gain_period, ratio, slides):
    """At the same v_n and v_t: amplitude b, βb and b; N_in(β) = ln(1 + b/(βx_f))/(−ln(1 − βK_oT/2)) in Case 3."""
    setups = {
        1: Setup(gain_period, ratio, speed=0.3, tracking=4.0),
        2: Setup(gain_period, ratio * beta_of(4.0, 0.01), case=2, speed=0.3, tracking=4.0),
        3: Setup(gain_period, ratio * beta_of(4.0, 0.01) ** 2, case=3, speed=0.3, tracking=4.0),
    }
    found = {n: compare(slides, setup.rollout(slides), setup.settled)[0] for n, setup in setups.items()}
    beta = setups[1].beta
    amplitude = {n: each.measured.amplitude.mean for n, each in found.items()}
    assert amplitude[2] == pytest.approx(beta * amplitude[1], rel=0.05)
    assert amplitude[3] == pytest.approx(amplitude[1], rel=0.05)
    unfiltered = found[1].map
    inside = math.log1p(unfiltered.b / (beta * unfiltered.x_f)) / -math.log(1 - beta * gain_period / 2)
    assert found[3].measured.period.mean - 1 == pytest.approx(inside, abs=1)
    assert found[2].measured.period.mean > 2 * found[1].measured.period.mean  # slower, about 1/β times


@pytest.mark.parametrize("robot", ["slides", "planar5"])
def test_map_of_cases_2_and_3_is_the_filtered_map_of_case_1(robot, robots):
    setup = Setup(2.5, 0.1, robot=robot)
    rollout = setup.rollout(robots[robot])
    values = state_of(robots[robot], setup, rollout, 10)
    at = {n: contact(robots[robot], values, "tool", CASES[n]) for n in (1, 2, 3)}
    beta = beta_of(setup.cutoff, setup.period)
    assert all(each.beta == pytest.approx(beta, rel=1e-9) for each in at.values())
    for n in (2, 3):
        filtered = at[1].map.filtered(beta, outside=n == 2)
        assert at[n].map.a == pytest.approx(filtered.a, abs=1e-12) == pytest.approx(1 - beta * 1.25, abs=1e-9)
        # finite differences of the Jacobian, and the damping of J_o⁺ at the probe, leave 1e-9 of T v
        assert at[n].map.c == pytest.approx(filtered.c, abs=1e-10)
    assert at[3].map.b == at[1].map.b
    second_order = at[1].map.b - at[1].v_n * setup.period
    assert at[2].map.b == pytest.approx(beta * at[1].v_n * setup.period + beta**2 * second_order, rel=1e-6)


def state_of(controller, setup, rollout, step):
    """What the step is fed at one moment of a rollout, q on the boundary."""
    run = prepare(controller, setup.scenario(), CASES[1])
    shapes = {signal.name: signal.shape for signal in controller.step.info.inputs}
    values = {name: value if value.shape == shapes[name] else value[step] for name, value in run.values.items()}
    q = rollout.q[step].copy()
    for _ in range(4):  # Newton along j onto the boundary
        seen = controller.kinematics(q=q)["point_position"][point_index(controller.manifest, "tool")]
        way = values["obstacle_center"][0] - seen
        u = way / np.linalg.norm(way)
        J = controller.jacobians(q=q)["point_jacobian"][point_index(controller.manifest, "tool")]
        j = J.T @ u
        q -= j * (setup.rho - np.linalg.norm(way)) / (j @ j)
    return values | {"q": q}


def test_filter_with_other_cutoffs_in_other_joints_is_in_the_map(slides):
    """Then A_β P q̇_g has a part along the normal: a drift inside of first order in T."""
    setup = Setup(1.0, 0.1)
    values = state_of(slides, setup, setup.rollout(slides), 10)
    # on a normal between the axes; along an axis the two joints do not mix
    values["q"] = setup.rho * np.array([-math.cos(0.7), -math.sin(0.7)])
    values["filter_cutoff"] = np.array([4.0, 40.0])
    at = contact(slides, values, "tool", CASES[3])
    beta = np.array([beta_of(4.0, 0.01), beta_of(40.0, 0.01)])
    assert at.map.a == pytest.approx(1 - at.toward**2 @ beta * setup.gain_period / 2, rel=1e-9)
    assert at.map.c == pytest.approx(-setup.period * at.toward @ (beta * at.dq_held), rel=0.05)  # c is second order


# ---- The normal map itself ----


@pytest.mark.parametrize("depth", [1e-1, 1e-2, 1e-3, 1e-4, 1e-5])
@pytest.mark.parametrize("robot", ["slides", "planar5"])
def test_command_jumps_by_v_n_over_nu_however_small_the_depth(depth, robot, robots):
    setup, controller = Setup(0.0, 0.1, robot=robot), robots[robot]
    values = state_of(controller, setup, setup.rollout(controller), 20)
    at = contact(controller, values, "tool", CASES[1])
    radii = values["influence_radius"].copy()
    radii[point_index(controller.manifest, "tool")] = at.distance + depth
    inside = controller.step(**values | {"influence_radius": radii})["dq_law"].copy()
    outside = controller.step(**values | {"obstacle_count": np.array(0.0)})["dq_law"].copy()
    # the damping 1e-9 m² takes (1e-9/(1e-5 nu))² of it at the least depth
    assert np.linalg.norm(inside - outside) == pytest.approx(at.jump, rel=1e-7)
    assert at.jump == pytest.approx(abs(at.v_n) / at.nu, rel=1e-12)


@pytest.mark.parametrize("robot", ["slides", "planar5"])
@pytest.mark.parametrize("side", ["inside", "outside"])
def test_one_step_residual_falls_by_eight_per_halving_of_the_sampling_time(robot, side, robots):
    """At depths that shrink with the map's own: x = b/2 inside, −c/2 outside; so the residual is O(T³)."""
    controller = robots[robot]
    residuals = []
    setup = Setup(0.5, 0.05, speed=0.5, robot=robot, tracking=4.0)
    state = state_of(controller, setup, setup.rollout(controller), 10)
    index = point_index(controller.manifest, "tool")
    for period in 0.005 / 2.0 ** np.arange(4):
        values = state | {"period": np.array(period), "lam_event": np.array(0.0)}
        at = contact(controller, values, "tool")
        x = at.map.b / 2 if side == "inside" else -abs(at.map.c) / 2
        for _ in range(4):
            distance = controller.step(**values)["distance"][index]
            values["q"] = values["q"] + at.approach * (x - (setup.influence - distance)) / (at.nu**2)
        q_next = controller.step(**values)["q_next"].copy()
        x_next = setup.influence - controller.step(**values | {"q": q_next})["distance"][index]
        residuals.append(abs(x_next - at.map(x)))
    factors = np.array(residuals[:-1]) / np.array(residuals[1:])
    assert residuals[-1] > 1e-12  # or rounding would be compared
    assert factors == pytest.approx(8.0, rel=0.1)  # the fourth order is a tenth of the third at T = 0.005 s


def test_period_for_small_gain_tends_to_a_time_that_does_not_depend_on_the_sampling_time():
    """(2/K_o) ln(1 + K_o v_n ρ/v_t²) as K_oT → 0, and an amplitude that goes with T."""
    gain, v_n, v_t, rho = 5.0, 0.3, 1.0, 0.5
    for T in (1e-3, 1e-4, 1e-5):
        normal_map = NormalMap(1 - gain * T / 2, v_n * T, T**2 * v_t**2 / (2 * rho), T)
        prediction = predict(normal_map)
        assert prediction.regime == "sawtooth"
        limit = 2 / gain * math.log1p(gain * v_n * rho / v_t**2)
        assert 1 / prediction.frequency == pytest.approx(limit, abs=3 * T)
        assert prediction.amplitude.mean == pytest.approx(v_n * T, rel=1e-9)


# ---- Closed forms against the map, iterated ----


def maps(seed, count, a, c_over_b):
    """Random maps with a and c/b within the ranges."""
    rng = np.random.default_rng(seed)
    b = 10 ** rng.uniform(-6, -2, count)
    return [
        NormalMap(float(each), float(step), float(step * share), 0.01)
        for each, step, share in zip(rng.uniform(*a, count), b, rng.uniform(*c_over_b, count), strict=True)
    ]


def test_every_period_of_a_sawtooth_lies_within_its_closed_form():
    for normal_map in maps(1, 200, (0.05, 1.0), (0.01, 0.99)):
        depths = iterate(normal_map, normal_map.b / 3, 3000)[500:]
        lengths, rises = cycles(depths)
        low, high = sojourn(normal_map, normal_map.b - normal_map.c), sojourn(normal_map, normal_map.b)
        assert low <= lengths.min() <= lengths.max() <= high
        assert rises == pytest.approx(normal_map.b, rel=1e-9)
        assert depths.min() >= -normal_map.c * (1 + 1e-12)
        assert depths.max() <= normal_map.b * (1 + 1e-12)
        two = normal_map.a * normal_map.b <= normal_map.c  # one sample each way from every entry
        assert predict(normal_map).regime == ("Nyquist two-cycle" if two else "sawtooth")
        assert np.all(lengths == 2) == two


def test_runs_outside_are_as_long_as_their_closed_form():
    for normal_map in maps(2, 200, (0.0, 1.0), (1.01, 6.0)):
        prediction = predict(normal_map)
        lengths, rises = cycles(iterate(normal_map, normal_map.b / 3, 3000)[500:])
        assert prediction.regime == "long runs outside"
        assert prediction.period.low <= lengths.min() <= lengths.max() <= prediction.period.high
        assert rises / normal_map.b == pytest.approx(np.round(rises / normal_map.b), rel=1e-9)


def test_entries_part_where_the_closed_form_says_for_gains_above_two():
    rivals = 0
    for normal_map in maps(3, 300, (-0.98, -0.02), (-1.2, 4.0)):
        for share in (0.02, 0.35, 0.65, 0.98):
            entry = share * normal_map.b
            prediction = predict(normal_map, entry)
            depths = iterate(normal_map, entry, 4000)[3000:]
            lengths, rises = cycles(depths)
            if prediction.regime == "none":
                assert lengths.size == 0
                assert depths[-1] == pytest.approx(prediction.settles_at, abs=1e-6 * normal_map.b)
                continue
            assert np.all(lengths == prediction.period.mean)
            assert rises == pytest.approx(prediction.amplitude.mean, rel=1e-6)
            assert (prediction.regime == "Nyquist two-cycle") == (lengths[0] == 2)
            rivals += prediction.rival is not None
    assert rivals > 50


def test_without_an_entry_the_cycle_that_most_entries_lead_to_is_predicted():
    for normal_map in maps(4, 100, (-0.98, -0.3), (0.0, 3.0)):
        reached = [predict(normal_map, share * normal_map.b).period for share in np.linspace(0.005, 0.995, 100)]
        counts = {span.mean: reached.count(span) for span in reached}
        if max(counts.values()) > 52:
            assert predict(normal_map).period.mean == max(counts, key=counts.get)


def test_gain_above_four_over_the_period_stays_bounded_and_never_repeats():
    for normal_map in maps(5, 50, (-3.0, -1.1), (0.0, 2.0)):
        assert predict(normal_map).regime == "aperiodic"
        depths = iterate(normal_map, 0.4 * normal_map.b, 5000)
        assert depths.max() <= normal_map.b * (1 + 1e-12)
        assert depths.min() >= normal_map.a * normal_map.b - normal_map.c - 1e-12 * normal_map.b
        neighbours = iterate(normal_map, 0.4 * normal_map.b * (1 + 1e-9), 5000)
        assert np.abs(depths - neighbours)[2000:].max() > 0.1 * normal_map.b  # they part, and stay apart


@pytest.mark.parametrize(
    ("normal_map", "settles_at"),
    [
        (NormalMap(0.5, -1e-3, 1e-4, 0.01), None),  # away, and out
        (NormalMap(0.5, 1e-3, 0.0, 0.01), 0.0),
        (NormalMap(0.5, 1e-3, -1e-4, 0.01), 2e-4),
        (NormalMap(-0.5, 1e-3, -2e-3, 0.01), 2e-3 / 1.5),
        (NormalMap(1.0, 1e-3, -1e-4, 0.01), None),  # K_o = 0: deeper and deeper
    ],
)
def test_map_without_a_cycle_says_where_the_point_settles(normal_map, settles_at):
    prediction = predict(normal_map)
    assert prediction.regime == "none"
    assert prediction.period is prediction.amplitude is prediction.frequency is None
    assert prediction.settles_at == (None if settles_at is None else pytest.approx(settles_at, abs=1e-15))


# ---- Two points ----


def corner(gain_period, cutoff=4.0, speed=0.1, duration=8.0, tilt=0.0):
    """Both points between two large discs, one ahead along x and one along y; the goal far away diagonally."""
    angle = math.pi / 4 + tilt
    far = 50.0
    return straight(
        "slides",
        (far * math.cos(angle), far * math.sin(angle)),
        [(3.2, 0.0, 3.0), (5.0, 8.2, 3.0)],
        {
            "obstacles_gain": gain_period / 0.01,
            "tool_gain": speed / far,
            "influence_radius": [0.2, 0.2],
            "filter_cutoff": cutoff,
        },
        tool=(-0.0002, -0.0003),
        duration=duration,
    )


@pytest.mark.parametrize("gain_period", [0.2, 0.5, 1.0, 1.5, 1.9])
@pytest.mark.parametrize("case", [1, 2])
def test_two_orthonormal_normals_chatter_at_nyquist_at_any_gain(gain_period, case, slides):
    rollout = prepare(slides, corner(gain_period), CASES[case]).in_c()
    (measured,) = measure(rollout, (5.0, 8.0))
    beta = 1.0 if case == 1 else beta_of(4.0, 0.01)
    predicted = two_point_cycle(0.1, gain_period / 0.01, 0.01, beta)
    depths = rollout.parameters["influence_radius"] - rollout.signals["distance"][500:]
    assert measured.points == ("tool", "corner")
    assert not measured.single
    assert measured.regime == "Nyquist two-cycle"
    assert measured.frequency == pytest.approx(predicted.frequency)
    # the goal is 50 m away and the discs are of 3 m: direction and normals turn by less than 1 %
    assert np.linalg.norm(depths, axis=1) == pytest.approx(predicted.depth, rel=0.02)
    assert measured.amplitude.mean == pytest.approx(predicted.step, rel=0.02)
    assert compare(slides, rollout, (5.0, 8.0)) == ()


def test_two_points_off_the_diagonal_leave_the_cycle_where_predicted():
    assert two_point_cycle(0.1, 100.0, 0.01).depth == pytest.approx(1e-3 / math.sqrt(3))
    with pytest.raises(BadInput, match="no cycle with both points in contact: wanted a bearing within"):
        two_point_cycle(0.1, 100.0, 0.01, bearing=0.3)
    with pytest.raises(BadInput, match="no cycle"):
        two_point_cycle(0.1, 201.0, 0.01)
    with pytest.raises(BadInput, match="wanted speed, gain and period above 0"):
        two_point_cycle(0.0, 100.0, 0.01)


# ---- Sticking ----


def test_goal_inside_the_region_ends_in_a_rest_at_the_boundary_point_nearest_to_it(slides):
    scenario = straight("slides", (-0.24, 0.32), DISC, {"obstacles_gain": 50.0, "tool_gain": 4.0}, tool=(-0.7, 0.0))
    rollout = prepare(slides, scenario, CASES[1]).in_c()
    stuck = sticking(slides, rollout)
    assert stuck is not None
    assert rollout.position[-1] == pytest.approx([-0.3, 0.4], abs=1e-3)  # 0.5 m from the centre, toward the goal
    assert (stuck.point, stuck.obstacle, stuck.hold) == ("tool", 0, None)
    assert stuck.v_n > 0
    assert stuck.error == pytest.approx(0.1, abs=1e-3)
    assert stuck.end == pytest.approx(rollout.t[-1] + rollout.period)
    assert "no motion along the boundary comes nearer to the goal" in stuck.explanation


@pytest.mark.parametrize("case", [1, 3])
@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_goal_away_from_the_obstacle_holds_the_point_until_the_damping_lets_go(case, gain, slides):
    """Eq. 11 projects out motion away from the obstacle as well; by K_o alone the depth never gets to zero."""
    beta = 1.0 if case == 1 else beta_of(16.0, 0.01)
    parameters = {"obstacles_gain": gain, "tool_gain": 4.0, "obstacles_damping": 1e-6, "filter_cutoff": 16.0}
    scenario = straight("slides", (-1.5, 0.0), DISC, parameters, tool=(-0.46, 0.03), duration=30.0)
    rollout = prepare(slides, scenario, CASES[case]).in_c()
    stuck = sticking(slides, rollout)
    assert stuck is not None
    assert stuck.v_n < 0
    assert "eq. 11 takes out all motion along the normal, away from the obstacle" in stuck.explanation
    left = int(np.argmax(~rollout.active)) * rollout.period  # when it got out in the end
    assert stuck.begin + stuck.hold == pytest.approx(left, rel=0.03)  # the depth decays in steps of βK_oT/2
    assert stuck.end == pytest.approx(left, abs=1.0)
    assert stuck.hold > 8 / (gain * beta)  # many time constants 2/(βK_o)
    assert np.linalg.norm(rollout.error[-1]) < 1e-3  # and reached its goal


def test_chatter_on_the_spot_is_a_rest_too(arm):
    """planar5 as it ships, K_oT = 2.5, drawn straight at an obstacle: it alternates, and comes no nearer."""
    parameters = {"obstacles_gain": 250.0, "tool_gain": 4.0}
    scenario = straight("planar5", (-0.35, 0.0), DISC, parameters, tool=(-0.7, 0.0))
    rollout = prepare(arm, scenario, CASES[1]).in_c()
    stuck = sticking(arm, rollout)
    assert stuck is not None
    assert measure(rollout, (4.0, 6.0))[0].regime == "Nyquist two-cycle"
    assert stuck.error == pytest.approx(0.15, abs=0.01)


def test_tracking_that_gets_where_it_should_is_not_sticking(slides, paper_run, planar5):
    scenario = straight("slides", (-0.55, 0.4), DISC, {"obstacles_gain": 50.0, "tool_gain": 4.0}, tool=(-0.6, -0.3))
    assert sticking(slides, prepare(slides, scenario, CASES[1]).in_c()) is None
    assert sticking(planar5, paper_run(3).in_c()) is None


# ---- The paper's scenario, and bad input ----


@pytest.mark.parametrize(("case", "regime"), [(1, "Nyquist two-cycle"), (2, "sawtooth"), (3, "sawtooth")])
def test_regimes_of_the_paper_scenario_are_as_predicted(case, regime, planar5, paper_run):
    """K_oT = 2.5 without the filter; with it βK_oT = 0.5, and a sawtooth is left."""
    comparisons = compare(planar5, paper_run(case).in_c())
    assert [each.measured.points for each in comparisons] == [("tool",), ("base_right",)]
    for each in comparisons:
        assert each.prediction.regime == each.measured.regime == regime
        # v_n changes along an encounter, which the map is averaged over: 12 % of the period, as for one contact
        assert each.measured.period.mean == pytest.approx(each.prediction.period.mean, rel=0.12)


@pytest.mark.parametrize("case", [2, 3])
def test_damping_of_the_avoidance_task_hides_the_sawtooth(case, planar5):
    """At 1e-6 m² the damping of J_o⁺ holds the point at some micrometres, and the paper's cases look calm."""
    scenario = read_scenario(find_scenario("paper"), ["obstacles_damping=1e-6"])
    comparisons = compare(planar5, prepare(planar5, scenario, CASES[case]).in_c())
    for each in comparisons:
        assert each.prediction.regime == each.measured.regime == "none"
        assert 0 < each.prediction.settles_at < 1e-4
        assert predict(replace(each.map, leak=0.0)).regime == "sawtooth"


def test_contact_in_a_rollout_is_the_contact_at_its_state(slides):
    setup = Setup(1.0, 0.2)
    rollout = setup.rollout(slides)
    at = contact_in(slides, rollout, 10, "tool")
    same = contact(slides, state_of(slides, setup, rollout, 10), "tool")
    assert at.map == same.map
    assert at.distance == pytest.approx(setup.influence, abs=1e-12)
    wanted = setup.wanted_map()
    assert (at.map.a, at.map.b, at.map.c) == pytest.approx((wanted.a, wanted.b, wanted.c), rel=0.05)


def test_bad_input_is_one_line_that_says_what_is_wrong(slides, tmp_path):
    setup = Setup(1.0, 0.2)
    rollout = setup.rollout(slides)
    values = state_of(slides, setup, rollout, 10)
    with pytest.raises(BadInput, match="no point of interest 'elbow'; valid choices: corner, tool"):
        contact(slides, values, "elbow")
    with pytest.raises(BadInput, match="wanted an obstacle for a contact, got none"):
        contact(slides, values | {"obstacle_count": np.array(0.0)}, "tool")
    with pytest.raises(BadInput, match="sits on the centre of obstacle 0"):
        contact(slides, values | {"q": values["obstacle_center"][0]}, "tool")
    with pytest.raises(BadInput, match="too short to measure chatter in: wanted 16 samples, got 3"):
        measure(rollout, (1.0, 1.03))
    with pytest.raises(BadInput, match="no point of interest met an obstacle"):
        measure(replace(rollout, signals={**rollout.signals, "active": np.zeros(len(rollout.t))}))
    free = generated(FREE_OF_AVOIDANCE, tmp_path)
    with pytest.raises(BadInput, match="free_slides: wanted a task of kind 'obstacle_avoidance', got frame_position"):
        contact(free, {"q": np.zeros(2)}, "tool")
    with pytest.raises(BadInput, match="obstacle_avoidance"):
        measure(replace(rollout, manifest=free.manifest))
    with pytest.raises(BadInput, match="obstacle_avoidance"):
        sticking(free, replace(rollout, manifest=free.manifest))
    short = prepare(slides, setup.scenario().model_copy(update={"duration": 0.2}), CASES[1]).in_c()
    with pytest.raises(BadInput, match="too short to see a rest in: wanted 50 samples, got 20"):
        sticking(slides, short)


# ---- Pictures ----


@pytest.fixture(scope="module")
def examples(slides):
    chosen = {(0.5, 0.1), (2.5, 0.02), (1.5, 1.4), (5.0, 0.3)}
    setups = [setup for setup in CYCLING if (setup.gain_period, setup.ratio) in chosen]
    setups = [setup for setup in setups if setup.robot == "slides" and setup.case == 1]
    return [compare(slides, setup.rollout(slides), setup.settled)[0] for setup in setups]


def test_pictures_show_every_regime_with_its_data(examples, tmp_path):
    plates = chatter_plates(examples)
    assert [plate.name for plate in plates] == ["chatter_regimes", "chatter_agreement", "chatter_examples"]
    regimes, agreement, depths = plates
    assert f"{len(examples)} compiled rollouts, of which 0 fell into another regime" in regimes.caption
    assert len(regimes.data["c/b"]) == len(agreement.data["measured period [samples]"]) == len(examples) == 4
    assert len(depths.figure.axes) == 4
    assert {path.suffix for path in save_plates(plates, tmp_path)} == {".png", ".svg", ".csv"}


def test_areas_of_the_regime_map_are_those_that_are_predicted(examples):
    """A point of the plane has the colour of the regime that `predict` gives there."""
    axes = chatter_plates(examples)[0].figure.axes[0]
    colours = {"#0072b2": "sawtooth", "#d55e00": "Nyquist two-cycle"}
    colours |= {"#009e73": "long runs outside", "#cc79a7": "aperiodic"}
    areas = [
        (colours[to_hex(area.get_facecolor()[0])], area.get_paths()[0])
        for area in axes.collections
        if area.get_facecolor().size and area.get_facecolor()[0][3] > 0
    ]
    rng = np.random.default_rng(0)
    for gain_period, ratio in zip(rng.uniform(0.05, 5.9, 60), 10 ** rng.uniform(-2.5, 0.9, 60), strict=True):
        here = [regime for regime, path in areas if path.contains_point((gain_period, ratio))]
        shallow = predict(NormalMap(1 - gain_period / 2, 1.0, ratio, 0.01), 1e-6)
        assert here == [shallow.regime]


def test_pictures_need_a_contact_that_chatters():
    with pytest.raises(BadInput, match="no contact that chatters"):
        chatter_plates([])
