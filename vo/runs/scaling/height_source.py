"""The scale of a mono path by the height of the camera above flat ground."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.records.metric_scale import MetricScale, ScaleFindings
from vo.base.records.posed_frames import PosedFrames
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Floats
from vo.runs.scaling.ground import find_ground

_NAME = "camera height"
_BACK = 3  # keyframes from which the direction of the motion is taken
_MIN_KEYFRAMES = 4  # with ground
_MIN_RATIO = 0.3  # of the keyframes
_MAX_SPREAD = 0.2  # of the heights, relative to their median
_SHARED = 5  # keyframes that share most landmarks count as one
_SIGMA = 0.05  # of the height above real ground: crown and slope of a road, suspension, kerbs


class _Seen(NamedTuple):
    segment: int
    height: float  # NaN where no ground was seen


class HeightSource:
    """Fits a plane to the landmarks below the camera at each keyframe.

    Args:
        height_m: of the camera's centre above the ground.
    """

    def __init__(self, height_m: float) -> None:
        self._height_m = height_m
        self._rng = np.random.default_rng(0)
        self._seen: list[_Seen] = []
        self._poses: list[tuple[int, Floats]] = []  # segment and pose of the newest keyframes

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Look for the ground at a keyframe."""
        pose = estimate.world_from_cam0
        if not estimate.is_keyframe or pose is None:
            return
        landmarks = snapshot().landmarks
        if landmarks is None:
            return
        cam_from_world = inverse(pose)
        in_cam = landmarks.xyz @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
        motion = self._motion(estimate.segment, pose)
        ground = None if motion is None else find_ground(in_cam, motion, self._rng)
        height = float("nan") if ground is None else ground.height
        self._seen.append(_Seen(estimate.segment, height))

    def measure(self, path: PosedFrames) -> ScaleFindings:
        """The scale of each world, in which enough keyframes have seen the ground."""
        worlds = dict(zip(path.segment.tolist(), path.world.tolist(), strict=True))
        scales, notes = [], []
        for world in sorted(set(worlds.values())):
            heights = np.array([s.height for s in self._seen if worlds.get(s.segment) == world])
            found = self._scale(world, heights)
            if isinstance(found, str):
                notes.append(f"{_NAME}, segment {world}: no scale: {found}")
            else:
                scales.append(found)
        return ScaleFindings(tuple(scales), tuple(notes))

    def _scale(self, world: int, heights: Floats) -> MetricScale | str:
        known = heights[np.isfinite(heights)]
        if len(known) < max(_MIN_KEYFRAMES, _MIN_RATIO * len(heights)):
            return f"flat ground was seen from {len(known)} of {len(heights)} keyframes only"
        median = float(np.median(known))
        spread = 1.4826 * float(np.median(np.abs(known - median))) / median
        if spread > _MAX_SPREAD:
            return f"the height above the ground varies by {spread:.0%}: it is not flat"
        of_median = 1.2533 * spread / np.sqrt(max(len(known) / _SHARED, 1.0))
        value = self._height_m / median
        return MetricScale(world, value, value * float(np.hypot(_SIGMA, of_median)), _NAME)

    def _motion(self, segment: int, pose: Floats) -> Floats | None:
        """Direction (3,) of the motion in the frame of the camera; None at a beginning."""
        if self._poses and self._poses[0][0] != segment:
            self._poses.clear()
        self._poses.append((segment, pose))
        if len(self._poses) <= _BACK:
            return None
        _, before = self._poses.pop(0)
        step = pose[:3, :3].T @ (pose[:3, 3] - before[:3, 3])
        length = float(np.linalg.norm(step))
        return np.asarray(step / length) if length > 0.0 else None
