"""Decompression of data up to a stated size.

A kilobyte of compressed data can unpack to gigabytes, whatever the file says about it.
"""

from __future__ import annotations

import bz2
import io
from typing import BinaryIO

import lz4.frame
import zstandard

from vo.base.errors import SourceError

_USUAL_BYTES = 64 * 2**20
_MAX_RATIO = 1000  # of more than _USUAL_BYTES; recordings of raw images reach about 50
_MAX_BYTES = 2**30
_STEP = 2**20
_MIN_ZSTD_BYTES = 18  # a header is never longer


def size_limit(stored: int) -> int:
    """Most bytes that data of `stored` bytes may unpack to, if no smaller size is stated."""
    return min(max(_USUAL_BYTES, stored * _MAX_RATIO), _MAX_BYTES)


def decompress(data: bytes, compression: str, max_bytes: int) -> bytes:
    """Decompress data; of data that ends too early, as much as possible.

    `max_bytes`: size that the data states, or `size_limit`.
    """
    try:
        if compression == "bz2":
            unpacked = bz2.BZ2Decompressor().decompress(data, max_bytes + 1)
        elif compression == "lz4":
            unpacked = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_bytes + 1))
        elif compression == "zstd":
            unpacked = _zstd(data, max_bytes)
        else:
            raise SourceError(f"compression '{compression}' is unknown; bz2, lz4 and zstd are read")
    except (OSError, RuntimeError, ValueError, EOFError, MemoryError, zstandard.ZstdError) as error:
        raise SourceError(f"it cannot be decompressed: {error}") from error
    if len(unpacked) > max_bytes:
        raise SourceError(f"it unpacks to more than the stated {max_bytes} bytes")
    return unpacked


def _zstd(data: bytes, max_bytes: int) -> bytes:
    stated = zstandard.frame_content_size(data) if len(data) >= _MIN_ZSTD_BYTES else -1
    if 0 <= stated <= max_bytes:
        try:
            return zstandard.decompress(data)
        except zstandard.ZstdError:
            pass  # it may end too early
    reader = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data), read_size=_STEP)
    parts, size = [], 0
    while size <= max_bytes:
        part = reader.read(min(_STEP, max_bytes + 1 - size))
        if not part:
            break
        parts.append(part)
        size += len(part)
    return b"".join(parts)


def copy_decompressed(source: BinaryIO, target: BinaryIO, max_bytes: int) -> None:
    """Decompress a zstd file into another.

    Raises:
        SourceError: it is damaged, or unpacks to more.
        OSError: a file cannot be read or written.
    """
    size = 0
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(source)
        while part := reader.read(_STEP):
            size += len(part)
            if size > max_bytes:
                raise SourceError(f"it unpacks to more than {max_bytes} bytes")
            target.write(part)
    except zstandard.ZstdError as error:
        raise SourceError(f"it cannot be decompressed: {error}") from error
