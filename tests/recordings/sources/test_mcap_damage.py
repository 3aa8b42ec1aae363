"""Truncated and damaged MCAP files: the intact part is read."""

from __future__ import annotations

import logging
import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import layouts
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap_logs import DIALECTS, write_log

from vo.base.errors import SourceError, VoError
from vo.recordings.formats.messages import ImageMessage
from vo.recordings.sources.logs.log import Entry
from vo.recordings.sources.mcap.file import McapFile
from vo.recordings.sources.mcap.records import NO_CHUNK
from vo.recordings.sources.registry import open_source

KINDS = {
    "zstd": (CompressionType.ZSTD, True),
    "lz4": (CompressionType.LZ4, True),
    "plain": (CompressionType.NONE, True),
    "unchunked": (CompressionType.NONE, False),
}
TRIES = 50
"""Writer options by kind of file."""

LONGEST_S = 5.0


@pytest.fixture(params=KINDS)
def whole(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    compression, chunked = KINDS[request.param]
    return write_log(
        tmp_path / f"{request.param}.mcap",
        layouts.log_messages(),
        compression=compression,
        use_chunking=chunked,
        chunk_size=8_000,
    )


def contents(file: McapFile) -> dict[tuple[str, int], bytes]:
    """The readable messages by topic and log time."""
    found = {}
    for topic, entries in file.entries([topic.name for topic in file.topics]).items():
        for entry in entries:
            try:
                found[topic, entry.log_ns] = file.read(entry)
            except SourceError:
                continue
    return found


def ends(file: McapFile, by_message: bool) -> dict[tuple[str, int], int]:
    """Last byte of the file that each message needs."""

    def end(entry: Entry) -> int:
        chunk, start, length = entry.address
        if chunk == NO_CHUNK:
            return int(start + length)
        holder = file._contents.chunks[chunk]
        if by_message and not holder.is_compressed:
            return int(holder.header.start + start + length)
        return int(holder.header.start + holder.header.size)

    return {
        (topic, entry.log_ns): end(entry)
        for topic, entries in file.entries([topic.name for topic in file.topics]).items()
        for entry in entries
    }


def check(damaged: Path, expected: dict[tuple[str, int], bytes]) -> None:
    """All expected messages are readable, and opening gives frames or an error of one line."""
    begun = time.monotonic()
    try:
        found = contents(McapFile(damaged))
    except SourceError:
        found = {}
    for key, data in expected.items():
        assert found.get(key) == data, key
    try:
        for frame in open_source(damaged).frames():
            assert frame.image0.shape == (layouts.HEIGHT, layouts.WIDTH)
    except VoError as error:
        assert str(error)
    assert time.monotonic() - begun < LONGEST_S


def test_all_messages_before_a_cut_are_read(whole: Path, tmp_path: Path) -> None:
    file = McapFile(whole)
    messages, sound = contents(file), ends(file, by_message=True)
    data = whole.read_bytes()
    damaged = tmp_path / "cut.mcap"
    for at in np.random.default_rng(1).integers(0, len(data), TRIES):
        damaged.write_bytes(data[:at])
        check(damaged, {key: messages[key] for key in messages if sound[key] <= at})


def test_all_messages_before_a_wrong_byte_are_read(whole: Path, tmp_path: Path) -> None:
    file = McapFile(whole)
    messages, sound = contents(file), ends(file, by_message=False)
    data = whole.read_bytes()
    damaged = tmp_path / "flipped.mcap"
    rng = np.random.default_rng(2)
    for at in rng.integers(8, len(data), TRIES):
        wrong = bytearray(data)
        wrong[at] ^= 1 << int(rng.integers(8))
        damaged.write_bytes(wrong)
        check(damaged, {key: messages[key] for key in messages if sound[key] <= at})


@pytest.mark.parametrize("kind", ["zstd", "lz4", "plain"])
def test_wrong_byte_loses_at_most_its_chunk(kind: str, tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "log.mcap", layouts.log_messages(), compression=KINDS[kind][0], chunk_size=8_000
    )
    file = McapFile(path)
    before, chunks = contents(file), file._contents.chunks
    victim = chunks[len(chunks) // 2].header
    data = bytearray(path.read_bytes())
    data[victim.start + victim.size // 2] ^= 4
    path.write_bytes(data)
    after = contents(McapFile(path))
    lost = {key for key in before if after.get(key) != before[key]}
    assert len(lost) > 0
    assert all(victim.first_ns <= log_ns <= victim.last_ns for _, log_ns in lost)
    assert all(after[key] == before[key] for key in after)


def test_warning_names_the_used_part_of_a_truncated_file(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_log(tmp_path / "log.mcap", layouts.log_messages(), chunk_size=8_000)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.6 * len(data))])
    source = open_source(path)
    assert 1 < len(source) < layouts.COUNT
    assert len(caplog.records) == 1
    message = caplog.records[0].getMessage()
    assert "is cut off or damaged" in message
    assert f"of {int(0.6 * len(data))}" in message
    span_s = (len(source) - 1) * 0.1
    assert f"in {span_s:.1f} s" in message


@pytest.mark.parametrize("kind", ["zstd", "lz4", "plain"])
def test_most_of_a_truncated_chunk_is_used(kind: str, tmp_path: Path) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (200, 48, 64), dtype=np.uint8)
    path = write_log(
        tmp_path / "log.mcap",
        (
            ("/image", ImageMessage(i + 1, "cam0", 64, 48, "mono8", pixels.tobytes()))
            for i, pixels in enumerate(noise)
        ),
        compression=KINDS[kind][0],
        chunk_size=10**7,
    )
    whole = contents(McapFile(path))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    found = contents(McapFile(path))
    # A compressor packs up to 128 KiB at a time; what is left of a pack is lost.
    assert 100 - 45 <= len(found) <= 100
    assert all(whole[key] == found[key] for key in found)


