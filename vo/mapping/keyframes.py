"""Frames become keyframes."""

from __future__ import annotations

import numpy as np

from vo.config import Config
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.neighbours import far_from
from vo.geometry.rectification import RectifiedRig
from vo.mapping.local_map import Keyframe, Map
from vo.tracking.keyframe_policy import Change, median_parallax
from vo.tracking.observations import predicted_octave
from vo.tracking.tracker import TrackedFrame
from vo.types import Bools, Floats, Ints

_TRACKABLE = 0.9  # share of the landmarks tried in a frame that is found in easy ones
_PATCH_SCALE = 1.3  # patches of landmarks that have changed size by more are taken anew
_PATCH_SCORE = 0.9  # and those that correlate less


def change_since(
    world: Map, frame: PreprocessedFrame, tracked: TrackedFrame, config: Config
) -> Change:
    """How much less of the map a tracked frame sees than the last keyframe, and how differently."""
    last = world.keyframes[-1]
    rows = tracked.observed.rows[tracked.inlier]
    parallax = median_parallax(
        world.xyz[rows], last.world_from_cam[:3, 3], tracked.world_from_cam[:3, 3]
    )
    elapsed_s = (frame.stamp_ns - last.stamp_ns) * 1e-9
    # Never more than can be expected to be tracked: else every frame of a rich scene is one.
    most = _TRACKABLE * config.tracking.max_landmarks / config.keyframes.min_tracked_share
    before = min(len(last.landmark), int(most))
    return Change(len(rows), before, parallax, elapsed_s)


def add_keyframe(
    world: Map,
    frame: PreprocessedFrame,
    world_from_cam: Floats,
    segment: int,
    free: Bools,
    rig: RectifiedRig,
) -> Keyframe:
    """Store a working frame; `free` (N,) marks its features that have no landmark."""
    return world.add_keyframe(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        segment=segment,
        image=frame.image0,
        world_from_cam=world_from_cam,
        keypoints=frame.keypoints,
        undistorted_xy=rig.undistort(frame.keypoints.xy),
        free=free,
    )


def add_tracked(
    world: Map,
    frame: PreprocessedFrame,
    tracked: TrackedFrame,
    segment: int,
    rig: RectifiedRig,
    config: Config,
) -> Keyframe:
    """Store a tracked frame with the landmarks that it sees."""
    observed = tracked.observed
    free = far_from(frame.keypoints.xy, observed.image_xy)
    keyframe = add_keyframe(world, frame, tracked.world_from_cam, segment, free, rig)
    kept = tracked.inlier & (world.rows(tracked.ids) >= 0)
    ids = tracked.ids[kept]
    keyframe.add_observations(
        ids,
        observed.xy[kept],
        observed.image_xy[kept],
        observed.disparity[kept],
        observed.sigma_px[kept],
    )
    rows = world.rows(ids)
    world.last_seen[rows] = keyframe.id
    _renew_patches(world, keyframe, rows, observed.scale[kept], observed.score[kept], config)
    return keyframe


def _renew_patches(
    world: Map, keyframe: Keyframe, rows: Ints, scale: Floats, score: Floats, config: Config
) -> None:
    """Take patches from this keyframe where the old ones have become too different."""
    stale = (np.abs(np.log(scale)) > np.log(_PATCH_SCALE)) | (score < _PATCH_SCORE)
    octave = predicted_octave(world.octave[rows], scale, config.features.scale_factor)
    world.octave[rows[stale]] = octave[stale]
    mask = np.zeros(len(world), dtype=bool)
    mask[rows[stale]] = True
    world.take_reference(keyframe, mask)
