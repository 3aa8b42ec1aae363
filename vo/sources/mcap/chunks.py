"""Chunks of an MCAP file: where they are, and their data unpacked, checked and kept for a while."""

from __future__ import annotations

import threading
import zlib
from collections import OrderedDict
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

import lz4.frame
import zstandard

from vo.sources.mcap.records import ChunkHead, Damaged

_KEPT_BYTES = 64 * 2**20
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
        case other:
            raise Damaged(
                chunk.head.start, f"a chunk is compressed with '{other}'; lz4 and zstd are known"
            )


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
