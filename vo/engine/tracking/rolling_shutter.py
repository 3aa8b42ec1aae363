"""Velocity of the camera while the rows of an image are read, and what it does to observations."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, se3_log
from vo.base.types import Floats
from vo.engine.geometry.rolling_shutter import Velocity, at_middle_row, disparity_at_middle_row
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import Observations
from vo.engine.tracking.motion_model import MotionModel

_MAX_STEP_NS = 500_000_000  # the mean velocity of a longer step says little of its end
_STEPS = 3  # that give a velocity and its change


class _Step(NamedTuple):
    """Motion from one frame to the next.

    Attributes:
        twist: (6,) per second, its mean.
        middle_ns: time in its middle.
    """

    twist: Floats
    middle_ns: int


class RollingShutter:
    """Corrects observations for the velocity of the camera during the readout of their frame.

    The velocity is that at the end of a line fitted to the last steps from frame to frame. Through
    two of them it would amplify noise by 2.5 instead of 1.6, and wrong stamps are noise, too. Where
    images have confirmed a gyroscope, it gives the rotation. A frame that has become a keyframe is
    corrected once more with the motion after it. Nothing is done with a global shutter.
    """

    def __init__(self, local_map: LocalMap, motion: MotionModel) -> None:
        self._map = local_map
        self._motion = motion
        self._readout_s = local_map.rig.readout_s
        self.restart(0)

    def restart(self, stamp_ns: int) -> None:
        """Begin at a frame of unknown velocity."""
        self._last_ns = stamp_ns
        self._steps: deque[_Step] = deque(maxlen=_STEPS - 1)  # those before

    def velocity(self, stamp_ns: int, world_from_cam: Floats) -> Velocity | None:
        """Velocity in the middle of the readout of a frame at a pose (4, 4), None if unknown."""
        if self._readout_s == 0.0:
            return None
        step = self._step(stamp_ns, world_from_cam)
        if step is None:
            return None
        return self._with_gyro(stamp_ns, _at(stamp_ns, [*self._steps, step]))

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Add the pose of a newly tracked frame."""
        if self._readout_s == 0.0:
            return
        step = self._step(stamp_ns, world_from_cam)
        newest = self._map.keyframes[-1]
        if step is None:
            self._steps.clear()
        else:
            if newest.frame.stamp_ns == self._last_ns:
                twist = _at(self._last_ns, [*self._steps, step][-2:])
                self._map.set_velocity(newest, self._with_gyro(self._last_ns, twist))
            self._steps.append(step)
        self._last_ns = stamp_ns

    def at_middle_row(
        self, observed: Observations, world_from_cam: Floats, velocity: Velocity | None
    ) -> Observations:
        """Observations as if all rows had been exposed at once; as they are without a velocity."""
        if velocity is None or len(observed) == 0:
            return observed
        rig = self._map.rig
        row = inverse(world_from_cam)[2]
        depth = self._map.xyz[observed.rows] @ row[:3] + row[3]
        near = np.where(depth > 0.0, 1.0 / np.where(depth > 0.0, depth, 1.0), 0.0)
        xy = at_middle_row(rig, observed.image_xy, near, velocity)
        if not rig.is_metric:
            return replace(observed, xy=xy)
        at = observed.image_xy
        disparity = disparity_at_middle_row(rig, at, observed.disparity, velocity)
        return replace(observed, xy=xy, disparity=disparity)

    def _step(self, stamp_ns: int, world_from_cam: Floats) -> _Step | None:
        """The motion since the last frame; None if that is too long ago."""
        elapsed_ns = stamp_ns - self._last_ns
        if not 0 < elapsed_ns <= _MAX_STEP_NS:
            return None
        twist = se3_log(inverse(self._motion.last) @ world_from_cam) * (1e9 / elapsed_ns)
        return _Step(twist, self._last_ns + elapsed_ns // 2)

    def _with_gyro(self, stamp_ns: int, twist: Floats) -> Velocity:
        angular = self._motion.rate(stamp_ns, self._readout_s)
        return Velocity(twist[:3] if angular is None else angular, twist[3:])


def _at(stamp_ns: int, steps: Sequence[_Step]) -> Floats:
    """Twist (6,) per second at a time, on a line fitted to those of steps."""
    times = np.array([1e-9 * (step.middle_ns - stamp_ns) for step in steps])
    twists = np.array([step.twist for step in steps])
    mean = times.mean()
    off = times - mean
    spread = max(float(off @ off), 1e-12)
    return np.asarray(twists.mean(axis=0) - (mean / spread) * (off @ twists))
