"""Trajectories that follow another convention than they should: the notes name it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from vo.base.geometry.transforms import (
    inverse,
    quat_xyzw_from_rotation,
    rotation_from_quat_xyzw,
    se3_exp,
)
from vo.base.types import Trajectory
from vo.outputs.evaluation.evaluation import evaluate


def walk() -> Trajectory:
    """A walk with turns about all axes."""
    poses, pose = [], np.eye(4)
    for i in range(200):
        rates = 0.03 * np.sin([0.05 * i, 0.03 * i + 1.0, 0.07 * i + 2.0])
        pose = pose @ se3_exp(np.array([*rates, 0.02 * np.sin(0.1 * i), 0.0, 0.1]))
        poses.append(pose)
    return Trajectory(np.arange(200) * 50_000_000, np.stack(poses))


def estimate(noise: float = 0.002) -> Trajectory:
    """An estimate of it, with errors."""
    true, rng = walk(), np.random.default_rng(0)
    errors = np.stack([se3_exp(rng.normal(0.0, noise, 6)) for _ in range(len(true))])
    return Trajectory(true.stamps_ns, true.world_from_cam @ errors)


def _reordered(true: Trajectory) -> Trajectory:
    quat = np.array([quat_xyzw_from_rotation(pose[:3, :3]) for pose in true.world_from_cam])
    poses = true.world_from_cam.copy()
    poses[:, :3, :3] = rotation_from_quat_xyzw(quat[:, [3, 0, 1, 2]])
    return replace(true, world_from_cam=poses)


def _turned(true: Trajectory) -> Trajectory:
    return replace(
        true, world_from_cam=true.world_from_cam @ se3_exp(np.array([0, 1.5, 0, 0, 0, 0]))
    )


def _mirrored(true: Trajectory) -> Trajectory:
    flip = np.diag([1.0, -1.0, 1.0, 1.0])
    return replace(true, world_from_cam=flip @ true.world_from_cam @ flip)


def _inverted(true: Trajectory) -> Trajectory:
    return replace(true, world_from_cam=inverse(true.world_from_cam))


def _late(true: Trajectory) -> Trajectory:
    return replace(true, stamps_ns=true.stamps_ns + 400_000_000)


def _in_millimetres(true: Trajectory) -> Trajectory:
    poses = true.world_from_cam.copy()
    poses[:, :3, 3] *= 1000.0
    return replace(true, world_from_cam=poses)


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (_reordered, r"if the quaternions of the reference are read in the order qw qx qy qz"),
        (_turned, "in a frame that is turned by 86° against the camera's"),
        (_mirrored, "if an axis of one side is mirrored"),
        (_inverted, "fit if the poses of one side are inverted"),
        (_late, "with stamps of the reference 0.4 s earlier"),
        (_in_millimetres, "lengths of the reference are 1000 times those of the estimate"),
    ],
)
def test_another_convention_is_named(change: Callable[[Trajectory], Trajectory], note: str) -> None:
    *_, found = evaluate(estimate(), change(walk())).notes
    assert note in found


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.05, 0.3])
def test_errors_alone_are_no_other_convention(noise: float) -> None:
    notes = evaluate(estimate(noise), walk()).notes
    assert not [note for note in notes if "nearly straight" not in note]
