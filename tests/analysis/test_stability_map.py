"""Measured boundaries of the compiled loop against the linear ones, and what the map says of tracking."""

import numpy as np
import pytest

from clikgen.analysis.certificate import certify
from clikgen.analysis.certificate_figures import certificate_figures
from clikgen.analysis.stability_map import boundary, stability_map, tracking_map
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.runtime.scenario import CASES, Scenario
from clikgen.runtime.simulation import prepare
from clikgen.symbolic.generate import generate
from clikgen.symbolic.spec import ControllerSpec

PERIODS = [3e-4, 2e-3, 0.01, 0.1, 0.7]
ROBOTS = {"arm3": (0, (0.5, 0.4, 0.3)), "base4": (2, (0.6, 0.45)), "arm10": (0, (0.12,) * 10)}


def spec(name):
    """Sliding joints along x and y, if any, then an arm of these segments."""
    slides, lengths = ROBOTS[name]
    joints = [{"type": "prismatic", "axis": axis, "lower": -5.0, "upper": 5.0} for axis in ([1, 0, 0], [0, 1, 0])][
        :slides
    ]
    for length in (0.0, *lengths[:-1]):
        joints.append({"type": "revolute", "axis": [0, 0, 1], "xyz": [length, 0, 0], "lower": -2.8, "upper": 2.8})
    named = [{"name": f"q{i}", "link": f"link_{i}", "velocity": 3.0} | joint for i, joint in enumerate(joints)]
    task = {"name": "tip", "kind": "frame_position", "frame": "tip", "gain": 4.0, "damping": 1e-6}
    frame = {"name": "tip", "link": named[-1]["link"], "xyz": [lengths[-1], 0, 0]}
    table = {
        "name": name,
        "description": "a planar chain",
        "period": 0.01,
        "robot": {"space": "planar", "joints": named, "frames": [frame]},
        "tasks": [task],
        "filter": {"kind": "first_order", "cutoff": 4.0},
    }
    return ControllerSpec.parse(table, name)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The shipped planar5, or a robot of the table above, compiled."""

    def load(name):
        if name == "planar5":
            return CompiledController.load(name)
        folder = tmp_path_factory.mktemp(name)
        for file, text in generate(spec(name)).items():
            (folder / file).write_text(text)
        return CompiledController.load(folder)

    return load


@pytest.fixture(scope="module")
def circle():
    """0.3 m about (0.6, 0), once in 4 s."""
    path = {"kind": "circle", "center": [0.6, 0.0], "radius": 0.3, "period": 4.0}
    return Scenario.parse(
        {
            "name": "circle",
            "description": "a circle",
            "controller": "planar5",
            "duration": 12.0,
            "q0": [0.0, 0.0, 0.0, 0.6, -1.2],
            "references": {"tool": path},
        },
        "circle",
    )


# ---- The boundary ----


@pytest.mark.parametrize("filtered", [False, True], ids=["no filter", "filter"])
@pytest.mark.parametrize("name", ["planar5", "arm3", "base4", "arm10"])
def test_measured_boundary_is_the_linear_bound(robot, name, filtered):
    controller = robot(name)
    points = boundary(controller, PERIODS, filtered=filtered)
    assert [point.period for point in points] == PERIODS
    for point in points:
        beta = 2 * np.pi * 4 * point.period / (1 + 2 * np.pi * 4 * point.period) if filtered else 1.0
        assert point.linear == pytest.approx(2 / (beta * point.period), rel=1e-5)
        assert point.deviation == pytest.approx(0, abs=1e-3)  # 0.01 % is what the bisection resolves


def test_the_boundary_is_the_same_from_any_regular_configuration(robot):
    controller, rng = robot("planar5"), np.random.default_rng(0)
    for _ in range(10):
        for point in boundary(controller, [0.02], True, rng.uniform(-2.5, 2.5, 5), {"filter_cutoff": 9.0}):
            assert point.deviation == pytest.approx(0, abs=1e-3)


def test_damping_and_unequal_cut_offs_move_the_boundary_up(robot):
    """To 2/(μT), μ the largest eigenvalue of J A_β J^#, which lies below β_max."""
    controller, q = robot("arm3"), np.array([0.3, 1.1, 0.7])
    for parameters in ({"tip_damping": 0.5}, {"filter_cutoff": [1.0, 4.0, 16.0]}):
        (point,) = boundary(controller, [0.01], "filter_cutoff" in parameters, q, parameters)
        damping, cutoffs = parameters.get("tip_damping", 1e-6), np.array(parameters.get("filter_cutoff", np.inf))
        J = controller.jacobians(q=q)["tip_jacobian"]
        A = np.eye(3) - np.diag(np.ones(3) / (1 + 2 * np.pi * 0.01 * cutoffs))
        inverse = J.T @ np.linalg.inv(J @ J.T + damping**2 * np.eye(2))
        share = np.linalg.eigvals(J @ A @ inverse).max()
        assert share < 0.99 * A.max()
        assert point.gain == pytest.approx(2 / (share * 0.01), rel=1e-3)
        assert point.deviation == pytest.approx(0, abs=1e-3)


