"""Reader of KITTI's `calib.txt`: projection matrices P0 to P3 of rectified cameras."""

from __future__ import annotations

import re

import numpy as np

from vo.base.errors import CalibrationError
from vo.base.geometry.transforms import inverse, make_transform
from vo.base.types import Camera, Floats, Rig
from vo.recordings.formats.calibration.checks import check_baseline, make_camera, make_numbers
from vo.recordings.formats.calibration.document import Calibration, Document, ImageSize

_LINE = re.compile(r"^[ \t]*(P[0-3])[ \t]*:[ \t]*([-+\d.nNiI].*)$", re.MULTILINE)


def recognises(document: Document) -> bool:
    """Whether there is a line `P0: …`."""
    return _LINE.search(document.text) is not None


def read(
    document: Document, image_size: ImageSize | None, cameras: tuple[str, str] = ("P0", "P1")
) -> Calibration:
    """Read a pair of KITTI's four cameras, or the left one if the right one is missing.

    `cameras`: the pair, left first: P0 and P1 are the grey cameras, P2 and P3 the colour ones.
    """
    matrices = dict(_LINE.findall(document.text))
    left, right = cameras
    if left not in matrices:
        raise CalibrationError(f"{document.path}: {left} is missing; add '{left}:' and 12 numbers")
    cam0, cam0_from_body = _camera(document, left, matrices[left], image_size)
    body_from_cam0 = inverse(cam0_from_body)
    if right not in matrices:
        return Calibration(Rig(cam0), body_from_cam0)
    cam1, cam1_from_body = _camera(document, right, matrices[right], image_size)
    cam1_from_cam0 = cam1_from_body @ body_from_cam0
    check_baseline(f"{document.path}: {right}", cam1_from_cam0)
    return Calibration(Rig(cam0, cam1, cam1_from_cam0), body_from_cam0)


def _camera(
    document: Document, name: str, text: str, image_size: ImageSize | None
) -> tuple[Camera, Floats]:
    """The camera and (4, 4) camera_from_body; the body is KITTI's rectified grey left camera."""
    where = f"{document.path}: {name}"
    projection = np.array(make_numbers(where, text.split(), 12)).reshape(3, 4)
    camera = make_camera(
        where,
        model="pinhole",
        resolution=image_size,
        intrinsics=[projection[0, 0], projection[1, 1], projection[0, 2], projection[1, 2]],
        distortion_model="none",
        distortion=None,
    )
    shift = np.linalg.solve(camera.matrix, projection[:, 3])
    return camera, make_transform(np.eye(3), shift)
