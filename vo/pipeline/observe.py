"""Find the map's landmarks in a frame: by descriptor for a first pose, then patch by patch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vo.config import StereoConfig, TrackingConfig
from vo.features.alignment import align_patches
from vo.features.matching import agree_in_rotation, match_everywhere, match_windows
from vo.geometry.pnp import PoseFit, refine_pose
from vo.geometry.rectification import WorkingRig
from vo.geometry.transforms import inverse, make_transform, transform_points
from vo.mapping.map import Map
from vo.pipeline.depth import disparity_from_depth
from vo.pipeline.working_frame import WorkingFrame
from vo.types import Bools, Bytes, Floats, Ints

_BORDER_PX = 8.0
_SCALE_RANGE = 2.0  # landmarks nearer or farther than this against their patch are not tried


@dataclass(frozen=True, eq=False)
class Visible:
    """Landmarks that should be in the image; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        xy: (n, 2) ideal pixels where they should be.
        image_xy: (n, 2) the same in the working image.
        depth: (n,) along the optical axis.
        scale: (n,) size of their patch now against its reference.
    """

    rows: Ints
    xy: Floats
    image_xy: Floats
    depth: Floats
    scale: Floats


@dataclass(frozen=True, eq=False)
class Observed:
    """Landmarks found in an image; rows belong together.

    Attributes:
        rows: (n,) rows of the map.
        image_xy: (n, 2) working-image pixels.
        xy: (n, 2) ideal pixels.
        disparity: (n,) pixels, NaN without a right match.
        sigma_px: (n,) standard deviation of xy.
        score: (n,) correlation of the patch.
        scale: (n,) size of the patch now against its reference.
    """

    rows: Ints
    image_xy: Floats
    xy: Floats
    disparity: Floats
    sigma_px: Floats
    score: Floats
    scale: Floats

    def __len__(self) -> int:
        return len(self.rows)


def visible_landmarks(world: Map, rig: WorkingRig, world_from_cam: Floats) -> Visible:
    """The landmarks that a camera at this pose should see."""
    in_cam = transform_points(inverse(world_from_cam), world.xyz)
    depth = in_cam[:, 2]
    typical = float(np.median(np.abs(depth))) if len(depth) else 0.0
    rows = np.flatnonzero(depth > 1e-3 * max(typical, 1e-9))
    xy = rig.project(in_cam[rows])
    image_xy = rig.image_from_ideal(xy)
    inside = (
        (image_xy[:, 0] >= _BORDER_PX)
        & (image_xy[:, 1] >= _BORDER_PX)
        & (image_xy[:, 0] < rig.width - _BORDER_PX)
        & (image_xy[:, 1] < rig.height - _BORDER_PX)
    )
    reference_centre = world.reference_poses()[rows, :3, 3]
    now = np.linalg.norm(world.xyz[rows] - world_from_cam[:3, 3], axis=1)
    then = np.linalg.norm(world.xyz[rows] - reference_centre, axis=1)
    scale = then / np.maximum(now, 1e-12)
    inside &= (scale < _SCALE_RANGE) & (scale > 1.0 / _SCALE_RANGE)
    return Visible(rows[inside], xy[inside], image_xy[inside], depth[rows[inside]], scale[inside])


def most_promising(world: Map, visible: Visible, count: int) -> Visible:
    """At most `count` of the landmarks: those found most often, then the newest."""
    if len(visible.rows) <= count:
        return visible
    found = np.minimum(world.found[visible.rows], 20)
    return _some(visible, np.sort(np.lexsort((-visible.rows, -found))[:count]))


def among(visible: Visible, rows: Ints) -> Visible:
    """Those of the landmarks that are in these rows of the map."""
    return _some(visible, np.flatnonzero(np.isin(visible.rows, rows)))


def _some(visible: Visible, kept: Ints) -> Visible:
    return Visible(
        visible.rows[kept],
        visible.xy[kept],
        visible.image_xy[kept],
        visible.depth[kept],
        visible.scale[kept],
    )


def match_by_descriptor(
    world: Map,
    visible: Visible,
    frame: WorkingFrame,
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
    world: Map, frame: WorkingFrame, config: TrackingConfig
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
    rig: WorkingRig,
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
    world_from_cam: Floats,
    image: Bytes,
    rig: WorkingRig,
    config: TrackingConfig,
) -> Observed:
    """Find landmarks to sub-pixel in an image seen from about this pose; no disparities yet."""
    rows = visible.rows
    found = align_patches(
        world.images,
        world.reference_slots()[rows],
        world.reference_xy[rows],
        patch_warp(world, visible, rig, world_from_cam),
        image,
        visible.image_xy,
        half_px=config.patch_half_px,
    )
    shift = np.linalg.norm(found.xy - visible.image_xy, axis=1)
    ideal = rig.ideal_from_image(found.xy)
    kept = found.converged & (found.score >= config.min_patch_score)
    kept &= (shift <= config.max_shift_px) & np.isfinite(ideal).all(axis=1)
    return Observed(
        rows=rows[kept],
        image_xy=found.xy[kept],
        xy=ideal[kept],
        disparity=np.full(int(kept.sum()), np.nan),
        sigma_px=np.full(int(kept.sum()), config.sigma_px),
        score=found.score[kept],
        scale=visible.scale[kept],
    )


def with_disparity(
    observed: Observed,
    world: Map,
    world_from_cam: Floats,
    frame: WorkingFrame,
    rig: WorkingRig,
    config: TrackingConfig,
    stereo: StereoConfig,
) -> Observed:
    """The same landmarks with their disparities, where there is a right image or depth."""
    if frame.depth is not None:
        disparity = disparity_from_depth(frame.depth, observed.image_xy, rig)
        return replace(observed, disparity=disparity)
    if frame.image1 is None:
        return observed
    in_cam = transform_points(inverse(world_from_cam), world.xyz[observed.rows])
    guess = rig.fx * rig.baseline_m / in_cam[:, 2]
    xy = observed.image_xy
    disparity = measure_disparity(frame.image0, frame.image1, xy, guess, rig, config, stereo)
    return replace(observed, disparity=disparity)


def measure_disparity(
    image0: Bytes,
    image1: Bytes,
    xy: Floats,
    guess: Floats,
    rig: WorkingRig,
    config: TrackingConfig,
    stereo: StereoConfig,
) -> Floats:
    """Sub-pixel disparity (n,) of patches around xy (n, 2), NaN where there is none."""
    offset = rig.disparity_offset_px
    start = xy - np.column_stack([guess + offset, np.zeros(len(guess))])
    found = align_patches(
        image0[None],
        np.zeros(len(xy), dtype=np.int64),
        xy,
        np.tile(np.eye(2), (len(xy), 1, 1)),
        image1,
        start,
        half_px=config.patch_half_px,
    )
    disparity = xy[:, 0] - found.xy[:, 0] - offset
    good = found.converged & (found.score >= config.min_patch_score)
    good &= np.abs(found.xy[:, 1] - xy[:, 1]) <= stereo.max_row_offset_px
    good &= (disparity > 0) & (np.abs(disparity - guess) <= np.maximum(3.0, 0.2 * guess))
    return np.where(good, disparity, np.nan)


def fit_pose(
    world: Map, observed: Observed, world_from_cam: Floats, rig: WorkingRig, config: TrackingConfig
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


def patch_warp(world: Map, visible: Visible, rig: WorkingRig, world_from_cam: Floats) -> Floats:
    """How patches (n, 2, 2) are stretched from their reference image to this one.

    Two neighbours one pixel away at the same depth are carried over (Forster et al., SVO, 2014,
    sec. IV-B: the patch is taken to face its reference camera).
    """
    rows = visible.rows
    reference = world.reference_poses()[rows]
    in_reference = np.einsum(
        "nji,nj->ni", reference[:, :3, :3], world.xyz[rows] - reference[:, :3, 3]
    )
    cam_from_world = inverse(world_from_cam)
    centre = visible.xy
    columns = []
    for axis, focal in ((0, rig.fx), (1, rig.fy)):
        moved = in_reference.copy()
        moved[:, axis] += in_reference[:, 2] / focal
        in_world = np.einsum("nij,nj->ni", reference[:, :3, :3], moved) + reference[:, :3, 3]
        columns.append(rig.project(transform_points(cam_from_world, in_world)) - centre)
    warp = np.stack(columns, axis=-1)
    determinant = np.abs(np.linalg.det(warp))
    bad = ~np.isfinite(determinant) | (determinant < 0.1) | (determinant > 10.0)
    warp[bad] = np.eye(2)
    return warp


def _refine(
    cam_from_world: Floats,
    xyz: Floats,
    xy: Floats,
    disparity: Floats,
    sigma_px: Floats,
    rig: WorkingRig,
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
