"""New landmarks from left and right of one keyframe, and where else they were seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.config import Config
from vo.frontend.depth import disparity_from_depth
from vo.frontend.lazy_future import LazyFuture
from vo.frontend.matching import match_segments
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.neighbours import NEIGHBOURS, median_of_nearest
from vo.geometry.rectification import RectifiedRig
from vo.geometry.surfaces import inverse_depth_slopes, surface_normals
from vo.geometry.transforms import inverse, transform_points
from vo.mapping.local_map import Keyframe, Map
from vo.mapping.patch_search import find_patches
from vo.tracking.observations import measure_disparity
from vo.types import Floats, Ints


def triangulate_stereo(
    world: Map,
    keyframe: Keyframe,
    frame: PreprocessedFrame,
    rig: RectifiedRig,
    config: Config,
) -> int:
    """Landmarks from the free features of a keyframe that have a disparity."""
    if not frame.has_disparity:
        return 0
    free = np.flatnonzero(keyframe.free)
    disparity = np.full(len(keyframe.keypoints), np.nan)
    disparity[free] = stereo_disparity(frame, free, rig, config)
    matched = np.flatnonzero(disparity >= config.stereo.min_disparity_px)
    rows = _strongest(keyframe, matched, config.mapping.new_per_keyframe)
    disparity = disparity[rows]
    xy = keyframe.undistorted_xy[rows]
    in_cam = rig.back_project(xy, rig.fx * rig.baseline_m / disparity)
    add_new(
        world,
        keyframe,
        rows,
        transform_points(keyframe.world_from_cam, in_cam),
        keyframe,
    )
    ids = world.id[len(world) - len(rows) :]
    sigma = np.full(len(rows), config.tracking.sigma_px)
    image_xy = keyframe.keypoints.xy[rows].astype(np.float64)
    keyframe.add_observations(ids, xy, image_xy, disparity, sigma)
    keyframe.free[rows] = False
    return len(rows)


def stereo_disparity(
    frame: PreprocessedFrame, rows: Ints, rig: RectifiedRig, config: Config
) -> Floats:
    """Sub-pixel disparities (n,) of some of a frame's features, NaN where there is none."""
    if frame.depth is not None:
        xy = frame.keypoints.xy[rows].astype(np.float64)
        return disparity_from_depth(frame.depth, xy, rig)
    assert frame.image1 is not None and frame.right is not None
    right = frame.right.result()
    left = frame.keypoints
    xy = left.xy[rows].astype(np.float64)
    width = frame.image0.shape[1]
    nearest = xy - (config.stereo.max_disparity_share * width, 0.0)
    farthest = xy + (config.stereo.max_row_offset_px, 0.0)
    scale = config.features.scale_factor ** right.octave.astype(np.float64)
    matched = match_segments(
        left.octave[rows],
        left.descriptor[rows],
        right.xy.astype(np.float64),
        right.octave,
        right.descriptor,
        nearest,
        farthest,
        tolerance_px=config.stereo.max_row_offset_px * scale,
        max_distance=config.tracking.max_hamming,
        ratio=0.9,
    )
    found = np.flatnonzero(matched >= 0)
    disparity = np.full(len(rows), np.nan)
    right_u = right.xy[matched[found], 0].astype(np.float64)
    guess = xy[found, 0] - right_u - rig.disparity_error(right_u)
    disparity[found] = measure_disparity(
        frame.image0, frame.image1, xy[found], guess, rig, config.tracking, config.stereo
    )
    disparity = _filled_from_neighbours(disparity, xy, frame, rig, config)
    return _on_surfaces(disparity, rows, frame, rig, config)


def looks_swapped(frame: PreprocessedFrame, rig: RectifiedRig, config: Config) -> bool:
    """Whether the right image would make a good left one: features lie on the wrong side."""
    if frame.image1 is None or frame.right is None:
        return False
    keypoints, left = frame.right.result(), frame.keypoints
    mirrored = replace(
        frame,
        image0=frame.image1,
        image1=frame.image0,
        left=LazyFuture(lambda: keypoints, None),
        right=LazyFuture(lambda: left, None),
    )
    disparity = stereo_disparity(mirrored, np.arange(len(keypoints)), rig, config)
    return int((disparity >= config.stereo.min_disparity_px).sum()) >= config.start.min_points


