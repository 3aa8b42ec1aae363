"""The cameras of a rig as views: pinhole cameras that all have the same intrinsics.

A camera gives one view, or two that look to both sides where its lens is wider than a pinhole
camera should be. The body is view 0, at camera 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vo.base.geometry import cameras
from vo.base.geometry.pair_rectification import central_focal
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.rectification_maps import Maps, wide_maps
from vo.base.geometry.transforms import inverse, make_transform, so3_exp
from vo.base.types import Bytes, Camera, Floats, Ints, Rig

_GROWTH_PX = 16  # around what masks hide, as in `vo.engine.frontend.static_masks`
# Beyond this angle from its axis a lens is shown by two views, as wide as it needs, of at most the
# second angle to each side.
_WIDE_DEG, _HALF_VIEW_DEG = 62.0, 50.0
_MAX_RAY_DEG, _STEP_DEG = 110, 2  # searched for the edge of an image
_EVEN_DEG = 1.0  # margin between the two views of one lens


@dataclass(frozen=True, eq=False)
class ViewOfCamera:
    """One view.

    Attributes:
        camera: index of the camera.
        body_from_view: (4, 4).
        maps: rectification maps, None for images used as recorded.
        mask: (H, W) uint8, 0 where the view has no pixels to be used; None without such.
    """

    camera: int
    body_from_view: Floats
    maps: Maps | None
    mask: Bytes | None

    def rectify(self, image: Bytes) -> Bytes:
        """The view of a recorded image."""
        if self.maps is None:
            return image
        return np.asarray(cv2.remap(image, *self.maps, cv2.INTER_LINEAR), dtype=np.uint8)


@dataclass(frozen=True, eq=False)
class RigViews:
    """All views; `rectified` has their intrinsics, and the rotation from view 0 to camera 0."""

    rectified: RectifiedRig
    views: tuple[ViewOfCamera, ...]

    @property
    def cameras(self) -> Ints:
        """(V,) camera of each view."""
        return np.array([view.camera for view in self.views])

    @property
    def body_from_views(self) -> Floats:
        """(V, 4, 4)."""
        return np.stack([view.body_from_view for view in self.views])


def rig_views(rig: Rig, masks: Sequence[Bytes | None] = ()) -> RigViews:
    """Choose the views of a rig; `masks` (H, W) are those of the recorded images, by camera."""
    lenses = rig.cameras
    first = lenses[0]
    intrinsics = np.array([(c.width, c.height, c.fx, c.fy, c.cx, c.cy) for c in lenses])
    are_ideal = not any(c.is_distorted or any(c.distortion) for c in lenses)
    if are_ideal and np.allclose(intrinsics, intrinsics[0], atol=0.02):
        size, matrix = (first.width, first.height), first.matrix
        turns: list[list[Floats]] = [[np.eye(3)] for _ in lenses]
    else:
        size, matrix, turns = _common_pinhole(lenses)
    cam0_from_body = make_transform(turns[0][0], np.zeros(3))
    views = []
    for number, (lens, pose) in enumerate(zip(lenses, rig.cam0_from_cams, strict=True)):
        recorded = masks[number] if number < len(masks) else None
        for turn in turns[number]:
            cam_from_view = make_transform(turn, np.zeros(3))
            maps = None
            if not np.array_equal(turn, np.eye(3)) or _differs(lens, size, matrix):
                maps = wide_maps(lens, turn.T, matrix, size)
            placed = inverse(cam0_from_body) @ pose @ cam_from_view
            views.append(ViewOfCamera(number, placed, maps, _mask(lens, maps, recorded)))
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    rectified = RectifiedRig(*size, fx, fy, cx, cy, 0.0, cam0_from_body, recorded_rows=first.height)
    return RigViews(rectified, tuple(views))


def _differs(lens: Camera, size: tuple[int, int], matrix: Floats) -> bool:
    same = np.allclose(lens.matrix, matrix, atol=0.02) and (lens.width, lens.height) == size
    return lens.is_distorted or any(lens.distortion) or not same


def _common_pinhole(
    lenses: Sequence[Camera],
) -> tuple[tuple[int, int], Floats, list[list[Floats]]]:
    """Size and matrix of all views, and for each camera the rotations cam_from_view (3, 3)."""
    focal = float(np.median([central_focal(lens)[0] for lens in lenses]))
    turns: list[list[Floats]] = []
    half_width = half_height = 0.0
    for lens in lenses:
        across, along = (_half_angle(lens, axis) for axis in (0, 1))
        if across > np.deg2rad(_WIDE_DEG):
            half = min(np.deg2rad(_HALF_VIEW_DEG), 0.5 * (across + np.deg2rad(_EVEN_DEG)))
            yaw = half - np.deg2rad(_EVEN_DEG)
            turns.append([so3_exp(np.array([0.0, side * yaw, 0.0])) for side in (-1.0, 1.0)])
            across = half
        else:
            turns.append([np.eye(3)])
        half_width = max(half_width, focal * np.tan(across))
        half_height = max(half_height, focal * np.tan(min(along, np.deg2rad(_HALF_VIEW_DEG))))
    size = 2 * int(half_width) + 1, 2 * int(half_height) + 1
    matrix = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    return size, matrix, turns


def _half_angle(lens: Camera, axis: int) -> float:
    """The greater angle from the optical axis to the two edges of the image along an axis."""
    angles = np.deg2rad(np.arange(0, _MAX_RAY_DEG, _STEP_DEG))
    greatest = 0.0
    for side in (-1.0, 1.0):
        rays = np.zeros((len(angles), 3))
        rays[:, axis], rays[:, 2] = side * np.sin(angles), np.cos(angles)
        at = cameras.project(lens, rays)[:, axis]
        end = (lens.width, lens.height)[axis] - 1
        with np.errstate(invalid="ignore"):
            inside = (at >= 0) & (at <= end) & (np.diff(at, prepend=at[0] - side) * side > 0)
        beyond = np.flatnonzero(~inside)
        last = (beyond[0] if len(beyond) else len(angles)) - 1
        greatest = max(greatest, float(angles[max(last, 0)]))
    return greatest


def _mask(lens: Camera, maps: Maps | None, recorded: Bytes | None) -> Bytes | None:
    if recorded is None:
        recorded = np.full((lens.height, lens.width), 255, np.uint8)
    shown = recorded if maps is None else np.asarray(cv2.remap(recorded, *maps, cv2.INTER_LINEAR))
    used = np.where(shown == 255, np.uint8(255), np.uint8(0))
    if used.all():
        return None
    side = 2 * _GROWTH_PX + 1
    return np.asarray(cv2.erode(used, np.ones((side, side), np.uint8)), np.uint8)
