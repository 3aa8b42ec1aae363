"""What is where in an MCAP file: from its summary, or else by going through it once."""

from __future__ import annotations

import logging
import zlib
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.records import ChunkIndex, Footer, Statistics

from vo.errors import SourceError
from vo.sources.mcap.book import IN_FILE, Book, Tally
from vo.sources.mcap.chunks import Chunk, unpack
from vo.sources.mcap.records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    HEAD,
    MAGIC,
    SCHEMA,
    STATISTICS,
    Damaged,
    Record,
    parse,
    read_chunk_head,
    records_between,
)

_log = logging.getLogger(__name__)

_FOOTER_BYTES = HEAD.size + 20


@dataclass
class Survey:
    """What is where.

    Attributes:
        book: channels, schemas and counts.
        chunks: those with messages, in the order of the file.
        is_listed: whether the book lists the messages too.
        end: bytes that made sense.
        damage: what came then, or None if the file was closed properly.
        lost: chunks that were left out.
    """

    book: Book
    chunks: list[Chunk]
    is_listed: bool
    end: int
    damage: Damaged | None = None
    lost: int = 0


def survey(path: Path) -> Survey:
    """Look at a file.

    Raises:
        SourceError: it is no MCAP file.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise SourceError(f"{path} does not begin like an MCAP file ({size} bytes)")
        try:
            found = _from_summary(stream, size)
        except Damaged:
            found = None
        return found or go_through_file(stream, size)


def _from_summary(stream: BinaryIO, size: int) -> Survey | None:
    """None where there is no summary, or one that does not list all chunks."""
    if size < 2 * len(MAGIC) + _FOOTER_BYTES:
        return None
    stream.seek(size - len(MAGIC) - _FOOTER_BYTES)
    tail = stream.read(_FOOTER_BYTES + len(MAGIC))
    if tail[_FOOTER_BYTES:] != MAGIC or HEAD.unpack_from(tail) != (FOOTER, 20):
        return None
    footer = parse(Footer, tail[HEAD.size : _FOOTER_BYTES], size)
    end = size - len(MAGIC) - _FOOTER_BYTES
    if not 0 < footer.summary_start < end:
        return None
    stream.seek(footer.summary_start)
    summary = stream.read(end - footer.summary_start)
    covered = summary + tail[: _FOOTER_BYTES - 4]
    if footer.summary_crc and zlib.crc32(covered) != footer.summary_crc:
        raise Damaged(footer.summary_start, "the checksum of the summary is wrong")
    return _from_records(stream, summary, footer.summary_start)


def _from_records(stream: BinaryIO, summary: bytes, data_end: int) -> Survey | None:
    book, indexes, statistics = Book(), [], None
    memory = BytesIO(summary)
    for record in records_between(memory, 0, len(summary)):
        if record.opcode in (SCHEMA, CHANNEL):
            book.note(memory, record, IN_FILE)
            continue
        content = summary[record.start : record.start + record.length]
        if record.opcode == CHUNK_INDEX:
            indexes.append(parse(ChunkIndex, content, record.start))
        elif record.opcode == STATISTICS:
            statistics = parse(Statistics, content, record.start)
    if statistics is None or statistics.chunk_count != len(indexes) or not indexes:
        return None
    counts = statistics.channel_message_counts
    if set(counts) - set(book.channels):
        return None
    for number, count in counts.items():
        book.tallies[number] = Tally(
            count, statistics.message_start_time, statistics.message_end_time
        )
    found = Survey(book, [], is_listed=False, end=data_end)
    for index in sorted(indexes, key=lambda index: index.chunk_start_offset):
        try:
            found.chunks.append(_indexed_chunk(stream, index, data_end))
        except Damaged:
            found.lost += 1
    return found


def _indexed_chunk(stream: BinaryIO, index: ChunkIndex, data_end: int) -> Chunk:
    """Where the data of a chunk is; only its first bytes are read."""
    if index.chunk_start_offset >= data_end:
        raise Damaged(data_end, "the index points beyond the data")
    stream.seek(index.chunk_start_offset)
    head = stream.read(HEAD.size)
    expected = (CHUNK, index.chunk_length - HEAD.size)
    if len(head) < HEAD.size or HEAD.unpack(head) != expected:
        raise Damaged(index.chunk_start_offset, "the index points to something else than a chunk")
    start = index.chunk_start_offset + HEAD.size
    chunk = read_chunk_head(stream, start, min(start + expected[1], data_end))
    return Chunk(chunk, chunk.size, frozenset(index.message_index_offsets) or None)


def go_through_file(stream: BinaryIO, size: int) -> Survey:
    """Note every message of the file up to its end or to where it is damaged."""
    found = begin()
    go_on(found, stream, size)
    salvage(found, stream, size)
    return found


def begin() -> Survey:
    """A survey that has seen no more than the file's first bytes."""
    return Survey(Book(), [], is_listed=True, end=len(MAGIC))


def go_on(found: Survey, stream: BinaryIO, size: int) -> None:
    """Note what has come since; `damage` then says why it goes no further, None at the end."""
    try:
        for record in records_between(stream, found.end, size):
            if record.opcode in (DATA_END, FOOTER):
                found.damage = None
                return
            _take_in(found, stream, record)
            found.end = record.start + record.length
        found.damage = Damaged(size, "it was never closed")
    except Damaged as damage:
        found.damage = damage


def _take_in(found: Survey, stream: BinaryIO, record: Record) -> None:
    if record.opcode != CHUNK:
        found.book.note(stream, record, IN_FILE)
        return
    head = read_chunk_head(stream, record.start, record.start + record.length)
    _note_chunk(found, stream, Chunk(head, head.size))


def _note_chunk(found: Survey, stream: BinaryIO, chunk: Chunk) -> None:
    """Note what is in a chunk; a damaged one is left out, or read as far as it makes sense."""
    number = len(found.chunks)
    found.chunks.append(chunk)
    stream.seek(chunk.head.start)
    try:
        unpacked = unpack(chunk, stream.read(chunk.stored))
    except Damaged as damage:
        found.lost += 1
        _log.debug("chunk at byte %d left out: %s", chunk.head.start, damage)
        return
    try:
        found.book.go_through(BytesIO(unpacked), 0, len(unpacked), number)
    except Damaged as damage:
        if not chunk.is_cut:
            found.lost += 1
            _log.debug("chunk at byte %d is damaged: %s", chunk.head.start, damage)


def salvage(found: Survey, stream: BinaryIO, size: int) -> None:
    """Take what there is of a chunk in which the file ends, if it does."""
    if found.damage is None:
        return
    stream.seek(found.end)
    start = stream.read(HEAD.size)
    if len(start) < HEAD.size or HEAD.unpack(start)[0] != CHUNK:
        return
    try:
        head = read_chunk_head(stream, found.end + HEAD.size, 0)
    except Damaged:
        return
    stored = min(head.size, size - head.start)
    if stored > 0:
        _note_chunk(found, stream, Chunk(head, stored))
        found.end = head.start + stored
