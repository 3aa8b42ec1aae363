"""Photographs whose EXIF data ask for a turn; all images are used as stored."""

from __future__ import annotations

import logging
import struct
from collections.abc import Sequence

from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot

_log = logging.getLogger(__name__)

_SAMPLES = 32
_HEADER_BYTES = 65_536
_SUFFIXES = (".jpg", ".jpeg")
_TAG_ORIENTATION = 0x0112
_APP1 = 0xE1
_SCAN = 0xDA
_MAX_ENTRIES = 100

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
                orientation = exif_orientation(file.read(_HEADER_BYTES))
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
    """How a JPEG file asks to be turned, 1 to 8; 1 is as stored, also if nothing is stated.

    Source: Exif 2.32 (CIPA DC-008), 4.5.4 and 4.6.4; TIFF 6.0, section 2.
    """
    try:
        return _of_jpeg(data) if data.startswith(b"\xff\xd8") else UPRIGHT
    except (struct.error, IndexError):
        return UPRIGHT


def _of_jpeg(data: bytes) -> int:
    at = 2
    while data[at] == 0xFF and data[at + 1] != _SCAN:
        (length,) = struct.unpack_from(">H", data, at + 2)
        if data[at + 1] == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return _of_tiff(data[at + 10 : at + 2 + length])
        at += 2 + length
    return UPRIGHT


def _of_tiff(data: bytes) -> int:
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return UPRIGHT
    (first,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, first)
    for entry in range(min(count, _MAX_ENTRIES)):
        tag, _, _, value = struct.unpack_from(f"{order}HHIH", data, first + 2 + 12 * entry)
        if tag == _TAG_ORIENTATION:
            return int(value) if 1 <= value <= 8 else UPRIGHT
    return UPRIGHT
