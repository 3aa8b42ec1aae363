"""A single image, from an image file or from a recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import CalibrationError, SourceError
from vo.base.types import Bytes, Camera, Rig
from vo.recordings.sources.grey_levels import find_grey_levels
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.registry import FORMATS, open_source
from vo.recordings.sources.source import Recording
from vo.recordings.sources.uncalibrated import open_uncalibrated

_FRAME = re.compile(r"(.+):(\d{1,9})")


class SingleImage(NamedTuple):
    """An image and, if it is known, its camera.

    Attributes:
        camera: calibration of the recording that it comes from, None without one.
        rig: all cameras of that recording.
        frame: its number in that recording.
    """

    name: str
    image: Bytes
    camera: Camera | None = None
    rig: Rig | None = None
    frame: int | None = None


def read_single_image(given: str | Path, *, right: bool = False) -> SingleImage:
    """Read an image in grey.

    `given`: an image file, or `RECORDING:NUMBER` for a frame of a recording, counted from 0.
    """
    frame = None if Path(given).exists() else _FRAME.fullmatch(str(given))
    if frame is not None:
        return _frame_of(Path(frame[1]), int(frame[2]), right=right)
    path = Path(given)
    if path.is_dir() or path.suffix.lower() in _recording_suffixes():
        raise SourceError(f"{path} is no image; for a frame of a recording give {path}:NUMBER")
    if path.exists() and not path.is_file():
        raise SourceError(f"{path} is not a file; give an image")
    stored = ImageFile(path)
    image = stored.read()
    levels = find_grey_levels([stored])
    return SingleImage(str(path), levels.to_8_bits(image, 0))


def _recording_suffixes() -> set[str]:
    return {suffix for entry in FORMATS.values() for suffix in entry.suffixes}


def _frame_of(path: Path, number: int, *, right: bool) -> SingleImage:
    recording: Recording
    is_calibrated = True
    try:
        recording = open_source(path)
    except CalibrationError:
        recording, is_calibrated = open_uncalibrated(path), False
    if number >= len(recording):
        raise SourceError(f"{path} has frames 0 to {len(recording) - 1}, no frame {number}")
    index = 1 if right else 0
    if right and not recording.rig.is_stereo:
        raise SourceError(f"{path} has no right images with a calibration")
    name = f"{path}:{number}"
    for frame in recording.frames(number, number + 1):
        image = frame.images[index]
        if image is not None:
            if not is_calibrated:
                return SingleImage(name, image, frame=number)
            return SingleImage(name, image, recording.rig.cameras[index], recording.rig, number)
    side = "right image of " if right else ""
    raise SourceError(f"the {side}frame {number} of {path} cannot be read")
