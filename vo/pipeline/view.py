"""What can be shown of a frame and of the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.geometry.neighbours import far_from
from vo.geometry.point_uncertainty import position_sigma
from vo.geometry.rectification import WorkingRig
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.lookup import rows_of
from vo.mapping.map import Keyframe, Map
from vo.pipeline.place import Tracked
from vo.pipeline.working_frame import WorkingFrame
from vo.types import FeatureState, Floats, Floats32, Ints, Landmarks, Sightings, View


class Seen(NamedTuple):
    """A tracked frame, the landmarks (n,) in it, and where they were (n, 2) in its image.

    The ids of the landmarks grow.
    """

    frame: WorkingFrame
    ids: Ints
    image_xy: Floats


def make_view(
    frame: WorkingFrame,
    tracked: Tracked | None,
    last: Seen | None,
    rig: WorkingRig,
    world: Map,
    world_from_cam: Floats | None,
) -> View:
    """Landmarks with where they were in the last tracked frame, and features beside them."""
    keypoints_xy = frame.keypoints.xy
    if tracked is None or world_from_cam is None:
        xy, codes = np.empty((0, 2), np.float32), np.empty(0, np.uint8)
        previous, free = xy, np.ones(len(keypoints_xy), dtype=bool)
        right_u = error_px = np.empty(0)
    else:
        xy = tracked.observed.image_xy.astype(np.float32)
        codes = np.where(tracked.inlier, FeatureState.TRACKED, FeatureState.REJECTED)
        previous = _positions_in(last, tracked.ids)
        right_u = (
            tracked.observed.image_xy[:, 0] - tracked.observed.disparity - rig.disparity_offset_px
        )
        error_px = _reprojection_error(world, tracked, rig, world_from_cam)
        free = far_from(keypoints_xy, tracked.observed.image_xy)
    new = np.full(int(free.sum()), FeatureState.NEW)
    return View(
        image0=frame.image0,
        image1=frame.image1,
        xy=np.concatenate([xy, keypoints_xy[free]]),
        feature_state=np.concatenate([codes, new]).astype(np.uint8),
        previous_xy=np.concatenate([previous, np.full((len(new), 2), np.nan, np.float32)]),
        camera_matrix=rig.matrix,
        right_u=_followed_by_nan(right_u, len(new)),
        error_px=_followed_by_nan(error_px, len(new)),
        lens=rig.lens,
        baseline_m=rig.baseline_m,
        cam0_from_image0=rig.cam0_from_working,
        path=frame.path,
    )


def landmarks_of(world: Map, rig: WorkingRig, sigma_disparity_px: float) -> Landmarks:
    """The map's points, with what their patches look like and how far they can be trusted."""
    keyframes = world.keyframes
    u, v = np.rint(world.reference_xy).astype(np.int64).T
    height, width = world.images.shape[1:]
    slots = world.reference_slots()
    number, row = world.sightings()
    sigma = position_sigma(
        world.xyz,
        np.stack([k.world_from_cam[:3, 3] for k in keyframes]),
        row,
        number,
        np.concatenate([k.disparity for k in keyframes]),
        np.concatenate([k.sigma_px for k in keyframes]),
        sigma_disparity_px,
        rig.fx,
        rig.fx * rig.baseline_m,
    )
    return Landmarks(
        ids=world.id.copy(),
        xyz=transform_points(rig.cam0_from_working, world.xyz),
        grey=world.images[slots, v.clip(0, height - 1), u.clip(0, width - 1)],
        sigma=sigma,
        # A keyframe's arrays are replaced, never changed, so that they need no copy.
        sightings=tuple(Sightings(k.frame_index, k.landmark, k.image_xy) for k in keyframes),
    )


def neighbours_of(world: Map, keyframe: Keyframe) -> dict[int, int]:
    """How many landmarks each of the map's older keyframes shares with one, by frame number."""
    number, row = world.sightings()
    seen = np.zeros(len(world), dtype=bool)
    seen[world.rows(keyframe.landmark)] = True
    counts = np.bincount(number[seen[row]], minlength=len(world.keyframes)).tolist()
    shared = zip(world.keyframes, counts, strict=True)
    return {other.frame_index: n for other, n in shared if n and other.id < keyframe.id}


def _reprojection_error(
    world: Map, tracked: Tracked, rig: WorkingRig, world_from_cam: Floats
) -> Floats:
    """In ideal pixels; NaN where the landmark has been dropped since."""
    rows = world.rows(tracked.ids)
    there = rows >= 0
    in_cam = transform_points(inverse(world_from_cam), world.xyz[rows[there]])
    error_px = np.full(len(rows), np.nan)
    off = rig.project(in_cam) - tracked.observed.xy[there]
    error_px[there] = np.hypot(off[:, 0], off[:, 1])
    return error_px


def _followed_by_nan(values: Floats, count: int) -> Floats32:
    nothing = np.full(count, np.nan, np.float32)
    return np.concatenate([values.astype(np.float32), nothing])


def _positions_in(last: Seen | None, ids: Ints) -> Floats32:
    result = np.full((len(ids), 2), np.nan, np.float32)
    if last is not None:
        there = rows_of(ids, last.ids)
        here = np.flatnonzero(there >= 0)
        result[here] = last.image_xy[there[here]]
    return result
