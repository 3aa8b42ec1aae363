"""Estimation of an error of the radial distortion, from many windows."""

from __future__ import annotations

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.rectification import RectifiedRig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.engine.geometry.k1_error import corner_radius, edge_shift_px, residual_per_k1

# At the image's edges: the effect of patches that are unevenly spread, and the minimum change of
# a correction.
_SYSTEMATIC_PX, _MIN_CHANGE_PX = 0.2, 0.2
# Windows of correctly calibrated lenses are off by one or two of their standard deviations.
_NOISE = 2.0
# Standard deviations of that size: where parts of the run confirm each other, and in one part.
_SIGNIFICANT, _SIGNIFICANT_ALONE = 2.5, 4.0
_INFORMATIVE = 1.5  # times the standard deviation of a part that the error must have to be judged
_MAX_DIFFERENCE = 0.5  # of a part that confirms an error, ratio of the error
_MIN_DIFFERENCE_SIGMA = 1.5  # of a part that contradicts it
_MIN_WINDOWS = 3
_OVERLAP = 10  # number of consecutive windows that share keyframes
_KNOWN = 0.3  # standard deviation of an error that an earlier pass has found, relative
_MAX_EDGE_PX = 15.0  # larger errors at the edges are not explained by one coefficient
# Of a lens that is quite another one: what windows share, and standard deviations.
_LENS_SYSTEMATIC_PX, _LENS_SIGNIFICANT = 1.0, 3.5
_MAX_RADIUS = 1.2  # focal lengths; few points of very wide lenses lie farther out
# What remains at the image corners. Lenses as calibrated, or wrong by k1 only, have up to 5 px at
# 0.7 and 2.2 px at 2.2 standard deviations; distorted ones taken for ideal 23 to 41 px at 8 to 46.
# In pairs, where parts do not agree on k1: up to 7 px, and 98 and 130 px.
_MIN_BEND_PX, _MIN_PAIR_PX = 6.0, 12.0


class _Mean:
    """A weighted mean of windows; of overlapping ones, one in ten counts for its uncertainty."""

    def __init__(self) -> None:
        self.windows, self._weight, self.value = 0, 0.0, 0.0

    @property
    def sigma(self) -> float:
        return float(np.sqrt(min(self.windows, _OVERLAP) / self._weight))

    def add(self, value: float, sigma: float, windows: int) -> None:
        weight = windows * sigma**-2
        self.windows, self._weight = self.windows + windows, self._weight + weight
        self.value += (value - self.value) * weight / self._weight


class _LensCheck:
    """Averages `CalibrationResidual.bend` over windows.

    A lens that is quite another one than calibrated, such as a distorted one taken for ideal,
    leaves it, even where other estimates from windows cancel.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self._mean = _Mean()
        power, self._min_px = (3, _MIN_PAIR_PX) if rig.is_metric else (5, _MIN_BEND_PX)
        self._px = rig.fx * min(corner_radius(rig), _MAX_RADIUS) ** power  # shift per unit

    @property
    def error_px(self) -> float:
        """At the image corners, 0 unless the lens is another one than calibrated."""
        if self._mean.windows < _MIN_WINDOWS:
            return 0.0
        limit = max(self._min_px, _LENS_SIGNIFICANT * self._mean.sigma)
        return self._mean.value if abs(self._mean.value) > limit else 0.0

    def add(self, residual: CalibrationResidual, windows: int) -> None:
        if np.isfinite(residual.bend_sigma):
            sigma_px = np.hypot(_NOISE * residual.bend_sigma * self._px, _LENS_SYSTEMATIC_PX)
            self._mean.add(residual.bend * self._px, float(sigma_px), windows)


class RadialDistortionEstimator:
    """Averages the estimates of windows, and compares parts of the run with each other.

    In a pair it is the error that both lenses have in common. A part is ten windows, which share no
    keyframes with most others. It confirms an error that was estimated from all if its own
    estimate is that error to within a half.

    Attributes:
        applied: the error of k1 that is corrected.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied = rig.k1_error
        self._rig = rig
        self._per_k1 = residual_per_k1(rig)
        self._k1_of_px = 1.0 / edge_shift_px(rig, 1.0)
        self._systematic = _SYSTEMATIC_PX * self._k1_of_px
        self._whole, self._parts = _Mean(), [_Mean()]
        self._check = _LensCheck(rig)
        if rig.k1_error != 0.0:
            self._whole.add(rig.k1_error, _KNOWN * abs(rig.k1_error), _OVERLAP)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """An error that the correction does not remove."""
        edge_px, error_px = self.applied / self._k1_of_px, self._check.error_px
        if abs(edge_px) <= _MAX_EDGE_PX and error_px == 0.0:
            return ()
        return (Fault(FaultKind.WRONG_LENS, value=max(edge_px, error_px, key=abs)),)

    def update(self, residual: CalibrationResidual, windows: int = 1) -> float | None:
        """Add the estimate of so many windows; the new error to correct, None for no change."""
        self._check.add(residual, windows)
        value, sigma = residual.bend, residual.bend_sigma
        if not self._rig.is_metric:
            value, sigma = float(residual.value[0]), float(residual.information[0, 0]) ** -0.5
        if not np.isfinite(sigma):
            return None
        sigma = float(np.hypot(_NOISE * sigma / self._per_k1, self._systematic))
        if self._parts[-1].windows >= _OVERLAP:
            self._parts.append(_Mean())
        for each in (self._whole, self._parts[-1]):
            each.add(self.applied + value / self._per_k1, sigma, windows)
        wanted = self._whole.value if self._is_confirmed() else 0.0
        if abs(wanted - self.applied) < _MIN_CHANGE_PX * self._k1_of_px:
            return None
        self.applied = wanted
        if self._rig.is_metric:
            self._check = _LensCheck(self._rig)
        return wanted

    def _is_confirmed(self) -> bool:
        """Whether the parts of the run agree on an error; less is asked of one that is applied."""
        size, agreeing, disagreeing = abs(self._whole.value), 0, 0
        for part in self._parts:
            if size > _INFORMATIVE * part.sigma:
                difference, limit = abs(part.value - self._whole.value), _MAX_DIFFERENCE * size
                agreeing += difference < limit
                disagreeing += difference > max(limit, _MIN_DIFFERENCE_SIGMA * part.sigma)
        if self.applied != 0.0:
            return disagreeing <= agreeing and size > self._systematic
        needed = _SIGNIFICANT if agreeing > 1 else _SIGNIFICANT_ALONE
        is_significant = self._whole.windows >= _MIN_WINDOWS and size > needed * self._whole.sigma
        return is_significant and disagreeing == 0
