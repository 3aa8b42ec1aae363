"""Alignment of the map's landmarks in an image, patch by patch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Floats
from vo.engine.frontend.frontend import Frontend
from vo.engine.frontend.patch_alignment import Patches
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.tracked_frame import Observations
from vo.engine.tracking.last_frame import LastFrame
from vo.engine.tracking.visibility import Visible

# Standard deviation of a patch's position as alignment estimates it: the median in streets, halls
# and corridors; the part of the variance that does not depend on it; and its maximum, in units of
# the median.
_MEDIAN_SIGMA_PX, _CONSTANT_VARIANCE, _MAX_SIGMA = 0.06, 0.4, 4.0
# With fewer converged alignments than this, in units of the minimum number of inliers, those that
# nearly converged are used too: nearly blank walls offer no others.
_ENOUGH = 5


class LandmarkAligner:
    """Finds landmarks in a frame to sub-pixel.

    Args:
        min_inliers: minimum number of landmarks of a tracked frame.
    """

    def __init__(self, local_map: LocalMap, frontend: Frontend, min_inliers: int) -> None:
        self._map = local_map
        self._patches = frontend.patches
        self._stereo = frontend.stereo
        self._min_inliers = min_inliers

    def candidates(self, visible: Visible, last: LastFrame | None) -> Visible:
        """The landmarks that can be found: all, by their patches."""
        return visible

    def align(
        self, visible: Visible, frame: PreprocessedFrame, last: LastFrame | None
    ) -> Observations:
        """Find landmarks in a frame that should show them; without disparities."""
        rows = visible.rows
        references = Patches(
            self._map.images,
            self._map.reference_slots()[rows],
            self._map.reference_xy[rows],
            visible.reference_from_image,
        )
        found = self._patches.align(references, frame.image0, visible.image_xy)
        x, y = (found.xy - visible.image_xy).T
        ideal = self._map.rig.undistort(found.xy)
        kept = found.nearly & self._patches.is_similar(found)
        kept &= x * x + y * y <= self._patches.max_shift_px**2
        kept &= np.isfinite(ideal[:, 0]) & np.isfinite(ideal[:, 1])
        converged = kept & found.converged
        if np.count_nonzero(converged) >= _ENOUGH * self._min_inliers:
            kept = converged
        at = np.flatnonzero(kept)  # taking rows is several times as fast as masking them
        return Observations(
            rows=rows.take(at),
            image_xy=found.xy.take(at, axis=0),
            xy=ideal.take(at, axis=0),
            disparity=np.full(len(at), np.nan),
            sigma_px=self._patches.sigma_px * _relative_sigma(found.sigma_px.take(at)),
            score=found.score.take(at),
            scale=visible.scale.take(at),
            slope=visible.slope.take(at, axis=0),
        )

    def with_disparity(
        self, observed: Observations, world_from_cam: Floats, frame: PreprocessedFrame
    ) -> Observations:
        """The same landmarks with their disparities, where there is a right image or depth."""
        if not frame.has_disparity:
            return observed
        rig = self._map.rig
        in_cam = transform_points(inverse(world_from_cam), self._map.xyz[observed.rows])
        guess = rig.fx * rig.baseline_m / in_cam[:, 2]
        disparity = self._stereo.measure(frame, observed.image_xy, guess, rig, observed.slope)
        return replace(observed, disparity=disparity)


def _relative_sigma(sigma_px: Floats) -> Floats:
    """Standard deviations (n,) of aligned positions, in units of the usual one."""
    relative = np.minimum(sigma_px / _MEDIAN_SIGMA_PX, _MAX_SIGMA)
    return np.asarray(np.sqrt(_CONSTANT_VARIANCE + (1.0 - _CONSTANT_VARIANCE) * relative**2))
