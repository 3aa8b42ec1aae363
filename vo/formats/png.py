"""Grey PNG images, decoded in half the time that OpenCV takes; it decodes all others.

Half of reading a recording is unpacking PNG. OpenCV's library inflates row by row; here all rows
are inflated at once, by a faster library, and the filters undone in compiled code.

Source: Portable Network Graphics Specification (Third Edition), W3C 2025.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from isal import isal_zlib

from vo.compiling.function import compiled
from vo.types import Bytes

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_GREY_8_BITS = bytes((8, 0, 0, 0, 0))  # depth, colour, compression, filters, interlacing
# What says nothing about pixels, or nothing that OpenCV minds. Others (transparency, animation,
# rotation) are left to it.
_HARMLESS = {b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs", b"gAMA", b"cHRM", b"sRGB", b"sBIT"}
_SUB, _UP, _AVERAGE, _PAETH = 1, 2, 3, 4


def is_complete(data: bytes) -> bool:
    """Whether a PNG file reaches its last chunk, and all checksums are right."""
    return any(kind == b"IEND" for kind, _ in _chunks(data))


def decode_grey(data: bytes) -> Bytes | None:
    """Pixels of a grey image with 8 bits, (H, W).

    None for other images, and for those with something wrong or unusual in them: what they are
    is for another decoder to say.

    Args:
        data: a complete PNG file.
    """
    header, packed = b"", []
    for kind, content in _chunks(data):
        if kind == b"IHDR":
            header = bytes(content)
        elif kind == b"IDAT":
            packed.append(content)
        elif kind not in _HARMLESS and kind != b"IEND":
            return None
    if len(header) != 13 or header[8:] != _GREY_8_BITS:
        return None
    width, height = (int.from_bytes(header[k : k + 4], "big") for k in (0, 4))
    size = height * (1 + width)
    unpacked = _inflate(b"".join(packed), size)
    if 0 in (width, height) or len(unpacked) != size:
        return None
    rows = np.frombuffer(unpacked, dtype=np.uint8).reshape(height, 1 + width)
    if rows[:, 0].max() > _PAETH:
        return None
    return np.asarray(_without_filters(rows))


def _chunks(data: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Kinds and contents of chunks (length, kind, content, checksum), as far as all is right."""
    view, position = memoryview(data), len(SIGNATURE)
    while position + 12 <= len(data):
        end = position + 8 + int.from_bytes(view[position : position + 4], "big")
        kind = bytes(view[position + 4 : position + 8])
        checksum = int.from_bytes(view[end : end + 4], "big")
        if end + 4 > len(data) or isal_zlib.crc32(view[position + 4 : end]) != checksum:
            return
        yield kind, view[position + 8 : end]
        if kind == b"IEND":
            return
        position = end + 4


def _inflate(packed: bytes, size: int) -> bytes:
    """Unpacked data, of which no more than a byte over `size` is made; empty if damaged."""
    unpacker = isal_zlib.decompressobj()
    try:
        unpacked: bytes = unpacker.decompress(packed, size + 1)
    except isal_zlib.error:  # type: ignore[misc]  # its stubs have an object of this class
        return b""
    return unpacked if unpacker.eof else b""


@compiled
def _without_filters(rows):  # type: ignore[no-untyped-def]
    """Rows (H, 1 + W) begin with the number of their filter; each hangs on the one above."""
    height, width = rows.shape[0], rows.shape[1] - 1
    image = np.empty((height, width), np.uint8)
    above = np.zeros(width, np.uint8)
    for y in range(height):
        filtered, row = rows[y], image[y]
        if filtered[0] == _SUB:
            left = np.uint8(0)
            for x in range(width):
                left = np.uint8(left + filtered[x + 1])
                row[x] = left
        elif filtered[0] == _UP:
            for x in range(width):
                row[x] = filtered[x + 1] + above[x]
        elif filtered[0] == _AVERAGE:
            last = 0
            for x in range(width):
                last = (filtered[x + 1] + ((last + above[x]) >> 1)) & 255
                row[x] = last
        elif filtered[0] == _PAETH:
            a, c = np.int32(0), np.int32(0)
            for x in range(width):
                b = np.int32(above[x])
                a = (np.int32(filtered[x + 1]) + _paeth(a, b, c)) & np.int32(255)
                row[x] = a
                c = b
        else:
            for x in range(width):
                row[x] = filtered[x + 1]
        above = row
    return image


@compiled
def _paeth(left, above, corner):  # type: ignore[no-untyped-def]
    """Whichever of the three neighbours is nearest to left + above - corner, in that order."""
    to_left, to_above = abs(above - corner), abs(left - corner)
    to_corner = abs(left + above - 2 * corner)
    best = above if to_above <= to_corner else corner
    return left if to_left <= min(to_above, to_corner) else best
