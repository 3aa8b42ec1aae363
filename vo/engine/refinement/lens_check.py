"""Check for a lens that is quite another one than calibrated, beyond what can be corrected."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.rectification import RectifiedRig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.engine.geometry.k1_error import corner_radius

_NOISE, _SYSTEMATIC_PX = 2.0, 1.0  # factor of windows' standard deviations, and what they share
_SIGNIFICANT = 3.5  # standard deviations of that size
_MIN_WINDOWS = 3
_OVERLAP = 10  # number of consecutive windows that share keyframes
_MAX_RADIUS = 1.2  # focal lengths; few points of very wide lenses lie farther out


class LensCheck:
    """Averages `CalibrationResidual.bend` over windows.

    A lens that is quite another one than calibrated, such as a distorted one taken for ideal,
    leaves it, even where other estimates from windows cancel.
    """

    def __init__(self, rig: RectifiedRig, *, power: int, min_px: float) -> None:
        self.corner_px = 0.0
        self._min_px = min_px
        self._px = rig.fx * min(corner_radius(rig), _MAX_RADIUS) ** power  # shift per unit
        self._weight = 0.0
        self._windows = 0

    @property
    def is_significant(self) -> bool:
        """Whether the lens is another one than calibrated."""
        if self._windows < _MIN_WINDOWS or self._weight == 0.0:
            return False
        sigma_px = np.sqrt(min(self._windows, _OVERLAP) / self._weight)
        return bool(abs(self.corner_px) > max(self._min_px, _SIGNIFICANT * sigma_px))

    def add(self, residual: CalibrationResidual, windows: int) -> None:
        """Add the residual of a window, which stands for `windows` of them."""
        self._windows += windows
        if not np.isfinite(residual.bend_sigma):
            return
        sigma_px = np.hypot(_NOISE * residual.bend_sigma * self._px, _SYSTEMATIC_PX)
        weight = windows * float(sigma_px) ** -2
        self._weight += weight
        self.corner_px += (residual.bend * self._px - self.corner_px) * weight / self._weight
