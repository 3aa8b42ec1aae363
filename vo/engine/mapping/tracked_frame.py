"""What tracking finds in a frame: observed landmarks and the pose that agrees with them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from vo.base.frozen import frozen
from vo.base.geometry.quantiles import median
from vo.base.types import Bools, Floats, Ints
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.rolling_shutter import Velocity
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap

# Of the landmarks in view, the ratio that clean recordings confirm at least once in any five
# consecutive frames is 0.43 in the dark and 0.56 elsewhere; with something that fills 60 % of the
# image it is 0.16 to 0.31. Of the landmarks found, at most 0.12 disagree in five frames.
_MIN_CONFIRMED = 0.25
_MAX_DISAGREEING = 0.25
# Minimum ratio of landmarks with a disparity from which the right camera takes part.
_MIN_MEASURED_RATIO = 0.1


@frozen(eq=False)
class Observations:
    """Landmarks found in an image; rows belong together.

    Attributes:
        rows: (n,) rows of the map; valid until landmarks are removed.
        image_xy: (n, 2) pixels of the rectified image.
        xy: (n, 2) ideal pixels, at the time of the middle row.
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

    def with_disparity(self, disparity: Floats) -> Observations:
        """The same with other disparities (n,)."""
        before, after = (self.rows, self.image_xy, self.xy), (self.sigma_px, self.score)
        return Observations(*before, disparity, *after, self.scale, self.slope)


@frozen(eq=False)
class TrackedFrame:
    """A frame with its pose in the map.

    Attributes:
        world_from_cam: (4, 4).
        ids: (n,) increasing ids of the observed landmarks.
        inlier: (n,) observations that agree with the pose.
        in_view: number of landmarks that should be in the image.
        velocity: for which the observations were corrected; None with a global shutter.
        information: (6, 6) on the pose, tangent on the right, as if landmarks were exact; None
            where more than their observations gave the pose.
    """

    world_from_cam: Floats
    ids: Ints
    observed: Observations
    inlier: Bools
    in_view: int
    velocity: Velocity | None = None
    information: Floats | None = None

    @cached_property
    def inliers(self) -> int:
        """Number of observations that agree with the pose."""
        return int(np.count_nonzero(self.inlier))

    @property
    def inlier_ratio(self) -> float:
        """Inliers among the landmarks that should be in the image."""
        return self.inliers / max(self.in_view, 1)

    @property
    def is_hardly_confirmed(self) -> bool:
        """Whether few of the landmarks that should be in the image agree with the pose."""
        return self.inlier_ratio < _MIN_CONFIRMED

    @property
    def is_contradicted(self) -> bool:
        """Whether many of the landmarks found disagree with the pose."""
        found = len(self.observed)
        return (found - self.inliers) / max(found, 1) > _MAX_DISAGREEING

    @property
    def lacks_disparities(self) -> bool:
        """Whether hardly any of the inliers has a disparity."""
        return len(self._measured_disparity) < _MIN_MEASURED_RATIO * self.inliers

    @property
    def median_disparity_px(self) -> float | None:
        """Median over the inliers; None where no disparity was measured."""
        measured = self._measured_disparity
        return median(measured) if len(measured) else None

    @cached_property
    def _measured_disparity(self) -> Floats:
        """Disparities of the inliers that have one."""
        disparity = self.observed.disparity[self.inlier]
        return np.asarray(disparity[np.isfinite(disparity)])


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
    pose, velocity = keyframe.world_from_cam, keyframe.velocity
    return TrackedFrame(pose, keyframe.landmark, observed, every, n, velocity)


class LastFrame(NamedTuple):
    """A tracked frame and the landmarks in it.

    Attributes:
        ids: (n,) increasing ids of the landmarks.
        image_xy: (n, 2) where they were found.
        inlier: (n,) whether they agreed with the pose.
    """

    frame: PreprocessedFrame
    ids: Ints
    image_xy: Floats
    inlier: Bools


def last_frame(frame: PreprocessedFrame, tracked: TrackedFrame) -> LastFrame:
    """What to keep of a tracked frame."""
    return LastFrame(frame, tracked.ids, tracked.observed.image_xy, tracked.inlier)
