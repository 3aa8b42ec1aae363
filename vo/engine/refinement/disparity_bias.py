"""Estimation of a disparity bias, constant or growing towards the sides, from many windows."""

from __future__ import annotations

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.rectification import RectifiedRig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.base.types import Bools, Floats

# Windows of one recording differ by more than their noise, due to uneven rectification and moving
# objects: a standard deviation of 0.1 px at the image's sides, measured on real recordings.
_SYSTEMATIC_PX = 0.1
_SIGNIFICANT = 2.5  # standard deviations of a part that stays corrected
# A new correction of less than 0.75 px at the sides must be more certain, and windows must agree
# on it: those of real, well-calibrated recordings show up to 0.5 px for a while, but scatter by a
# fifth of it and drift away. Those of wrong calibrations scatter by less than a tenth.
_SMALL_PX, _SIGNIFICANT_SMALL, _MIN_MEAN_BY_SPREAD = 0.75, 4.0, 6.0
_MIN_CHANGE_PX = 0.05
_MIN_WINDOWS = 3
_MIN_SKEW_PX, _MIN_YAW_RATIO, _MAX_YAW_RATIO = 0.3, 0.5, 1.5
_OVERLAP = 10  # number of consecutive windows that share keyframes
_MEMORY = 20  # windows by which a correction is judged
# A calibration that is slightly wrong has a smaller bias, in the middle and at the sides of the
# image; only that of a yaw, which rows confirm, may be larger.
_MAX_BIAS_PX, _MAX_YAW_RAD = 3.0, 0.0105  # 0.6 degrees


