"""Decides from window to window whether, and by how much, a single camera's lens is corrected."""

from __future__ import annotations

import numpy as np

from vo.backend.calibration_residual import CalibrationResidual
from vo.geometry.k1_error import edge_shift_px, residual_per_k1
from vo.geometry.rectification import RectifiedRig

# At the image's edges: what is too little to tell from uneven patches, and to correct anew.
_SYSTEMATIC_PX, _LEAST_CHANGE_PX = 0.2, 0.2
# Windows of lenses that are calibrated right are off by one or two of their standard deviations.
_NOISE = 2.0
_SIGNIFICANT = 2.5  # standard deviations of that size
_LEAST_WINDOWS = 3
_OVERLAP = 10  # windows from one to the next that shares no keyframe with it


class RadialDistortionEstimator:
    """Averages what the windows say of the total error of k1."""

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied = 0.0
        self._bend = residual_per_k1(rig)
        k1_of_px = 1.0 / edge_shift_px(rig, 1.0)
        self._systematic = _SYSTEMATIC_PX * k1_of_px
        self._least_change = _LEAST_CHANGE_PX * k1_of_px
        self._weight = 0.0
        self._sum = 0.0
        self._windows = 0

    def update(self, left: CalibrationResidual, windows: int = 1) -> float | None:
        """Take in the estimate of a window that speaks for so many.

        Windows overlap: ten together count for how sure their mean is like one.

        Returns:
            The new error to correct, or None to leave it.
        """
        value, sigma = left.value[0] / self._bend, left.information[0, 0] ** -0.5 / self._bend
        sigma = float(np.hypot(_NOISE * sigma, self._systematic))
        self._weight += windows * sigma**-2
        self._sum += windows * (self.applied + float(value)) * sigma**-2
        self._windows += windows
        estimate = self._sum / self._weight
        sure = np.sqrt(min(self._windows, _OVERLAP) / self._weight)
        if self.applied == 0.0 and (
            self._windows < _LEAST_WINDOWS or abs(estimate) <= _SIGNIFICANT * sure
        ):
            return None
        # An estimate that has come back to what windows differ by anyway is none.
        wanted = estimate if abs(estimate) > self._systematic else 0.0
        if abs(wanted - self.applied) < self._least_change:
            return None
        self.applied = wanted
        return wanted
