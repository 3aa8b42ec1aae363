"""Pose of an inertial sensor on a camera, and its time offset, by the camera's path.

The position is a linear least-squares solution, with known rotations, of the equations that relate
preintegrated samples to positions of the camera: Martinelli, "Closed-form solution of
visual-inertial structure from motion", 2014, with the lever arm as a further unknown.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence

import numpy as np

from vo.base.errors import VoError
from vo.base.geometry.transforms import make_transform, so3_log
from vo.base.types import Estimate, Floats, Ints
from vo.engine.geometry import so3
from vo.engine.geometry.gyro_alignment import Rotations, align_gyro
from vo.engine.inertial.preintegration import Preintegrated, preintegrate
from vo.engine.inertial.samples import SampleReader
from vo.recordings.formats.calibration import ImuCalibration
from vo.recordings.sources.imu import Imu, usable_noise

_log = logging.getLogger(__name__)
_INTERVAL_S = 0.1  # of compared rotations
_MAX_OFFSETS_S = (0.3, 2.0)
_MAX_RESIDUAL = 0.25  # of the signal
_MAX_SIGMA_RAD = 0.035
_STEP_NS = 200_000_000  # between the poses that a position is found from
_TOLERANCE_NS, _MAX_STEP_NS, _MIN_STEPS = 2_000_000, 500_000_000, 20
# Standard deviations of changes of velocity and of position, of the position and of the bias.
_VELOCITY_M_S, _POSITION_M, _ARM_M, _BIAS_M_S2 = 0.02, 0.004, 0.1, 0.3
_UNKNOWN = 10  # columns before the velocities: scale, gravity, bias, position


def align_sensor(sensor: Imu, path: Sequence[Estimate]) -> ImuCalibration | None:
    """Pose and time offset of a sensor.

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
            arm = _camera_in_imu(sensor, path, found.cam_from_imu, found.time_offset_s)
            pose = make_transform(found.cam_from_imu, np.round(-found.cam_from_imu @ arm, 4))
            return ImuCalibration(pose, sensor.noise, round(found.time_offset_s, 6))
    return None


def _camera_in_imu(
    sensor: Imu, path: Sequence[Estimate], cam_from_imu: Floats, time_offset_s: float
) -> Floats:
    """Position (3,) of the camera in the frame of the sensor; near 0 where motion hardly shows it.

    Unknown are the scale of the path, gravity, the bias of the accelerometer, this position and all
    velocities.
    """
    reader = SampleReader(sensor)
    reader.time_offset_s = time_offset_s
    stamps, world_from_cam = _poses(path)
    rotation = world_from_cam[:, :3, :3] @ cam_from_imu
    noise, zero = usable_noise(sensor), np.zeros(3)
    steps: list[tuple[int, Preintegrated]] = []
    for k, ends in enumerate(zip(stamps[:-1].tolist(), stamps[1:].tolist(), strict=True)):
        samples = reader.between(*ends) if ends[1] - ends[0] < _MAX_STEP_NS else None
        if samples is not None:
            steps.append((k, preintegrate(samples, zero, zero, noise)))
    if len(steps) < _MIN_STEPS:
        return zero
    turned = np.stack([p.rotation.T @ rotation[k].T @ rotation[k + 1] for k, p in steps])
    jacobian = np.stack([p.jacobian for _, p in steps])
    gyro_bias = np.linalg.lstsq(
        jacobian[:, :3, :3].reshape(-1, 3), so3.log(turned).reshape(-1), rcond=None
    )[0]
    size = _UNKNOWN + 3 * len(stamps)
    matrix, right = np.zeros((len(steps), 6, size)), np.zeros((len(steps), 6))
    for row, (k, step) in enumerate(steps):
        here, there = _UNKNOWN + 3 * k, _UNKNOWN + 3 * k + 3
        seconds, eye, first = step.duration_s, np.eye(3), rotation[k]
        velocity, position = matrix[row, :3], matrix[row, 3:]
        velocity[:, there : there + 3], velocity[:, here : here + 3] = eye, -eye
        velocity[:, 1:4] = -seconds * eye
        position[:, 0] = world_from_cam[k + 1, :3, 3] - world_from_cam[k, :3, 3]
        position[:, here : here + 3] = -seconds * eye
        position[:, 1:4] = -0.5 * seconds**2 * eye
        position[:, 7:10] = first - rotation[k + 1]
        for part, at in ((velocity, 3), (position, 6)):
            part[:, 4:7] = -first @ step.jacobian[at : at + 3, 3:]
        moved = np.concatenate([step.velocity, step.position]) + step.jacobian[3:, :3] @ gyro_bias
        right[row] = (moved.reshape(2, 3) @ first.T).reshape(-1)
    weight = 1.0 / np.repeat([_VELOCITY_M_S, _POSITION_M], 3)
    prior = np.zeros((6, size))
    prior[:, 4:_UNKNOWN] = np.diag(1.0 / np.repeat([_BIAS_M_S2, _ARM_M], 3))
    matrix = np.concatenate([(matrix * weight[:, None]).reshape(-1, size), prior])
    right = np.concatenate([(right * weight).reshape(-1), np.zeros(6)])
    arm = np.linalg.lstsq(matrix, right, rcond=None)[0][7:_UNKNOWN]
    _log.info("%s: the camera is at %s m", sensor.name, np.round(arm, 4))
    return np.asarray(arm)


def _poses(path: Sequence[Estimate]) -> tuple[Ints, Floats]:
    """Stamps (N,) and poses (N, 4, 4) of frames of the longest segment, 0.2 s apart."""
    longest = Counter(each.segment for each in path).most_common(1)[0][0]
    stamps: list[int] = []
    poses = []
    for each in path:
        late = not stamps or each.stamp_ns - stamps[-1] > _STEP_NS - _TOLERANCE_NS
        if each.segment == longest and each.world_from_cam0 is not None and late:
            stamps.append(each.stamp_ns)
            poses.append(each.world_from_cam0)
    return np.array(stamps, dtype=np.int64), np.stack(poses)


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
