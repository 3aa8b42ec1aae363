"""Photographs whose EXIF data ask for a turn; all images are used as stored."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from vo.recordings.formats.exif import ORIENTATION, exif_numbers
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot

_log = logging.getLogger(__name__)

_SAMPLES = 32
HEADER_BYTES = 65_536
_SUFFIXES = (".jpg", ".jpeg")
UPRIGHT = 1


def warn_of_turned(name: str, shots: Sequence[Shot]) -> None:
    """Warn if some images ask to be shown turned; up to 32 of them, evenly spread, are checked."""
    step = max(1, len(shots) // _SAMPLES)
    files = [shot.image.path for shot in shots[::step] if isinstance(shot.image, ImageFile)]
    files = [path for path in files if path.suffix.lower() in _SUFFIXES and path.is_file()]
    turned = []
    for path in files:
        try:
            with path.open("rb") as file:
                orientation = exif_orientation(file.read(HEADER_BYTES))
        except OSError:
            continue
        if orientation != UPRIGHT:
            turned.append(path)
    if turned:
        _log.warning(
            "%s: EXIF asks to turn %d of %d checked images, such as %s; all are used as stored, as "
            "in COLMAP, and the calibration must be that of the images as stored",
            name,
            len(turned),
            len(files),
            turned[0].name,
        )


def exif_orientation(data: bytes) -> int:
    """How a JPEG file asks to be turned, 1 to 8; 1 is as stored, also if nothing is stated."""
    asked = int(exif_numbers(data).get(ORIENTATION, UPRIGHT))
    return asked if 1 <= asked <= 8 else UPRIGHT
