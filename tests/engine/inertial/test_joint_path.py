"""A path by the information of all images and the samples together."""

from __future__ import annotations

import numpy as np
import pytest
from inertial_flight import (
    IMU_FROM_CAM,
    NOISE,
    keyframe_stamps,
    sensor,
    visual_poses,
    world_from_cam,
)

from vo.base.geometry.transforms import adjoint, inverse, se3_log
from vo.base.types import Floats
from vo.engine.inertial import joint_path as module
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.joint_path import JointPaths, joint_path
from vo.engine.inertial.keyframe_states import KeyframeStates, Node
from vo.engine.inertial.samples import SampleReader

_COUNT = 40  # more than are eliminated at once
_SIGMA = np.full(6, 1e-3)  # rad and m, of `visual_poses`
_FLOOR = np.array([3e-5] * 3 + [0.0] * 3)  # that a chain adds to motions by images


def _solved(poses: Floats) -> KeyframeStates:
    """The states of a chain that takes the covariances of motions as stated."""
    stamps = keyframe_stamps(_COUNT)
    source = sensor(noise=1.0, seconds=25.0)
    chain = InertialChain(SampleReader(source), NOISE, IMU_FROM_CAM, is_metric=True)
    for k, pose in enumerate(poses):
        covariance = np.diag(_SIGMA**2) if k else None
        chain.set(Node(k, k, int(stamps[k]), 0, pose, covariance))
        chain.update()
    solved = chain.smoothed()
    assert solved is not None and len(solved.nodes) == _COUNT
    return solved


def _information(poses: Floats) -> Floats:
    """(6 n - 6, 6 n - 6) of independent motions from each keyframe to the next."""
    motions = inverse(poses[:-1]) @ poses[1:]
    result = np.zeros((6 * _COUNT, 6 * _COUNT))
    for k, motion in enumerate(motions):
        effect = np.zeros((6, 6 * _COUNT))
        effect[:, 6 * k : 6 * k + 6] = -adjoint(inverse(motion))
        effect[:, 6 * k + 6 : 6 * k + 12] = np.eye(6)
        moved = 3e-4 * np.linalg.norm(motion[:3, 3])
        variance = _SIGMA**2 + _FLOOR**2 + np.repeat([0.0, moved**2], 3)
        result += effect.T @ (effect / variance[:, None])
    return result[6:, 6:]


def _poses(solved: KeyframeStates) -> Floats:
    """Of the camera, relative to the first."""
    states = solved.estimate.states
    pose = np.tile(np.eye(4), (_COUNT, 1, 1))
    pose[:, :3, :3], pose[:, :3, 3] = states.rotation, states.position
    pose = pose @ IMU_FROM_CAM
    return np.asarray(inverse(pose[:1]) @ pose)


def _off(poses: Floats, others: Floats) -> Floats:
    return np.stack([se3_log(inverse(a) @ b) for a, b in zip(poses, others, strict=True)])


def test_independent_motions_give_the_path_of_the_chain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PARTS", ())
    seen = visual_poses(world_from_cam(keyframe_stamps(_COUNT)), 1.0, 1.0)
    solved = _solved(seen)
    found = joint_path(solved, NOISE, seen, _information(seen))
    assert found is not None
    poses, covariance = found
    expected = _poses(solved)
    assert np.abs(_off(expected, seen)).max() > 0.005
    sigma = np.sqrt(np.diagonal(covariance[1:], axis1=1, axis2=2))
    assert (np.abs(_off(poses, expected)[1:]) / sigma).max() < 0.05
    np.testing.assert_allclose(poses[0], seen[0], atol=1e-9)
    np.testing.assert_array_equal(covariance[0], 0.0)


def test_path_is_nearer_to_the_truth_than_that_of_images_with_variances_too_wide() -> None:
    truth = world_from_cam(keyframe_stamps(_COUNT))
    truth = inverse(truth[:1]) @ truth
    ratio, nees = [], []
    for seed in range(8):
        seen = visual_poses(truth, 1.0, 1.0, seed=seed)
        found = joint_path(_solved(seen), NOISE, seen, 0.25 * _information(seen))
        assert found is not None
        errors = _off(found[0], truth)
        ratio.append(np.log((errors[:, 3:] ** 2).sum() / (_off(seen, truth)[:, 3:] ** 2).sum()))
        nees.append(errors[-1] @ np.linalg.solve(found[1][-1], errors[-1]))
    assert np.exp(0.5 * np.mean(ratio)) < 0.6
    assert 0.5 < np.mean(nees) < 6.0


def test_only_paths_with_all_keyframes_of_a_world_are_taken() -> None:
    seen = visual_poses(world_from_cam(keyframe_stamps(_COUNT)), 1.0, 1.0)
    paths, information = JointPaths(NOISE), _information(seen)
    paths.placed.append(_solved(seen))
    assert paths.of(list(range(_COUNT)), seen, information) is not None
    assert paths.of(list(range(_COUNT - 1)), seen[:-1], information[:-6, :-6]) is None


def test_information_that_determines_nothing_gives_no_path() -> None:
    seen = visual_poses(world_from_cam(keyframe_stamps(_COUNT)), 1.0, 1.0)
    nothing = -1e12 * np.eye(6 * _COUNT - 6)
    assert joint_path(_solved(seen), NOISE, seen, nothing) is None
