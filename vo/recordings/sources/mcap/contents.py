"""Contents of an MCAP file: read from its summary, or else by a scan of all records."""

from __future__ import annotations

import logging
import zlib
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.records import ChunkIndex, Footer, Metadata, MetadataIndex, Statistics

from vo.base.errors import SourceError
from vo.recordings.sources.logs.log import MessageSpan
from vo.recordings.sources.mcap.chunks import Chunk, decompress
from vo.recordings.sources.mcap.records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    MAGIC,
    METADATA,
    METADATA_INDEX,
    NO_CHUNK,
    RECORD_HEADER,
    SCHEMA,
    STATISTICS,
    Damaged,
    MessageIndex,
    Record,
    parse,
    read_chunk_header,
    records_between,
)

_log = logging.getLogger(__name__)

_MAX_METADATA_BYTES = 2**20
_FOOTER_BYTES = RECORD_HEADER.size + 20


@dataclass
class FileContents:
    """Contents of a file.

    Attributes:
        is_listed: whether the index lists the messages too.
        end: number of valid bytes.
        damage: the reason why the scan ended there; None if the file was closed properly.
        metadata: facts by the name of their record.
    """

    index: MessageIndex
    chunks: list[Chunk]
    is_listed: bool
    end: int
    damage: Damaged | None = None
    damaged_chunks: int = 0
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)


def read_contents(path: Path) -> FileContents:
    """Read the contents of a file.

    Raises:
        SourceError: it is not an MCAP file.
        OSError: it cannot be read.
    """
    size = path.stat().st_size
    with path.open("rb") as stream:
        if stream.read(len(MAGIC)) != MAGIC:
            raise SourceError(f"{path} is not an MCAP file: its first bytes differ ({size} bytes)")
        try:
            contents = _from_summary(stream, size)
        except Damaged:
            contents = None
        return contents or scan_file(stream, size)


def _from_summary(stream: BinaryIO, size: int) -> FileContents | None:
    """Read the summary; None if there is none, or if it does not list all chunks."""
    if size < 2 * len(MAGIC) + _FOOTER_BYTES:
        return None
    stream.seek(size - len(MAGIC) - _FOOTER_BYTES)
    tail = stream.read(_FOOTER_BYTES + len(MAGIC))
    if tail[_FOOTER_BYTES:] != MAGIC or RECORD_HEADER.unpack_from(tail) != (FOOTER, 20):
        return None
    footer = parse(Footer, tail[RECORD_HEADER.size : _FOOTER_BYTES], size)
    end = size - len(MAGIC) - _FOOTER_BYTES
    if not 0 < footer.summary_start < end:
        return None
    stream.seek(footer.summary_start)
    summary = stream.read(end - footer.summary_start)
    covered = summary + tail[: _FOOTER_BYTES - 4]
    if footer.summary_crc and zlib.crc32(covered) != footer.summary_crc:
        raise Damaged(footer.summary_start, "the checksum of the summary is wrong")
    return _from_records(stream, summary, footer.summary_start)


def _from_records(stream: BinaryIO, summary: bytes, data_end: int) -> FileContents | None:
    index, chunk_indexes, statistics = MessageIndex(), [], None
    about: list[MetadataIndex] = []
    memory = BytesIO(summary)
    for record in records_between(memory, 0, len(summary)):
        if record.opcode in (SCHEMA, CHANNEL):
            index.add_record(memory, record, NO_CHUNK)
            continue
        content = summary[record.start : record.start + record.length]
        if record.opcode == CHUNK_INDEX:
            chunk_indexes.append(parse(ChunkIndex, content, record.start))
        elif record.opcode == STATISTICS:
            statistics = parse(Statistics, content, record.start)
        elif record.opcode == METADATA_INDEX:
            about.append(parse(MetadataIndex, content, record.start))
    if statistics is None or statistics.chunk_count != len(chunk_indexes) or not chunk_indexes:
        return None
    counts = statistics.channel_message_counts
    if set(counts) - set(index.channels):
        return None
    for number, count in counts.items():
        index.statistics[number] = MessageSpan(
            count, statistics.message_start_time, statistics.message_end_time
        )
    contents = FileContents(index, [], is_listed=False, end=data_end)
    for each in sorted(chunk_indexes, key=lambda each: each.chunk_start_offset):
        try:
            contents.chunks.append(_indexed_chunk(stream, each, data_end))
        except Damaged:
            contents.damaged_chunks += 1
    for found in about:
        start = found.offset + RECORD_HEADER.size
        _add_metadata(contents, stream, Record(METADATA, start, found.length - RECORD_HEADER.size))
    return contents


