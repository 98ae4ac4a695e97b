"""Quaternions and the orientation error against SciPy's rotations, at every angle from zero to half a turn."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from clikgen.symbolic.rotations import (
    cross_matrix,
    orientation_error,
    quaternion_of,
    quaternion_product,
    unit_quaternion,
)

# Quaternions and matrices have entries below 1, rounded at 1.1e-16; each result adds some ten such terms.
ROUNDING = 2e-15
ANGLES = [0.0, 1e-300, 1e-160, 1e-16, 1e-9, 1e-3, 1.0, np.pi / 2, 2.0, 3.0, np.pi - 1e-9, np.pi]


def _function(f, *sizes):
    arguments = [ca.SX.sym(f"x{i}", *(size if isinstance(size, tuple) else (size,))) for i, size in enumerate(sizes)]
    function = ca.Function("f", arguments, [ca.densify(f(*arguments))])
    return lambda *values: np.array(function(*values)).squeeze()


quaternion = _function(quaternion_of, (3, 3))
unit = _function(unit_quaternion, 4)
product = _function(quaternion_product, 4, 4)
axis_angle = _function(lambda d, q: orientation_error(d, q, "axis_angle"), 4, 4)
quaternion_error = _function(lambda d, q: orientation_error(d, q, "quaternion"), 4, 4)


@st.composite
def _rotations(draw):
    """A rotation by one of the angles that could be trouble, or any, about an axis or any direction."""
    angle = draw(st.sampled_from(ANGLES) | st.floats(0, np.pi))
    axis = draw(st.sampled_from(np.vstack([np.eye(3), -np.eye(3), [[1, 1, 0], [1, 1, 1], [0, 1, -1]]]).tolist()))
    if draw(st.booleans()):
        axis = np.random.default_rng(draw(st.integers(0, 2**32 - 1))).normal(size=3)
    return Rotation.from_rotvec(angle * np.asarray(axis) / np.linalg.norm(axis))


def _xyzw(q):
    return Rotation.from_quat(q, scalar_first=True)


@given(_rotations())
def test_the_quaternion_of_a_matrix_is_that_rotation_s_with_unit_length_and_positive_w(rotation):
    q = quaternion(rotation.as_matrix())
    assert q[0] >= 0
    assert np.linalg.norm(q) == pytest.approx(1, abs=ROUNDING)
    np.testing.assert_allclose(_xyzw(q).as_matrix(), rotation.as_matrix(), rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("axis", np.eye(3, dtype=int).tolist())
def test_half_a_turn_about_an_axis_has_that_axis_for_its_quaternion(axis):
    matrix = 2 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_array_equal(quaternion(matrix), [0, *axis])


@given(_rotations(), _rotations())
def test_the_product_is_the_one_turn_after_the_other(p, q):
    together = product(p.as_quat(scalar_first=True), q.as_quat(scalar_first=True))
    np.testing.assert_allclose(_xyzw(together).as_matrix(), (p * q).as_matrix(), rtol=0, atol=ROUNDING)


@given(_rotations(), _rotations(), st.sampled_from([1.0, -1.0, 1e-120, -3.7, 1e3]))
def test_the_error_is_scipys_logarithm_whatever_the_reference_s_length_and_sign(reference, rotation, scale):
    q_d, q = reference.as_quat(scalar_first=True), quaternion(rotation.as_matrix())
    error = axis_angle(scale * q_d, q)
    assert np.linalg.norm(error) <= np.pi + ROUNDING
    # the log magnifies the quaternions' rounding by at most π/1, near half a turn
    turned = (Rotation.from_rotvec(error) * rotation).as_matrix()
    np.testing.assert_allclose(turned, reference.as_matrix(), rtol=0, atol=4 * ROUNDING)
    expected = (reference * rotation.inv()).as_rotvec()
    if np.linalg.norm(expected) < np.pi - 1e-12:  # beyond, rounding chooses between e and −e
        np.testing.assert_allclose(error, expected, rtol=0, atol=4 * ROUNDING)


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_error_s_length_is_exact_at_angles_that_are_trouble(angle, sign):
    axis = np.array([2.0, -3.0, 6.0]) / 7
    q_d = sign * np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
    error = axis_angle(q_d, [1, 0, 0, 0])
    if angle == np.pi:  # cos(π/2) is 6e-17 here: of the two answers either will do
        error *= np.sign(error[0])
    # relative, so that 1e-300 rad counts too; at π the half angle's cosine is rounded at 6e-17
    np.testing.assert_allclose(error, angle * axis, rtol=1e-15, atol=0)
    chord = quaternion_error(q_d, [1, 0, 0, 0])
    np.testing.assert_allclose(np.linalg.norm(chord), 2 * np.sin(angle / 2), rtol=1e-15, atol=1e-150)


def test_exactly_half_a_turn_has_a_finite_error_of_length_pi():
    np.testing.assert_array_equal(axis_angle([0, 0, 1, 0], [1, 0, 0, 0]), [0, np.pi, 0])
    np.testing.assert_array_equal(axis_angle([0, 0, -1, 0], [1, 0, 0, 0]), [0, -np.pi, 0])


@given(_rotations(), st.sampled_from([1.0, -1.0]))
def test_a_reference_that_is_where_the_frame_is_leaves_no_error(rotation, sign):
    q = quaternion(rotation.as_matrix())
    np.testing.assert_allclose(axis_angle(sign * q, q), 0, rtol=0, atol=3e-16)  # normalising rounds once


@given(_rotations(), _rotations())
def test_the_quaternion_error_points_along_the_logarithm_and_is_a_chord_long(reference, rotation):
    q_d, q = reference.as_quat(scalar_first=True), quaternion(rotation.as_matrix())
    log, chord = axis_angle(q_d, q), quaternion_error(q_d, q)
    angle = np.linalg.norm(log)
    expected = 2 * np.sin(angle / 2) * log / max(angle, 1e-300)
    np.testing.assert_allclose(chord, expected, rtol=0, atol=2 * ROUNDING)


def test_a_quaternion_of_zero_counts_as_the_identity():
    np.testing.assert_array_equal(unit(np.zeros(4)), [1, 0, 0, 0])
    np.testing.assert_array_equal(axis_angle(np.zeros(4), [1, 0, 0, 0]), np.zeros(3))


def test_a_reference_that_is_not_a_number_is_not_passed_over():
    assert np.all(np.isnan(unit([np.nan, 1, 0, 0])))
    assert np.any(np.isnan(axis_angle([np.nan, 1, 0, 0], [1, 0, 0, 0])))


def test_the_cross_matrix_times_a_vector_is_their_cross_product():
    v, omega = np.array([0.3, -0.7, 1.1]), np.array([-0.2, 0.9, 0.4])
    spatial = _function(cross_matrix, 3)
    np.testing.assert_array_equal(spatial(v) @ omega, np.cross(v, omega))
    planar = _function(cross_matrix, 2)
    in_plane = np.cross([*v[:2], 0], [0, 0, omega[2]])
    np.testing.assert_array_equal(planar(v[:2]) @ [0, 0, omega[2]], in_plane[:2])
