"""Velocity of the camera while the rows of an image are read, and what it does to observations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.geometry.rolling_shutter import Velocity, at_middle_row, disparity_at_middle_row
from vo.geometry.transforms import inverse, se3_log
from vo.mapping.local_map import LocalMap
from vo.mapping.tracked_frame import Observations
from vo.tracking.inertial_motion import InertialMotion
from vo.tracking.motion_model import MotionModel
from vo.types import Floats

_MAX_STEP_S = 0.5  # between frames; the mean velocity of a longer step says little of its end


class RollingShutter:
    """Corrects observations for the velocity of the camera during the readout of their frame.

    The velocity is that of the motion since the last frame, changing as it did between that motion
    and the one before. Where images have confirmed a gyroscope, it gives the rotation. A frame that
    has become a keyframe is corrected once more with the motion after it. Nothing is done with a
    global shutter.

    Args:
        local_map: holds landmarks and keyframes.
        motion: knows the last pose, and perhaps a gyroscope.
    """

    def __init__(self, local_map: LocalMap, motion: MotionModel) -> None:
        self._map = local_map
        self._motion = motion
        self._readout_s = local_map.rig.readout_s
        self.restart(0)

    def restart(self, stamp_ns: int) -> None:
        """Begin at a frame of unknown velocity."""
        self._last_ns = stamp_ns
        # Twist (6,) per second from the frame before the last one to the last, and that time.
        self._before: tuple[Floats, float] | None = None

    def velocity(self, stamp_ns: int, world_from_cam: Floats) -> Velocity | None:
        """Velocity in the middle of the readout of a frame at a pose (4, 4), None if unknown."""
        if self._readout_s == 0.0:
            return None
        step = self._step(stamp_ns, world_from_cam)
        if step is None:
            return None
        twist, seconds = step
        if self._before is not None:
            twist = twist + (twist - self._before[0]) * (seconds / (seconds + self._before[1]))
        return self._with_gyro(stamp_ns, twist)

    def update(self, stamp_ns: int, world_from_cam: Floats) -> None:
        """Add the pose of a newly tracked frame."""
        if self._readout_s == 0.0:
            return
        step = self._step(stamp_ns, world_from_cam)
        newest = self._map.keyframes[-1]
        if step is not None and newest.frame.stamp_ns == self._last_ns:
            twist, seconds = step
            if self._before is not None:
                old, since_s = self._before
                twist = old + (twist - old) * (since_s / (seconds + since_s))
            self._map.set_velocity(newest, self._with_gyro(self._last_ns, twist))
        self._last_ns, self._before = stamp_ns, step

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
        if not rig.is_stereo:
            return replace(observed, xy=xy)
        at = observed.image_xy
        disparity = disparity_at_middle_row(rig, at, observed.disparity, velocity)
        return replace(observed, xy=xy, disparity=disparity)

    def _step(self, stamp_ns: int, world_from_cam: Floats) -> tuple[Floats, float] | None:
        """Mean twist (6,) per second since the last frame, and the time."""
        seconds = 1e-9 * (stamp_ns - self._last_ns)
        if not 0.0 < seconds <= _MAX_STEP_S:
            return None
        return se3_log(inverse(self._motion.last) @ world_from_cam) / seconds, seconds

    def _with_gyro(self, stamp_ns: int, twist: Floats) -> Velocity:
        angular, motion = None, self._motion
        if isinstance(motion, InertialMotion):
            angular = motion.rate(stamp_ns, self._readout_s)
        return Velocity(twist[:3] if angular is None else angular, twist[3:])
