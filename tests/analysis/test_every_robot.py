"""The analyses on every robot that ships: limits, selective damping and other tasks do not blur what they measure."""

import numpy as np
import pytest

from clikgen.analysis.certificate import regular_configuration, singular_values
from clikgen.analysis.measured_filter import measure_response
from clikgen.analysis.stability_map import boundary
from clikgen.analysis.tracking import damping_at, greatest_damping
from clikgen.runtime.controller import CompiledController
from clikgen.runtime.documents import BadInput
from clikgen.symbolic.spec import shipped_specs

ROBOTS = [path.stem for path in shipped_specs()]


@pytest.mark.parametrize("name", ROBOTS)
def test_compiled_filter_has_the_response_of_its_beta(name):
    response = measure_response(CompiledController.load(name), steps=8 * 16_384)
    low = response.frequency < 0.25 / response.period
    z = np.exp(2j * np.pi * response.frequency[low] * response.period)
    expected = response.beta * z / (z - (1 - response.beta))
    assert np.max(np.abs(response.response[low] / expected - 1)) < 0.01  # the estimate's leakage


@pytest.mark.parametrize("name", ["planar3", "planar10", "ur6", "dual_arm"])
@pytest.mark.parametrize("filtered", [False, True])
def test_measured_stability_boundary_is_the_linear_bound(name, filtered):
    """0.01 % from the bisection, and what an error of 1e-6 m still has of curvature."""
    for point in boundary(CompiledController.load(name), [0.002, 0.02], filtered):
        assert point.gain == pytest.approx(point.linear, rel=1e-3)


@pytest.mark.parametrize("name", ROBOTS)
def test_regular_configuration_is_regular_and_inside_the_limits(name):
    controller = CompiledController.load(name)
    q, limits = regular_configuration(controller), controller.manifest.limits
    assert np.all((q > limits[:, 0]) & (q < limits[:, 1]))
    assert singular_values(controller, q[None])[0, -1] > 0.1


def test_a_pose_is_no_position_for_the_bounds_of_the_loop():
    with pytest.raises(BadInput, match="panda7: wanted a task of kind frame_position, got none"):
        boundary(CompiledController.load("panda7"), [0.002])


def test_damping_is_what_the_step_adds_to_the_gram_matrix():
    """Constant as it is; selective zero away from a singularity and at its greatest at one, by hand for one row."""
    J = np.array([[0.3, 0.4]])  # σ = s = 0.5
    constant, near = {"a_damping": np.array(0.2)}, {"a_damping": np.array(0.2), "a_near_singularity": np.array(1.0)}
    assert damping_at(constant, "a", J) == 0.2
    assert damping_at(near, "a", J) == pytest.approx(0.2 * (1 - 0.25))
    assert damping_at(near, "a", 4 * J) == 0
    assert damping_at(near, "a", 0 * J) == 0.2
    assert greatest_damping(near, "a", 1.0, rows=1) == 0
    assert greatest_damping(near, "a", 1.0, rows=2) == 0.2
    assert greatest_damping(constant, "a", 9.0, rows=2) == 0.2
