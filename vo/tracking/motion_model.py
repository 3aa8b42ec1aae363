"""Where the camera should be next: it keeps its velocity."""

from __future__ import annotations

import numpy as np

from vo.geometry.transforms import inverse, orthonormalised, se3_exp, se3_log
from vo.types import Floats


class ConstantVelocity:
    """Predicts a pose from the last two, whatever the time between frames."""

    def __init__(self) -> None:
        self._stamp_ns = 0
        self._world_from_cam: Floats = np.eye(4)
        self._twist_per_s: Floats | None = None

    def restart(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Begin at a pose, with no idea of the velocity."""
        self._stamp_ns, self._world_from_cam = stamp_ns, world_from_cam
        self._twist_per_s = None

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Take in the pose of the newest frame."""
        elapsed_s = (stamp_ns - self._stamp_ns) * 1e-9
        if elapsed_s > 0:
            moved = se3_log(inverse(self._world_from_cam) @ world_from_cam)
            self._twist_per_s = moved / elapsed_s
        self._stamp_ns, self._world_from_cam = stamp_ns, world_from_cam

    def carry(self, motion: Floats) -> None:
        """The newest frame was moved (4, 4) in the world; the velocity in its own frame stays."""
        self._world_from_cam = orthonormalised(motion @ self._world_from_cam)

    def predict(self, stamp_ns: int) -> Floats:
        """world_from_cam at a later time."""
        if self._twist_per_s is None:
            return self._world_from_cam
        elapsed_s = (stamp_ns - self._stamp_ns) * 1e-9
        return np.asarray(self._world_from_cam @ se3_exp(self._twist_per_s * elapsed_s))

    @property
    def last(self) -> Floats:
        """world_from_cam of the newest frame."""
        return self._world_from_cam
