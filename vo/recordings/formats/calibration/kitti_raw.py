"""Reader of KITTI raw's `calib_cam_to_cam.txt`: four cameras, recorded and rectified.

Source: Geiger et al., Vision meets Robotics: The KITTI Dataset, 2013, section IV-B.
"""

from __future__ import annotations

import re

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import check_baseline, make_camera, make_numbers
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize
from vo.recordings.formats.calibration.matrices import (
    make_projection,
    make_rotation,
    matrix_camera,
    rotation_and_translation,
)

_LINE = re.compile(r"^[ \t]*([A-Z](?:_rect)?_0[0-3])[ \t]*:(.*)$", re.MULTILINE)


def recognises(document: Document) -> bool:
    """Whether there is a line of one of its cameras, such as `P_rect_00: …`."""
    return _LINE.search(document.text) is not None


def read(
    document: Document, image_size: ImageSize | None, cameras: tuple[str, str] = ("00", "01")
) -> Calibration:
    """Read a pair, or the left camera if the right one is missing.

    Images of size S_00 are unrectified (K, D, R and T apply); all others are assumed to be
    rectified (S_rect_00, P_rect_00), which KITTI calls `sync`. The body is the unrectified
    reference camera 00.

    `cameras`: numbers of the pair, left first: 00 and 01 are grey, 02 and 03 in colour.
    """
    lines = _Lines(document)
    left, right = cameras
    if f"P_rect_{left}" not in lines.text and f"K_{left}" not in lines.text:
        raise CalibrationError(f"{document.path}: P_rect_{left} and K_{left} are missing")
    recorded = _is_recorded(lines, left, image_size)
    camera = _recorded if recorded else _rectified
    cam0, cam0_from_body = camera(lines, left)
    if (f"K_{right}" if recorded else f"P_rect_{right}") not in lines.text:
        return Calibration(Rig(cam0), inverse(cam0_from_body))
    cam1, cam1_from_body = camera(lines, right)
    cam1_from_cam0 = cam1_from_body @ inverse(cam0_from_body)
    check_baseline(f"{document.path}: camera {right}", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), inverse(cam0_from_body))


class _Lines:
    """The lines of the file by name."""

    def __init__(self, document: Document) -> None:
        self.path = document.path
        self.text = dict(_LINE.findall(document.text))

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


def _rectified(lines: _Lines, number: str) -> tuple[Camera, Floats]:
    """The rectified camera, and (4, 4) camera_from_body."""
    where = f"{lines.path}: P_rect_{number}"
    # All rectified cameras, also those in colour, have the axes of R_rect_00.
    rotation = make_rotation(f"{lines.path}: R_rect_00", lines.numbers("R_rect_00"))
    p, t = make_projection(where, lines.numbers(f"P_rect_{number}"))
    camera = make_camera(
        where,
        model="pinhole",
        resolution=lines.numbers(f"S_rect_{number}"),
        intrinsics=[p[0, 0], p[1, 1], p[0, 2], p[1, 2]],
        distortion_model="none",
        distortion=None,
    )
    return camera, make_transform(rotation, t)


def _recorded(lines: _Lines, number: str) -> tuple[Camera, Floats]:
    """The unrectified camera, and (4, 4) camera_from_body."""
    where = f"{lines.path}: camera {number}"
    camera = matrix_camera(
        where,
        resolution=lines.numbers(f"S_{number}"),
        matrix=lines.numbers(f"K_{number}"),
        distortion_model="radtan",
        distortion=lines.numbers(f"D_{number}"),
    )
    camera_from_body = rotation_and_translation(
        where, lines.numbers(f"R_{number}"), lines.numbers(f"T_{number}")
    )
    return camera, camera_from_body
