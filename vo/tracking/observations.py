"""Find the map's landmarks in a frame: by descriptor for a first pose, then patch by patch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.config import StereoConfig, TrackingConfig
from vo.frontend.alignment import align_between
from vo.frontend.depth import disparity_from_depth
from vo.frontend.matching import agree_in_rotation, match_everywhere, match_windows
from vo.frontend.preprocessing import PreprocessedFrame
from vo.geometry.patch_prediction import points_in_view, predict_patches
from vo.geometry.pnp import PoseFit, refine_pose
from vo.geometry.rectification import RectifiedRig
from vo.geometry.surfaces import left_from_right
from vo.geometry.transforms import inverse, make_transform, transform_points
from vo.mapping.local_map import Map
from vo.types import Bools, Bytes, Floats, Ints

_BORDER_PX = 8.0
# What pixel noise makes of a patch's position, as alignment estimates it: the median in streets,
# halls and corridors; the share of the variance that it has no part in; and where it ends.
_USUAL_SIGMA_PX, _SAME_VARIANCE, _MOST_SIGMA = 0.06, 0.4, 4.0
# With fewer sure landmarks, in units of the least that a pose needs, poor ones are taken too: in
# front of a nearly blank wall there are no others.
_ENOUGH = 5
_SCALE_RANGE = 2.0  # landmarks nearer or farther than this against their patch are not tried


@dataclass(frozen=True, eq=False)
class Visible:
    """Landmarks that should be in the image; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        xy: (n, 2) ideal pixels where they should be.
        image_xy: (n, 2) the same in the working image.
        scale: (n,) size of their patch now against its reference.
        reference_from_image: (n, 2, 2) takes steps of pixels back to their reference image.
        slope: (n, 2) how inverse depth changes from pixel to pixel, relative to it, 1/px.
    """

    rows: Ints
    xy: Floats
    image_xy: Floats
    scale: Floats
    reference_from_image: Floats
    slope: Floats


@dataclass(frozen=True, eq=False)
class Observations:
    """Landmarks found in an image; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        image_xy: (n, 2) working-image pixels.
        xy: (n, 2) ideal pixels.
        disparity: (n,) pixels, NaN without a right match.
        sigma_px: (n,) standard deviation of xy.
        score: (n,) correlation of the patch.
        scale: (n,) size of the patch now against its reference.
        slope: (n, 2) how inverse depth changes from pixel to pixel, relative to it, 1/px.
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


def visible_landmarks(
    world: Map, rig: RectifiedRig, world_from_cam: Floats, most: int | None = None
) -> Visible:
    """The landmarks that a camera at this pose should see.

    Of more than `most` those found most often, then the newest.
    """
    poses = np.stack([*(k.world_from_cam for k in world.keyframes), world_from_cam])
    first = world.keyframes[0].id if world.keyframes else 0
    intrinsics = (rig.fx, rig.fy, rig.cx, rig.cy)
    reference = world.reference - first
    inside = (_BORDER_PX, _BORDER_PX, rig.width - _BORDER_PX, rig.height - _BORDER_PX)
    everywhere = (-np.inf, -np.inf, np.inf, np.inf)
    corners = inside if rig.lens is None else everywhere
    rows, xy = points_in_view(world.xyz, reference, poses, intrinsics, _SCALE_RANGE, corners)
    image_xy = rig.distort(xy)
    if rig.lens is not None:
        u, v = image_xy[:, 0], image_xy[:, 1]
        left, top, right, bottom = inside
        kept = np.flatnonzero((u >= left) & (u < right) & (v >= top) & (v < bottom))
        rows, xy, image_xy = rows.take(kept), xy.take(kept, axis=0), image_xy.take(kept, axis=0)
    if most is not None and len(rows) > most:
        found = np.minimum(world.found.take(rows), 20)
        rank = found * len(world) + rows  # rows are in order of their landmarks' ids
        kept = np.sort(np.argpartition(rank, len(rank) - most)[len(rank) - most :])
        rows, xy, image_xy = rows.take(kept), xy.take(kept, axis=0), image_xy.take(kept, axis=0)
    here = np.full(len(rows), len(poses) - 1)
    seen = predict_patches(world.xyz, world.normal, reference, rows, here, poses, intrinsics)
    return Visible(rows, xy, image_xy, seen.scale, seen.reference_from_target, seen.slope)


