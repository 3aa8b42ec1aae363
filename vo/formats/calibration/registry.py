"""The kinds of calibration file, told apart by what they contain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from vo.errors import CalibrationError
from vo.formats.calibration import (
    basalt,
    colmap,
    euroc,
    kalibr,
    kitti,
    kitti_raw,
    opencv,
    orb_slam,
    own,
    ros,
)
from vo.formats.calibration.document import Calibration, Document, ImageSize, load_document


class CalibrationFormat(NamedTuple):
    """A kind of file: how to know it, and how to read it given the size of the images."""

    recognises: Callable[[Document], bool]
    read: Callable[[Document, ImageSize | None], Calibration]


# Asked in this order: the more particular before the more general.
FORMATS: dict[str, CalibrationFormat] = {
    "KITTI raw": CalibrationFormat(kitti_raw.recognises, kitti_raw.read),
    "KITTI": CalibrationFormat(kitti.recognises, kitti.read),
    "COLMAP": CalibrationFormat(colmap.recognises, colmap.read),
    "Basalt": CalibrationFormat(basalt.recognises, basalt.read),
    "ORB-SLAM3": CalibrationFormat(orb_slam.recognises, orb_slam.read),
    "ROS camera_info": CalibrationFormat(ros.recognises, ros.read),
    "OpenCV": CalibrationFormat(opencv.recognises, opencv.read),
    "Kalibr": CalibrationFormat(kalibr.recognises, kalibr.read),
    "EuRoC": CalibrationFormat(euroc.recognises, euroc.read),
    "vo": CalibrationFormat(own.recognises, own.read),
}


def read_calibration(path: Path | str, image_size: ImageSize | None = None) -> Calibration:
    """Read a calibration file of any known kind.

    Args:
        path: the file.
        image_size: width and height of the images, for kinds that do not give them (KITTI, some of
            OpenCV's and ORB-SLAM's), or that tell two sorts of images apart by it (KITTI raw).

    Raises:
        CalibrationError: the file is missing, of no known kind, or what it says cannot be true.
    """
    document = load_document(Path(path))
    for name, kind in FORMATS.items():
        if kind.recognises(document):
            try:
                return replace(kind.read(document, image_size), kind=name, file=Path(path))
            except CalibrationError as error:
                raise CalibrationError(f"{error} (read as {name} calibration)") from error
    reason = document.problem or (
        f"is no calibration file of a known kind ({', '.join(FORMATS)}); docs/calibration.md "
        "shows what one looks like"
    )
    raise CalibrationError(f"{path} {reason}")