def _filled_from_neighbours(
    disparity: Floats, xy: Floats, frame: PreprocessedFrame, rig: RectifiedRig, config: Config
) -> Floats:
    """Try features without a partner, such as those in grass, at the disparity of those beside."""
    assert frame.image1 is not None
    known, missing = np.flatnonzero(~np.isnan(disparity)), np.flatnonzero(np.isnan(disparity))
    if len(known) < NEIGHBOURS or len(missing) == 0:
        return disparity
    guess = median_of_nearest(xy[missing], xy[known], disparity[known])
    filled = disparity.copy()
    filled[missing] = measure_disparity(
        frame.image0, frame.image1, xy[missing], guess, rig, config.tracking, config.stereo
    )
    return filled


def _on_surfaces(
    disparity: Floats, rows: Ints, frame: PreprocessedFrame, rig: RectifiedRig, config: Config
) -> Floats:
    """Measure disparities again, now that those around tell how the right camera sees a patch."""
    assert frame.image1 is not None
    known = np.flatnonzero(disparity > 0.0)
    xy, guess = frame.keypoints.xy[rows[known]].astype(np.float64), disparity[known]
    slope = inverse_depth_slopes(rig.undistort(xy), guess, np.arange(len(known)))
    again = measure_disparity(
        frame.image0, frame.image1, xy, guess, rig, config.tracking, config.stereo, slope
    )
    measured = disparity.copy()
    measured[known] = np.where(np.isnan(again), guess, again)
    return measured


def estimate_normals(
    world: Map, keyframe: Keyframe, rig: RectifiedRig, *, only_new: bool = False
) -> None:
    """Tell from landmarks beside each other in a keyframe how their surfaces are inclined."""
    rows = world.rows(keyframe.landmark)
    seen = np.flatnonzero(rows >= 0)
    rows = rows[seen]
    in_cam = transform_points(inverse(keyframe.world_from_cam), world.xyz[rows])
    ahead = in_cam[:, 2] > 0
    rows, seen, depth = rows[ahead], seen[ahead], in_cam[ahead, 2]
    of = np.flatnonzero(world.found[rows] <= 1) if only_new else np.arange(len(rows))
    intrinsics = (rig.fx, rig.fy, rig.cx, rig.cy)
    pose = keyframe.world_from_cam
    world.normal[rows[of]] = surface_normals(keyframe.xy[seen], depth, of, pose, intrinsics)


def look_back(world: Map, keyframe: Keyframe, rig: RectifiedRig, config: Config) -> None:
    """Find the newest landmarks in the keyframes before, which did not know them yet."""
    new = np.flatnonzero((world.last_seen == keyframe.id) & (world.found <= 1))
    others = world.keyframes[-1 - config.mapping.look_back : -1]
    if len(new) == 0 or not others:
        return
    first = world.id[new[0]]
    unseen = [~np.isin(world.id[new], k.landmark[k.landmark >= first]) for k in others]
    rows = np.concatenate([new[mask] for mask in unseen])
    camera = np.repeat(np.arange(len(others)), [np.count_nonzero(mask) for mask in unseen])
    camera += len(world.keyframes) - 1 - len(others)
    found = find_patches(world, rows, camera, rig, config.tracking)
    for number, other in enumerate(world.keyframes):
        mine = found.camera == number
        if mine.any():
            none = np.full(np.count_nonzero(mine), np.nan)
            sigma = np.full(len(none), config.tracking.sigma_px)
            ids = world.id[found.rows[mine]]
            other.add_observations(ids, found.xy[mine], found.image_xy[mine], none, sigma)


def _strongest(keyframe: Keyframe, rows: Ints, count: int) -> Ints:
    """At most `count` of some features, the strongest corners (the detector spread them evenly)."""
    if len(rows) <= count:
        return rows
    order = np.argsort(-keyframe.keypoints.response[rows], kind="stable")[:count]
    return np.sort(rows[order])


def add_new(world: Map, reference: Keyframe, rows: Ints, xyz: Floats, last_seen: Keyframe) -> Ints:
    """Make landmarks (n, 3) of features of a keyframe, that holds their patches; returns ids."""
    keypoints = reference.keypoints
    return world.add_landmarks(
        xyz,
        keypoints.descriptor[rows],
        keypoints.octave[rows],
        keypoints.angle[rows],
        reference,
        keypoints.xy[rows].astype(np.float64),
        last_seen,
    )
