"""Detection of a focal length that changes during a recording: zoom, or a lens that refocuses."""

from __future__ import annotations

from collections import deque

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.mapping.tracked_frame import TrackedFrame

_EXAMINED, _RECENT = 3, 4  # every third frame; the newest four of these are averaged
_LANDMARKS = 200  # examined; enough for 0.1 %
_ITERATIONS, _CAUCHY = 3, 3.0  # robust fit; scale in standard deviations of a pixel
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
    """

    def __init__(self, rig: RectifiedRig) -> None:
        self._rig = rig
        self._frames = 0
        self._is_settled = False
        self._recent: deque[tuple[float, float, float]] = deque(maxlen=_RECENT)

    def restart(self) -> None:
        """Begin anew, with another map."""
        self._recent.clear()
        self._is_settled = False

    def update(self, xyz: Floats, tracked: TrackedFrame) -> tuple[Fault, ...]:
        """That the focal length has changed, if it has, from a frame and its landmarks (n, 3)."""
        self._frames += 1
        if self._frames % _EXAMINED == 0:
            self._recent.append(self._change(xyz, tracked))
        if len(self._recent) < _RECENT:
            return ()
        change, sigma, explained = np.array(self._recent).T
        weight = 1.0 / (sigma**2 + _SYSTEMATIC**2)
        mean = float(np.average(change, weights=weight))
        self._is_settled |= abs(mean) < _SETTLED
        limit = max(_MIN_CHANGE, _MIN_SIGNIFICANCE * weight.sum() ** -0.5)
        if not self._is_settled or abs(mean) < limit or explained.mean() < _MIN_EXPLAINED:
            return ()
        return (Fault(FaultKind.FOCAL_LENGTH_CHANGE, value=mean),)

    def _change(self, xyz: Floats, tracked: TrackedFrame) -> tuple[float, float, float]:
        """Relative change of the focal length, its sigma, and by what it divides residuals."""
        step = len(xyz) // _LANDMARKS + 1
        rig, observed = self._rig, tracked.observed
        cam_from_world = inverse(tracked.world_from_cam)
        p = xyz[::step] @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        x, y, near = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2], 1.0 / p[:, 2]
        found = (observed.xy[::step] - (rig.cx, rig.cy)) / (rig.fx, rig.fy)
        error = np.concatenate([found[:, 0] - x, found[:, 1] - y])
        none, one = np.zeros(len(x)), np.ones(len(x))
        # Derivatives of x and y by translation, rotation and scale of the image.
        by_x = [near, none, -x * near, -x * y, one + x * x, -y, x]
        by_y = [none, near, -y * near, -one - y * y, x * y, x, y]
        jacobian = np.concatenate([np.stack(by_x, axis=1), np.stack(by_y, axis=1)])
        sigma = np.tile(observed.sigma_px[::step] / rig.fx, 2)
        left = error
        for _ in range(_ITERATIONS):
            squares = (left / sigma) ** 2
            both = squares[: len(x)] + squares[len(x) :]
            weighted = jacobian.T / (np.tile(1.0 + both / _CAUCHY**2, 2) * sigma**2)
            information = weighted @ jacobian
            try:
                covariance = np.linalg.inv(information)
            except np.linalg.LinAlgError:  # too few landmarks
                return 0.0, np.inf, 1.0
            solution = covariance @ (weighted @ error)
            left = error - jacobian @ solution
        pose = np.linalg.solve(information[:6, :6], weighted[:6] @ error)
        unscaled = _median(error - jacobian[:, :6] @ pose)
        return float(solution[6]), covariance[6, 6] ** 0.5, unscaled / max(_median(left), 1e-12)


def _median(residuals: Floats) -> float:
    """Median length of (2n,) residuals along x, and along y."""
    return float(np.median(np.hypot(*residuals.reshape(2, -1))))