def match_by_descriptor(
    world: Map,
    visible: Visible,
    frame: PreprocessedFrame,
    radius_px: float,
    scale_factor: float,
    config: TrackingConfig,
) -> tuple[Ints, Ints]:
    """Rows into `visible` and into the frame's keypoints that belong together."""
    rows, keypoints = visible.rows, frame.keypoints
    octave = predicted_octave(world.octave[rows], visible.scale, scale_factor)
    matched = match_windows(
        visible.image_xy,
        octave,
        world.descriptor[rows],
        np.full(len(rows), radius_px),
        keypoints.xy,
        keypoints.octave,
        keypoints.descriptor,
        max_distance=config.max_hamming,
        ratio=config.ratio,
    )
    query = np.flatnonzero(matched >= 0)
    train = matched[query]
    kept = agree_in_rotation(world.angle[rows[query]], keypoints.angle[train])
    return query[kept], train[kept]


def match_without_prediction(
    world: Map, frame: PreprocessedFrame, config: TrackingConfig
) -> tuple[Ints, Ints]:
    """Rows of the map and of the frame's keypoints that belong together, by descriptor alone."""
    matched = match_everywhere(
        world.descriptor,
        frame.keypoints.descriptor,
        max_distance=config.max_hamming,
        ratio=config.ratio,
    )
    query = np.flatnonzero(matched >= 0)
    train = matched[query]
    kept = agree_in_rotation(world.angle[query], frame.keypoints.angle[train])
    return query[kept], train[kept]


