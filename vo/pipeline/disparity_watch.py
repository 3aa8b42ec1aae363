"""Decides from window to window whether, and by how much, disparities are to be corrected."""

from __future__ import annotations

import numpy as np

from vo.smoothing.miscalibration import Miscalibration

# Windows of the same recording differ by more than their noise explains: uneven rectification,
# moving things. Measured on real recordings: 0.1 px.
_SYSTEMATIC_PX = 0.1
_SIGNIFICANT = 2.0  # standard deviations
_LEAST_CHANGE_PX = 0.05
_LEAST_WINDOWS = 3
_YAW_PX, _LEAST_YAW, _MOST_YAW = 0.3, 0.5, 1.5
_OVERLAP = 10  # windows from one to the next that shares no keyframe with it


class DisparityWatch:
    """Averages what the windows say of the total offset."""

    def __init__(self) -> None:
        self.applied_px = 0.0
        self._weight = 0.0
        self._sum = 0.0
        self._windows = 0

    @property
    def estimate_px(self) -> float:
        """The mean over windows so far, 0 before the first."""
        return self._sum / self._weight if self._weight > 0 else 0.0

    def update(self, left_over: Miscalibration) -> float | None:
        """Take in a window's estimate; the new offset to apply, or None to leave it.

        Windows overlap: one in ten counts for how sure their mean is.
        """
        sigma = float(np.hypot(left_over.sigma, _SYSTEMATIC_PX))
        self._weight += sigma**-2
        self._sum += (self.applied_px + left_over.value) * sigma**-2
        estimate = self.estimate_px
        self._windows += 1
        sure_px = sigma / np.sqrt(1.0 + (self._windows - 1) / _OVERLAP)
        if self.applied_px == 0.0 and (
            self._windows < _LEAST_WINDOWS or abs(estimate) <= _SIGNIFICANT * sure_px
        ):
            return None
        # An estimate that has come back to what windows differ by anyway is none.
        wanted = estimate if abs(estimate) > _SYSTEMATIC_PX else 0.0
        if abs(wanted - self.applied_px) < _LEAST_CHANGE_PX:
            return None
        self.applied_px = wanted
        return wanted


def is_from_yaw(offset_px: float, skew_px: float) -> bool:
    """Whether the offset and the skew of the rows have one cause: the right camera looks sideways.

    Turned by w about its vertical axis it sees rows off by w x y and disparities by -w (1 + x^2),
    x and y being pixels over focal length. A skew that another cause has is of another size.
    """
    ratio = -offset_px / skew_px if abs(skew_px) > _YAW_PX else 0.0
    return _LEAST_YAW < ratio < _MOST_YAW
