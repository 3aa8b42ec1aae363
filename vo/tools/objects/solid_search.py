"""Instances of a solid object in an image: its points, matched and posed (PnP)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.transforms import make_transform, transform_points
from vo.base.types import Bools, Camera, Floats, Floats32, Ints
from vo.engine.geometry.pnp import PoseFit, refine_pose
from vo.tools.objects.flat_verification import first_of_each_place, near
from vo.tools.objects.part_matching import PartVectors, match_part
from vo.tools.objects.scene_features import SceneFeatures, unit_vectors
from vo.tools.objects.stored_objects import Solid

_MIN_INLIERS = 8
_MAX_INSTANCES = 10
_SAME_PLACE = 0.03  # of the size: nearer features are of one place
_PLACE_PX = 3.0  # the same, in the image
_RANSAC_PX, _RANSAC_ITERATIONS = 6.0, 3000
_REACH_PX = (6.0, 4.0, 3.0)  # of a feature from its prediction, in each round
_REACH = 0.015  # the same, of the size of the object in the scene
_MAX_DISTANCE, _MAX_DISTANCE_BINARY = 0.45, 0.8  # squared, where the place is predicted
_MIN_COSINE = float(np.cos(np.deg2rad(60.0)))  # between the view and that of a stored feature
_SIGMA_PX, _SIGMA_OF_SIZE = 0.5, 0.25  # of features: the smallest, and of larger ones
_GATE = 2.5
_CORRELATION = 3.0  # of the errors of features and of points: factor of the covariance, measured
_MAX_BLUR_PX = 0.8
_WEIGHTS = (-22.8, 6.0, 15.0)  # intercept, logarithm of inliers, ratio of what should be seen
EDGES = (  # pairs of corners, of x, y, z in this order
    *((0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7)),
    *((0, 4), (1, 5), (2, 6), (3, 7)),
)


class SolidInstance(NamedTuple):
    """An instance of a solid in an image without distortion."""

    cam_from_object: Floats
    covariance: Floats  # (6, 6), tangent (rx ry rz tx ty tz) of exp(xi) @ cam_from_object
    inliers: int  # points that agree
    ratio: float  # of the points that should be seen where the object is seen at all
    corners: Floats  # (8, 2) pixels of its box; EDGES joins them

    @property
    def confidence(self) -> float:
        """Probability that it is there, 0 to 1."""
        intercept, of_count, of_ratio = _WEIGHTS
        total = intercept + of_count * np.log(max(self.inliers, 1)) + of_ratio * self.ratio
        return float(1.0 / (1.0 + np.exp(-np.clip(total, -50.0, 50.0))))


class SolidVectors(NamedTuple):
    """A solid as it is matched."""

    solid: Solid
    vectors: PartVectors


def solid_vectors(solid: Solid) -> SolidVectors:
    """Prepare a solid for matching."""
    reach = _SAME_PLACE * float(np.linalg.norm(np.ptp(solid.box, axis=0)))
    same = np.ones((len(solid.xyz), len(solid.xyz)), bool)
    for axis in solid.xyz.T:
        same &= np.abs(axis[:, None] - axis[None]) <= reach
    nothing = np.full(len(solid.xyz), np.nan, np.float32)
    vector = unit_vectors(solid.descriptor)
    return SolidVectors(solid, PartVectors(vector, solid.xyz[:, :2], nothing, nothing, same))


def solid_instances(
    scene: SceneFeatures, stored: SolidVectors, camera: Camera
) -> Iterator[SolidInstance]:
    """All instances of a solid, by features of an image without distortion."""
    left = scene
    for _ in range(_MAX_INSTANCES):
        matches = match_part(left, stored.vectors)
        start = _robust(stored.solid.xyz[matches.part], left.xy[matches.scene], camera)
        found = None if start is None else _grown(left, stored, camera, start)
        if found is None:
            return
        instance, hull = found
        yield instance
        outside = [cv2.pointPolygonTest(hull, (float(u), float(v)), False) < 0 for u, v in left.xy]
        left = left.select(np.flatnonzero(outside))


def _robust(points: Floats32, pixels: Floats32, camera: Camera) -> Floats | None:
    """cam_from_object of points, some of which are wrong; None if there is none."""
    if len(points) < _MIN_INLIERS:
        return None
    try:
        found, turn, move, inlier = cv2.solvePnPRansac(
            points.astype(np.float64),
            pixels.astype(np.float64),
            camera.matrix,
            None,
            iterationsCount=_RANSAC_ITERATIONS,
            reprojectionError=_RANSAC_PX,
            confidence=0.9999,
            flags=cv2.SOLVEPNP_AP3P,
        )
    except cv2.error:  # degenerate points
        return None
    if not found or inlier is None or not np.isfinite(move).all():
        return None
    return make_transform(np.asarray(cv2.Rodrigues(turn)[0], np.float64), move.ravel())


def _grown(
    scene: SceneFeatures, stored: SolidVectors, camera: Camera, pose: Floats
) -> tuple[SolidInstance, Floats32] | None:
    """The instance with all features that its pose predicts, and the hull of its box."""
    solid = stored.solid
    fit: PoseFit | None = None
    for reach in _REACH_PX:
        seen, at, blur = _visible(solid, pose, camera)
        row, column = _predicted(scene, stored, seen, at, reach)
        if len(row) < _MIN_INLIERS:
            return None
        points = solid.xyz[column].astype(np.float64)
        fit = pose_fit(pose, points, scene, row, blur[column], camera)
        pose = fit.cam_from_world
    assert fit is not None
    inliers = int(np.count_nonzero(fit.inlier))
    corners = box_corners(solid.box, pose, camera)
    if inliers < _MIN_INLIERS or corners is None:
        return None
    ratio = inliers / max(len(np.unique(np.rint(at[seen] / _PLACE_PX), axis=0)), 1)
    instance = SolidInstance(pose, pose_covariance(fit), inliers, ratio, corners)
    return instance, np.asarray(cv2.convexHull(corners.astype(np.float32)))


def pose_fit(
    pose: Floats, points: Floats, scene: SceneFeatures, rows: Ints, blur: Floats, camera: Camera
) -> PoseFit:
    """The pose of points (N, 3) that the features in `rows` show; `blur`: their own sigma, px."""
    sigma = np.maximum(_SIGMA_PX, _SIGMA_OF_SIZE * scene.size[rows].astype(np.float64))
    pixels = scene.xy[rows].astype(np.float64)
    nothing = np.full(len(rows), np.nan)
    observed = PixelObservations(pixels, nothing, np.hypot(sigma, blur), 1.0)
    intrinsics = Intrinsics.from_matrix(camera.matrix)
    return refine_pose(pose, points, observed, intrinsics, 0.0, gate=_GATE)


def pose_covariance(fit: PoseFit) -> Floats:
    """Covariance (6, 6) of a pose, by the residuals of the features where they are larger."""
    squares = float((fit.residual[fit.inlier] ** 2).sum())
    factor = squares / max(2 * int(np.count_nonzero(fit.inlier)) - 6, 1)
    information = fit.information / (_CORRELATION * max(factor, 1.0))
    return np.asarray(np.linalg.pinv(information, hermitian=True))


def _visible(solid: Solid, pose: Floats, camera: Camera) -> tuple[Bools, Floats, Floats]:
    """(N,) which features the camera sees from about their side; (N, 2) pixels and (N,) sigma.

    The error of a point is along the view that it was learned from, and seen from another one.
    """
    in_cam = transform_points(pose, solid.xyz.astype(np.float64))
    depth = np.asarray(np.maximum(in_cam[:, 2], 1e-9))
    at = in_cam[:, :2] / depth[:, None] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    away = -pose[:3, :3].T @ pose[:3, 3] - solid.xyz
    cosine = (away * solid.ray).sum(axis=1) / np.linalg.norm(away, axis=1)
    inside = ((at >= 0) & (at < (camera.width, camera.height))).all(axis=1)
    sine = np.sqrt(np.maximum(1.0 - cosine**2, 0.0))
    blur = camera.fx / depth * solid.sigma * sine
    is_seen = (in_cam[:, 2] > 0) & inside & (cosine >= _MIN_COSINE) & (blur <= _MAX_BLUR_PX)
    return np.asarray(is_seen), np.asarray(at), np.asarray(blur)


def _predicted(
    scene: SceneFeatures, stored: SolidVectors, seen: Bools, at: Floats, reach: float
) -> tuple[Ints, Ints]:
    """One-to-one matches of features near where the pose predicts them, the most alike first."""
    columns = np.flatnonzero(seen)
    if not len(columns):
        return columns, columns
    extent = float(np.sqrt(np.prod(np.maximum(np.ptp(at[columns], axis=0), 1.0))))
    row, column = near(scene.xy, at[columns], max(reach, _REACH * extent))
    column = columns[column]
    distance = 2.0 - 2.0 * (scene.vector[row] * stored.vectors.vector[column]).sum(axis=1)
    is_binary = stored.solid.descriptor.dtype == np.uint8
    good = np.flatnonzero(distance <= (_MAX_DISTANCE_BINARY if is_binary else _MAX_DISTANCE))
    good = good[np.argsort(distance[good], kind="stable")]
    row, column = row[good], column[good]
    kept = first_of_each_place(scene.xy[row], at[column].astype(np.float32))
    return row[kept], column[kept]


def box_corners(box: Floats32, cam_from_object: Floats, camera: Camera) -> Floats | None:
    """(8, 2) pixels of the corners of a box; None if one is not in front of the camera."""
    x, y, z = box.T.astype(np.float64)
    corners = np.array([[a, b, c] for a in x for b in y for c in z])
    in_cam = transform_points(cam_from_object, corners)
    if in_cam[:, 2].min() <= 1e-6:
        return None
    plane = in_cam[:, :2] / in_cam[:, 2:]
    return np.asarray(plane * (camera.fx, camera.fy) + (camera.cx, camera.cy))
