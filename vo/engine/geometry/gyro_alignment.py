"""Time offset and rotation between a camera and a gyroscope, from rotations that both measured.

Sources: Kelly and Sukhatme, "A general framework for temporal calibration of multiple
proprioceptive and exteroceptive sensors", ISER 2010; Arun et al., "Least-squares fitting of two 3-D
point sets", 1987 (the rotation by SVD); Bortz, "A new mathematical formulation for strapdown
inertial navigation", 1971.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.types import Floats, Ints

_COARSE_S = 0.01
_MIN_INTERVALS = 12
_STEPS = 15
_ROUNDS = 4  # of reweighting
_MIN_STEP_S = 1e-6
_CAUCHY = 2.4  # standard deviations at which a residual has half the weight
_MAX_RESIDUAL = 0.5  # of the signal; above, the two do not measure the same motion
_MIN_SIGNAL_RAD_S = 0.02
_MIRRORED = 0.5  # ratio of residuals of a mirrored and a right-handed frame, below which it is one
_MIN_PLANAR = 0.02  # ratio of second to first singular value for a rotation that is determined


@frozen(eq=False)
class GyroAlignment:
    """How a gyroscope fits the rotations of a camera.

    Attributes:
        time_offset_s: what to add to the stamp of an image to get the same moment on the clock of
            the gyroscope.
        time_offset_sd_s: its standard deviation.
        cam_from_imu: (3, 3) rotation; orthogonal, with determinant -1 if the axes are mirrored.
        rotation_sd_rad: largest standard deviation of it; infinite if all rotations are about one
            axis, because then one angle is arbitrary.
        main_axis: (3,) unit vector in the frame of the gyroscope, about which it turns most.
        gyro_bias: (3,) rad/s.
        residual_rad_s: robust standard deviation of the difference between the rates of both.
        signal_rad_s: RMS of the camera's rate without its mean.
    """

    time_offset_s: float
    time_offset_sd_s: float
    cam_from_imu: Floats
    rotation_sd_rad: float
    main_axis: Floats
    gyro_bias: Floats
    residual_rad_s: float
    signal_rad_s: float
    count: int

    @property
    def is_mirrored(self) -> bool:
        """Whether the axes of the gyroscope form a left-handed frame."""
        return float(np.linalg.det(self.cam_from_imu)) < 0.0


class Rotations(NamedTuple):
    """Rotations of a camera over N intervals of time.

    Attributes:
        first_ns: (N,) stamps of the images at their starts.
        last_ns: (N,) stamps at their ends, at most about 0.2 s later.
        rotvec: (N, 3) rotation vectors of first_from_last, in the frame of the camera.
    """

    first_ns: Ints
    last_ns: Ints
    rotvec: Floats


def align_gyro(
    rotations: Rotations, stamps_ns: Ints, gyro: Floats, max_offset_s: float = 0.3
) -> GyroAlignment | None:
    """Find offset, rotation and bias with which the gyroscope reproduces the camera's rotations.

    Args:
        rotations: of the camera; a third of them may be outliers.
        stamps_ns: (M,) stamps of the gyroscope, increasing.
        gyro: (M, 3) rad/s.
        max_offset_s: largest offset.

    Returns:
        None if there are too few intervals, too little rotation, or both do not fit.
    """
    if len(stamps_ns) < 4 or len(rotations.rotvec) < _MIN_INTERVALS:
        return None
    zero_ns = int(stamps_ns[0])
    integral = _Integral((stamps_ns - zero_ns) / 1e9, gyro)
    first, last = ((ns - zero_ns) / 1e9 for ns in (rotations.first_ns, rotations.last_ns))
    inside = (first >= integral.times[0]) & (last <= integral.times[-1]) & (last > first)
    if inside.sum() < _MIN_INTERVALS:
        return None
    problem = _Problem(integral, first[inside], last[inside], rotations.rotvec[inside])
    signal = float(np.sqrt(np.mean(np.sum(problem.centred(problem.rates) ** 2, axis=1))))
    if signal < _MIN_SIGNAL_RAD_S:
        return None
    offsets = np.arange(-max_offset_s, max_offset_s + 1e-9, _COARSE_S)
    best = int(np.argmin(problem.fits(offsets).scale))
    if not 0 < best < len(offsets) - 1:
        return None
    found = problem.refined(float(offsets[best]))
    if found.residual_rad_s > _MAX_RESIDUAL * signal:
        return None
    return replace(found, signal_rad_s=signal)


class _Integral:
    """Rotation vectors of a gyroscope between any two times, to the second order in the angle.

    Its rate is taken as linear between samples.
    """

    def __init__(self, times: Floats, gyro: Floats) -> None:
        self.times, self._gyro = times, gyro
        steps = np.diff(times)[:, None]
        angle = np.zeros_like(gyro)
        np.cumsum(0.5 * steps * (gyro[1:] + gyro[:-1]), axis=0, out=angle[1:])
        turned = _cross(angle, gyro)
        coning = np.zeros_like(gyro)
        np.cumsum(0.5 * steps * (turned[1:] + turned[:-1]), axis=0, out=coning[1:])
        self._angle, self._turned, self._coning = angle, turned, coning

    def rate(self, times: Floats) -> Floats:
        """(..., 3) angular rates; the nearest sample outside the recorded time."""
        return np.stack([np.interp(times, self.times, axis) for axis in self._gyro.T], axis=-1)

    def rotvec(self, first: Floats, last: Floats) -> Floats:
        """(..., 3) rotation vectors of first_from_last, in the frame at `first`."""
        (a0, c0), (a1, c1) = self._at(first), self._at(last)
        return np.asarray(a1 - a0 + 0.5 * (c1 - c0 - _cross(a0, a1 - a0)))

    def _at(self, times: Floats) -> tuple[Floats, Floats]:
        row = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        step = (times - self.times[row])[..., None]
        rate = self.rate(times)
        angle = self._angle[row] + 0.5 * step * (self._gyro[row] + rate)
        turned = self._turned[row] + _cross(angle, rate)
        return angle, self._coning[row] + 0.5 * step * turned


class _Fits(NamedTuple):
    """Rotation and bias for each of K given offsets.

    Attributes:
        matrix: (K, 3, 3) orthogonal.
        bias: (K, 3) in the camera's frame, rad/s.
        residual: (K, N, 3) rad/s.
        scale: (K,) robust standard deviation of a component.
        weight: (K, N).
    """

    matrix: Floats
    bias: Floats
    residual: Floats
    scale: Floats
    weight: Floats


class _Fit(NamedTuple):
    """One of them."""

    matrix: Floats
    bias: Floats
    residual: Floats
    scale: float
    weight: Floats


class _Problem:
    """The rates of both sensors: rotation vectors divided by the lengths of their intervals."""

    def __init__(self, integral: _Integral, first: Floats, last: Floats, rotvec: Floats) -> None:
        self._integral, self._first, self._last = integral, first, last
        self._seconds = (last - first)[:, None]
        self.rates = rotvec / self._seconds

    def centred(self, rates: Floats, weight: Floats | None = None) -> Floats:
        """Rates without their weighted mean."""
        return np.asarray(rates - np.average(rates, axis=0, weights=weight))

    def fit(self, offset: float, handed: int = 0) -> _Fit:
        """The rotation at an offset; see `fits`."""
        found = self.fits(np.array([offset]), handed)
        matrix, bias, residual, scale, weight = (field[0] for field in found)
        return _Fit(matrix, bias, residual, float(scale), weight)

    def fits(self, offsets: Floats, handed: int = 0) -> _Fits:
        """The rotation at K offsets, with reweighting; `handed` 0 allows mirrored axes too."""
        measured = self._gyro_rates(offsets[:, None])
        weight = np.ones(measured.shape[:2])
        for _ in range(_ROUNDS):
            share = weight / weight.sum(axis=1, keepdims=True)
            camera = share @ self.rates
            gyro = (share[:, None] @ measured)[:, 0]
            matrix = _rotation(
                self.rates - camera[:, None], measured - gyro[:, None], weight, handed
            )
            bias = camera - (matrix @ gyro[:, :, None])[:, :, 0]
            residual = self.rates - measured @ np.swapaxes(matrix, 1, 2) - bias[:, None]
            length = np.sqrt(np.mean(residual**2, axis=2))
            ranked, last = np.sort(length, axis=1), length.shape[1] - 1
            middle = 0.5 * (ranked[:, last // 2] + ranked[:, (last + 1) // 2])
            scale = np.maximum(1.3 * middle, 1e-9)
            weight = 1.0 / (1.0 + (length / (_CAUCHY * scale[:, None])) ** 2)
        return _Fits(matrix, bias, residual, scale, weight)

    def refined(self, offset: float) -> GyroAlignment:
        """Gauss-Newton on offset, rotation and bias."""
        handed = 1
        if self.fit(offset, -1).scale < _MIRRORED * self.fit(offset, 1).scale:
            handed = -1
        covariance = np.full((7, 7), np.inf)
        for _ in range(_STEPS):
            fit = self.fit(offset, handed)
            jacobian = self._jacobian(offset, fit)
            weighted = jacobian * fit.weight[:, None, None]
            information = np.einsum("nij,nik->jk", weighted, jacobian)
            gradient = np.einsum("nij,ni->j", weighted, fit.residual)
            covariance = np.linalg.pinv(information, rcond=1e-10, hermitian=True)
            step = float((covariance @ gradient)[0])
            offset += float(np.clip(step, -_COARSE_S, _COARSE_S))
            if abs(step) < _MIN_STEP_S:
                break
        fit = self.fit(offset, handed)
        variance = fit.scale**2 * np.diag(covariance)
        rates = self.centred(self._gyro_rates(offset))
        values, axes = np.linalg.svd(rates, full_matrices=False)[1:]
        planar = values[1] < _MIN_PLANAR * values[0]
        return GyroAlignment(
            time_offset_s=offset,
            time_offset_sd_s=float(np.sqrt(variance[0])),
            cam_from_imu=fit.matrix,
            rotation_sd_rad=float("inf") if planar else float(np.sqrt(variance[1:4].max())),
            main_axis=axes[0],
            gyro_bias=-fit.matrix.T @ fit.bias,
            residual_rad_s=float(fit.scale * np.sqrt(3.0)),
            signal_rad_s=0.0,
            count=len(self.rates),
        )

    def _jacobian(self, offset: float, fit: _Fit) -> Floats:
        """(N, 3, 7) derivatives of the prediction by offset, rotation (left) and bias."""
        change = self._integral.rate(self._last + offset) - self._integral.rate(
            self._first + offset
        )
        predicted = self._gyro_rates(offset) @ fit.matrix.T
        jacobian = np.zeros((len(predicted), 3, 7))
        jacobian[:, :, 0] = change @ fit.matrix.T / self._seconds
        x, y, z = predicted.T
        jacobian[:, 0, 2], jacobian[:, 0, 3] = z, -y
        jacobian[:, 1, 1], jacobian[:, 1, 3] = -z, x
        jacobian[:, 2, 1], jacobian[:, 2, 2] = y, -x
        jacobian[:, :, 4:] = np.eye(3)
        return jacobian

    def _gyro_rates(self, offset: float | Floats) -> Floats:
        rotvec = self._integral.rotvec(self._first + offset, self._last + offset)
        return np.asarray(rotvec / self._seconds)


def _cross(a: Floats, b: Floats) -> Floats:
    """Cross products (..., 3), in a third of the time of `np.cross`."""
    ax, ay, az = (a[..., k] for k in range(3))
    bx, by, bz = (b[..., k] for k in range(3))
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def _rotation(camera: Floats, gyro: Floats, weight: Floats, handed: int) -> Floats:
    """The orthogonal matrices that map rates of the gyroscope to those of the camera best."""
    u, _, vt = np.linalg.svd(np.swapaxes(camera * weight[:, :, None], 1, 2) @ gyro)
    if handed != 0:
        u[:, :, 2] *= handed * (np.linalg.det(u) * np.linalg.det(vt))[:, None]
    return np.asarray(u @ vt)
