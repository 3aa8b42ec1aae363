"""Place a frame in the map: a first pose from descriptors, then from every patch in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.config import Config, TrackingConfig
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.quantiles import median
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse
from vo.mapping.local_map import Keyframe, Map
from vo.tracking import observations as observe
from vo.tracking.observations import Observations
from vo.types import Bools, Floats, Ints

# Search windows, one after the other, in units of the normal one.
_WIDEN = (1.0, 3.0)
_WIDEN_LOST = (3.0, 8.0)


@dataclass(frozen=True, eq=False)
class TrackedFrame:
    """A frame placed in the map: its pose, what it sees (landmark ids), and what agrees.

    Only the ids hold for long: the rows in `observed` move when landmarks are dropped.
    """

    world_from_cam: Floats
    ids: Ints
    observed: Observations
    inlier: Bools

    @property
    def inliers(self) -> int:
        """Number of landmarks that agree with the pose."""
        return int(self.inlier.sum())

    @property
    def median_disparity_px(self) -> float | None:
        """Of the landmarks that agree with the pose; None where no disparity was measured."""
        disparity = self.observed.disparity[self.inlier]
        measured = disparity[~np.isnan(disparity)]
        return median(measured) if len(measured) else None


def track_by_projection(
    world: Map,
    frame: PreprocessedFrame,
    predicted: Floats,
    rig: RectifiedRig,
    config: Config,
    *,
    lost: bool = False,
) -> Floats | None:
    """world_from_cam from landmarks matched near where a predicted pose puts them.

    With `lost` the prediction is a guess, and wider windows are searched.
    """
    visible = observe.visible_landmarks(world, rig, predicted)
    radius_px = config.tracking.search_share * rig.width
    for widen in _WIDEN_LOST if lost else _WIDEN:
        query, keypoints = observe.match_by_descriptor(
            world, visible, frame, widen * radius_px, config.features.scale_factor, config.tracking
        )
        pose = _pose_of(world, frame, visible.rows[query], keypoints, rig, config)
        if pose is not None:
            return pose
    return None


def relocalize(
    world: Map, frame: PreprocessedFrame, rig: RectifiedRig, config: Config
) -> Floats | None:
    """world_from_cam from descriptors alone."""
    rows, keypoints = observe.match_without_prediction(world, frame, config.tracking)
    return _pose_of(world, frame, rows, keypoints, rig, config)


def refine(
    world: Map, frame: PreprocessedFrame, pose: Floats, rig: RectifiedRig, config: Config
) -> TrackedFrame | None:
    """Align every landmark in view, starting from a first pose, and fit the pose to them.

    None if too few of them agree.
    """
    visible = observe.visible_landmarks(world, rig, pose, config.tracking.max_landmarks)
    observed = observe.align_landmarks(world, visible, frame.image0, rig, config.tracking)
    observed = observe.with_disparity(
        observed, world, pose, frame, rig, config.tracking, config.stereo
    )
    fit = observe.fit_pose(world, observed, pose, rig, config.tracking)
    world.visible[visible.rows] += 1
    world.found[observed.rows[fit.inlier]] += 1
    if int(fit.inlier.sum()) < _needed(len(visible.rows), config.tracking):
        return None
    ids = world.id[observed.rows]
    return TrackedFrame(inverse(fit.cam_from_world), ids, observed, fit.inlier)


def _needed(visible: int, config: TrackingConfig) -> float:
    """How many landmarks have to agree: half as many do where they are most of those in view."""
    sure = config.min_inliers
    return max(min(sure, max(sure, visible) / 2), config.min_share * visible)


def as_tracked_frame(world: Map, keyframe: Keyframe) -> TrackedFrame:
    """A first keyframe as if it had been tracked."""
    n = len(keyframe.landmark)
    observed = Observations(
        world.rows(keyframe.landmark),
        keyframe.image_xy,
        keyframe.xy,
        keyframe.disparity,
        keyframe.sigma_px,
        np.ones(n),
        np.ones(n),
        np.zeros((n, 2)),
    )
    every = np.ones(n, dtype=bool)
    return TrackedFrame(keyframe.world_from_cam, keyframe.landmark, observed, every)


def _pose_of(
    world: Map,
    frame: PreprocessedFrame,
    rows: Ints,
    keypoints: Ints,
    rig: RectifiedRig,
    config: Config,
) -> Floats | None:
    octave = frame.keypoints.octave[keypoints].astype(np.float64)
    found = observe.pose_from_matches(
        world.xyz[rows],
        rig.undistort(frame.keypoints.xy[keypoints]),
        config.features.scale_factor**octave,
        rig,
        config.tracking,
    )
    return None if found is None else found[0]
