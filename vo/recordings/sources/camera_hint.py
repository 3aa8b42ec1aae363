"""What a camera says of its lens and shutter in photographs and videos: a first guess."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from vo.recordings.formats.exif import (
    FOCAL_35_MM,
    FOCAL_MM,
    PX_PER_UNIT,
    UNIT,
    WIDTH_PX,
    exif_numbers,
)
from vo.recordings.formats.mp4_boxes import read_mp4
from vo.recordings.sources.images import ImageFile, StoredImage
from vo.recordings.sources.orientation import HEADER_BYTES

_DIAGONAL_35_MM = math.hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0}  # of FocalPlaneResolutionUnit
_WIDTHS = (0.2, 5.0)  # focal lengths in image widths that cameras have
# Standard deviations: videos are cut from the sensor's images, and wide lenses are no pinholes.
_PHOTOGRAPH, _VIDEO, _WIDE = 0.05, 0.15, 0.4


class CameraHint(NamedTuple):
    """A focal length in pixels with its standard deviation, NaN without; 0 s: shutter unknown."""

    focal_px: float = math.nan
    sigma_px: float = math.nan
    readout_s: float = 0.0
    told_by: str = ""

    @property
    def is_known(self) -> bool:
        """Whether there is a focal length."""
        return math.isfinite(self.focal_px)


NO_HINT = CameraHint()


def camera_hint(path: Path, first: StoredImage, size: tuple[int, int]) -> CameraHint:
    """What a video, or the first image, says; `size`: (width, height) of the images."""
    diagonal = math.hypot(*size)
    if isinstance(first, ImageFile):
        focal_px, told_by = _of_photograph(first.path, size)
        return _checked(CameraHint(focal_px, _PHOTOGRAPH * focal_px, 0.0, told_by), size)
    if not path.is_file():
        return NO_HINT
    # Recordings that are not videos need neither.
    from vo.recordings.sources.gopro import open_gopro
    from vo.recordings.sources.motion_tracks import read_motion_track

    gopro = open_gopro(path)
    if gopro is not None:
        readout_s = 0.0 if gopro.is_stabilised else gopro.readout_s
        field = gopro.number("ZFOV")  # between corners; of a wide lens, in proportion to angles
        focal_px = diagonal / math.radians(field) if 20.0 < field < 180.0 else math.nan
        told_by = f"GoPro, {field:.0f}° between corners"
        return _checked(CameraHint(focal_px, _WIDE * focal_px, readout_s, told_by), size)
    track = read_motion_track(path)
    found = CameraHint() if track is None else CameraHint(readout_s=track.readout_s)
    text = read_mp4(path).texts.get("camera.focal_length.35mm_equivalent", "")
    if track is not None and track.focal_35_mm:
        text = f"{track.focal_35_mm:g}"
    try:
        focal_px = float(text) / _DIAGONAL_35_MM * diagonal
    except ValueError:
        return found
    told_by = f"{text} mm of 35 mm film"
    return _checked(
        found._replace(focal_px=focal_px, sigma_px=_VIDEO * focal_px, told_by=told_by), size
    )


def _checked(hint: CameraHint, size: tuple[int, int]) -> CameraHint:
    """Without a focal length that no camera has."""
    is_usual = _WIDTHS[0] < hint.focal_px / max(size) < _WIDTHS[1]
    return hint if is_usual else CameraHint(readout_s=hint.readout_s)


def _of_photograph(path: Path, size: tuple[int, int]) -> tuple[float, str]:
    try:
        with path.open("rb") as file:
            found = exif_numbers(file.read(HEADER_BYTES))
    except OSError:
        return math.nan, ""
    if found.get(FOCAL_35_MM):
        mm = found[FOCAL_35_MM]
        return mm / _DIAGONAL_35_MM * math.hypot(*size), f"EXIF: {mm:g} mm of 35 mm film"
    unit_mm = _MM_PER_UNIT.get(int(found.get(UNIT, 2)), 25.4)
    px_per_mm = found.get(PX_PER_UNIT, 0.0) / unit_mm * size[0] / found.get(WIDTH_PX, size[0])
    mm = found.get(FOCAL_MM, 0.0)
    return mm * px_per_mm or math.nan, f"EXIF: {mm:g} mm, {px_per_mm:.0f} px/mm"
