"""Numbers in the EXIF data of JPEG files.

Source: Exif 2.32 (CIPA DC-008), 4.5.4, 4.6.3 and 4.6.5; TIFF 6.0, section 2.
"""

from __future__ import annotations

import struct

ORIENTATION, FOCAL_MM, FOCAL_35_MM = 0x0112, 0x920A, 0xA405
WIDTH_PX, PX_PER_UNIT, UNIT = 0xA002, 0xA20E, 0xA210
_FURTHER = 0x8769  # offset of the directory with the exposure and the lens
_APP1, _SCAN = 0xE1, 0xDA
_MAX_ENTRIES = 100
_SHORT, _LONG, _RATIONAL = 3, 4, 5


def exif_numbers(data: bytes) -> dict[int, float]:
    """First number of each tag, from the beginning of a file; empty for one without."""
    found: dict[int, float] = {}
    try:
        at = 2 if data.startswith(b"\xff\xd8") else len(data)
        while data[at] == 0xFF and data[at + 1] != _SCAN:
            (length,) = struct.unpack_from(">H", data, at + 2)
            if data[at + 1] == _APP1 and data[at + 4 : at + 10] == b"Exif\0\0":
                _read_tiff(data[at + 10 : at + 2 + length], found)
                break
            at += 2 + length
    except (struct.error, IndexError):
        pass  # what was read before the damage
    return found


def _read_tiff(data: bytes, found: dict[int, float]) -> None:
    order = {b"II": "<", b"MM": ">"}.get(data[:2])
    if order is None:
        return
    (first,) = struct.unpack_from(f"{order}I", data, 4)
    _read_directory(data, order, first, found)
    if _FURTHER in found:
        _read_directory(data, order, int(found[_FURTHER]), found)


def _read_directory(data: bytes, order: str, first: int, found: dict[int, float]) -> None:
    (count,) = struct.unpack_from(f"{order}H", data, first)
    for entry in range(min(count, _MAX_ENTRIES)):
        at = first + 2 + 12 * entry
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if kind == _SHORT:
            (found[tag],) = struct.unpack_from(f"{order}H", data, at + 8)
        elif kind == _LONG:
            (found[tag],) = struct.unpack_from(f"{order}I", data, at + 8)
        elif kind == _RATIONAL:
            (offset,) = struct.unpack_from(f"{order}I", data, at + 8)
            above, below = struct.unpack_from(f"{order}II", data, offset)
            if below:
                found[tag] = above / below
