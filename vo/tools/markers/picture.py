"""Pictures of images with their markers and axes."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.geometry.cameras import project
from vo.base.types import Bytes, Camera, Floats
from vo.tools.markers.image_markers import FrameMarkers, PlanePose

_BITS = 4  # of fractions of pixels
_OUTLINE, _AMBIGUOUS, _TEXT = (80, 220, 60), (0, 170, 255), (80, 220, 60)  # BGR
_AXES = ((60, 60, 240), (80, 220, 60), (240, 140, 60))  # x, y, z
_STEPS = 12  # along an axis, which a lens bends


def draw_markers(
    image: Bytes, frame: FrameMarkers, camera: Camera | None, length_m: float
) -> Bytes:
    """The image (H, W, 3) BGR with outlines, ids and axes; ambiguous ones are orange."""
    picture = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    for marker in frame.markers:
        is_ambiguous = marker.pose is not None and marker.pose.is_ambiguous
        _line(picture, marker.detected.corners, _AMBIGUOUS if is_ambiguous else _OUTLINE, True)
        at = np.rint(marker.detected.corners.min(axis=0) - (0, 6)).astype(int).tolist()
        cv2.putText(
            picture, str(marker.id), at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _TEXT, 1, cv2.LINE_AA
        )
        if marker.pose is not None and camera is not None and frame.board is None:
            _draw_axes(picture, camera, marker.pose, 0.5 * length_m)
    if frame.board is not None and camera is not None:
        _draw_axes(picture, camera, frame.board, 2.0 * length_m)
    return picture


def _draw_axes(picture: Bytes, camera: Camera, pose: PlanePose, length_m: float) -> None:
    cam_from_marker = pose.cam_from_marker
    along = np.linspace(0.0, length_m, _STEPS)[:, None]
    for axis, colour in zip(np.eye(3), _AXES, strict=True):
        points = (along * axis) @ cam_from_marker[:3, :3].T + cam_from_marker[:3, 3]
        pixels = project(camera, points)
        if np.isfinite(pixels).all() and np.abs(pixels).max() < 1e5:
            _line(picture, pixels, colour, False)


def _line(picture: Bytes, xy: Floats, colour: tuple[int, int, int], is_closed: bool) -> None:
    points = np.rint(xy * 2**_BITS).astype(np.int32)
    cv2.polylines(picture, [points], is_closed, colour, 2, cv2.LINE_AA, _BITS)
