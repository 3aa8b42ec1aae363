"""Chunks of an MCAP file: where they are, and their data unpacked, checked and kept for a while."""

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

from vo.sources.mcap.records import ChunkHead, Damaged

_KEPT_BYTES = 64 * 2**20
_STEP, _LARGEST_STEP = 4096, 2**20
_FEWEST_KEPT = 2  # left and right may be in chunks of their own


@dataclass(frozen=True)
class Chunk:
    """A chunk of the file.

    Attributes:
        head: what it says of itself.
        stored: bytes of its data that the file still has.
        channels: numbers of those that have messages in it; None where nobody says.
    """

    head: ChunkHead
    stored: int
    channels: frozenset[int] | None = None

    @property
    def is_cut(self) -> bool:
        """Whether the file ends inside."""
        return self.stored < self.head.size

    @property
    def is_packed(self) -> bool:
        """Whether its data is compressed."""
        return self.head.compression != ""


def unpack(chunk: Chunk, data: bytes) -> bytes:
    """The records in a chunk; of one that is cut off, as far as they go.

    Raises:
        Damaged: the data does not unpack or its checksum is wrong.
    """
    try:
        unpacked = _unpack(chunk, data)
    except (RuntimeError, zstandard.ZstdError, MemoryError, ValueError) as error:
        raise Damaged(chunk.head.start, f"a chunk cannot be unpacked: {error}") from error
    if chunk.is_cut:
        return unpacked
    if len(unpacked) != chunk.head.unpacked_size:
        raise Damaged(
            chunk.head.start,
            f"a chunk unpacks to {len(unpacked)} bytes instead of {chunk.head.unpacked_size}",
        )
    if chunk.head.crc and zlib.crc32(unpacked) != chunk.head.crc:
        raise Damaged(chunk.head.start, "the checksum of a chunk is wrong")
    return unpacked


def _unpack(chunk: Chunk, data: bytes) -> bytes:
    match chunk.head.compression:
        case "":
            return data
        case "zstd":
            if chunk.is_cut:
                return zstandard.ZstdDecompressor().decompressobj().decompress(data)
            return zstandard.decompress(data, chunk.head.unpacked_size)
        case "lz4":
            unpacked = lz4.frame.LZ4FrameDecompressor().decompress(data)
            return bytes(unpacked)
        case _:
            raise _unknown(chunk)


class UnpackedStream:
    """The records in a sound chunk, unpacked as far as someone has read.

    A chunk is listed by the first bytes of its messages; of one that holds a single large image
    next to nothing is unpacked. Checksums are not looked at; `ChunkCache.get` does that.
    """

    def __init__(self, stream: BinaryIO, chunk: Chunk) -> None:
        stored = _Part(stream, chunk.head.start, chunk.stored)
        self._chunk = chunk
        self._source: _Part | BinaryIO = stored
        if chunk.head.compression == "zstd":
            self._source = zstandard.ZstdDecompressor().stream_reader(stored, read_size=_STEP)  # type: ignore[arg-type]
        elif chunk.head.compression == "lz4":
            self._source = lz4.frame.LZ4FrameFile(stored)
        elif chunk.is_packed:
            raise _unknown(chunk)
        self._unpacked = bytearray()
        self._position = 0

    def seek(self, offset: int) -> int:
        """Go somewhere; nothing is unpacked yet."""
        self._position = offset
        return offset

    def read(self, size: int) -> bytes:
        """Some bytes, fewer at the end.

        Raises:
            Damaged: they do not unpack.
        """
        end = self._position + size
        try:
            while len(self._unpacked) < end:
                more = self._source.read(min(max(end - len(self._unpacked), _STEP), _LARGEST_STEP))
                if not more:
                    break
                self._unpacked += more
        except (RuntimeError, EOFError, zstandard.ZstdError, MemoryError, ValueError) as error:
            reason = f"a chunk cannot be unpacked: {error}"
            raise Damaged(self._chunk.head.start, reason) from error
        data = bytes(self._unpacked[self._position : end])
        self._position += len(data)
        return data


class _Part:
    """A stretch of a file, as a file of its own."""

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


def _unknown(chunk: Chunk) -> Damaged:
    name = chunk.head.compression
    reason = f"a chunk is compressed with '{name}'; lz4 and zstd are known"
    return Damaged(chunk.head.start, reason)


def load_chunk(path: Path, chunk: Chunk) -> bytes:
    """The records in a chunk, from the file; else as `unpack`."""
    with path.open("rb") as stream:
        stream.seek(chunk.head.start)
        return unpack(chunk, stream.read(chunk.stored))


class ChunkCache:
    """The chunks that were used last, for several threads."""

    def __init__(self, path: Path, chunks: list[Chunk]) -> None:
        self._path = path
        self._chunks = chunks
        self._lock = threading.Lock()
        self._kept: OrderedDict[int, Future[bytes]] = OrderedDict()

    def get(self, number: int) -> bytes:
        """The records in a chunk; who asks for one that is being unpacked waits for it.

        Raises:
            Damaged: as `unpack` does.
            OSError: the file cannot be read.
        """
        with self._lock:
            waiting = self._kept.get(number)
            future: Future[bytes] = waiting or Future()
            self._kept[number] = future
            self._kept.move_to_end(number)
            self._drop_oldest()
        if waiting is None:
            try:
                future.set_result(load_chunk(self._path, self._chunks[number]))
            except (Damaged, OSError) as error:
                future.set_exception(error)
        return future.result()

    def _drop_oldest(self) -> None:
        size = sum(self._chunks[number].head.unpacked_size for number in self._kept)
        while size > _KEPT_BYTES and len(self._kept) > _FEWEST_KEPT:
            number, _ = self._kept.popitem(last=False)
            size -= self._chunks[number].head.unpacked_size
