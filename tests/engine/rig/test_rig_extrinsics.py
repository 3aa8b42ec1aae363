"""A camera that stands otherwise than its calibration says."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from rig_walks import Walk, ate

from vo.base.config import load_config
from vo.base.geometry.transforms import inverse, make_transform, rotation_angle, so3_exp
from vo.base.records.calibration_errors import CameraPoseError
from vo.base.types import Rig, Trajectory
from vo.engine.rig.odometry import RigOdometry


def wrong(rig: Rig, camera: int) -> Rig:
    """One degree and one centimetre off, along all axes."""
    axes = np.ones(3) / np.sqrt(3.0)
    poses = rig.cam0_from_cams.copy()
    poses[camera] = poses[camera] @ make_transform(so3_exp(np.deg2rad(1.0) * axes), 0.01 * axes)
    further = tuple(
        each._replace(cam0_from_cam=pose) for each, pose in zip(rig.further, poses[2:], strict=True)
    )
    return replace(rig, cam1_from_cam0=inverse(poses[1]), further=further)


def run(rig: Rig, walk: Walk) -> tuple[Trajectory, tuple[CameraPoseError, ...], Rig]:
    with closing(RigOdometry(rig, load_config(overrides=["threads=1"]))) as odometry:
        for frame in walk.frames:
            odometry.track(frame)
        odometry.finish()
        errors = odometry.calibration_errors.cameras
        return odometry.trajectory.trajectory(), errors, odometry.corrected(rig)


@pytest.mark.parametrize("camera", [1, 3])
def test_a_turned_camera_is_found_and_corrected(walk: Walk, camera: int) -> None:
    path, (error,), corrected = run(wrong(walk.rig, camera), walk)
    assert error.camera == camera
    assert abs(error.angle_deg - 1.0) < 0.1
    assert 0.005 < error.distance_m < 0.013
    assert f"by {error.angle_deg:.2f}° and" in error.in_words
    assert len(path) == len(walk.frames)
    off = inverse(walk.rig.cam0_from_cams[camera]) @ corrected.cam0_from_cams[camera]
    assert np.rad2deg(rotation_angle(off[:3, :3])) < 0.1  # it was 1
    assert np.linalg.norm(off[:3, 3]) < 0.006  # it was 0.01
    # Without the correction 0.016 and 0.0047 m; frames between keyframes were tracked without it.
    assert ate(path, walk.truth) < {1: 0.005, 3: 0.006}[camera]


def test_a_right_calibration_stays(walk: Walk) -> None:
    _, errors, corrected = run(walk.rig, walk)
    assert errors == () and corrected is walk.rig
