"""Readers of calibration files in several formats, with checks for plausibility."""

from vo.recordings.formats.calibration.document import Calibration, ImageSize, ImuCalibration
from vo.recordings.formats.calibration.own import write_calibration
from vo.recordings.formats.calibration.registry import FORMATS, calibration_format, read_calibration

__all__ = [
    "FORMATS",
    "Calibration",
    "ImageSize",
    "ImuCalibration",
    "calibration_format",
    "read_calibration",
    "write_calibration",
]
