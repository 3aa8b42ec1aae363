"""Time between the exposures of left and right images, from rows and the motion of the image.

A right image that is taken at another time than its left one, such as one that belongs to the frame
before, shows points where they are at that time: their rows differ by the offset times their
vertical speed in the image. A wrong calibration, which rows show as well, does not change with the
motion. Both are estimated together, from several pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.quantiles import median
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.vertical_disparity_model import PRIOR_SIGMA_PX, vertical_disparity_terms
from vo.base.types import Bytes, Floats
from vo.engine.frontend.pair_matching import PairPoints

_MAX_POINTS = 200  # of a pair
_MIN_POINTS = 50
_MIN_PAIRS = 2
_MAX_PAIRS = 8  # the newest are kept
_WINDOW_PX, _LEVELS = (11, 11), 4  # of optical flow
_ITERATIONS, _CONVERGED_PX = 15, 1e-3  # change of a row that ends them
_MIN_SIGMA_PX = 0.1  # of rows, however well they fit
_CORRELATION = 25.0  # factor for variances, see `vertical_disparity_model`
_SIGNIFICANT = 4.0  # standard deviations
# Smaller offsets are not reported. Recordings of cameras that are triggered together show up to
# 1.5 ms, and 0.014 intervals.
_MIN_OFFSET_MS, _MIN_OFFSET_RATIO = 3.0, 0.05


class _LeftImage(NamedTuple):
    """A rectified left image (H, W) and its time."""

    stamp_ns: int
    image: Bytes


class _Pair(NamedTuple):
    """Points of a pair.

    Attributes:
        terms: (N, 5) derivatives of rows by the errors of the right camera's calibration.
        rows_px: (N,) row in the right image minus row in the left.
        speed_before: (N,) vertical speed in px/ms since the image before, NaN where unknown.
        interval_ms: time since then.
        speed_after: (N,) the same until the next image.
    """

    terms: Floats
    rows_px: Floats
    speed_before: Floats
    interval_ms: float
    speed_after: Floats


class _Fit(NamedTuple):
    offset_ms: float
    sigma_ms: float
    residual_px: float


class TimeOffsetEstimator:
    """Estimates the time offset of right images.

    Attributes:
        offset_ms: time of right images minus that of left ones, None unless it is certain.
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self.offset_ms: float | None = None
        self._rig = rig
        self._images: list[_LeftImage] = []  # the newest two
        # Points of the newest pair, and the left image before it, until the next image.
        self._pending: tuple[PairPoints, _LeftImage] | None = None
        self._pairs: list[_Pair] = []

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The offset as a fault, if it is certain."""
        if self.offset_ms is None:
            return ()
        return (Fault(FaultKind.RIGHT_TIME_OFFSET, value=self.offset_ms),)

    def next_image(self, stamp_ns: int, left: Bytes) -> None:
        """Add a rectified left image (H, W); to be called for every frame."""
        pending, self._pending = self._pending, None
        self._images = [*self._images[-1:], _LeftImage(stamp_ns, left)]
        if pending is None or self._interval_ms() <= 0.0:
            return
        (points, before), rig = pending, self._rig
        of_pair, after = self._images
        x = (points.right[:, 0] - rig.cx) / rig.fx
        y = (points.left[:, 1] - rig.cy) / rig.fy
        interval_ms = _interval_ms(before, of_pair)
        moved = _moved(of_pair.image, before.image, points.left)
        speed_before = (points.left[:, 1] - moved[:, 1]) / interval_ms
        moved = _moved(of_pair.image, after.image, points.left)
        speed_after = (moved[:, 1] - points.left[:, 1]) / self._interval_ms()
        pair = _Pair(
            vertical_disparity_terms(x, y), points.rows_px, speed_before, interval_ms, speed_after
        )
        self._pairs = [*self._pairs, pair][-_MAX_PAIRS:]
        self._estimate()

    def add(self, stamp_ns: int, points: PairPoints) -> None:
        """Add the matched points of a pair, with rows as calibrated, if it is the newest frame."""
        step = -(-len(points.left) // _MAX_POINTS)
        if step == 0 or self._interval_ms() <= 0.0 or self._images[-1].stamp_ns != stamp_ns:
            return
        points = PairPoints(points.left[::step], points.right[::step])
        if len(points.left) >= _MIN_POINTS:
            self._pending = points, self._images[0]

    def _interval_ms(self) -> float:
        """Time between the newest two left images, 0 before the second."""
        if len(self._images) < 2:
            return 0.0
        return _interval_ms(*self._images)

    def _estimate(self) -> None:
        if len(self._pairs) < _MIN_PAIRS:
            return
        interval_ms = median([pair.interval_ms for pair in self._pairs])
        best = self._fit(0.0, interval_ms)
        if best.residual_px > _MIN_SIGMA_PX:  # wrong matches make several minima
            others = [self._fit(start, interval_ms) for start in (-interval_ms, interval_ms)]
            best = min(best, *others, key=lambda fit: fit.residual_px)  # the first of equal ones
        least = max(_MIN_OFFSET_MS, _MIN_OFFSET_RATIO * interval_ms)
        is_certain = abs(best.offset_ms) > max(least, _SIGNIFICANT * best.sigma_ms)
        self.offset_ms = best.offset_ms if is_certain else None

    def _fit(self, offset_ms: float, interval_ms: float) -> _Fit:
        """Iteratively reweighted least squares with Cauchy weights, starting from an offset.

        Points do not move evenly: their path is a parabola through the three images. In the time
        from 0 to the offset their mean speed is a + offset b, a and b from the speeds before and
        after.
        """
        pairs = self._pairs
        before = np.concatenate([p.speed_before for p in pairs])
        after = np.concatenate([p.speed_after for p in pairs])
        known = np.isfinite(before + after)
        if np.count_nonzero(known) < _MIN_POINTS:
            return _Fit(0.0, np.inf, np.inf)
        a = 0.5 * (before + after)[known]
        b = 0.5 * (after - before)[known] / interval_ms
        static = np.concatenate([p.terms for p in pairs])[known]
        rows = np.concatenate([p.rows_px for p in pairs])[known]
        prior = np.diag([*PRIOR_SIGMA_PX**-2.0, 1e-9])
        found = np.array([0.0, 0.0, 0.0, 0.0, 0.0, offset_ms])
        for step in range(_ITERATIONS):
            bounded = float(np.clip(found[-1], -interval_ms, interval_ms))
            terms = np.column_stack([static, a + bounded * b])
            if step == 0:
                found[0] = median(rows - terms @ found)
            residual = rows - terms @ found
            sigma = max(_MIN_SIGMA_PX, 1.4826 * median(np.abs(residual)))
            weight = 1.0 / (_CORRELATION * sigma**2 * (1.0 + (residual / (2.0 * sigma)) ** 2))
            information = (terms * weight[:, None]).T @ terms + prior
            last, found = found, np.linalg.solve(information, terms.T @ (weight * rows))
            if np.abs(terms @ (found - last)).max() < _CONVERGED_PX:
                break
        variance = float(np.linalg.inv(information)[-1, -1])
        return _Fit(float(found[-1]), float(np.sqrt(variance)), sigma)


def _interval_ms(before: _LeftImage, image: _LeftImage) -> float:
    return 1e-6 * (image.stamp_ns - before.stamp_ns)


def _moved(image: Bytes, other: Bytes, xy: Floats) -> Floats:
    """Pixels (N, 2) in another image of pixels (N, 2) of an image, NaN where they are not found."""
    start = xy.astype(np.float32)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(
        image, other, start, start.copy(), None, None, _WINDOW_PX, _LEVELS
    )
    return np.where(found.reshape(-1, 1) > 0, moved.astype(np.float64), np.nan)
