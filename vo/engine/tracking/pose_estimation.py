"""Pose of a camera from landmarks: PnP on matches, and refinement on aligned patches."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.config import TrackingConfig
from vo.base.geometry.projection import PixelObservations
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Floats, Ints
from vo.engine.geometry.pnp import PoseFit, refine_pose
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import Observations, TrackedFrame

_MAX_ITERATIONS, _CONFIDENCE = 200, 0.999  # of RANSAC
# Landmarks by which a frame is fitted again. With 60, in blurred images, poses were worse by 15 mm.
_MIN_LEFT = 100


class PoseEstimator:
    """Estimates poses from landmarks of the map."""

    def __init__(
        self, local_map: LocalMap, sigma_disparity_px: float, config: TrackingConfig
    ) -> None:
        self._map = local_map
        self._sigma_disparity_px = sigma_disparity_px
        self._config = config

    def from_matches(self, rows: Ints, xy: Floats, sigma_px: Floats) -> Floats | None:
        """world_from_cam from landmarks (n,) and ideal pixels (n, 2); None if it is not reliable.

        Source: Gao et al. 2003 (P3P) in RANSAC, then Huber-weighted refinement.
        """
        if len(rows) < self._config.min_inliers:
            return None
        xyz = self._map.xyz[rows]
        found, rotation_vector, translation, inlier = cv2.solvePnPRansac(
            np.ascontiguousarray(xyz),
            np.ascontiguousarray(xy),
            self._map.rig.matrix,
            None,
            iterationsCount=_MAX_ITERATIONS,
            reprojectionError=self._config.pnp_threshold_px,
            confidence=_CONFIDENCE,
            flags=cv2.SOLVEPNP_AP3P,
        )
        if not found or inlier is None or len(inlier) < self._config.min_inliers:
            return None
        start = make_transform(cv2.Rodrigues(rotation_vector)[0], translation)
        no_disparity = np.full(len(xyz), np.nan)
        fit = self._refine(start, xyz, xy, no_disparity, sigma_px)
        if int(fit.inlier.sum()) < self._config.min_inliers:
            return None
        return inverse(fit.cam_from_world)

    def refine(self, observed: Observations, world_from_cam: Floats) -> PoseFit:
        """Refine a pose on all observations, disparities included."""
        return self._refine(
            inverse(world_from_cam),
            self._map.xyz.take(observed.rows, axis=0),
            observed.xy,
            observed.disparity,
            observed.sigma_px,
        )

    def refit(self, tracked: TrackedFrame) -> Floats | None:
        """world_from_cam of a frame by its landmarks as they are now; None if too few are left."""
        rows, observed = self._map.rows(tracked.ids), tracked.observed
        kept = np.flatnonzero((rows >= 0) & tracked.inlier)
        if len(kept) < max(_MIN_LEFT, 0.5 * tracked.inliers):
            return None
        fit = self._refine(
            inverse(tracked.world_from_cam),
            self._map.xyz.take(rows.take(kept), axis=0),
            observed.xy.take(kept, axis=0),
            observed.disparity.take(kept),
            observed.sigma_px.take(kept),
        )
        return inverse(fit.cam_from_world)

    def _refine(
        self,
        cam_from_world: Floats,
        xyz: Floats,
        xy: Floats,
        disparity: Floats,
        sigma_px: Floats,
    ) -> PoseFit:
        rig = self._map.rig
        return refine_pose(
            cam_from_world,
            xyz,
            PixelObservations(xy, disparity, sigma_px, self._sigma_disparity_px),
            rig.intrinsics,
            rig.fx * rig.baseline_m,
            gate=self._config.gate,
        )
