"""Registry of calibration formats, with detection by content."""

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
    """A file format: its detection, and its reader, given the size of the images."""

    recognises: Callable[[Document], bool]
    read: Callable[[Document, ImageSize | None], Calibration]


# Checked in this order, the more specific formats first.
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
    """Read a calibration file of any supported format.

    Args:
        path: the file.
        image_size: width and height of the images, for files that do not contain them (KITTI, some
            of OpenCV and ORB-SLAM) or contain two sizes (KITTI raw).

    Raises:
        CalibrationError: the file is missing, of an unknown format, or a value is implausible.
    """
    document = load_document(Path(path))
    for name, kind in FORMATS.items():
        if kind.recognises(document):
            try:
                return replace(kind.read(document, image_size), kind=name, file=Path(path))
            except CalibrationError as error:
                raise CalibrationError(f"{error} (read as {name} calibration)") from error
    reason = document.problem or (
        f"is not a calibration file of a supported format ({', '.join(FORMATS)}); see "
        "docs/calibration.md"
    )
    raise CalibrationError(f"{path} {reason}")
