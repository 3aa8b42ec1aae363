"""New landmarks from features that two keyframes of a single camera share."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vo.config import Config
from vo.frontend.alignment import Alignment, align_between
from vo.frontend.matching import agree_in_rotation, match_segments
from vo.geometry.epipolar_segments import epipolar_segments
from vo.geometry.patch_prediction import predict_patches
from vo.geometry.quantiles import median
from vo.geometry.rectification import RectifiedRig
from vo.geometry.surfaces import surface_normals
from vo.geometry.transforms import inverse, transform_points
from vo.geometry.triangulation import SoundPoints, sound_points
from vo.mapping.local_map import Keyframe, Map
from vo.mapping.triangulate_stereo import add_new
from vo.types import Bytes, Floats, Ints

_NEAREST, _FARTHEST = 0.15, 100.0  # depths where features are looked for, of the median depth
_SMALLEST = 0.75  # of a feature's depth is left when the camera has come nearer
# Least parallax of a landmark, as a share of the angle by which its image has moved: what a
# calibration leaves wrong from one side of the image to the other looks like parallax in a turn.
# One real turn asks for it, recordings with a perfect camera do not (docs/accuracy.md).
_PARALLAX_SHARE = 0.12
_THIN = 150  # a keyframe with fewer landmarks takes those of turns too
# With fewer still, parallax from here on will do: such depths are good to a quarter, and a turn in
# front of a blank wall is got through.
_SCARCE, _SCARCE_PARALLAX_DEG = 100, 0.3
_MOST_MOVED_PX = 3.0  # by knowing the surface


class _Parallax(NamedTuple):
    """Least parallax of a landmark: an angle, and a share of that by which its image moved."""

    least_deg: float
    share: float


def triangulate_between_keyframes(
    world: Map, keyframe: Keyframe, image: np.ndarray, rig: RectifiedRig, config: Config
) -> int:
    """Landmarks from features that a keyframe shares with some keyframes before it.

    In a thin map those from a turn are better than none; in one that is about to be lost, those
    whose depth is hardly known.
    """
    others = world.keyframes[:-1][-config.mapping.neighbours :]
    before, most = len(keyframe.landmark), config.mapping.new_per_keyframe
    least_deg = config.mapping.min_parallax_deg
    for parallax, wanted in (
        (_Parallax(least_deg, _PARALLAX_SHARE), before + most),
        (_Parallax(least_deg, 0.0), min(_THIN, before + most)),
        (_Parallax(_SCARCE_PARALLAX_DEG, 0.0), min(_SCARCE, before + most)),
    ):
        for other in reversed(others):
            room = wanted - len(keyframe.landmark)
            if room > 0:
                _grow_between(world, keyframe, other, image, rig, config, room, parallax)
    return len(keyframe.landmark) - before


def _grow_between(
    world: Map,
    keyframe: Keyframe,
    other: Keyframe,
    image: np.ndarray,
    rig: RectifiedRig,
    config: Config,
    room: int,
    parallax: _Parallax,
) -> None:
    """Triangulate free features of `other` that lie on their epipolar lines in `keyframe`.

    The keyframes may lie so far behind each other that what is nearest in the older one is behind
    the camera in the newer.
    """
    now_from_other = inverse(keyframe.world_from_cam) @ other.world_from_cam
    depth = _median_depth(world, other)
    baseline = float(np.linalg.norm(now_from_other[:3, 3]))
    if depth is None or baseline < 0.005 * depth:
        return
    query, train = np.flatnonzero(other.free), np.flatnonzero(keyframe.free)
    query, start, end = _segments(other, query, now_from_other, depth, rig)
    query, train = _match_between(keyframe, other, query, train, start, end, config)
    if len(query) == 0:
        return
    guess = keyframe.keypoints.xy[train].astype(np.float64)
    found = align_between(
        world.images,
        np.full(len(query), other.slot),
        other.keypoints.xy[query].astype(np.float64),
        None,
        image[None],
        np.zeros(len(query), dtype=np.int64),
        guess,
        half_px=config.tracking.patch_half_px,
    )
    size = config.features.scale_factor ** keyframe.keypoints.octave[train]
    good = found.converged & (found.score >= config.tracking.min_patch_score)
    good &= np.linalg.norm(found.xy - guess, axis=1) <= 1.0 + 1.5 * size
    query, train, image_xy = query[good], train[good], found.xy[good]
    xy = rig.undistort(image_xy)
    points, good, _ = _points_between(
        other.undistorted_xy[query], xy, now_from_other, rig, config, parallax
    )
    query, train, image_xy = query[good], train[good], image_xy[good]
    found = _on_surfaces(world, keyframe, other, image, query, image_xy, points[good], rig, config)
    good = found.converged & (found.score >= config.tracking.min_patch_score)
    good &= np.linalg.norm(found.xy - image_xy, axis=1) <= _MOST_MOVED_PX
    query, train, image_xy = query[good], train[good], found.xy[good]
    xy = rig.undistort(image_xy)
    points, good, angle = _points_between(
        other.undistorted_xy[query], xy, now_from_other, rig, config, parallax
    )
    chosen = np.flatnonzero(good)
    if len(chosen) > room:
        chosen = np.sort(chosen[np.argsort(-angle[chosen], kind="stable")[:room]])
    query, train = query[chosen], train[chosen]
    xy, image_xy, points = xy[chosen], image_xy[chosen], points[chosen]
    in_world = transform_points(other.world_from_cam, points)
    ids = add_new(world, other, query, in_world, keyframe)
    none = np.full(len(ids), np.nan)
    sigma = np.full(len(ids), config.tracking.sigma_px)
    other_xy = other.keypoints.xy[query].astype(np.float64)
    other.add_observations(ids, other.undistorted_xy[query], other_xy, none, sigma)
    keyframe.add_observations(ids, xy, image_xy, none, sigma)
    other.free[query] = False
    keyframe.free[train] = False


def _on_surfaces(
    world: Map,
    keyframe: Keyframe,
    other: Keyframe,
    image: Bytes,
    query: Ints,
    image_xy: Floats,
    points: Floats,
    rig: RectifiedRig,
    config: Config,
) -> Alignment:
    """Find features again, now that a first depth tells how the camera sees them from here.

    Args:
        world: the map.
        keyframe: the newer one.
        other: the older one.
        image: of the newer one.
        query: (n,) features of the older one.
        image_xy: (n, 2) where they were found in the newer one.
        points: (n, 3) in the older one's frame.
        rig: the working camera.
        config: all settings.
    """
    pose, intrinsics = other.world_from_cam, (rig.fx, rig.fy, rig.cx, rig.cy)
    rows = world.rows(other.landmark)
    landmarks = transform_points(inverse(pose), world.xyz[rows])
    known = (rows >= 0) & (landmarks[:, 2] > 0)
    xy = np.concatenate([other.undistorted_xy[query], other.xy[known]])
    depth = np.concatenate([points[:, 2], landmarks[known, 2]])
    number, first = np.arange(len(query)), np.zeros(len(query), dtype=np.int64)
    seen = predict_patches(
        transform_points(pose, points),
        surface_normals(xy, depth, number, pose, intrinsics),
        first,
        number,
        first + 1,
        np.stack([pose, keyframe.world_from_cam]),
        intrinsics,
    )
    return align_between(
        world.images,
        np.full(len(query), other.slot),
        other.keypoints.xy[query].astype(np.float64),
        seen.reference_from_target,
        image[None],
        first,
        image_xy,
        half_px=config.tracking.patch_half_px,
    )


def _match_between(
    keyframe: Keyframe,
    other: Keyframe,
    query: Ints,
    train: Ints,
    segment_start: Floats,
    segment_end: Floats,
    config: Config,
) -> tuple[Ints, Ints]:
    if len(query) == 0 or len(train) == 0:
        return query[:0], train[:0]
    keypoints = keyframe.keypoints
    size = config.features.scale_factor ** keypoints.octave[train].astype(np.float64)
    matched = match_segments(
        other.keypoints.octave[query],
        other.keypoints.descriptor[query],
        keyframe.undistorted_xy[train],
        keypoints.octave[train],
        keypoints.descriptor[train],
        segment_start,
        segment_end,
        tolerance_px=1.5 * size,
        max_distance=config.tracking.max_hamming,
        ratio=config.tracking.ratio,
    )
    found = np.flatnonzero(matched >= 0)
    query, train = query[found], train[matched[found]]
    kept = agree_in_rotation(other.keypoints.angle[query], keypoints.angle[train])
    return query[kept], train[kept]


def _segments(
    other: Keyframe, query: Ints, now_from_other: Floats, depth: float, rig: RectifiedRig
) -> tuple[Ints, Floats, Floats]:
    """Features whose depths are all in front of both cameras, and where their segments end now."""
    start, end, possible = epipolar_segments(
        other.undistorted_xy[query],
        now_from_other,
        _NEAREST * depth,
        _FARTHEST * depth,
        _SMALLEST,
        (rig.fx, rig.fy, rig.cx, rig.cy),
    )
    return query[possible], start[possible], end[possible]


def _points_between(
    xy_other: Floats,
    xy_now: Floats,
    now_from_other: Floats,
    rig: RectifiedRig,
    config: Config,
    parallax: _Parallax,
) -> SoundPoints:
    """Points in the other view's frame."""
    return sound_points(
        now_from_other,
        xy_other,
        xy_now,
        (rig.fx, rig.fy, rig.cx, rig.cy),
        least_rad=float(np.deg2rad(parallax.least_deg)),
        share=parallax.share,
        limit_px=config.tracking.gate * config.tracking.sigma_px,
    )


def _median_depth(world: Map, keyframe: Keyframe) -> float | None:
    rows = world.rows(keyframe.landmark)
    rows = rows[rows >= 0]
    if len(rows) < 8:
        return None
    cam_from_world = inverse(keyframe.world_from_cam)
    return median(world.xyz[rows] @ cam_from_world[2, :3] + cam_from_world[2, 3])
