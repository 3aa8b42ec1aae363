"""Detection of torn images, whose rows from one on are those of another time.

Without vertical synchronisation the lower part of an image is that of the frame before; where rows
are lost, it moves up. Landmarks then have residuals that jump at a row, and no pose explains both
parts.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.types import Floats
from vo.engine.tracking.pose_residuals import PoseFit, PoseResiduals, median_length

_MIN_LANDMARKS, _MIN_PART = 40, 4  # of a frame, and of either part
_ROWS = np.arange(1, 16) / 16.0  # of the image's height, at which it may be torn
# Mean cost below which residuals are those of sound landmarks; and what a jump must explain: ratios
# of the cost to that without it and to that with a shear, as of a rolling shutter; and the ratio of
# median residuals. Torn images of a hall reach all of them in 13 to 33 % of the frames, clean
# recordings in at most 2 %.
_SOUND = 0.1
_MAX_COST, _MAX_COST_TO_SHEAR, _MIN_EXPLAINED = 0.75, 0.85, 1.3
_RECENT, _NEEDED = 40, 5  # newest frames examined, and how many of them need to be torn


class TornImageDetector:
    """Fits a jump of the image at a row to the residuals of landmarks.

    Attributes:
        faults: that images are torn, if many are.
    """

    def __init__(self, height: int) -> None:
        self._height = height
        self._torn: deque[bool] = deque(maxlen=_RECENT)
        self.faults: tuple[Fault, ...] = ()

    def update(self, residuals: PoseResiduals) -> None:
        """Examine the next frame."""
        self._torn.append(self._is_torn(residuals))
        fault = Fault(FaultKind.TORN_IMAGES, value=sum(self._torn) / len(self._torn))
        self.faults = (fault,) if sum(self._torn) >= _NEEDED else ()

    def _is_torn(self, residuals: PoseResiduals) -> bool:
        if len(residuals.row) < _MIN_LANDMARKS or (pose := residuals.fit()) is None:
            return False
        cost = residuals.cost(pose.left)
        if cost < _SOUND:
            return False
        row = self._best_row(residuals, pose)
        jump = residuals.fit(_both(np.asarray(residuals.row > row, np.float64)))
        if jump is None or residuals.cost(jump.left) > _MAX_COST * cost:
            return False
        if median_length(pose.left) < _MIN_EXPLAINED * median_length(jump.left):
            return False
        shear = residuals.fit(_both(np.asarray(residuals.row / self._height - 0.5, np.float64)))
        if shear is None:
            return False
        return residuals.cost(jump.left) < _MAX_COST_TO_SHEAR * residuals.cost(shear.left)

    def _best_row(self, residuals: PoseResiduals, pose: PoseFit) -> float:
        """The row at which a jump lowers the weighted squares most, poses adapted."""
        n = len(residuals.row)
        rows = _ROWS * self._height
        below = residuals.row > rows[:, None]
        parts = np.count_nonzero(below, axis=1)
        weight = 1.0 / (residuals.sigma[:n] ** 2 * (1.0 + residuals.squares(pose.left) / 9.0))
        usable = np.flatnonzero((parts >= _MIN_PART) & (n - parts >= _MIN_PART))
        gain, part = np.zeros(len(rows)), np.asarray(below[usable].T, np.float64)
        # Shifts along x and along y of what is below each row.
        shared = np.stack([pose.weighted[:, :n] @ part, pose.weighted[:, n:] @ part], axis=-1)
        taken = np.linalg.solve(pose.information, shared.reshape(6, -1)).reshape(shared.shape)
        own = (weight @ part)[:, None, None] * np.eye(2)
        left = own - np.einsum("kni,knj->nij", shared, taken)
        pull = ((weight * pose.left.reshape(2, n)) @ part).T[:, :, None]
        steps = np.linalg.solve(left + 1e-9 * own, pull)
        gain[usable] = np.sum(pull * steps, axis=(1, 2))
        return float(rows[np.argmax(gain)])


def _both(column: Floats) -> Floats:
    """(2n, 2): a shift along x, and along y, for values of (n,)."""
    none = np.zeros(len(column))
    return np.stack([np.concatenate([column, none]), np.concatenate([none, column])], axis=1)