def _add_metadata(contents: FileContents, stream: BinaryIO, record: Record) -> None:
    """Keep the facts of a metadata record; a damaged or very long one is left out."""
    if not 0 < record.length <= _MAX_METADATA_BYTES:
        return
    stream.seek(record.start)
    try:
        found = parse(Metadata, stream.read(record.length), record.start)
    except Damaged:
        return
    contents.metadata[found.name] = found.metadata


def _indexed_chunk(stream: BinaryIO, index: ChunkIndex, data_end: int) -> Chunk:
    """Read the header of a chunk listed in the index."""
    if index.chunk_start_offset >= data_end:
        raise Damaged(data_end, "the index refers to a position beyond the data")
    stream.seek(index.chunk_start_offset)
    header = stream.read(RECORD_HEADER.size)
    expected = (CHUNK, index.chunk_length - RECORD_HEADER.size)
    if len(header) < RECORD_HEADER.size or RECORD_HEADER.unpack(header) != expected:
        raise Damaged(index.chunk_start_offset, "the index refers to a record that is not a chunk")
    start = index.chunk_start_offset + RECORD_HEADER.size
    chunk = read_chunk_header(stream, start, min(start + expected[1], data_end))
    return Chunk(chunk, chunk.size, frozenset(index.message_index_offsets) or None)


def scan_file(stream: BinaryIO, size: int) -> FileContents:
    """Index all messages of the file, up to its end or to the first damage."""
    contents = empty_contents()
    scan_new_records(contents, stream, size)
    index_truncated_chunk(contents, stream, size)
    return contents


def empty_contents() -> FileContents:
    """Contents of a file of which only the magic bytes have been read."""
    return FileContents(MessageIndex(), [], is_listed=True, end=len(MAGIC))


def scan_new_records(contents: FileContents, stream: BinaryIO, size: int) -> None:
    """Scan the records from `contents.end` on; set `damage` to the reason for stopping, or None."""
    try:
        for record in records_between(stream, contents.end, size):
            if record.opcode in (DATA_END, FOOTER):
                contents.damage = None
                return
            _index_record(contents, stream, record)
            contents.end = record.start + record.length
        contents.damage = Damaged(size, "it was never closed")
    except Damaged as damage:
        contents.damage = damage


def _index_record(contents: FileContents, stream: BinaryIO, record: Record) -> None:
    if record.opcode == METADATA:
        _add_metadata(contents, stream, record)
    if record.opcode != CHUNK:
        contents.index.add_record(stream, record, NO_CHUNK)
        return
    header = read_chunk_header(stream, record.start, record.start + record.length)
    _index_chunk(contents, stream, Chunk(header, header.size))


def _index_chunk(contents: FileContents, stream: BinaryIO, chunk: Chunk) -> None:
    """Index the messages of a chunk; of a damaged chunk, none or those before the damage."""
    number = len(contents.chunks)
    contents.chunks.append(chunk)
    stream.seek(chunk.header.start)
    try:
        decompressed = decompress(chunk, stream.read(chunk.stored))
    except Damaged as damage:
        contents.damaged_chunks += 1
        _log.debug("chunk at byte %d skipped: %s", chunk.header.start, damage)
        return
    try:
        contents.index.add_records(BytesIO(decompressed), 0, len(decompressed), number)
    except Damaged as damage:
        if not chunk.is_truncated:
            contents.damaged_chunks += 1
            _log.debug("chunk at byte %d is damaged: %s", chunk.header.start, damage)


def index_truncated_chunk(contents: FileContents, stream: BinaryIO, size: int) -> None:
    """Index the readable part of a chunk that is truncated by the end of the file."""
    if contents.damage is None:
        return
    stream.seek(contents.end)
    start = stream.read(RECORD_HEADER.size)
    if len(start) < RECORD_HEADER.size or RECORD_HEADER.unpack(start)[0] != CHUNK:
        return
    try:
        header = read_chunk_header(stream, contents.end + RECORD_HEADER.size, 0)
    except Damaged:
        return
    stored = min(header.size, size - header.start)
    if stored > 0:
        _index_chunk(contents, stream, Chunk(header, stored))
        contents.end = header.start + stored