def pose_from_matches(
    xyz: Floats,
    xy: Floats,
    sigma_px: Floats,
    rig: RectifiedRig,
    config: TrackingConfig,
) -> tuple[Floats, Bools] | None:
    """world_from_cam from points (n, 3) and ideal pixels (n, 2), and who agrees; None if unsure.

    Source: Gao et al. 2003 (P3P) in RANSAC, then Huber-weighted refinement.
    """
    if len(xyz) < config.min_inliers:
        return None
    found, rotation_vector, translation, inlier = cv2.solvePnPRansac(
        np.ascontiguousarray(xyz),
        np.ascontiguousarray(xy),
        rig.matrix,
        None,
        iterationsCount=200,
        reprojectionError=config.pnp_threshold_px,
        confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or inlier is None or len(inlier) < config.min_inliers:
        return None
    first = make_transform(cv2.Rodrigues(rotation_vector)[0], translation)
    unused = np.full(len(xyz), np.nan)
    fit = _refine(first, xyz, xy, unused, sigma_px, rig, config)
    if int(fit.inlier.sum()) < config.min_inliers:
        return None
    return inverse(fit.cam_from_world), fit.inlier


def align_landmarks(
    world: Map,
    visible: Visible,
    image: Bytes,
    rig: RectifiedRig,
    config: TrackingConfig,
) -> Observations:
    """Find landmarks to sub-pixel in an image that should show them; no disparities yet."""
    rows = visible.rows
    found = align_between(
        world.images,
        world.reference_slots()[rows],
        world.reference_xy[rows],
        visible.reference_from_image,
        image[None],
        np.zeros(len(rows), dtype=np.int64),
        visible.image_xy,
        half_px=config.patch_half_px,
    )
    x, y = (found.xy - visible.image_xy).T
    ideal = rig.undistort(found.xy)
    kept = found.nearly & (found.score >= config.min_patch_score)
    kept &= x * x + y * y <= config.max_shift_px**2
    kept &= np.isfinite(ideal[:, 0]) & np.isfinite(ideal[:, 1])
    sure = kept & found.converged
    if np.count_nonzero(sure) >= _ENOUGH * config.min_inliers:
        kept = sure
    at = np.flatnonzero(kept)  # taking rows is several times as fast as masking them
    return Observations(
        rows=rows.take(at),
        image_xy=found.xy.take(at, axis=0),
        xy=ideal.take(at, axis=0),
        disparity=np.full(len(at), np.nan),
        sigma_px=config.sigma_px * _uncertainty(found.sigma_px.take(at)),
        score=found.score.take(at),
        scale=visible.scale.take(at),
        slope=visible.slope.take(at, axis=0),
    )


def _uncertainty(sigma_px: Floats) -> Floats:
    """Standard deviations (n,) of aligned positions, in units of a usual patch's."""
    share = np.minimum(sigma_px / _USUAL_SIGMA_PX, _MOST_SIGMA)
    return np.asarray(np.sqrt(_SAME_VARIANCE + (1.0 - _SAME_VARIANCE) * share**2))


def with_disparity(
    observed: Observations,
    world: Map,
    world_from_cam: Floats,
    frame: PreprocessedFrame,
    rig: RectifiedRig,
    config: TrackingConfig,
    stereo: StereoConfig,
) -> Observations:
    """The same landmarks with their disparities, where there is a right image or depth."""
    if frame.depth is not None:
        disparity = disparity_from_depth(frame.depth, observed.image_xy, rig)
        return replace(observed, disparity=disparity)
    if frame.image1 is None:
        return observed
    in_cam = transform_points(inverse(world_from_cam), world.xyz[observed.rows])
    guess = rig.fx * rig.baseline_m / in_cam[:, 2]
    xy = observed.image_xy
    disparity = measure_disparity(
        frame.image0, frame.image1, xy, guess, rig, config, stereo, observed.slope
    )
    return replace(observed, disparity=disparity)


def measure_disparity(
    image0: Bytes,
    image1: Bytes,
    xy: Floats,
    guess: Floats,
    rig: RectifiedRig,
    config: TrackingConfig,
    stereo: StereoConfig,
    slope: Floats | None = None,
) -> Floats:
    """Sub-pixel disparity (n,) of patches around xy (n, 2), NaN where there is none.

    Where the surface recedes, as a road does, the right camera sees the patch sheared: `slope`
    (n, 2) tells how disparity changes from pixel to pixel, relative to it; None if unknown.
    """
    expected = guess + rig.disparity_error(xy[:, 0] - guess)
    start = xy - np.column_stack([expected, np.zeros(len(guess))])
    only = np.zeros(len(xy), dtype=np.int64)
    back = None if slope is None else left_from_right(guess, slope)
    found = align_between(
        image0[None], only, xy, back, image1[None], only, start, half_px=config.patch_half_px
    )
    disparity = xy[:, 0] - found.xy[:, 0] - rig.disparity_error(found.xy[:, 0])
    good = found.converged & (found.score >= config.min_patch_score)
    good &= np.abs(found.xy[:, 1] - xy[:, 1]) <= stereo.max_row_offset_px
    good &= (disparity > 0) & (np.abs(disparity - guess) <= np.maximum(3.0, 0.2 * guess))
    return np.where(good, disparity, np.nan)


def fit_pose(
    world: Map,
    observed: Observations,
    world_from_cam: Floats,
    rig: RectifiedRig,
    config: TrackingConfig,
) -> PoseFit:
    """Refine the pose on all that was observed, the right camera included."""
    return _refine(
        inverse(world_from_cam),
        world.xyz[observed.rows],
        observed.xy,
        observed.disparity,
        observed.sigma_px,
        rig,
        config,
    )


def predicted_octave(
    octave: NDArray[np.int32], scale: Floats, scale_factor: float
) -> NDArray[np.int32]:
    """The pyramid level on which a landmark should be found, after its size has changed."""
    change = np.round(np.log(scale) / np.log(scale_factor))
    level: NDArray[np.int32] = np.maximum(octave + change, 0).astype(np.int32)
    return level


def _refine(
    cam_from_world: Floats,
    xyz: Floats,
    xy: Floats,
    disparity: Floats,
    sigma_px: Floats,
    rig: RectifiedRig,
    config: TrackingConfig,
) -> PoseFit:
    return refine_pose(
        cam_from_world,
        xyz,
        xy,
        disparity,
        sigma_px,
        config.sigma_disparity_px,
        (rig.fx, rig.fy, rig.cx, rig.cy),
        rig.fx * rig.baseline_m,
        gate=config.gate,
    )