class DisparityBiasEstimator:
    """Averages the estimates of windows.

    A correction is judged by the windows after it, which were not used for it: if they are
    explained better without it, it is taken back and the estimation starts again.

    Attributes:
        applied: (2,) the offset and the curve that are corrected, pixels.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied: Floats = np.zeros(2)
        self._implausible_px = 0.0
        edge = max(rig.cx, rig.width - rig.cx) / rig.fx
        self._edge = np.array([1.0, edge**2])  # value of each of the two at the image's sides
        self._systematic = np.diag((_SYSTEMATIC_PX / self._edge) ** 2)
        self._max_yaw_px = _MAX_YAW_RAD * rig.fx
        self._min_windows = _MIN_WINDOWS
        self._restart()

    @property
    def faults(self) -> tuple[Fault, ...]:
        """A bias that is too large to be corrected."""
        fault = Fault(FaultKind.WRONG_STEREO_CALIBRATION, value=self._implausible_px)
        return (fault,) if self._implausible_px != 0.0 else ()

    def update(
        self, residual: CalibrationResidual, windows: int = 1, skew_px: float | None = None
    ) -> Floats | None:
        """Add the estimate of a window that stands for `windows` of them.

        Windows overlap: one in ten counts for the uncertainty of their mean.

        `skew_px`: of vertical disparities, None if it is unknown.

        Returns:
            The new offset and curve to apply, None for no change.
        """
        covariance = np.linalg.inv(residual.information) + self._systematic
        information: Floats = np.asarray(np.linalg.inv(covariance))
        if self._is_refuted(residual.value, information, windows):
            self._restart()
            self._min_windows = _OVERLAP
        self._add(self.applied + residual.value, information, windows)
        wanted = np.zeros(2) if self._windows < self._min_windows else self._wanted(skew_px)
        if not (np.abs(wanted - self.applied) * self._edge >= _MIN_CHANGE_PX).any():
            return None
        self.applied = wanted
        return wanted

    def _restart(self) -> None:
        self._information, self._sum = np.zeros((2, 2)), np.zeros(2)
        self._windows = 0
        self._mean, self._weight, self._chi2 = np.zeros(2), np.zeros(2), np.zeros(2)
        self._support = 0.0

    def _is_refuted(self, residual: Floats, information: Floats, windows: int) -> bool:
        """Whether the windows since the correction fit better without it: difference of chi^2."""
        if not self.applied.any():
            return False
        without = self.applied + residual
        gain = without @ information @ without - residual @ information @ residual
        fading = max(0.0, 1.0 - windows / _MEMORY)
        self._support = fading * self._support + windows / _OVERLAP * float(gain)
        return self._support < 0.0

    def _add(self, bias: Floats, information: Floats, windows: int) -> None:
        self._information += windows * information
        self._sum += windows * information @ bias
        self._windows += windows
        weight = windows * np.diag(information)
        self._weight = self._weight + weight
        change, part = bias - self._mean, weight / self._weight
        self._mean = self._mean + part * change
        self._chi2 = self._chi2 + weight * (1.0 - part) * change**2

    def _wanted(self, skew_px: float | None) -> Floats:
        """The bias that is worth correcting."""
        simplest = self._simplest(_SIGNIFICANT)
        if not self._is_yaw(float(simplest[0]), skew_px):
            is_doubtful = (self.applied == 0.0) & ~self._is_consistent(simplest)
            simplest = np.where(is_doubtful, 0.0, simplest)
        wanted = np.where(np.abs(simplest) * self._edge > _SYSTEMATIC_PX, simplest, 0.0)
        self._implausible_px = self._excess(wanted, skew_px)
        return wanted if self._implausible_px == 0.0 else np.zeros(2)

    def _excess(self, bias: Floats, skew_px: float | None) -> float:
        """An offset, or else a curve at the sides, that is implausible; 0 if both are plausible.

        A yaw has both, of the same size at one focal length, unless its offset is compensated.
        """
        for each_px, edge in zip(bias.tolist(), self._edge.tolist(), strict=True):
            is_yaw = self._is_yaw(each_px, skew_px) and abs(each_px) <= self._max_yaw_px
            if abs(each_px) * edge > _MAX_BIAS_PX and not is_yaw:
                return float(each_px * edge)
        return 0.0

    def _is_yaw(self, offset_px: float, skew_px: float | None) -> bool:
        return skew_px is not None and is_from_yaw(offset_px, skew_px)

    def _is_consistent(self, bias: Floats) -> Bools:
        """Which of the two windows agree on, if they are small."""
        is_large = np.abs(bias) * self._edge > _SMALL_PX
        spread = np.sqrt(self._chi2 / self._weight * self._windows / max(1, self._windows - 1))
        is_certain = self._simplest(_SIGNIFICANT_SMALL) != 0.0
        agree = np.abs(bias) > _MIN_MEAN_BY_SPREAD * spread
        return np.asarray(is_large | (is_certain & agree))

    def _simplest(self, significant: float) -> Floats:
        """The fewest parameters that explain the windows: none, one of the two, or both."""
        weight = (1.0 + (self._windows - 1) / _OVERLAP) / self._windows
        # Where windows differ more than usual (Birge's ratio).
        scale = np.maximum(1.0, np.sqrt(self._chi2 / max(1, self._windows - 1)))
        both: Floats = np.asarray(np.linalg.solve(self._information, self._sum))
        best, least = both, significant
        for kept in ([], [0], [1]):
            value = np.zeros(2)
            value[kept] = self._sum[kept] / self._information[kept, kept]
            remaining = (both - value) / scale
            distance = float(np.sqrt(weight * remaining @ self._information @ remaining))
            if distance < least:
                best, least = value, distance
            if not best.any():
                break
        return best


def is_from_yaw(offset_px: float, skew_px: float) -> bool:
    """Whether the offset and the skew of vertical disparities are both from a yaw error.

    A right camera turned by w about its vertical axis has vertical disparities of w x y and a bias
    of disparities of -w (1 + x^2), in pixels from the principal point over focal length. A skew
    from another cause has another size.
    """
    ratio = -offset_px / skew_px if abs(skew_px) > _MIN_SKEW_PX else 0.0
    return _MIN_YAW_RATIO < ratio < _MAX_YAW_RATIO
