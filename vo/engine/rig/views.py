"""The cameras of a rig as views: pinhole cameras that all have the same intrinsics.

A camera gives one view, or several where its lens is wider than a pinhole camera should be. The
body is view 0, at camera 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from vo.base.geometry.lens_field import WIDE_DEG, half_angles
from vo.base.geometry.pair_rectification import central_focal
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.rectification_maps import Maps, wide_maps
from vo.base.geometry.remapping import Remapping
from vo.base.geometry.transforms import inverse, make_transform, so3_exp
from vo.base.types import Bytes, Camera, Floats, Ints, Rig

_GROWTH_PX = 16  # around what masks hide, as in `vo.engine.frontend.static_masks`
_HALF_VIEW_DEG = 50.0  # from the axis to the edge, at most, of each view of a wide lens
_EVEN_DEG = 1.0  # margin between the two views of one lens
# Directions (yaw and pitch in degrees) of the views of a single wide lens; only equirectangular
# images have the one behind.
_BEHIND = (180, 0)
_AROUND = ((0, 0), (90, 0), _BEHIND, (270, 0), (0, 90), (0, -90))


@dataclass(frozen=True, eq=False)
class ViewOfCamera:
    """One view.

    Attributes:
        camera: index of the camera.
        body_from_view: (4, 4).
        maps: rectification maps, None for images used as recorded.
        mask: (H, W) uint8, 0 where the view has no pixels to be used; None without such.
        lens: the camera, if it is a wide lens whose image may be a circle.
    """

    camera: int
    body_from_view: Floats
    maps: Maps | None
    mask: Bytes | None
    lens: Camera | None = None

    def rectify(self, image: Bytes) -> Bytes:
        """The view of a recorded image."""
        return image if self._remapping is None else self._remapping(image)

    @cached_property
    def _remapping(self) -> Remapping | None:
        return None if self.maps is None else Remapping(self.maps)

    def mask_of(self, recorded: Bytes) -> Bytes | None:
        """The mask for one of the recorded image; None if all of the view is used."""
        shown = self.rectify(recorded)
        used = np.where(shown == 255, np.uint8(255), np.uint8(0))
        if used.all():
            return None
        side = 2 * _GROWTH_PX + 1
        return np.asarray(cv2.erode(used, np.ones((side, side), np.uint8)), np.uint8)


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
        if recorded is None:
            recorded = np.full((lens.height, lens.width), 255, np.uint8)
        for turn in turns[number]:
            cam_from_view = make_transform(turn, np.zeros(3))
            maps = None
            if not np.array_equal(turn, np.eye(3)) or _differs(lens, size, matrix):
                maps = wide_maps(lens, turn.T, matrix, size)
            placed = inverse(cam0_from_body) @ pose @ cam_from_view
            is_circle = len(turns[number]) > 1 and lens.distortion_model != "equirectangular"
            view = ViewOfCamera(number, placed, maps, None, lens if is_circle else None)
            views.append(replace(view, mask=view.mask_of(recorded)))
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
    limit = np.deg2rad(_HALF_VIEW_DEG)
    for lens in lenses:
        rotations, half = _turns(lens, is_single=len(lenses) == 1)
        turns.append(rotations)
        half_width = max(half_width, focal * np.tan(half))
        half_height = max(half_height, focal * np.tan(min(half_angles(lens)[1], limit)))
    size = 2 * int(half_width) + 1, 2 * int(half_height) + 1
    matrix = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
    return size, matrix, turns


def _turns(lens: Camera, *, is_single: bool) -> tuple[list[Floats], float]:
    """Rotations cam_from_view of the views of a lens, and half the angle across each.

    With other cameras around, two views to the sides are enough, as wide as they need to be.
    """
    across, along = half_angles(lens)
    limit, even = np.deg2rad((_HALF_VIEW_DEG, _EVEN_DEG)).tolist()
    if across <= np.deg2rad(WIDE_DEG):
        return [np.eye(3)], across
    if lens.distortion_model == "equirectangular":
        return [_turn(*each) for each in _AROUND], limit
    if is_single and along > np.deg2rad(WIDE_DEG):
        return [_turn(*each) for each in _AROUND if each != _BEHIND], limit
    half = min(limit, 0.5 * (across + even))
    yaw_deg = float(np.rad2deg(half - even))
    return [_turn(-yaw_deg, 0.0), _turn(yaw_deg, 0.0)], half


def _turn(yaw_deg: float, pitch_deg: float) -> Floats:
    yaw, pitch = np.deg2rad(yaw_deg), np.deg2rad(pitch_deg)
    turn = so3_exp(np.array([0.0, yaw, 0.0])) @ so3_exp(np.array([pitch, 0.0, 0.0]))
    return np.asarray(np.round(turn, 12))