def test_configurations_and_numbers_that_do_not_fit_are_bad_inputs(robot):
    controller = robot("planar5")
    with pytest.raises(BadInput, match="planar5: q: wanted shape"):
        boundary(controller, [0.01], q=np.zeros(4))
    with pytest.raises(BadInput, match="planar5: period"):
        boundary(controller, [-0.01])
    with pytest.raises(BadInput, match="planar5: filter_cutoff"):
        boundary(controller, [0.01], parameters={"filter_cutoff": -1.0})
    with pytest.raises(BadInput, match="no input 'tool_grain'; did you mean 'tool_gain'"):
        boundary(controller, [0.01], parameters={"tool_grain": 1.0})


# ---- Tracking ----


@pytest.mark.parametrize("case", [1, 2])
def test_tracking_stays_within_the_certified_ball_all_over_the_map(robot, circle, case):
    periods, gains = np.geomspace(0.004, 1.5, 12).tolist(), np.geomspace(2, 400, 12).tolist()
    rows = []

    def progress(done, of):
        rows.append((done, of))

    found = tracking_map(robot("planar5"), circle, periods, gains, CASES[case], transient=0.5, progress=progress)
    certified = np.isfinite(found.ultimate)
    assert 30 < certified.sum() < certified.size
    assert np.all(found.largest[certified] <= found.ultimate[certified])
    np.testing.assert_array_equal(certified, found.gains[None] < found.certified[:, None])
    beyond = found.gains[None] * (found.beta * found.periods)[:, None] > 2.1
    assert np.all(found.largest[beyond] > 0.5)  # nothing tracks beyond the linear bound
    assert np.all(found.rms <= found.largest)
    assert rows == [(i + 1, 12) for i in range(12)]


def test_an_entry_of_the_map_is_the_run_by_itself(robot, circle):
    controller = robot("planar5")
    found = tracking_map(controller, circle, [0.02], [3.0], transient=0.5)
    alone = circle.model_copy(update={"parameters": {"period": 0.02, "tool_gain": 3.0}})
    run = prepare(controller, alone, CASES[1])
    error = np.linalg.norm(run.in_c().error, axis=1)[300:]
    assert found.largest[0, 0] == error.max()
    assert found.rms[0, 0] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-12)
    assert found.ultimate[0, 0] == pytest.approx(certify(controller, run).e_minus, rel=1e-12)
    assert found.certified[0] == pytest.approx(certify(controller, run).largest_gain, rel=1e-12)


def test_a_transient_that_leaves_nothing_is_a_bad_input(robot, circle):
    with pytest.raises(BadInput, match="transient"):
        tracking_map(robot("planar5"), circle, [0.02], [3.0], transient=1.0)


# ---- Figures ----


def test_figures_show_theory_and_measurement(robot, circle):
    rows = []
    found = stability_map(
        robot("planar5"), circle, [0.01, 0.1, 3.0], [1.0, 10.0, 100.0], progress=lambda *row: rows.append(row)
    )
    assert rows == [(i + 1, 6) for i in range(6)]
    figures = certificate_figures(found)
    assert set(figures) == {"stability_map", "tracking_error"}
    panels = figures["stability_map"].axes
    for axes, points, tracking in (
        (panels[0], found.boundary, found.tracking),
        (panels[1], found.filtered_boundary, found.filtered_tracking),
    ):
        certified, linear, measured = (line.get_ydata() for line in axes.get_lines()[:3])
        np.testing.assert_allclose(linear, [2 / (point.share * point.period) for point in points])
        np.testing.assert_array_equal(measured, [point.gain for point in points])
        np.testing.assert_array_equal(certified, [*tracking.certified[:2], np.nan])
    for axes, tracking in zip(figures["tracking_error"].axes, (found.tracking, found.filtered_tracking), strict=True):
        drawn = [line.get_ydata() for line in axes.get_lines()]
        for errors in (tracking.largest[:, 0], tracking.ultimate[:, 0]):
            shown = np.where(errors < 1.0, errors, np.nan)
            assert any(np.array_equal(values, shown, equal_nan=True) for values in drawn)
