"""Orientation of an inertial sensor on a camera, and its time offset, by the camera's path."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from vo.base.errors import VoError
from vo.base.geometry.transforms import make_transform, so3_log
from vo.base.types import Estimate
from vo.engine.geometry.gyro_alignment import Rotations, align_gyro
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.sources.imu import Imu

_log = logging.getLogger(__name__)
_INTERVAL_S = 0.1  # of compared rotations
_MAX_OFFSETS_S = (0.3, 2.0)
_MAX_RESIDUAL = 0.25  # of the signal
_MAX_SIGMA_RAD = 0.035


def align_sensor(sensor: Imu, path: Sequence[Estimate]) -> ImuCalibration | None:
    """Orientation and time offset of a sensor, taken to be at the camera.

    Returns:
        None if the camera turned too little or about one axis, or the sensor does not fit.
    """
    turned = _rotations(path)
    try:
        samples = sensor.read()
    except VoError:
        return None
    for reach_s in _MAX_OFFSETS_S:
        found = align_gyro(turned, samples.stamps_ns, samples.gyro, reach_s)
        if found is None or found.is_mirrored or found.rotation_sd_rad > _MAX_SIGMA_RAD:
            continue
        if found.residual_rad_s < _MAX_RESIDUAL * found.signal_rad_s:
            _log.info("%s: %s", sensor.name, found)
            pose = make_transform(found.cam_from_imu, np.zeros(3))
            return ImuCalibration(pose, sensor.noise, round(found.time_offset_s, 6))
    return None


def _rotations(path: Sequence[Estimate]) -> Rotations:
    """Rotations between frames of a tenth of a second apart."""
    stamps = np.array([each.stamp_ns for each in path], dtype=np.int64)
    after = np.searchsorted(stamps, stamps + round(_INTERVAL_S * 1e9))
    found = []
    for first, last in enumerate(after.tolist()):
        if last >= len(path) or stamps[last] - stamps[first] > 2e9 * _INTERVAL_S:
            continue
        a, b = path[first], path[last]
        if a.segment == b.segment and a.world_from_cam0 is not None:
            assert b.world_from_cam0 is not None
            turned = so3_log(a.world_from_cam0[:3, :3].T @ b.world_from_cam0[:3, :3])
            found.append((a.stamp_ns, b.stamp_ns, turned))
    return Rotations(
        np.array([row[0] for row in found], dtype=np.int64),
        np.array([row[1] for row in found], dtype=np.int64),
        np.array([row[2] for row in found]).reshape(-1, 3),
    )
