"""From the world of a pose graph to a metric, upright one."""

from __future__ import annotations

import numpy as np
from inertial_flight import keyframe_stamps, world_from_cam

from vo.base.geometry.similarity import Similarity
from vo.base.geometry.transforms import inverse, se3_exp, so3_exp
from vo.engine.inertial.world_alignment import alignment_covariance, upright_alignment


def test_exact_poses_give_the_exact_world() -> None:
    truth = world_from_cam(keyframe_stamps(12))
    moved = Similarity(0.4, so3_exp(np.array([0.7, -0.4, 1.9])), np.array([3.0, -1.0, 2.0]))
    found = upright_alignment(
        moved.transform_poses(truth), np.full(12, 0.2), truth, np.full(12, 0.5)
    )
    np.testing.assert_allclose(
        found.transform_poses(moved.transform_poses(truth)), truth, atol=1e-9
    )
    assert abs(found.scale - 2.5) < 1e-12


def test_scale_and_vertical_are_means_and_the_first_keyframe_keeps_its_heading() -> None:
    """Drift about the vertical does not matter; errors of the vertical and the scale average."""
    truth = world_from_cam(keyframe_stamps(40))
    drifted = truth.copy()
    for n in range(40):
        tilt = 0.02 if n % 2 else -0.02
        drifted[n, :3, :3] = so3_exp(np.array([tilt, 0.0, 0.01 * n])) @ truth[n, :3, :3]
    drifted[0] = truth[0]
    scale = np.exp(0.01 * np.resize([1.0, -1.0], 40))
    found = upright_alignment(truth, np.ones(40), drifted, scale)
    assert abs(found.scale - 1.0) < 1e-9
    assert np.degrees(np.arccos(found.rotation[2, 2])) < 0.05
    np.testing.assert_allclose(found.transform_poses(truth[:1])[0, :3, 3], truth[0, :3, 3])
    assert abs(np.arctan2(found.rotation[1, 0], found.rotation[0, 0])) < 1e-3


def test_covariance_is_that_of_sampled_worlds() -> None:
    poses = world_from_cam(keyframe_stamps(3))
    rng = np.random.default_rng(5)
    errors = []
    for scale, x, y in rng.normal(size=(4000, 3)) * [0.01, 0.02, 0.02]:
        turn = se3_exp(np.array([x, y, 0.0, 0.0, 0.0, 0.0]))
        other = turn @ poses
        other[:, :3, 3] *= 1.0 + scale
        change = inverse(poses) @ other
        turned = 0.5 * (change[:, :3, :3] - np.swapaxes(change[:, :3, :3], 1, 2))
        axis = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
        errors.append(np.concatenate([axis, change[:, :3, 3]], axis=1))
    sampled = np.einsum("sni,snj->nij", np.stack(errors), np.stack(errors)) / len(errors)
    expected = alignment_covariance(poses, 0.01, 0.02)
    np.testing.assert_allclose(sampled, expected, atol=0.08 * np.abs(expected).max())