def test_no_warning_for_intact_files(whole: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        assert len(list(open_source(whole).frames())) == layouts.COUNT
    assert caplog.records == []


def test_messages_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    messages = list(layouts.log_messages())
    path = write_log(tmp_path / "log.mcap", messages[:1] + messages[:0:-1])
    source = open_source(path)
    stamps = [frame.stamp_ns for frame in source.frames()]
    assert stamps == layouts.STAMPS_NS
    assert all(b > a for a, b in pairwise(stamps))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" * 2, b"#!/bin/sh\n"])
def test_error_for_files_that_are_not_mcap(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(SourceError, match="is not an MCAP file|no topic has readable messages"):
        open_source(path)


OPTIONS: list[dict[str, Any]] = [
    {"enable_crcs": False},
    {"enable_crcs": False, "compression": CompressionType.NONE},
    {"index_types": IndexType.NONE},
    {"use_statistics": False},
    {"repeat_channels": False, "repeat_schemas": False},
    {"use_summary_offsets": False},
]


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("options", OPTIONS, ids=lambda options: ",".join(options))
def test_files_of_other_writers(
    tmp_path: Path, dialect: str, options: dict[str, Any], caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "log.mcap"
    write_log(path, layouts.log_messages("png"), DIALECTS[dialect], chunk_size=8_000, **options)
    frames = list(open_source(path).frames())
    assert [frame.stamp_ns for frame in frames] == layouts.STAMPS_NS
    assert all(np.array_equal(f.image0, layouts.image(f.index)) for f in frames)
    assert caplog.records == []


@pytest.mark.parametrize("dialect", DIALECTS)
def test_damaged_files_without_checksums(tmp_path: Path, dialect: str) -> None:
    rng = np.random.default_rng(4)
    path = tmp_path / "log.mcap"
    for options in OPTIONS[:3]:
        write_log(path, layouts.log_messages(), DIALECTS[dialect], chunk_size=8_000, **options)
        data = path.read_bytes()
        for _ in range(12):
            wrong = bytearray(data)
            for at in rng.integers(8, len(data), 3):
                wrong[at : at + int(rng.integers(1, 20))] = rng.bytes(int(rng.integers(0, 20)))
            path.write_bytes(wrong)
            check(path, {})


def test_implausible_stamp_is_left_out(tmp_path: Path) -> None:
    messages = [(t, replace(m, stamp_ns=0)) for t, m in layouts.log_messages()]
    times = iter(range(len(messages)))
    path = write_log(
        tmp_path / "log.mcap",
        messages,
        log_ns=lambda _: 2**64 - 1 if (n := next(times)) % 10 == 3 else n + 1,
    )
    source = open_source(path, mode="mono")
    assert 0 < len(source) < layouts.COUNT


def test_an_index_that_points_beyond_the_file(tmp_path: Path) -> None:
    path = write_log(
        tmp_path / "log.mcap", layouts.log_messages(), chunk_size=8_000, enable_crcs=False
    )
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    victim = summary.chunk_indexes[1].chunk_start_offset
    data = bytearray(path.read_bytes())
    at = data.rindex(victim.to_bytes(8, "little"))
    data[at : at + 8] = (2**64 - 1).to_bytes(8, "little")
    path.write_bytes(data)
    assert 0 < len(list(open_source(path).frames())) < layouts.COUNT
