"""What tracking finds in a frame: observed landmarks and the pose that agrees with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.geometry.quantiles import median
from vo.mapping.keyframe import Keyframe
from vo.mapping.local_map import LocalMap
from vo.types import Bools, Floats, Ints


@dataclass(frozen=True, eq=False)
class Observations:
    """Landmarks found in an image; rows belong together.

    Attributes:
        rows: (n,) rows of the map; valid until landmarks are removed.
        image_xy: (n, 2) pixels of the rectified image.
        xy: (n, 2) ideal pixels.
        disparity: (n,) pixels, NaN without a measurement.
        sigma_px: (n,) standard deviation of xy.
        score: (n,) correlation of the patch.
        scale: (n,) size of the patch relative to its reference.
        slope: (n, 2) change of inverse depth from pixel to pixel, relative to it, 1/px.
    """

    rows: Ints
    image_xy: Floats
    xy: Floats
    disparity: Floats
    sigma_px: Floats
    score: Floats
    scale: Floats
    slope: Floats

    def __len__(self) -> int:
        return len(self.rows)


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame with its pose in the map.

    Attributes:
        world_from_cam: (4, 4).
        ids: (n,) increasing ids of the observed landmarks.
        observed: the n observations.
        inlier: (n,) observations that agree with the pose.
        in_view: number of landmarks that should be in the image.
    """

    world_from_cam: Floats
    ids: Ints
    observed: Observations
    inlier: Bools
    in_view: int

    @property
    def inliers(self) -> int:
        """Number of observations that agree with the pose."""
        return int(np.count_nonzero(self.inlier))

    @property
    def inlier_ratio(self) -> float:
        """Inliers among the landmarks that should be in the image."""
        return self.inliers / max(self.in_view, 1)

    @property
    def median_disparity_px(self) -> float | None:
        """Median over the inliers; None where no disparity was measured."""
        disparity = self.observed.disparity[self.inlier]
        measured = disparity[~np.isnan(disparity)]
        return median(measured) if len(measured) else None


def as_tracked_frame(local_map: LocalMap, keyframe: Keyframe) -> TrackedFrame:
    """A keyframe of a new map as if it had been tracked."""
    n = len(keyframe.landmark)
    observed = Observations(
        local_map.rows(keyframe.landmark),
        keyframe.image_xy,
        keyframe.xy,
        keyframe.disparity,
        keyframe.sigma_px,
        np.ones(n),
        np.ones(n),
        np.zeros((n, 2)),
    )
    every = np.ones(n, dtype=bool)
    return TrackedFrame(keyframe.world_from_cam, keyframe.landmark, observed, every, n)
