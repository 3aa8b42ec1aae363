"""Detection of a focal length that changes during a recording: zoom, or a lens that refocuses."""

from __future__ import annotations

from collections import deque

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.engine.tracking.pose_residuals import PoseResiduals, median_length

_RECENT = 4  # newest frames examined, which are averaged
# Recordings of lenses as calibrated have at most 0.0036 and 4.5 standard deviations, also with
# wrong distortion; a zoom by 3 % within 1.5 s has 0.016 and 27.
_MIN_CHANGE, _MIN_SIGNIFICANCE = 0.007, 8.0
_SYSTEMATIC = 0.001
# The median residual is divided by this and more where the image is scaled, too. Zooms by 3 % have
# 1.5 to 4; landmarks with wrong depths, in turns of a blurred camera of 353 x 226 pixels, 0.9 to
# 1.2.
_MIN_EXPLAINED = 1.3
_SETTLED = 0.002  # a wrong calibration has more from the first frame on, until it is corrected


class FocalChangeDetector:
    """Compares the size of the image with that of the map.

    A pose is fitted to the landmarks in view together with a scale of the image about its principal
    point. Moving forward enlarges near things more than far ones, a longer focal length all alike.

    Attributes:
        faults: that the focal length has changed, if it has.
    """

    def __init__(self) -> None:
        self.faults: tuple[Fault, ...] = ()
        self._is_settled = False
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=_RECENT)

    def restart(self) -> None:
        """Begin anew, with another map."""
        self._recent.clear()
        self.faults = ()
        self._is_settled = False

    def update(self, residuals: PoseResiduals) -> None:
        """Examine the next frame."""
        self._recent.append(self._change(residuals))
        self.faults = self._faults()

    def _faults(self) -> tuple[Fault, ...]:
        weights = [1.0 / (sigma * sigma + _SYSTEMATIC**2) for _, sigma, _ in self._recent]
        weight = sum(weights)
        if len(weights) < _RECENT or weight == 0.0:
            return ()
        mean = sum(w * each[0] for w, each in zip(weights, self._recent, strict=True)) / weight
        self._is_settled |= abs(mean) < _SETTLED
        limit = max(_MIN_CHANGE, _MIN_SIGNIFICANCE * weight**-0.5)
        explained = sum(each[2] for each in self._recent) / _RECENT
        if not self._is_settled or abs(mean) < limit or explained < _MIN_EXPLAINED:
            return ()
        return (Fault(FaultKind.FOCAL_LENGTH_CHANGE, value=mean),)

    @staticmethod
    def _change(residuals: PoseResiduals) -> tuple[float, float, float]:
        """Relative change of the focal length, its sigma, and by what it divides residuals."""
        fit = residuals.fit(residuals.xy.reshape(-1, 1))
        if fit is None:  # too few landmarks
            return 0.0, np.inf, 1.0
        variance = float(np.linalg.inv(fit.information)[6, 6])
        pose = np.linalg.solve(fit.information[:6, :6], fit.weighted[:6] @ residuals.error)
        unscaled = median_length(residuals.error - residuals.by_pose @ pose)
        return float(fit.values[6]), variance**0.5, unscaled / max(median_length(fit.left), 1e-12)
