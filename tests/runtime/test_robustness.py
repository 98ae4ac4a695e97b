"""What the header promises: any finite input within the limits gives finite output."""

import numpy as np
import pytest


@pytest.mark.parametrize("block", range(10))
def test_a_hundred_thousand_states_within_the_limits_give_finite_steps(block, evaluate_many, states_within_limits):
    outputs = evaluate_many("step", states_within_limits(100_000, block))
    for name, array in outputs.items():
        assert np.all(np.isfinite(array)), f"{name}: {np.sum(~np.isfinite(array))} numbers are not finite"
    assert 1_000 < np.sum(outputs["active"]) < 99_000  # both sides of the switch were visited


def test_the_states_within_the_limits_respect_them(states_within_limits, planar5_manifest):
    values = states_within_limits(2_000, 3)
    for signal in planar5_manifest.function("step").inputs:
        array = values[signal.name]
        assert np.all(array >= signal.minimum)
        assert np.all(array <= signal.maximum)
        # their whole range, too: within two decades of the limit that is farthest from zero
        assert np.max(np.abs(array)) >= 0.01 * signal.maximum
    for matrix in values["tool_gain"]:
        np.testing.assert_array_equal(matrix, matrix.T)
        # an eigenvalue of 1e-6 beside one of 1e4 is known only to their rounding
        assert np.linalg.eigvalsh(matrix)[0] > -1e-11


@pytest.mark.parametrize("name", ["kinematics", "jacobians"])
def test_kinematics_and_jacobians_are_finite_within_the_limits(name, evaluate_many, states_within_limits):
    outputs = evaluate_many(name, states_within_limits(100_000, 11))
    for array in outputs.values():
        assert np.all(np.isfinite(array))
