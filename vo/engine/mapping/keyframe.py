"""Keyframes of the local map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.geometry.rectification import RectifiedRig
from vo.base.types import Bools, Bytes, Floats, Ints, Keypoints
from vo.engine.geometry.rolling_shutter import Velocity, at_middle_row


@frozen()
class FrameId:
    """Which frame a keyframe is.

    Attributes:
        index: number of the frame in the source.
        segment: number of its segment.
    """

    index: int
    stamp_ns: int
    segment: int


class NewObservations(NamedTuple):
    """Observations to be added to a keyframe; rows belong together.

    Attributes:
        landmark: (n,) ids.
        xy: (n, 2) ideal pixels.
        image_xy: (n, 2) pixels of the rectified image.
        disparity: (n,) pixels, NaN without a measurement.
        sigma_px: (n,) standard deviation of xy.
    """

    landmark: Ints
    xy: Floats
    image_xy: Floats
    disparity: Floats
    sigma_px: Floats


def without_disparity(ids: Ints, xy: Floats, image_xy: Floats, sigma_px: float) -> NewObservations:
    """Observations by camera 0 alone, of one standard deviation."""
    count = len(ids)
    return NewObservations(ids, xy, image_xy, np.full(count, np.nan), np.full(count, sigma_px))


def usual_inverse_depth(inverse_depth: Floats) -> float:
    """Median of those that are known (n,), 0 if none is."""
    known = inverse_depth[~np.isnan(inverse_depth)]
    return median(known) if len(known) else 0.0


@dataclass(eq=False)
class Keyframe:
    """A frame that the map keeps.

    Attributes:
        id: number among the keyframes, from 0, never used again.
        slot: index of its image in `LocalMap.images`.
        world_from_cam: (4, 4), changed by optimisation.
        covariance: (6, 6) in the camera's frame, None before the first optimisation.
        cross_covariance: (6, 6) by id of earlier keyframes: rows are errors of this one.
        undistorted: gives `undistorted_xy`.
        free: (N,) features without a landmark.
        landmark: (n,) ids of the landmarks that it observes.
        xy: (n, 2) ideal pixels where it observes them.
        image_xy: (n, 2) the same in its rectified image.
        disparity: (n,) pixels, NaN without a measurement.
        sigma_px: (n,) standard deviation of xy.
        mask: (H, W) uint8, 0 where its image is not to be used, or None.
        is_doubted: whether little of the map agreed with its pose, so that the motion since the
            keyframe before may be wrong.
        velocity: of the camera while the rows of its image were read; None with a global shutter,
            and while it is unknown.
    """

    id: int
    frame: FrameId
    slot: int
    world_from_cam: Floats
    covariance: Floats | None
    cross_covariance: dict[int, Floats]
    keypoints: Keypoints
    undistorted: Callable[[], Floats]
    free: Bools
    landmark: Ints
    xy: Floats
    image_xy: Floats
    disparity: Floats
    sigma_px: Floats
    mask: Bytes | None = None
    is_doubted: bool = False
    velocity: Velocity | None = None

    @property
    def undistorted_xy(self) -> Floats:
        """(N, 2) ideal pixels of its features, computed when they are needed."""
        return self.undistorted()

    def undistort(self, rig: RectifiedRig, inverse_depth: Floats) -> None:
        """Compute ideal pixels anew, by inverse depths (n,) of its landmarks, NaN where unknown."""
        usual = usual_inverse_depth(inverse_depth)
        near = np.where(np.isnan(inverse_depth), usual, inverse_depth)
        self.xy = at_middle_row(rig, self.image_xy, near, self.velocity)
        xy = self.keypoints.xy.astype(np.float64)
        self.undistorted = cache(partial(at_middle_row, rig, xy, usual, self.velocity))

    def add_observations(self, new: NewObservations) -> None:
        """Add observations of landmarks that this keyframe does not observe yet."""
        for name, values in zip(NewObservations._fields, new, strict=True):
            setattr(self, name, np.concatenate([getattr(self, name), values]))

    def keep_observations(self, mask: Bools) -> None:
        """Remove the observations outside of the mask (n,)."""
        kept = mask.nonzero()[0]  # taking rows is several times as fast as masking them
        if len(kept) == len(mask):
            return
        for name in NewObservations._fields:
            setattr(self, name, getattr(self, name).take(kept, axis=0))
