"""Chunks of an MCAP file: decompression, checksums and a cache."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard

from vo.base.errors import SourceError
from vo.recordings.formats.decompression import decompress as formats_decompress
from vo.recordings.formats.decompression import size_limit
from vo.recordings.sources.mcap.records import ChunkHeader, Damaged

_STEP, _MAX_STEPPED = 4096, 2**16


@dataclass(frozen=True)
class Chunk:
    """A chunk of the file.

    Attributes:
        stored: number of bytes of its data in the file; fewer than `header.size` if truncated.
        channels: numbers of the channels with messages in it; None if unknown.
    """

    header: ChunkHeader
    stored: int
    channels: frozenset[int] | None = None

    @property
    def is_truncated(self) -> bool:
        """Whether the file ends inside the chunk."""
        return self.stored < self.header.size

    @property
    def is_compressed(self) -> bool:
        """Whether its data is compressed."""
        return self.header.compression != ""


def decompress(chunk: Chunk, data: bytes) -> bytes:
    """Decompress the records of a chunk; of a truncated chunk, as many as possible.

    Raises:
        Damaged: the data cannot be decompressed, or its checksum is wrong.
    """
    try:
        decompressed = _decompress(chunk, data)
    except SourceError as error:
        raise Damaged(chunk.header.start, f"a chunk: {error}") from error
    if chunk.is_truncated:
        return decompressed
    if len(decompressed) != chunk.header.decompressed_size:
        raise Damaged(
            chunk.header.start,
            f"a chunk decompresses to {len(decompressed)} bytes instead of "
            f"{chunk.header.decompressed_size}",
        )
    if chunk.header.crc and zlib.crc32(decompressed) != chunk.header.crc:
        raise Damaged(chunk.header.start, "the checksum of a chunk is wrong")
    return decompressed


def _decompress(chunk: Chunk, data: bytes) -> bytes:
    if not chunk.is_compressed:
        return data
    if chunk.header.compression not in ("zstd", "lz4"):
        raise _unknown_compression(chunk)
    max_bytes = min(chunk.header.decompressed_size, size_limit(len(data)))
    return formats_decompress(data, chunk.header.compression, max_bytes)


class DecompressedStream:
    """The records of an intact chunk, decompressed on demand.

    Indexing needs only the first bytes of each message, so that a chunk with one large image is
    hardly decompressed. One with several is decompressed at once, which is faster than in steps.
    The checksum is not verified here but in `load_chunk`.
    """

    def __init__(self, stream: BinaryIO, chunk: Chunk) -> None:
        self._stream, self._chunk = stream, chunk
        stored = _FileRange(stream, chunk.header.start, chunk.stored)
        self._source: _FileRange | BinaryIO = stored
        if chunk.header.compression == "zstd":
            self._source = zstandard.ZstdDecompressor().stream_reader(stored, read_size=_STEP)  # type: ignore[arg-type]
        elif chunk.header.compression == "lz4":
            self._source = lz4.frame.LZ4FrameFile(stored)
        elif chunk.is_compressed:
            raise _unknown_compression(chunk)
        self._decompressed = b""
        self._position = 0

    def seek(self, offset: int) -> int:
        """Set the position; nothing is decompressed yet."""
        self._position = offset
        return offset

    def read(self, size: int) -> bytes:
        """Read bytes; fewer at the end.

        Raises:
            Damaged: the data cannot be decompressed.
        """
        end = self._position + size
        if len(self._decompressed) < end:
            try:
                self._decompress_to(end)
            except (RuntimeError, EOFError, zstandard.ZstdError, MemoryError, ValueError) as error:
                reason = f"a chunk cannot be decompressed: {error}"
                raise Damaged(self._chunk.header.start, reason) from error
        data = self._decompressed[self._position : end]
        self._position += len(data)
        return data

    def _decompress_to(self, end: int) -> None:
        if end <= _MAX_STEPPED:
            while len(self._decompressed) < end and (more := self._source.read(_STEP)):
                self._decompressed += more
            return
        self._stream.seek(self._chunk.header.start)
        try:
            whole = _decompress(self._chunk, self._stream.read(self._chunk.stored))
        except SourceError as error:
            raise ValueError(str(error)) from error
        self._decompressed = max(whole, self._decompressed, key=len)


class _FileRange:
    """A byte range of a file as a readable stream."""

    def __init__(self, stream: BinaryIO, start: int, size: int) -> None:
        self._stream = stream
        self._next = start
        self._end = start + size

    def read(self, size: int = -1) -> bytes:
        self._stream.seek(self._next)
        left = self._end - self._next
        data = self._stream.read(left if size < 0 else min(size, left))
        self._next += len(data)
        return data

    def readable(self) -> bool:
        return True


def _unknown_compression(chunk: Chunk) -> Damaged:
    name = chunk.header.compression
    reason = f"a chunk is compressed with '{name}'; lz4 and zstd are supported"
    return Damaged(chunk.header.start, reason)


def load_chunk(path: Path, chunk: Chunk) -> bytes:
    """Read and decompress the records of a chunk; raises as `decompress`."""
    with path.open("rb") as stream:
        stream.seek(chunk.header.start)
        return decompress(chunk, stream.read(chunk.stored))
