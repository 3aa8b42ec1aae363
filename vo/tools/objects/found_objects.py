"""Instances as they are reported: poses, and pixels of the recorded image."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from vo.base.geometry.cameras import distort
from vo.base.geometry.transforms import make_transform
from vo.base.types import Camera, Floats
from vo.tools.objects.flat_verification import FlatInstance
from vo.tools.objects.scene_features import SceneFeatures
from vo.tools.objects.solid_search import EDGES, SolidInstance, pose_covariance, pose_fit
from vo.tools.objects.stored_objects import FoundObject, Part


def found_solid(name: str, instance: SolidInstance, is_metric: bool, camera: Camera) -> FoundObject:
    """An instance of a solid; its pose in metres, if those of its map are."""
    corners = as_recorded(instance.corners, camera)
    (left, top), (right, bottom) = corners.min(axis=0), corners.max(axis=0)
    return FoundObject(
        name,
        0,
        instance.confidence,
        instance.inliers,
        np.array([[left, top], [right, top], [right, bottom], [left, bottom]]),
        None,
        instance.cam_from_object if is_metric else None,
        instance.covariance if is_metric else None,
        corners[np.array(EDGES)],
    )


def as_recorded(pixels: Floats, camera: Camera) -> Floats:
    """Pixels (N, 2) of an image without distortion in the recorded one."""
    if not camera.is_distorted:
        return pixels
    bent = distort(camera, (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
    return np.where(np.isfinite(bent), bent, pixels)


def with_pose(
    found: FoundObject, part: Part, scene: SceneFeatures, flat: FlatInstance, camera: Camera
) -> FoundObject:
    """The instance with its pose, if the size of the part is known, and its outline as recorded.

    `found`: instance in an image without distortion.
    """
    pose = covariance = None
    if np.isfinite(part.unit_m):
        rows, columns = flat.matches.scene, flat.matches.part
        centre = (np.array(part.image_size) - 1.0) / 2.0
        plane = part.unit_m * (part.xy[columns] - centre)
        points = np.column_stack([plane, np.zeros(len(plane))])
        pose = _flat_pose(points, scene.xy[rows].astype(np.float64), camera.matrix)
        if pose is not None:
            fit = pose_fit(pose, points, scene, rows, np.zeros(len(rows)), camera)
            covariance = pose_covariance(fit)
    outline = as_recorded(found.outline, camera)
    return replace(found, outline=outline, cam_from_object=pose, covariance=covariance)


def _flat_pose(points: Floats, pixels: Floats, matrix: Floats) -> Floats | None:
    """cam_from_object (4, 4) of points (N, 3) with z = 0: the better of both poses, refined.

    Source: Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014.
    """
    middle = points.mean(axis=0)
    centred = np.ascontiguousarray(points - middle)
    try:
        count, turns, moves, _ = cv2.solvePnPGeneric(
            centred, pixels, np.ascontiguousarray(matrix), None, flags=cv2.SOLVEPNP_IPPE
        )
        if not count:
            return None
        turn, move = cv2.solvePnPRefineLM(centred, pixels, matrix, None, turns[0], moves[0])
    except cv2.error:  # degenerate points
        return None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], dtype=np.float64)
    pose = make_transform(rotation, move.ravel() - rotation @ middle)
    return pose if np.isfinite(pose).all() and move[2] > 0 else None
