"""Pose and time offset of an inertial sensor on a camera, from poses relative to a board.

A batch problem: the pose and velocity of the sensor at each image, and, common to all, its pose on
the camera, the time offset, both biases and the direction of gravity. Images and samples are
weighted by their noise.

Sources: Furgale et al., "Unified temporal and spatial calibration for multi-sensor systems", IROS
2013 (the problem; with splines); Forster et al., 2017 (inertial residuals).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bools, Floats, ImuNoise, Ints
from vo.engine.geometry.gyro_alignment import GyroAlignment, Rotations, align_gyro
from vo.engine.geometry.so3 import log_rows
from vo.tools.calibrating.board_poses import BoardPoses
from vo.tools.calibrating.imu_camera_states import (
    COMMON,
    OFFSET,
    ROTATION,
    STATE,
    TRANSLATION,
    BorderedSystem,
    Common,
    Increments,
    Samples,
    States,
)

_MAX_GAP = 3.5  # median intervals; longer ones are not bridged
_MIN_VIEWS = 40
_MARGIN_S = 0.02
_ITERATIONS = 25
_CONVERGED = 1e-6
_PRIOR_SD = np.array([10.0] * 3 + [10.0] * 3 + [1.0] + [0.2] * 3 + [0.5] * 3 + [10.0] * 2)
_EPSILON = 1e-6
_CAUCHY = 9.0  # squared Mahalanobis distance of a pose of half weight


@dataclass(frozen=True, eq=False)
class ImuOnCamera:
    """Result: the sensor on the camera."""

    cam0_from_imu: Floats  # (4, 4)
    time_offset_s: float  # what to add to stamps of images to get the clock of the sensor
    rotation_sd_deg: Floats  # (3,) standard deviations about the axes of the camera
    translation_sd_m: Floats  # (3,) along them
    time_offset_sd_s: float
    gyro_bias: Floats  # (3,) rad/s
    accel_bias: Floats  # (3,) m/s²
    misfit: float  # residuals relative to the given noise; about 1
    views: int
    seconds: float  # time from the first to the last
    corner_rms_px: float  # error of corners of the board in the images


def calibrate_imu_camera(
    poses: BoardPoses, stamps_ns: Ints, gyro: Floats, accel: Floats, noise: ImuNoise
) -> ImuOnCamera:
    """Calibrate from poses of cam0 and samples.

    `poses`: of cam0 relative to the board. `stamps_ns`: (M,) stamps of the samples. `gyro`: (M, 3)
    rad/s. `accel`: (M, 3) m/s².

    Raises:
        CalibrationError: too few views, too little rotation, or both do not fit together.
    """
    poses = _with_neighbours(poses)
    _check_count(poses)
    aligned = _align(poses, stamps_ns, gyro)
    problem = _Problem(poses, stamps_ns, gyro, accel, noise, aligned)
    return problem.solve()


def _check_count(poses: BoardPoses) -> None:
    if len(poses.stamps_ns) < _MIN_VIEWS:
        raise CalibrationError(
            f"the board is seen in {len(poses.stamps_ns)} consecutive images; at least "
            f"{_MIN_VIEWS} are needed: keep it in view while you turn and move the camera quickly"
        )


def _with_neighbours(poses: BoardPoses) -> BoardPoses:
    """Views without a view just before or after are left out."""
    joined = _joined(poses.stamps_ns)
    kept = np.concatenate([[False], joined]) | np.concatenate([joined, [False]])
    if len(poses.stamps_ns) < 2:
        kept = np.zeros(len(poses.stamps_ns), dtype=bool)
    return replace(
        poses,
        stamps_ns=poses.stamps_ns[kept],
        board_from_cam=poses.board_from_cam[kept],
        information=poses.information[kept],
    )


def _joined(stamps_ns: Ints) -> Bools:
    """(N - 1,) whether a view and the next one are close in time."""
    steps = np.diff(stamps_ns)
    return np.asarray(steps <= _MAX_GAP * np.median(steps)) if len(steps) else np.zeros(0, bool)


def _align(poses: BoardPoses, stamps_ns: Ints, gyro: Floats) -> GyroAlignment:
    """First guess of rotation, offset and bias of the gyroscope."""
    joined = _joined(poses.stamps_ns)
    rotation = poses.board_from_cam[:, :3, :3]
    turned = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    rotations = Rotations(poses.stamps_ns[:-1], poses.stamps_ns[1:], log_rows(turned))
    chosen = Rotations(
        rotations.first_ns[joined], rotations.last_ns[joined], rotations.rotvec[joined]
    )
    found = align_gyro(chosen, stamps_ns, gyro)
    if found is None:
        raise CalibrationError(
            "the rotation of the camera does not match the gyroscope at any time offset up to "
            "0.3 s: turn it quickly about all axes, and check that both use one clock "
            "(vo info RECORDING)"
        )
    if found.is_mirrored:
        raise CalibrationError(
            "the axes of the gyroscope form a left-handed frame: one axis, or all, have the wrong "
            "sign"
        )
    if not np.isfinite(found.rotation_sd_rad):
        raise CalibrationError(
            "the camera was turned about one axis only; turn it about at least two"
        )
    return found


class _Problem:
    def __init__(
        self,
        poses: BoardPoses,
        stamps_ns: Ints,
        gyro: Floats,
        accel: Floats,
        noise: ImuNoise,
        aligned: GyroAlignment,
    ) -> None:
        self._poses = self._inside(poses, stamps_ns, aligned.time_offset_s)
        _check_count(self._poses)
        zero_ns = int(stamps_ns[0])
        self._samples = Samples((stamps_ns - zero_ns) / 1e9, gyro, accel)
        self._times = (self._poses.stamps_ns - zero_ns) / 1e9
        self._is_joined = _joined(self._poses.stamps_ns)
        self._seconds = np.diff(self._times)
        self._whiten_imu = self._imu_weights(noise)
        self._whiten_cam = np.swapaxes(np.linalg.cholesky(self._poses.information), 1, 2)
        self._common = Common(
            aligned.cam_from_imu,
            np.zeros(3),
            aligned.time_offset_s,
            aligned.gyro_bias,
            np.zeros(3),
            np.eye(3),
        )
        self._states = self._first_states()
        self._common = self._common._replace(up=self._first_up(accel))

    @staticmethod
    def _inside(poses: BoardPoses, stamps_ns: Ints, offset_s: float) -> BoardPoses:
        """The views between the first and the last sample."""
        margin = round(1e9 * _MARGIN_S)
        at = poses.stamps_ns + round(1e9 * offset_s)
        kept = (at > stamps_ns[0] + margin) & (at < stamps_ns[-1] - margin)
        return _with_neighbours(
            replace(
                poses,
                stamps_ns=poses.stamps_ns[kept],
                board_from_cam=poses.board_from_cam[kept],
                information=poses.information[kept],
            )
        )

    def _imu_weights(self, noise: ImuNoise) -> Floats:
        """(M, 9, 9) square roots of the information of increments; 0 over gaps."""
        seconds = np.where(self._is_joined, self._seconds, 1.0)
        covariance = np.zeros((len(seconds), 9, 9))
        each = np.eye(3)
        gyro, accel = noise.gyro_noise**2, noise.accel_noise**2
        covariance[:, :3, :3] = gyro * seconds[:, None, None] * each
        covariance[:, 3:6, 3:6] = accel * seconds[:, None, None] * each
        covariance[:, 6:, 6:] = accel * seconds[:, None, None] ** 3 / 3.0 * each
        both = accel * seconds[:, None, None] ** 2 / 2.0 * each
        covariance[:, 3:6, 6:] = covariance[:, 6:, 3:6] = both
        root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(covariance)), 1, 2)
        return np.asarray(root * self._is_joined[:, None, None])

    def _first_states(self) -> States:
        poses = self._poses.board_from_cam
        rotation = poses[:, :3, :3] @ self._common.rotation
        position = poses[:, :3, 3]
        velocity = np.gradient(position, self._times, axis=0)
        return States(rotation, position, velocity)

    def _first_up(self, accel: Floats) -> Floats:
        """Rotation of z to the mean direction of the specific force."""
        at = self._times + self._common.offset_s
        force = np.stack([np.interp(at, self._samples.times_s, axis) for axis in accel.T], axis=1)
        mean = np.einsum("nij,nj->i", self._states.rotation, force)
        up = mean / np.linalg.norm(mean)
        side = np.linalg.svd(up[None])[2][1]
        return np.stack([side, np.cross(up, side), up], axis=1)

    def solve(self) -> ImuOnCamera:
        """Levenberg-Marquardt, with less weight for views that do not fit."""
        damping, cost = 1e-6, self._cost(self._states, self._common)
        for _ in range(_ITERATIONS):
            system = self._system()
            of_states, of_common, _ = system.solve(damping)
            states, common = self._states.moved(of_states), self._common.moved(of_common)
            new = self._cost(states, common)
            if new > cost * (1.0 + 1e-12):
                damping *= 30.0
                if damping > 1e6:
                    break
                continue
            self._states, self._common = states, common
            done = cost - new < _CONVERGED * cost
            damping, cost = max(0.1 * damping, 1e-12), new
            if done:
                break
        return self._result(cost)

    def _result(self, cost: float) -> ImuOnCamera:
        information = self._system().solve(0.0)[2]
        # 6 numbers for each view and 9 between views determine 9 for each view.
        freedom = 6 * len(self._times) + 9 * int(self._is_joined.sum()) - STATE * len(self._times)
        misfit = float(np.sqrt(cost / max(freedom - COMMON, 1)))
        sd = misfit * np.sqrt(np.diag(np.linalg.inv(information)))
        common = self._common
        return ImuOnCamera(
            make_transform(common.rotation, common.translation),
            common.offset_s,
            np.degrees(sd[ROTATION]),
            sd[TRANSLATION],
            float(sd[OFFSET]),
            common.gyro_bias,
            common.accel_bias,
            misfit,
            len(self._times),
            float(self._times[-1] - self._times[0]),
            self._poses.rms_px,
        )

    def _cost(self, states: States, common: Common) -> float:
        imu = self._imu_residual(states, states, common, self._increments(common))
        squared = np.sum(self._cam_residual(states, common) ** 2, axis=1)
        robust = _CAUCHY * np.log1p(squared / _CAUCHY)
        return float(np.sum(imu**2) + np.sum(robust))

    def _increments(self, common: Common) -> Increments:
        first = self._times[:-1] + common.offset_s
        last = np.where(self._is_joined, self._times[1:], self._times[:-1] + 1e-3)
        return self._samples.integrate(
            first, last + common.offset_s, common.gyro_bias, common.accel_bias
        )

    def _imu_residual(
        self, before: States, after: States, common: Common, increments: Increments
    ) -> Floats:
        """(M, 9) whitened; the first states are those of `before`, the second of `after`."""
        first, second = before.part(slice(None, -1)), after.part(slice(1, None))
        seconds, gravity = self._seconds[:, None], common.gravity
        back = np.swapaxes(first.rotation, 1, 2)
        turned = np.swapaxes(increments.rotation, 1, 2) @ back @ second.rotation
        faster = second.velocity - first.velocity - gravity * seconds
        moved = second.position - first.position - first.velocity * seconds
        moved = moved - 0.5 * gravity * seconds**2
        residual = np.concatenate(
            [
                log_rows(turned),
                np.einsum("nij,nj->ni", back, faster) - increments.velocity,
                np.einsum("nij,nj->ni", back, moved) - increments.position,
            ],
            axis=1,
        )
        return np.asarray(np.einsum("nij,nj->ni", self._whiten_imu, residual))

    def _cam_residual(self, states: States, common: Common) -> Floats:
        """(N, 6) whitened differences from the measured poses of the camera."""
        imu_from_cam = common.rotation.T
        centre = -imu_from_cam @ common.translation
        back = np.swapaxes(self._poses.board_from_cam[:, :3, :3], 1, 2)
        turned = back @ states.rotation @ imu_from_cam
        moved = states.position + states.rotation @ centre - self._poses.board_from_cam[:, :3, 3]
        residual = np.concatenate([log_rows(turned), np.einsum("nij,nj->ni", back, moved)], axis=1)
        return np.asarray(np.einsum("nij,nj->ni", self._whiten_cam, residual))

    def _system(self) -> BorderedSystem:
        """Normal equations, with derivatives by differences, for all images at once."""
        states, common = self._states, self._common
        increments = self._increments(common)
        imu = self._imu_residual(states, states, common, increments)
        cam = self._cam_residual(states, common)
        count = len(states.position)
        by_first, by_second = (np.zeros((count - 1, 9, STATE)) for _ in range(2))
        by_state = np.zeros((count, 6, STATE))
        for k in range(STATE):
            step = np.zeros((count, STATE))
            step[:, k] = _EPSILON
            moved = states.moved(step)
            by_first[:, :, k] = self._imu_residual(moved, states, common, increments) - imu
            by_second[:, :, k] = self._imu_residual(states, moved, common, increments) - imu
            by_state[:, :, k] = self._cam_residual(moved, common) - cam
        imu_common, cam_common = np.zeros((count - 1, 9, COMMON)), np.zeros((count, 6, COMMON))
        for k in range(COMMON):
            moved_common = common.moved(_EPSILON * np.eye(COMMON)[k])
            again = self._increments(moved_common)
            imu_common[:, :, k] = self._imu_residual(states, states, moved_common, again) - imu
            cam_common[:, :, k] = self._cam_residual(states, moved_common) - cam
        root = 1.0 / np.sqrt(1.0 + np.sum(cam**2, axis=1) / _CAUCHY)
        cam = cam * root[:, None]
        by_state, cam_common = (each * root[:, None, None] for each in (by_state, cam_common))
        system = BorderedSystem.empty(count, STATE, COMMON)
        for jacobian in (by_first, by_second, by_state, imu_common, cam_common):
            jacobian /= _EPSILON
        _add(system, slice(None, -1), by_first, imu_common, imu)
        _add(system, slice(1, None), by_second, imu_common, imu)
        _add(system, slice(None), by_state, cam_common, cam)
        system.next += np.einsum("nki,nkj->nij", by_first, by_second)
        for jacobian, residual in ((imu_common, imu), (cam_common, cam)):
            system.corner += np.einsum("nki,nkj->ij", jacobian, jacobian)
            system.right_common -= np.einsum("nki,nk->i", jacobian, residual)
        system.corner += np.diag(_PRIOR_SD**-2.0)
        return system


def _add(
    system: BorderedSystem, rows: slice, by_state: Floats, by_common: Floats, residual: Floats
) -> None:
    """Add the products of a derivative by states with itself, the border and the residual."""
    system.diagonal[rows] += np.einsum("nki,nkj->nij", by_state, by_state)
    system.border[rows] += np.einsum("nki,nkj->nij", by_state, by_common)
    system.right[rows] -= np.einsum("nki,nk->ni", by_state, residual)


_MAX_ROTATION_DEG, _MAX_TRANSLATION_M, _MAX_OFFSET_S = 0.1, 0.003, 0.5e-3
_MAX_MISFIT = 3.0
_MIN_SECONDS = 10.0
_MAX_CORNER_PX = 0.7


def warnings_of(found: ImuOnCamera) -> list[str]:
    """What the user should know about the result, and do."""
    lines = []
    if found.seconds < _MIN_SECONDS:
        lines.append(f"only {found.seconds:.0f} s are used; 30 to 60 s are better")
    if float(np.max(found.rotation_sd_deg)) > _MAX_ROTATION_DEG:
        lines.append(
            f"the rotation is known to {np.max(found.rotation_sd_deg):.2g} degrees only; turn the "
            "camera more, about all three axes"
        )
    if float(np.max(found.translation_sd_m)) > _MAX_TRANSLATION_M:
        lines.append(
            f"the position is known to {1e3 * np.max(found.translation_sd_m):.2g} mm only; turn "
            "the camera faster, back and forth, so that rotations accelerate"
        )
    if found.time_offset_sd_s > _MAX_OFFSET_S:
        lines.append(f"the time offset is known to {1e3 * found.time_offset_sd_s:.2g} ms only")
    if found.misfit > _MAX_MISFIT:
        lines.append(
            f"samples and images fit {found.misfit:.1f} times worse than their noise: rolling "
            "shutter, motion blur, a wrong size of the squares, stamps of arrival, or more noise "
            "than given"
        )
    if found.corner_rms_px > _MAX_CORNER_PX:
        lines.append(
            f"corners are off by {found.corner_rms_px:.2f} px: check the calibration of the "
            "camera, use shorter exposures"
        )
    return lines


def comments(found: ImuOnCamera) -> list[str]:
    """Comments for the calibration file."""
    return [
        f"vo calibrate --imu: {found.views} views in {found.seconds:.1f} s, corners "
        f"{found.corner_rms_px:.3f} px RMS, misfit {found.misfit:.2f}",
        f"standard deviations: rotation {np.max(found.rotation_sd_deg):.4f} degrees, position "
        f"{1e3 * np.max(found.translation_sd_m):.2f} mm, time offset "
        f"{1e3 * found.time_offset_sd_s:.3f} ms",
    ]
