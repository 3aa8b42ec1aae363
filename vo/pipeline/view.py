"""What can be shown of a frame."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.geometry.rectification import WorkingRig
from vo.pipeline.grow import far_from
from vo.pipeline.place import Tracked
from vo.pipeline.working_frame import WorkingFrame
from vo.types import FeatureState, Floats, Floats32, Ints, View


class Seen(NamedTuple):
    """A tracked frame, the landmarks (n,) in it and where they were (n, 2) in its image."""

    frame: WorkingFrame
    ids: Ints
    image_xy: Floats


def make_view(
    frame: WorkingFrame, tracked: Tracked | None, last: Seen | None, rig: WorkingRig
) -> View:
    """Landmarks with where they were in the last tracked frame, and features beside them."""
    keypoints_xy = frame.keypoints.xy
    if tracked is None:
        xy, codes = np.empty((0, 2), np.float32), np.empty(0, np.uint8)
        previous, free = xy, np.ones(len(keypoints_xy), dtype=bool)
    else:
        xy = tracked.observed.image_xy.astype(np.float32)
        codes = np.where(tracked.inlier, FeatureState.TRACKED, FeatureState.REJECTED)
        previous = _positions_in(last, tracked.ids)
        free = far_from(keypoints_xy.astype(np.float64), tracked.observed.image_xy)
    new = np.full(int(free.sum()), FeatureState.NEW)
    return View(
        image0=frame.image0,
        image1=frame.image1,
        xy=np.concatenate([xy, keypoints_xy[free]]),
        feature_state=np.concatenate([codes, new]).astype(np.uint8),
        previous_xy=np.concatenate([previous, np.full((len(new), 2), np.nan, np.float32)]),
        camera_matrix=rig.matrix,
    )


def _positions_in(last: Seen | None, ids: Ints) -> Floats32:
    result = np.full((len(ids), 2), np.nan, np.float32)
    if last is not None and len(last.ids):
        _, here, there = np.intersect1d(ids, last.ids, return_indices=True)
        result[here] = last.image_xy[there]
    return result
