"""Registry of calibration formats, with detection by content."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from vo.base.errors import CalibrationError
from vo.recordings.formats.calibration.document import (
    Calibration,
    Document,
    ImageSize,
    load_document,
    shortened,
)


class CalibrationFormat(NamedTuple):
    """A file format: the module of its functions, loaded when it is asked, and their ending."""

    module: str
    ending: str = ""

    def recognises(self, document: Document) -> bool:
        """Whether a file is of this format."""
        return bool(self._function("recognises")(document))

    def read(self, document: Document, image_size: ImageSize | None) -> Calibration:
        """Read a file of this format."""
        calibration: Calibration = self._function("read")(document, image_size)
        return calibration

    def _function(self, name: str) -> Callable[..., Any]:
        function: Callable[..., Any] = getattr(self.loaded, name + self.ending)
        return function

    @property
    def loaded(self) -> Any:
        """The module."""
        return import_module(f"vo.recordings.formats.calibration.{self.module}")


# Checked in this order, the more specific formats first.
FORMATS: dict[str, CalibrationFormat] = {
    "KITTI raw": CalibrationFormat("kitti", "_raw"),
    "KITTI": CalibrationFormat("kitti"),
    "COLMAP": CalibrationFormat("colmap"),
    "ZED": CalibrationFormat("zed"),
    "Basalt": CalibrationFormat("rigs", "_basalt"),
    "DepthAI": CalibrationFormat("depthai"),
    "NeRF": CalibrationFormat("nerf"),
    "OpenSfM": CalibrationFormat("opensfm"),
    "SVO or maplab": CalibrationFormat("rigs", "_maplab"),
    "OKVIS": CalibrationFormat("rigs", "_okvis"),
    "camodocal": CalibrationFormat("camodocal"),
    "stella_vslam": CalibrationFormat("stella_vslam"),
    "ORB-SLAM3": CalibrationFormat("orb_slam"),
    "ROS camera_info": CalibrationFormat("ros"),
    "OpenCV": CalibrationFormat("opencv"),
    "Kalibr": CalibrationFormat("kalibr"),
    "EuRoC": CalibrationFormat("euroc"),
    "Camera matrix": CalibrationFormat("matrix"),
    "DSO": CalibrationFormat("dso"),
    "vo": CalibrationFormat("own"),
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
    chain = document.data.get(_OPENVINS_CHAIN) if _OPENVINS_CHAIN in document.text else None
    if chain is None:
        return document
    beside = path.parent / str(chain)
    if not isinstance(chain, str) or not beside.is_file():
        raise CalibrationError(f"{path}: {_OPENVINS_CHAIN} {shortened(chain)} does not exist")
    loaded = load_document(beside)
    imu = FORMATS["Kalibr"].loaded.OPENVINS_IMU
    settings = {key: document.data[key] for key in (imu,) if key in document.data}
    return replace(loaded, content=({**loaded.data, **settings}, ""))
