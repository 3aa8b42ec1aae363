"""New landmarks from the disparities of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.geometry.transforms import transform_points
from vo.base.types import Bools, Floats, Ints
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.rolling_shutter import at_middle_row, disparity_at_middle_row
from vo.engine.mapping.keyframe import Keyframe, NewObservations
from vo.engine.mapping.local_map import LocalMap


@dataclass(frozen=True, eq=False)
class StereoFeatures:
    """Features with a disparity; rows belong together.

    Attributes:
        rows: (n,) rows of the frame's features.
        disparity: (n,) pixels.
    """

    rows: Ints
    disparity: Floats

    def __len__(self) -> int:
        return len(self.rows)


class StereoTriangulator:
    """Triangulates features with a disparity.

    Args:
        max_new: maximum number of landmarks per frame.
    """

    def __init__(self, local_map: LocalMap, frontend: Frontend, max_new: int) -> None:
        self._map = local_map
        self._stereo = frontend.stereo
        self._sigma_px = frontend.patches.sigma_px
        self._max_new = max_new

    def measure(self, frame: PreprocessedFrame, free: Bools) -> StereoFeatures:
        """Disparities of free features (N,), of the strongest where there are too many."""
        if not frame.has_disparity:
            return StereoFeatures(np.empty(0, np.int64), np.empty(0))
        rows = np.flatnonzero(free)
        disparity = np.full(len(free), np.nan)
        disparity[rows] = self._stereo.disparities(frame, rows, self._map.rig)
        matched = np.flatnonzero(disparity >= self._stereo.min_disparity_px)
        strongest = self._strongest(frame, matched)
        return StereoFeatures(strongest, disparity[strongest])

    def add_landmarks(self, keyframe: Keyframe, features: StereoFeatures) -> None:
        """Add the landmarks of a keyframe's features."""
        rows, disparity = features.rows, features.disparity
        rig = self._map.rig
        image_xy = keyframe.keypoints.xy[rows].astype(np.float64)
        xy, velocity = keyframe.undistorted_xy[rows], keyframe.velocity
        if velocity is not None:
            disparity = disparity_at_middle_row(rig, image_xy, disparity, velocity)
            xy = at_middle_row(rig, image_xy, disparity / (rig.fx * rig.baseline_m), velocity)
        in_cam = rig.back_project(xy, rig.fx * rig.baseline_m / disparity)
        in_world = transform_points(keyframe.world_from_cam, in_cam)
        ids = self._map.add_landmarks(in_world, keyframe, rows, keyframe)
        sigma_px = np.full(len(rows), self._sigma_px)
        keyframe.add_observations(NewObservations(ids, xy, image_xy, disparity, sigma_px))
        keyframe.free[rows] = False

    def _strongest(self, frame: PreprocessedFrame, rows: Ints) -> Ints:
        """The strongest corners of some features (the detector has spread them evenly)."""
        if len(rows) <= self._max_new:
            return rows
        strength = frame.keypoints.response[rows]
        return np.sort(rows[np.argsort(-strength, kind="stable")[: self._max_new]])
