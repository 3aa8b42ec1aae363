from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo.base.geometry import transforms as tf
from vo.base.types import Floats

_unit = st.floats(-1.0, 1.0, allow_nan=False)
_vectors = st.tuples(_unit, _unit, _unit).map(np.array)
_angles = st.one_of(st.floats(0.0, 3.1), st.floats(1e-12, 1e-3))


def _rotvec(direction: Floats, angle: float) -> Floats:
    length = np.linalg.norm(direction)
    return np.zeros(3) if length < 1e-3 else direction / length * angle


_rotvecs = st.builds(_rotvec, _vectors, _angles)
_tangents = st.builds(lambda r, t: np.concatenate([r, 50.0 * t]), _rotvecs, _vectors)
_transforms = _tangents.map(tf.se3_exp)


@given(_tangents)
def test_se3_log_inverts_exp(tangent: Floats) -> None:
    np.testing.assert_allclose(tf.se3_log(tf.se3_exp(tangent)), tangent, atol=1e-9)


@given(_transforms)
def test_se3_exp_inverts_log(transform: Floats) -> None:
    np.testing.assert_allclose(tf.se3_exp(tf.se3_log(transform)), transform, atol=1e-9)


@given(_rotvecs)
def test_so3_exp_gives_rotations(rotvec: Floats) -> None:
    rotation = tf.so3_exp(rotvec)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0), (0.6, 0, -0.8)])
@pytest.mark.parametrize("short_of_pi", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
def test_log_of_half_turns_keeps_angle_and_axis(
    axis: tuple[float, float, float], short_of_pi: float
) -> None:
    rotvec = np.array(axis) * (np.pi - short_of_pi)
    found = tf.so3_log(tf.so3_exp(rotvec))
    assert np.linalg.norm(found) == pytest.approx(np.pi - short_of_pi, abs=1e-9)
    np.testing.assert_allclose(tf.so3_exp(found), tf.so3_exp(rotvec), atol=1e-9)


@given(st.tuples(_unit, _unit, _unit, _unit).map(np.array))
def test_quaternions_of_their_rotations_are_equal(quat: Floats) -> None:
    if np.linalg.norm(quat) < 1e-3:
        return
    quat = quat / np.linalg.norm(quat)
    found = tf.quat_xyzw_from_rotation(tf.rotation_from_quat_xyzw(quat))
    assert abs(float(found @ quat)) == pytest.approx(1.0, abs=1e-12)


def test_quaternion_order_is_xyzw() -> None:
    quarter_about_z = np.array([0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    rotation = tf.rotation_from_quat_xyzw(quarter_about_z)
    np.testing.assert_allclose(rotation @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(tf.so3_exp(np.array([0, 0, np.pi / 2])), rotation, atol=1e-12)


def test_many_quaternions_at_once_and_of_any_length() -> None:
    quats = np.random.default_rng(0).normal(size=(5, 4)) * 3.0
    rotations = tf.rotation_from_quat_xyzw(quats)
    assert rotations.shape == (5, 3, 3)
    np.testing.assert_allclose(rotations[3], tf.rotation_from_quat_xyzw(quats[3]), atol=1e-15)


@given(_transforms, st.builds(lambda r, t: np.concatenate([r, t]), _rotvecs, _vectors))
def test_adjoint_transforms_tangents_between_frames(a_from_b: Floats, tangent: Floats) -> None:
    carried = tf.se3_exp(tf.adjoint(a_from_b) @ tangent)
    expected = a_from_b @ tf.se3_exp(tangent) @ tf.inverse(a_from_b)
    np.testing.assert_allclose(carried, expected, atol=1e-8)


@given(_transforms)
def test_inverse_times_transform_is_identity(transform: Floats) -> None:
    np.testing.assert_allclose(tf.inverse(transform) @ transform, np.eye(4), atol=1e-9)


def test_inverse_of_many_is_the_inverse_of_each() -> None:
    many = np.stack([tf.se3_exp(np.full(6, 0.1 * i)) for i in range(4)])
    np.testing.assert_allclose(tf.inverse(many)[2], tf.inverse(many[2]))


def test_adjacent_names_cancel() -> None:
    a_from_b = tf.make_transform(tf.so3_exp(np.array([0, 0, np.pi / 2])), np.array([1.0, 2.0, 3.0]))
    found = tf.transform_points(a_from_b, np.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(found, [[1.0, 3.0, 3.0]], atol=1e-12)


@given(_transforms, _transforms)
def test_interpolation_begins_and_ends_at_the_poses(first: Floats, second: Floats) -> None:
    np.testing.assert_allclose(tf.interpolate(first, second, 0.0), first, atol=1e-8)
    np.testing.assert_allclose(tf.interpolate(first, second, 1.0), second, atol=1e-7)


def test_interpolation_has_constant_velocity() -> None:
    second = tf.make_transform(tf.so3_exp(np.array([0, 0.4, 0])), np.zeros(3))
    quarter = tf.interpolate(np.eye(4), second, 0.25)
    assert tf.rotation_angle(quarter[:3, :3]) == pytest.approx(0.1, abs=1e-12)


@pytest.mark.parametrize("size", [1e-15, 1e-12, 1e-9, 1e-7, 1e-3])
def test_orthonormalised_gives_the_nearest_rotation(size: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        near = tf.se3_exp(rng.normal(size=6))
        near[:3, :3] += size * rng.standard_normal((3, 3))
        u, _, vt = np.linalg.svd(near[:3, :3])
        np.testing.assert_allclose(tf.orthonormalised(near)[:3, :3], u @ vt, atol=1e-14)


def test_orthonormalised_corrects_rounding() -> None:
    exact = tf.se3_exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
    mended = tf.orthonormalised(np.round(exact, 4))
    np.testing.assert_allclose(mended[:3, :3] @ mended[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(mended, exact, atol=1e-4)
