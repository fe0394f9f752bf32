"""Rotation vectors, their derivative and tangent bases, against pinocchio, scipy and differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from costs.rotation import (
    log_derivative,
    log_rotation,
    make_quaternions,
    make_tangent_basis,
    quaternion_matrix,
    skew,
)

ANGLES = (0.0, 1e-13, 1e-9, 1e-6, 1e-4, 1e-3, 0.5 * np.pi, 3.0, np.pi - 1e-6, np.pi - 1e-9)


def random_axes(seed, count):
    axes = np.random.default_rng(seed).normal(size=(count, 3))
    return axes / np.linalg.norm(axes, axis=1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_log_returns_the_rotation_vector_from_zero_to_almost_pi(angle):
    phi = angle * random_axes(1, 200)
    np.testing.assert_allclose(log_rotation(Rotation.from_rotvec(phi).as_matrix()), phi, rtol=1e-8, atol=1e-12)


def test_log_at_pi_gives_the_axis_up_to_its_sign():
    axes = np.concatenate([np.eye(3), random_axes(2, 200)])
    rotation = 2.0 * axes[:, :, None] * axes[:, None, :] - np.eye(3)  # exp(pi a), exactly symmetric
    phi = log_rotation(rotation)
    np.testing.assert_allclose(np.linalg.norm(phi, axis=1), np.pi, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.einsum("mk,mk->m", phi, axes)), np.pi, atol=1e-12)


@given(seed=st.integers(0, 10_000))
def test_log_and_exp_are_inverse(seed):
    rotation = Rotation.random(20, random_state=seed).as_matrix()
    phi = log_rotation(rotation)
    np.testing.assert_allclose(Rotation.from_rotvec(phi).as_matrix(), rotation, atol=1e-12)
    assert np.linalg.norm(phi, axis=1).max() <= np.pi + 1e-12


@pytest.mark.parametrize("angle", [0.0, 1e-6, 9.9e-5, 1.01e-4, 1e-2, 0.5 * np.pi, 2.5, 3.1, np.pi - 1e-3])
def test_log_derivative_is_that_of_a_small_left_rotation(angle):
    phi = angle * random_axes(3, 20)
    step = 1e-5
    derivative = log_derivative(phi)
    rotation = Rotation.from_rotvec(phi).as_matrix()
    for k in range(3):
        turn = Rotation.from_rotvec(step * np.eye(3)[k]).as_matrix()
        difference = (log_rotation(turn @ rotation) - log_rotation(turn.T @ rotation)) / (2.0 * step)
        np.testing.assert_allclose(derivative[:, :, k], difference, atol=2e-8)


def test_log_derivative_by_hand():
    # a quarter turn about z, turned a little more about z, grows by just that much
    derivative = log_derivative(np.array([[0.0, 0.0, 0.5 * np.pi]]))[0]
    np.testing.assert_allclose(derivative[:, 2], [0.0, 0.0, 1.0], atol=1e-15)
    # across: (theta / 2) cot(theta / 2) on the diagonal, theta / 2 beside it
    np.testing.assert_allclose(derivative[:2, :2], [[np.pi / 4, np.pi / 4], [-np.pi / 4, np.pi / 4]], atol=1e-15)


@pytest.mark.parametrize("angle", [9.9e-5, 1.01e-4, 1e-3])
def test_log_derivative_bends_by_a_twelfth_of_the_squared_angle_near_zero(angle):
    derivative = log_derivative(angle * np.array([[0.0, 0.0, 1.0]]))[0]
    np.testing.assert_allclose((1.0 - np.diag(derivative)) / angle**2, [1.0 / 12.0, 1.0 / 12.0, 0.0], rtol=1e-5)


def test_log_derivative_is_finite_at_pi():
    derivative = log_derivative(np.pi * np.eye(3))
    np.testing.assert_allclose(derivative[0] @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0], atol=1e-15)
    assert np.abs(derivative).max() < 2.0


def test_skew_is_the_cross_product():
    a, b = np.random.default_rng(4).normal(size=(2, 50, 3))
    np.testing.assert_allclose(np.einsum("mkl,ml->mk", skew(a), b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("axis", [*np.eye(3), *-np.eye(3), *random_axes(5, 20)])
def test_tangent_basis_is_right_handed_and_orthonormal(axis):
    frame = np.vstack([make_tangent_basis(axis), axis])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)


@given(arrays(float, (4, 3), elements=st.floats(-7.0, 7.0)))
def test_quaternions_are_those_of_yaw_pitch_and_roll(angles: np.ndarray) -> None:
    expected = Rotation.from_euler("ZYX", angles)
    found = make_quaternions(angles)
    assert (Rotation.from_quat(found, scalar_first=True) * expected.inv()).magnitude() == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1.0, abs=1e-14)


def test_quaternions_do_not_flip_where_angles_go_on() -> None:
    turn = np.linspace(-4.0 * np.pi, 4.0 * np.pi, 500)
    for column in range(3):
        angles = np.full((500, 3), 0.3)
        angles[:, column] = turn
        assert np.abs(np.diff(make_quaternions(angles), axis=0)).max() < 0.03


@given(seed=st.integers(0, 10_000))
def test_matrix_of_a_quaternion_is_scipys_to_the_last_bit(seed):
    for quaternion in np.random.default_rng(seed).normal(size=(20, 4)):
        assert (quaternion_matrix(quaternion) == Rotation.from_quat(quaternion, scalar_first=True).as_matrix()).all()


def test_quaternion_without_length_is_refused():
    with pytest.raises(ValueError, match="length 0"):
        quaternion_matrix((0.0, 0.0, 0.0, 0.0))
