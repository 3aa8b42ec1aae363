"""Covariances of a whole run against its errors."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from vo.base.config import load_config
from vo.base.geometry.transforms import inverse, se3_log
from vo.base.types import Floats, KeyframePose, Mode, Trajectory
from vo.engine.odometry import Odometry
from vo.outputs.evaluation.association import associate
from vo.recordings.sources.registry import open_source


def _keyframes(folder: Path, mode: Mode) -> tuple[list[KeyframePose], Floats]:
    """Keyframes of a run that was never lost, and their true poses."""
    source = open_source(folder, mode=mode)
    with closing(Odometry(source.rig, load_config("default", ["threads=1"]))) as odometry:
        for _ in odometry.track_all(source.frames()):
            pass
        odometry.finish()
        keyframes = odometry.trajectory.keyframes()
    assert {k.segment for k in keyframes} == {0}
    stamps = np.array([k.stamp_ns for k in keyframes])
    found = Trajectory(stamps, np.stack([k.world_from_cam0 for k in keyframes]))
    assert source.ground_truth is not None
    matched = associate(found, source.ground_truth, interpolated=True)
    assert len(matched) == len(keyframes)
    return keyframes, matched.reference


@pytest.mark.parametrize("mode", ["stereo", "mono"])
def test_errors_of_a_run_are_as_large_as_it_says(mode: Mode, synthetic_stereo: Path) -> None:
    keyframes, true = _keyframes(synthetic_stereo, mode)
    found = np.stack([k.world_from_cam0 for k in keyframes])
    found, true = inverse(found[0]) @ found, inverse(true[0]) @ true
    scale = 1.0
    if mode == "mono":
        near, truly = found[1:7, :3, 3], true[1:7, :3, 3]
        scale = float((near * truly).sum() / (near**2).sum())
    found[:, :3, 3] *= scale
    size = np.r_[np.ones(3), np.full(3, scale)]
    nees = []
    for k, keyframe in enumerate(keyframes[1:], start=1):
        assert keyframe.covariance is not None
        xi = se3_log(inverse(found[k]) @ true[k])
        nees.append(xi @ np.linalg.solve(size[:, None] * keyframe.covariance * size, xi))
    assert len(nees) >= 4
    # Poses of one path err together, so that the mean of one run is far from that of many (6).
    assert 0.3 < np.mean(nees) < 20.0
