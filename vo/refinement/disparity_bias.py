"""Decides from window to window whether, and by how much, disparities are to be corrected."""

from __future__ import annotations

import numpy as np

from vo.backend.calibration_residual import CalibrationResidual
from vo.geometry.rectification import RectifiedRig
from vo.types import Floats

# Windows of the same recording differ by more than their noise explains: uneven rectification,
# moving things. Measured on real recordings, of the offset: 0.1 px.
_SYSTEMATIC_PX = 0.1
_SIGNIFICANT = 2.5  # standard deviations
_LEAST_CHANGE_PX = 0.05
_LEAST_WINDOWS = 3
_YAW_PX, _LEAST_YAW, _MOST_YAW = 0.3, 0.5, 1.5
_OVERLAP = 10  # windows from one to the next that shares no keyframe with it


class DisparityBiasEstimator:
    """Averages what the windows say of the total error.

    Attributes:
        applied: (2,) the offset and the curve that are corrected, pixels.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied: Floats = np.zeros(2)
        edge = max(rig.cx, rig.width - rig.cx) / rig.fx
        self._edge = np.array([1.0, edge**2])  # what each of the two is at the image's sides
        self._systematic = np.diag((_SYSTEMATIC_PX / self._edge) ** 2)
        self._information, self._sum = np.zeros((2, 2)), np.zeros(2)
        self._windows = 0

    def update(self, left: CalibrationResidual, windows: int = 1) -> Floats | None:
        """Take in the estimate of a window that speaks for so many.

        Windows overlap: one in ten counts for how sure their mean is.

        Returns:
            The new offset and curve to apply, or None to leave them.
        """
        information = np.linalg.inv(np.linalg.inv(left.information) + self._systematic)
        self._information += windows * information
        self._sum += windows * information @ (self.applied + left.value)
        self._windows += windows
        if self._windows < _LEAST_WINDOWS:
            return None
        # What windows differ by anyway is no error.
        simplest = self._simplest()
        wanted = np.where(np.abs(simplest) * self._edge > _SYSTEMATIC_PX, simplest, 0.0)
        if not (np.abs(wanted - self.applied) * self._edge >= _LEAST_CHANGE_PX).any():
            return None
        self.applied = wanted
        return wanted

    def _simplest(self) -> Floats:
        """What explains the windows with the fewest numbers: nothing, one of the two, or both."""
        share = (1.0 + (self._windows - 1) / _OVERLAP) / self._windows
        both: Floats = np.asarray(np.linalg.solve(self._information, self._sum))
        best, least = both, _SIGNIFICANT
        for kept in ([], [0], [1]):
            value = np.zeros(2)
            value[kept] = self._sum[kept] / self._information[kept, kept]
            missed = both - value
            distance = float(np.sqrt(share * missed @ self._information @ missed))
            if distance < least:
                best, least = value, distance
            if not best.any():
                break
        return best


def is_from_yaw(offset_px: float, skew_px: float) -> bool:
    """Whether the offset and the skew of the rows have one cause: the right camera looks sideways.

    Turned by w about its vertical axis it sees rows off by w x y and disparities by -w (1 + x^2),
    x and y being pixels over focal length. A skew that another cause has is of another size.
    """
    ratio = -offset_px / skew_px if abs(skew_px) > _YAW_PX else 0.0
    return _LEAST_YAW < ratio < _MOST_YAW
