"""Estimation of a disparity bias, constant or growing towards the sides, from many windows."""

from __future__ import annotations

import numpy as np

from vo.calibration_errors import CalibrationResidual
from vo.faults import Fault, FaultKind
from vo.geometry.rectification import RectifiedRig
from vo.types import Floats

# Windows of one recording differ by more than their noise, due to uneven rectification and moving
# objects: a standard deviation of 0.1 px of the offset, measured on real recordings.
_SYSTEMATIC_PX = 0.1
_SIGNIFICANT = 2.5  # standard deviations
_MIN_CHANGE_PX = 0.05
_MIN_WINDOWS = 3
_MIN_SKEW_PX, _MIN_YAW_RATIO, _MAX_YAW_RATIO = 0.3, 0.5, 1.5
_OVERLAP = 10  # number of consecutive windows that share keyframes
# A calibration that is slightly wrong has a smaller bias in the middle of the image; only that of a
# yaw, which rows confirm, may be larger. The curve is limited at the sides of the image.
_MAX_OFFSET_PX, _MAX_YAW_PX, _MAX_CURVE_PX = 3.0, 8.0, 8.0


class DisparityBiasEstimator:
    """Averages the estimates of windows.

    Attributes:
        applied: (2,) the offset and the curve that are corrected, pixels.
        faults: a bias that windows show and that is too large for a slightly wrong calibration, so
            that nothing is corrected.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied: Floats = np.zeros(2)
        self.faults: tuple[Fault, ...] = ()
        edge = max(rig.cx, rig.width - rig.cx) / rig.fx
        self._edge = np.array([1.0, edge**2])  # value of each of the two at the image's sides
        self._systematic = np.diag((_SYSTEMATIC_PX / self._edge) ** 2)
        self._information, self._sum = np.zeros((2, 2)), np.zeros(2)
        self._windows = 0

    def update(
        self, residual: CalibrationResidual, windows: int = 1, skew_px: float | None = None
    ) -> Floats | None:
        """Add the estimate of a window that stands for `windows` of them.

        Windows overlap: one in ten counts for the uncertainty of their mean.

        Args:
            residual: of the window.
            windows: number of windows that it stands for.
            skew_px: of vertical disparities, None if it is unknown.

        Returns:
            The new offset and curve to apply, None for no change.
        """
        information = np.linalg.inv(np.linalg.inv(residual.information) + self._systematic)
        self._information += windows * information
        self._sum += windows * information @ (self.applied + residual.value)
        self._windows += windows
        if self._windows < _MIN_WINDOWS:
            return None
        # Differences between windows are not significant.
        simplest = self._simplest()
        wanted = np.where(np.abs(simplest) * self._edge > _SYSTEMATIC_PX, simplest, 0.0)
        excess_px = self._excess(wanted, skew_px)
        self.faults = ()
        if excess_px != 0.0:
            self.faults = (Fault(FaultKind.WRONG_STEREO_CALIBRATION, value=excess_px),)
            wanted = np.zeros(2)
        if not (np.abs(wanted - self.applied) * self._edge >= _MIN_CHANGE_PX).any():
            return None
        self.applied = wanted
        return wanted

    def _excess(self, bias: Floats, skew_px: float | None) -> float:
        """An offset, or else a curve at the sides, that is implausible; 0 if both are plausible."""
        offset_px, side_px = (bias * self._edge).tolist()
        is_yaw = skew_px is not None and is_from_yaw(offset_px, skew_px)
        if abs(offset_px) > (_MAX_YAW_PX if is_yaw else _MAX_OFFSET_PX):
            return float(offset_px)
        return float(side_px) if abs(side_px) > _MAX_CURVE_PX else 0.0

    def _simplest(self) -> Floats:
        """The fewest parameters that explain the windows: none, one of the two, or both."""
        weight = (1.0 + (self._windows - 1) / _OVERLAP) / self._windows
        both: Floats = np.asarray(np.linalg.solve(self._information, self._sum))
        best, least = both, _SIGNIFICANT
        for kept in ([], [0], [1]):
            value = np.zeros(2)
            value[kept] = self._sum[kept] / self._information[kept, kept]
            remaining = both - value
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
