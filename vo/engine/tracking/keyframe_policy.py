"""Decision whether a frame becomes a keyframe, and a forecast of it, to extract features early."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.config import KeyframeConfig
from vo.base.geometry.quantiles import median
from vo.base.types import Floats
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import TrackedFrame

# Ratio of the landmarks in view that is tracked where tracking is easy.
_USUAL_TRACKED_RATIO = 0.9
# Minimum ratio of the parallax of a keyframe from which the camera counts as moving.
_MIN_MOVING_RATIO = 0.2
# Median motion of landmarks in the image since the last keyframe, px, up to which the camera rests.
_REST_PX = 0.2


class Change(NamedTuple):
    """Change since the last keyframe.

    Attributes:
        last_tracked: landmarks of the last keyframe, limited in rich scenes, where not all of them
            can be tracked.
        parallax_rad: median angle between the rays to landmarks, now and at the last keyframe.
        elapsed_s: time since the last keyframe.
        is_hidden: whether landmarks are lost while the camera rests, by something before them.
    """

    tracked: int
    last_tracked: int
    parallax_rad: float
    elapsed_s: float
    is_hidden: bool = False


class KeyframePolicy:
    """Decides on keyframes by the landmarks that are lost, the parallax and the time.

    Landmarks that somebody hides who walks past a camera at rest make no keyframe: he would become
    a part of the map.
    """

    def __init__(self, config: KeyframeConfig, max_landmarks: int) -> None:
        self._config = config
        # Without this limit every frame of a rich scene would become a keyframe.
        self._max_tracked = int(_USUAL_TRACKED_RATIO * max_landmarks / config.min_tracked_ratio)

    def change_since_last(
        self, local_map: LocalMap, frame: PreprocessedFrame, tracked: TrackedFrame
    ) -> Change:
        """Change of a tracked frame since the newest keyframe."""
        last = local_map.keyframes[-1]
        rows = tracked.observed.rows[tracked.inlier]
        parallax = median_parallax(
            local_map.xyz.take(rows, axis=0),
            last.world_from_cam[:3, 3],
            tracked.world_from_cam[:3, 3],
        )
        elapsed_s = (frame.stamp_ns - last.frame.stamp_ns) * 1e-9
        last_tracked = min(len(last.landmark), self._max_tracked)
        are_lost = len(rows) < self._config.min_tracked_ratio * last_tracked
        is_hidden = are_lost and _rests(last, tracked)
        return Change(len(rows), last_tracked, parallax, elapsed_s, is_hidden)

    def needs_keyframe(self, change: Change) -> bool:
        """Whether a frame should become a keyframe."""
        config = self._config
        if change.tracked < config.min_tracked_ratio * change.last_tracked:
            return not change.is_hidden
        min_parallax_rad = np.deg2rad(config.min_parallax_deg)
        if change.parallax_rad > min_parallax_rad:
            return True
        is_moving = change.parallax_rad > _MIN_MOVING_RATIO * min_parallax_rad
        is_old = change.elapsed_s >= config.max_gap_s
        return bool(is_moving and (is_old or change.tracked < config.min_tracked))


def _rests(last: Keyframe, tracked: TrackedFrame) -> bool:
    """Whether landmarks are where the last keyframe has them in the image."""
    ids, xy = tracked.ids[tracked.inlier], tracked.observed.image_xy[tracked.inlier]
    _, now, before = np.intersect1d(ids, last.landmark, assume_unique=True, return_indices=True)
    moved_px = np.linalg.norm(xy[now] - last.image_xy[before], axis=1)
    return len(now) > 0 and median(moved_px) < _REST_PX


def median_parallax(points: Floats, first_centre: Floats, second_centre: Floats) -> float:
    """Median angle (rad) between rays from points (N, 3) to two camera centres; 0 without any."""
    if len(points) == 0:
        return 0.0
    return median(_parallaxes(np.ascontiguousarray(points), first_centre, second_centre))


@compiled
def _parallaxes(points, first, second):  # type: ignore[no-untyped-def]
    angles = np.empty(len(points))
    for n in range(len(points)):
        ax, ay, az = points[n, 0] - first[0], points[n, 1] - first[1], points[n, 2] - first[2]
        bx, by, bz = points[n, 0] - second[0], points[n, 1] - second[1], points[n, 2] - second[2]
        lengths = np.sqrt(ax * ax + ay * ay + az * az) * np.sqrt(bx * bx + by * by + bz * bz)
        cosine = (ax * bx + ay * by + az * bz) / max(lengths, 1e-12)
        angles[n] = np.arccos(min(max(cosine, -1.0), 1.0))
    return angles


_WEIGHT = 0.25  # of the newest keyframe in the running average
_LIKELY = 0.6  # ratio of keyframes right after a keyframe from which another one is expected
_ALMOST_SURE = 0.85  # ratio from which even the frame after the next is expected to be one
_NO_CHANGE = Change(0, 0, 0.0, 0.0)


class KeyframeForecast:
    """Extrapolates the change since the last keyframe; a wrong forecast costs time only."""

    def __init__(self, policy: KeyframePolicy) -> None:
        self._policy = policy
        self._frames = 0  # since the last keyframe
        self._before = _NO_CHANGE  # of the frame before
        self._second_loss = 0.0  # ratio of the landmarks lost from the first frame to the second
        self._consecutive = 0.5  # ratio of keyframes that follow a keyframe immediately

    @property
    def expects_all(self) -> bool:
        """Whether almost every frame becomes a keyframe."""
        return self._consecutive > _ALMOST_SURE

    def expects_next(self, change: Change, *, is_keyframe: bool) -> bool:
        """Whether the next frame is likely to become a keyframe, after one with this change."""
        self._frames += 1
        before, self._before = self._before, change
        loss = before.tracked - change.tracked
        if self._frames == 1:  # many are lost at once, then fewer: use the keyframe before
            loss = round(self._second_loss * change.last_tracked)
        elif self._frames == 2:
            self._second_loss = loss / max(change.last_tracked, 1)
        if is_keyframe:
            self._consecutive += _WEIGHT * ((self._frames == 1) - self._consecutive)
            self._frames, self._before = 0, _NO_CHANGE
            return self._consecutive > _LIKELY
        extrapolated = Change(
            change.tracked - loss,
            change.last_tracked,
            2.0 * change.parallax_rad - before.parallax_rad,
            2.0 * change.elapsed_s - before.elapsed_s,
        )
        return self._policy.needs_keyframe(extrapolated)
