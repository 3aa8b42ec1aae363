"""Estimation of an error of a single camera's radial distortion, from many windows."""

from __future__ import annotations

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.rectification import RectifiedRig
from vo.base.records.calibration_errors import CalibrationResidual
from vo.engine.geometry.k1_error import corner_radius, edge_shift_px, residual_per_k1

# Of a lens that is quite another one: what windows share, and standard deviations.
_LENS_SYSTEMATIC_PX, _LENS_SIGNIFICANT = 1.0, 3.5
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
        return bool(abs(self.corner_px) > max(self._min_px, _LENS_SIGNIFICANT * sigma_px))

    def add(self, residual: CalibrationResidual, windows: int) -> None:
        """Add the residual of a window, which stands for `windows` of them."""
        self._windows += windows
        if not np.isfinite(residual.bend_sigma):
            return
        sigma_px = np.hypot(_NOISE * residual.bend_sigma * self._px, _LENS_SYSTEMATIC_PX)
        weight = windows * float(sigma_px) ** -2
        self._weight += weight
        self.corner_px += (residual.bend * self._px - self.corner_px) * weight / self._weight


# At the image's edges: the effect of patches that are unevenly spread, and the minimum change of
# a correction.
_SYSTEMATIC_PX, _MIN_CHANGE_PX = 0.2, 0.2
# Windows of correctly calibrated lenses are off by one or two of their standard deviations.
_NOISE = 2.0
_SIGNIFICANT = 2.5  # standard deviations of that size
_MIN_WINDOWS = 3
_OVERLAP = 10  # number of consecutive windows that share keyframes
_MAX_EDGE_PX = 15.0  # larger errors at the edges are not explained by one coefficient
# Of the bend that remains at the image corners. Lenses as calibrated, or wrong by k1 only, have up
# to 5 px at 0.7 and 2.2 px at 2.2 standard deviations; distorted ones taken for ideal 23 to 41 px
# at 8 to 46 standard deviations.
_MIN_BEND_PX = 6.0


class RadialDistortionEstimator:
    """Averages the estimates of windows.

    Attributes:
        applied: the error of k1 that is corrected.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.applied = 0.0
        self._bend = residual_per_k1(rig)
        self._k1_of_px = 1.0 / edge_shift_px(rig, 1.0)
        self._systematic = _SYSTEMATIC_PX * self._k1_of_px
        self._min_change = _MIN_CHANGE_PX * self._k1_of_px
        self._weight = 0.0
        self._sum = 0.0
        self._windows = 0
        self._check = LensCheck(rig, power=5, min_px=_MIN_BEND_PX)

    @property
    def faults(self) -> tuple[Fault, ...]:
        """An error that the correction does not remove."""
        edge_px = self.applied / self._k1_of_px
        if abs(edge_px) <= _MAX_EDGE_PX and not self._check.is_significant:
            return ()
        return (Fault(FaultKind.WRONG_LENS, value=max(edge_px, self._check.corner_px, key=abs)),)

    def update(self, residual: CalibrationResidual, windows: int = 1) -> float | None:
        """Add the estimate of a window that stands for `windows` of them.

        Windows overlap: one in ten counts for the uncertainty of their mean.

        Returns:
            The new error to correct, None for no change.
        """
        self._check.add(residual, windows)
        value = residual.value[0] / self._bend
        sigma = residual.information[0, 0] ** -0.5 / self._bend
        sigma = float(np.hypot(_NOISE * sigma, self._systematic))
        self._weight += windows * sigma**-2
        self._sum += windows * (self.applied + float(value)) * sigma**-2
        self._windows += windows
        estimate = self._sum / self._weight
        sure = np.sqrt(min(self._windows, _OVERLAP) / self._weight)
        if self.applied == 0.0 and (
            self._windows < _MIN_WINDOWS or abs(estimate) <= _SIGNIFICANT * sure
        ):
            return None
        # An estimate that is no longer significant.
        wanted = estimate if abs(estimate) > self._systematic else 0.0
        if abs(wanted - self.applied) < self._min_change:
            return None
        self.applied = wanted
        return wanted
