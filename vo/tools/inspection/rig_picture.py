"""A rig from above: what its cameras see, and where two or more see the same."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.geometry.rig_overlap import sees
from vo.base.types import Bytes, Floats, Rig

_SIZE_PX = 640
_MIN_RADIUS_M = 2.0
_EXTENTS = 5.0  # radius of the picture, in distances of the farthest camera
_GREY = (255, 205, 150, 105, 70)  # seen by none, by one camera, by two, …


def draw_rig(rig: Rig) -> Bytes:
    """The plane of the cameras from above (H, W), grey; camera 0 looks up.

    A place is the darker the more cameras see it.
    """
    poses = rig.cam0_from_cams
    radius_m = max(_MIN_RADIUS_M, _EXTENTS * float(np.abs(poses[:, :3, 3]).max()))
    level = np.linspace(-radius_m, radius_m, _SIZE_PX)
    x, z = np.meshgrid(level, -level)
    points = np.stack([x, np.full_like(x, poses[:, 1, 3].mean()), z], axis=-1).reshape(-1, 3)
    count = sum(
        sees(camera, pose, points).astype(np.int64)
        for camera, pose in zip(rig.cameras, poses, strict=True)
    )
    shades = np.array(_GREY, np.uint8)[np.minimum(count, len(_GREY) - 1)]
    picture = np.ascontiguousarray(shades.reshape(_SIZE_PX, _SIZE_PX))
    for number, pose in enumerate(poses):
        _draw_camera(picture, f"cam{number}", pose, radius_m)
    text = f"from above, {2 * radius_m:.3g} m wide: darker where more cameras see"
    _write(picture, text, (6, _SIZE_PX - 8))
    return picture


def _draw_camera(picture: Bytes, name: str, pose: Floats, radius_m: float) -> None:
    """A line along the optical axis of a camera, and its name at the end."""
    ahead = pose[[0, 2], 2] * 0.16 * radius_m
    ends = [pose[[0, 2], 3], pose[[0, 2], 3] + ahead]
    scale = 0.5 * _SIZE_PX / radius_m
    (u0, v0), (u1, v1) = (
        (round(0.5 * _SIZE_PX + scale * x), round(0.5 * _SIZE_PX - scale * z)) for x, z in ends
    )
    cv2.circle(picture, (u0, v0), 4, 0, -1, cv2.LINE_AA)
    cv2.line(picture, (u0, v0), (u1, v1), 0, 2, cv2.LINE_AA)
    _write(picture, name, (u1 + (6 if u1 >= u0 else -46), v1 + (16 if v1 > v0 else -4)))


def _write(picture: Bytes, text: str, place: tuple[int, int]) -> None:
    cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 0, 1, cv2.LINE_AA)
