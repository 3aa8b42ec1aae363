"""Readers of KITTI's `calib.txt`, rectified cameras, and KITTI raw's `calib_cam_to_cam.txt`.

Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, 2013, section IV-B.
"""

from __future__ import annotations

import re

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import (
    make_camera,
    make_projection,
    make_rig,
    make_rotation,
    matrix_camera,
    rotation_and_translation,
)
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize
from vo.recordings.formats.calibration.numbers import make_numbers

_LINE = re.compile(r"^[ \t]*(P[0-3])[ \t]*:[ \t]*([-+\d.nNiI].*)$", re.MULTILINE)
_RAW_LINE = re.compile(r"^[ \t]*([A-Z](?:_rect)?_0[0-3])[ \t]*:(.*)$", re.MULTILINE)

_PosedCamera = tuple[Camera, Floats]
"""A camera, and (4, 4) camera_from_body."""


def recognises(document: Document) -> bool:
    """Whether there is a line `P0: …`."""
    return _LINE.search(document.text) is not None


def recognises_raw(document: Document) -> bool:
    """Whether there is a line of one of its cameras, such as `P_rect_00: …`."""
    return _RAW_LINE.search(document.text) is not None


def read(
    document: Document, image_size: ImageSize | None, cameras: tuple[str, str] = ("P0", "P1")
) -> Calibration:
    """Read a pair of KITTI's four cameras, or the left one if the right one is missing.

    The body is the rectified grey left camera.

    `cameras`: the pair, left first: P0 and P1 are the grey cameras, P2 and P3 the colour ones.
    """
    matrices = dict(_LINE.findall(document.text))
    left, right = cameras
    if left not in matrices:
        raise CalibrationError(f"{document.path}: {left} is missing; add '{left}:' and 12 numbers")

    def camera(name: str) -> _PosedCamera:
        where = f"{document.path}: {name}"
        p = np.array(make_numbers(where, matrices[name].split(), 12)).reshape(3, 4)
        found = make_camera(where, image_size, [p[0, 0], p[1, 1], p[0, 2], p[1, 2]])
        return found, make_transform(np.eye(3), np.linalg.solve(found.matrix, p[:, 3]))

    found = [camera(name) for name in (left, right) if name in matrices]
    return _on_body(f"{document.path}: {right}", found)


def read_raw(
    document: Document, image_size: ImageSize | None, cameras: tuple[str, str] = ("00", "01")
) -> Calibration:
    """Read a pair of KITTI raw, or the left camera if the right one is missing.

    Images of size S_00 are unrectified (K, D, R and T apply); all others are assumed to be
    rectified (S_rect_00, P_rect_00), which KITTI calls `sync`. The body is the unrectified
    reference camera 00.

    `cameras`: numbers of the pair, left first: 00 and 01 are grey, 02 and 03 in colour.
    """
    lines = _Lines(document)
    left, right = cameras
    if f"P_rect_{left}" not in lines.text and f"K_{left}" not in lines.text:
        raise CalibrationError(f"{document.path}: P_rect_{left} and K_{left} are missing")
    is_recorded = _is_recorded(lines, left, image_size)
    camera, key = (_recorded, "K_") if is_recorded else (_rectified, "P_rect_")
    numbers = [left, right] if key + right in lines.text else [left]
    found = [camera(lines, number) for number in numbers]
    return _on_body(f"{document.path}: camera {right}", found)


def rectification(document: Document) -> Floats:
    """(4, 4) from the unrectified camera 00 to the rectified one."""
    rotation = make_rotation(f"{document.path}: R_rect_00", _Lines(document).numbers("R_rect_00"))
    return make_transform(rotation, np.zeros(3))


def _on_body(where: str, cameras: list[_PosedCamera]) -> Calibration:
    cam0, cam0_from_body = cameras[0]
    body_from_cam0 = inverse(cam0_from_body)
    if len(cameras) == 1:
        return Calibration(Rig(cam0), body_from_cam0)
    cam1, cam1_from_body = cameras[1]
    rig = make_rig(where, cam0, cam1, cam1_from_body @ body_from_cam0)
    return Calibration(rig, body_from_cam0)


class _Lines:
    """The lines of the file by name."""

    def __init__(self, document: Document) -> None:
        self.path = document.path
        self.text = dict(_RAW_LINE.findall(document.text))

    def numbers(self, name: str) -> tuple[float, ...]:
        if name not in self.text:
            raise CalibrationError(f"{self.path}: {name} is missing")
        return make_numbers(f"{self.path}: {name}", self.text[name].split())


def _is_recorded(lines: _Lines, camera: str, image_size: ImageSize | None) -> bool:
    if f"P_rect_{camera}" not in lines.text:
        return True
    if image_size is None or f"S_{camera}" not in lines.text:
        return False
    return lines.numbers(f"S_{camera}") == tuple(float(side) for side in image_size)


def _rectified(lines: _Lines, number: str) -> _PosedCamera:
    where = f"{lines.path}: P_rect_{number}"
    # All rectified cameras, also those in colour, have the axes of R_rect_00.
    rotation = make_rotation(f"{lines.path}: R_rect_00", lines.numbers("R_rect_00"))
    p, t = make_projection(where, lines.numbers(f"P_rect_{number}"))
    size = lines.numbers(f"S_rect_{number}")
    camera = make_camera(where, size, [p[0, 0], p[1, 1], p[0, 2], p[1, 2]])
    return camera, make_transform(rotation, t)


def _recorded(lines: _Lines, number: str) -> _PosedCamera:
    where = f"{lines.path}: camera {number}"
    camera = matrix_camera(
        where,
        resolution=lines.numbers(f"S_{number}"),
        matrix=lines.numbers(f"K_{number}"),
        distortion_model="radtan",
        distortion=lines.numbers(f"D_{number}"),
    )
    rotation, translation = lines.numbers(f"R_{number}"), lines.numbers(f"T_{number}")
    return camera, rotation_and_translation(where, rotation, translation)
