from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo.base.geometry.similarity import umeyama
from vo.base.geometry.transforms import so3_exp

SEEDS = st.integers(0, 2**32 - 1)


@given(seed=SEEDS, scale=st.floats(0.01, 100.0))
def test_recovers_a_random_similarity(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(20, 3))
    rotation, translation = so3_exp(rng.normal(size=3)), rng.normal(size=3) * 10
    target = scale * source @ rotation.T + translation
    found = umeyama(source, target, with_scale=True)
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, translation, atol=1e-9 * max(1.0, scale))
    np.testing.assert_allclose(found.transform_points(source), target, atol=1e-8 * max(1.0, scale))


@given(seed=SEEDS)
def test_rigid_motion_has_scale_one_and_exact_rotation(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(20, 3))
    rotation = so3_exp(rng.normal(size=3))
    found = umeyama(source, 3.0 * source @ rotation.T, with_scale=False)
    assert found.scale == 1.0
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)


@given(seed=SEEDS)
def test_the_rotation_is_never_a_reflection(seed: int) -> None:
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(10, 3))
    found = umeyama(source, source * (1.0, 1.0, -1.0), with_scale=True)
    assert np.linalg.det(found.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)


@given(seed=SEEDS)
def test_points_may_be_coplanar_or_collinear(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation = so3_exp(rng.normal(size=3))
    for dimensions in (1, 2):
        source = rng.normal(size=(15, dimensions)) @ rng.normal(size=(dimensions, 3))
        target = 2.0 * source @ rotation.T + 1.0
        found = umeyama(source, target, with_scale=True)
        assert found.scale == pytest.approx(2.0)
        assert np.linalg.det(found.rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(found.transform_points(source), target, atol=1e-8)
        assert found.is_on_line == (dimensions == 1)


def test_poses_keep_their_rotations_proper() -> None:
    source = np.random.default_rng(0).normal(size=(5, 3))
    found = umeyama(source, 4.0 * source, with_scale=True)
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = source
    moved = found.transform_poses(poses)
    np.testing.assert_allclose(moved[:, :3, :3], poses[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(moved[:, :3, 3], 4.0 * source, atol=1e-12)


def test_rejects_fewer_than_three_points() -> None:
    with pytest.raises(ValueError, match="2 points, at least 3"):
        umeyama(np.zeros((2, 3)), np.zeros((2, 3)), with_scale=True)


def test_rejects_points_in_one_place() -> None:
    here, there = np.full((9, 3), 1234.1), np.random.default_rng(0).normal(size=(9, 3))
    for source, target in ((here, there), (there, here)):
        with pytest.raises(ValueError, match="one place"):
            umeyama(source, target, with_scale=False)


def test_rejects_different_shapes() -> None:
    with pytest.raises(ValueError, match=r"\(4, 3\) and \(5, 3\)"):
        umeyama(np.zeros((4, 3)), np.zeros((5, 3)), with_scale=True)
