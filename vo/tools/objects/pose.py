"""Poses of found objects, and images without the distortion of a lens."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from vo.base.geometry.cameras import distort
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Camera, Floats
from vo.tools.objects.part_matching import PartMatches
from vo.tools.objects.records import FoundObject, Part
from vo.tools.objects.scene_features import SceneFeatures


def without_distortion(image: Bytes, camera: Camera) -> Bytes:
    """An (H, W) uint8 image as a pinhole camera with the same matrix would see it."""
    if not camera.is_distorted:
        return image
    height, width = image.shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    rays = np.column_stack(
        [(u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy]
    )
    pixels = np.nan_to_num(distort(camera, rays), nan=-1.0).reshape(height, width, 2)
    return np.asarray(cv2.remap(image, pixels.astype(np.float32), None, cv2.INTER_LINEAR), np.uint8)


def with_pose(
    found: FoundObject, part: Part, scene: SceneFeatures, matches: PartMatches, camera: Camera
) -> FoundObject:
    """The instance with its pose, if the size of the part is known, and its outline as recorded.

    `found`: instance in an image without distortion.
    """
    pose = None
    if np.isfinite(part.unit_m):
        flat = np.zeros(len(matches.part))
        centre = (np.array(part.image_size) - 1.0) / 2.0
        points = part.unit_m * np.column_stack([part.xy[matches.part] - centre, flat])
        pose = _flat_pose(points, scene.xy[matches.scene].astype(np.float64), camera.matrix)
    outline = found.outline
    if camera.is_distorted:
        rays = (outline - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
        bent = distort(camera, rays)
        outline = np.where(np.isfinite(bent), bent, outline)
    return replace(found, outline=outline, cam_from_object=pose)


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
