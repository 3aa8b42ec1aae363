"""What can be shown of a frame and of the map."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.neighbours import far_from
from vo.geometry.point_uncertainty import position_sigma
from vo.geometry.rectification import RectifiedRig
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.local_map import Keyframe, Map
from vo.mapping.lookup import rows_of
from vo.tracking.tracker import TrackedFrame
from vo.types import Bools, FeatureState, Floats, Floats32, Ints, Landmarks, Sightings, View


class LastFrame(NamedTuple):
    """A tracked frame, the landmarks (n,) in it, where they were (n, 2), which agree (n,).

    The ids of the landmarks grow.
    """

    frame: PreprocessedFrame
    ids: Ints
    image_xy: Floats
    inlier: Bools


def make_view(frame: PreprocessedFrame, tracked: TrackedFrame | None, rig: RectifiedRig) -> View:
    """Landmarks that were found in a frame; beside them its features, if they were used."""
    features_xy = frame.used_keypoints_xy
    if tracked is None:
        xy, codes = features_xy, np.empty(0, np.uint8)
    else:
        codes = np.where(tracked.inlier, FeatureState.TRACKED, FeatureState.REJECTED)
        found_xy = tracked.observed.image_xy
        free = np.flatnonzero(far_from(features_xy, found_xy))
        xy = np.concatenate([found_xy.astype(np.float32), features_xy.take(free, axis=0)])
    feature_state = np.full(len(xy), FeatureState.NEW, dtype=np.uint8)
    feature_state[: len(codes)] = codes
    return View(
        image0=frame.image0,
        image1=frame.image1,
        xy=xy,
        feature_state=feature_state,
        previous_xy=np.full((len(xy), 2), np.nan, np.float32),
        camera_matrix=rig.matrix,
        lens=rig.lens,
        baseline_m=rig.baseline_m,
        cam0_from_image0=rig.cam0_from_rectified,
        path=frame.path,
    )


def with_matches(
    view: View,
    tracked: TrackedFrame | None,
    last: LastFrame | None,
    rig: RectifiedRig,
    world: Map,
    world_from_cam: Floats | None,
) -> View:
    """The same with where each landmark was before and on the right, and how far it is off."""
    previous_xy = view.previous_xy.copy()
    right_u, error_px = np.full((2, len(view.xy)), np.nan, np.float32)
    if tracked is not None and world_from_cam is not None:
        found, count = tracked.observed, len(tracked.ids)
        previous_xy[:count] = _positions_in(last, tracked.ids)
        right = found.image_xy[:, 0] - found.disparity
        right_u[:count] = right - rig.disparity_error(right)
        error_px[:count] = _reprojection_error(world, tracked, rig, world_from_cam)
    return replace(view, previous_xy=previous_xy, right_u=right_u, error_px=error_px)


def points_of(world: Map, rig: RectifiedRig) -> Landmarks:
    """The map's points alone."""
    return Landmarks(world.id.copy(), transform_points(rig.cam0_from_rectified, world.xyz))


def landmarks_of(world: Map, rig: RectifiedRig, sigma_disparity_px: float) -> Landmarks:
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
    return replace(
        points_of(world, rig),
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
    world: Map, tracked: TrackedFrame, rig: RectifiedRig, world_from_cam: Floats
) -> Floats:
    """In ideal pixels; NaN where the landmark has been dropped since."""
    rows = world.rows(tracked.ids)
    there = rows >= 0
    in_cam = transform_points(inverse(world_from_cam), world.xyz[rows[there]])
    error_px = np.full(len(rows), np.nan)
    off = rig.project(in_cam) - tracked.observed.xy[there]
    error_px[there] = np.hypot(off[:, 0], off[:, 1])
    return error_px


def _positions_in(last: LastFrame | None, ids: Ints) -> Floats32:
    result = np.full((len(ids), 2), np.nan, np.float32)
    if last is not None:
        there = rows_of(ids, last.ids)
        here = np.flatnonzero(there >= 0)
        result[here] = last.image_xy[there[here]]
    return result
