"""Registry of calibration formats, with detection by content."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import CalibrationError
from vo.recordings.formats.calibration import (
    camodocal,
    colmap,
    depthai,
    dso,
    euroc,
    kalibr,
    kitti,
    matrix,
    nerf,
    opencv,
    opensfm,
    orb_slam,
    own,
    rigs,
    ros,
    stella_vslam,
    zed,
)
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
    shortened,
)


class CalibrationFormat(NamedTuple):
    """A file format: its detection, and its reader, given the size of the images."""

    recognises: Callable[[Document], bool]
    read: Callable[[Document, ImageSize | None], Calibration]


# Checked in this order, the more specific formats first.
FORMATS: dict[str, CalibrationFormat] = {
    "KITTI raw": CalibrationFormat(kitti.recognises_raw, kitti.read_raw),
    "KITTI": CalibrationFormat(kitti.recognises, kitti.read),
    "COLMAP": CalibrationFormat(colmap.recognises, colmap.read),
    "ZED": CalibrationFormat(zed.recognises, zed.read),
    "Basalt": CalibrationFormat(rigs.recognises_basalt, rigs.read_basalt),
    "DepthAI": CalibrationFormat(depthai.recognises, depthai.read),
    "NeRF": CalibrationFormat(nerf.recognises, nerf.read),
    "OpenSfM": CalibrationFormat(opensfm.recognises, opensfm.read),
    "SVO or maplab": CalibrationFormat(rigs.recognises_maplab, rigs.read_maplab),
    "OKVIS": CalibrationFormat(rigs.recognises_okvis, rigs.read_okvis),
    "camodocal": CalibrationFormat(camodocal.recognises, camodocal.read),
    "stella_vslam": CalibrationFormat(stella_vslam.recognises, stella_vslam.read),
    "ORB-SLAM3": CalibrationFormat(orb_slam.recognises, orb_slam.read),
    "ROS camera_info": CalibrationFormat(ros.recognises, ros.read),
    "OpenCV": CalibrationFormat(opencv.recognises, opencv.read),
    "Kalibr": CalibrationFormat(kalibr.recognises, kalibr.read),
    "EuRoC": CalibrationFormat(euroc.recognises, euroc.read),
    "Camera matrix": CalibrationFormat(matrix.recognises, matrix.read),
    "DSO": CalibrationFormat(dso.recognises, dso.read),
    "vo": CalibrationFormat(own.recognises, own.read),
}


_log = logging.getLogger(__name__)
_OPENVINS_CHAIN = "relative_config_imucam"


def read_calibration(path: Path | str, image_size: ImageSize | None = None) -> Calibration:
    """Read a calibration file of any supported format.

    `image_size`: width and height of the images, for files that do not contain them (KITTI, some of
    OpenCV and ORB-SLAM) or contain several (KITTI raw, ZED).

    Raises:
        CalibrationError: the file is missing, of an unknown format, or a value is implausible.
    """
    document = _load(Path(path))
    for name, kind in FORMATS.items():
        if kind.recognises(document):
            _log.info("%s: calibration of format %s", path, name)
            try:
                return replace(kind.read(document, image_size), kind=name, file=Path(path))
            except CalibrationError as error:
                raise CalibrationError(f"{error} (read as {name} calibration)") from error
    reason = document.problem or (
        f"is not a calibration file of a supported format ({', '.join(FORMATS)}); see "
        "docs/calibration.md"
    )
    raise CalibrationError(f"{path} {reason}")


def calibration_format(path: Path | str) -> str | None:
    """Name of the format of a file, a key of `FORMATS`; None if it is no calibration."""
    try:
        document = load_document(Path(path))
        return next((name for name, kind in FORMATS.items() if kind.recognises(document)), None)
    except CalibrationError:
        return None


def _load(path: Path) -> Document:
    """The document, or the camera chain that settings of OpenVINS name."""
    document = load_document(path)
    chain = document.data.get(_OPENVINS_CHAIN)
    if chain is None:
        return document
    beside = path.parent / str(chain)
    if not isinstance(chain, str) or not beside.is_file():
        raise CalibrationError(f"{path}: {_OPENVINS_CHAIN} {shortened(chain)} does not exist")
    loaded = load_document(beside)
    settings = {key: document.data[key] for key in (kalibr.OPENVINS_IMU,) if key in document.data}
    return replace(loaded, data={**loaded.data, **settings})
