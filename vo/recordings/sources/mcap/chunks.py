"""Chunks of an MCAP file: decompression, checksums and a cache."""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard

from vo.base.errors import SourceError
from vo.recordings.formats.decompression import decompress as formats_decompress
from vo.recordings.formats.decompression import size_limit
from vo.recordings.sources.mcap.records import ChunkHeader, Damaged

_MAX_CACHED_BYTES = 64 * 2**20
_STEP, _MAX_STEP = 4096, 2**20
_MIN_CACHED = 2  # left and right images may be in different chunks


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
    hardly decompressed. The checksum is not verified here but in `ChunkCache.get`.
    """

    def __init__(self, stream: BinaryIO, chunk: Chunk) -> None:
        stored = _FileRange(stream, chunk.header.start, chunk.stored)
        self._chunk = chunk
        self._source: _FileRange | BinaryIO = stored
        if chunk.header.compression == "zstd":
            self._source = zstandard.ZstdDecompressor().stream_reader(stored, read_size=_STEP)  # type: ignore[arg-type]
        elif chunk.header.compression == "lz4":
            self._source = lz4.frame.LZ4FrameFile(stored)
        elif chunk.is_compressed:
            raise _unknown_compression(chunk)
        self._decompressed = bytearray()
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
        try:
            while len(self._decompressed) < end:
                more = self._source.read(min(max(end - len(self._decompressed), _STEP), _MAX_STEP))
                if not more:
                    break
                self._decompressed += more
        except (RuntimeError, EOFError, zstandard.ZstdError, MemoryError, ValueError) as error:
            reason = f"a chunk cannot be decompressed: {error}"
            raise Damaged(self._chunk.header.start, reason) from error
        data = bytes(self._decompressed[self._position : end])
        self._position += len(data)
        return data


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


class ChunkCache:
    """Thread-safe cache of the most recently used chunks."""

    def __init__(self, path: Path, chunks: list[Chunk]) -> None:
        self._path = path
        self._chunks = chunks
        self._lock = threading.Lock()
        self._cached: OrderedDict[int, Future[bytes]] = OrderedDict()

    def get(self, number: int) -> bytes:
        """The records of a chunk; waits for one that another thread is decompressing.

        Raises:
            Damaged: as in `decompress`.
            OSError: the file cannot be read.
        """
        with self._lock:
            waiting = self._cached.get(number)
            future: Future[bytes] = waiting or Future()
            self._cached[number] = future
            self._cached.move_to_end(number)
            self._drop_oldest()
        if waiting is None:
            try:
                future.set_result(load_chunk(self._path, self._chunks[number]))
            except (Damaged, OSError) as error:
                future.set_exception(error)
        return future.result()

    def _drop_oldest(self) -> None:
        size = sum(self._chunks[number].header.decompressed_size for number in self._cached)
        while size > _MAX_CACHED_BYTES and len(self._cached) > _MIN_CACHED:
            number, _ = self._cached.popitem(last=False)
            size -= self._chunks[number].header.decompressed_size
