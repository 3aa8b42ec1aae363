"""MCAP files that grow while they are read."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import layouts
import numpy as np
import pytest
from mcap_logs import write_log

from vo.base.errors import SourceError
from vo.recordings.formats.messages import Message
from vo.recordings.sources.mcap import follow
from vo.recordings.sources.registry import open_source

PIECES = 40
PAUSE_S = 0.01


def messages(rounds: int) -> Iterator[tuple[str, Message]]:
    """The six frames repeated, with increasing stamps."""
    for number in range(rounds):
        for topic, message in layouts.log_messages():
            later = message.stamp_ns + number * layouts.COUNT * 100_000_001
            yield topic, replace(message, stamp_ns=later)


@contextmanager
def growing(path: Path, data: bytes) -> Iterator[threading.Thread]:
    """Write a file in small parts, as a recorder does."""
    path.write_bytes(b"")

    def write() -> None:
        with path.open("ab", buffering=0) as stream:
            for piece in np.array_split(np.frombuffer(data, np.uint8), PIECES):
                stream.write(piece.tobytes())
                time.sleep(PAUSE_S)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield thread
    finally:
        thread.join()


@pytest.mark.parametrize("chunked", [True, False])
def test_same_frames_while_the_file_grows(tmp_path: Path, chunked: bool) -> None:
    whole = write_log(tmp_path / "whole.mcap", messages(5), use_chunking=chunked, chunk_size=8_000)
    expected = list(open_source(whole).frames())
    path = tmp_path / "live.mcap"
    with growing(path, whole.read_bytes()) as writer:
        source = open_source(path, follow=True)
        frames = source.frames()
        first = next(frames)
        assert writer.is_alive()
        found = [first, *frames]
    assert source.rig.is_stereo
    assert len(source) == len(expected) == 30
    assert source.unpaired == 0
    for a, b in zip(found, expected, strict=True):
        assert (a.index, a.stamp_ns) == (b.index, b.stamp_ns)
        assert np.array_equal(a.image0, b.image0)
        assert a.image1 is not None and b.image1 is not None
        assert np.array_equal(a.image1, b.image1)


def test_a_file_that_is_never_closed_ends_when_it_no_longer_grows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(follow, "END_TIMEOUT_S", 0.3)
    whole = write_log(tmp_path / "whole.mcap", messages(5), chunk_size=8_000)
    data = whole.read_bytes()
    path = tmp_path / "live.mcap"
    with growing(path, data[: len(data) // 2]):
        frames = list(open_source(path, follow=True, mode="mono").frames())
    assert 10 <= len(frames) <= 16
    assert [r.getMessage() for r in caplog.records if "cut off or damaged" in r.getMessage()]


def test_slices_of_a_growing_file(tmp_path: Path) -> None:
    whole = write_log(tmp_path / "whole.mcap", messages(5), chunk_size=8_000)
    source = open_source(whole, follow=True)
    assert [frame.index for frame in source.frames(2, 11, 4)] == [2, 6, 10]


def test_error_for_formats_that_cannot_grow(tmp_path: Path) -> None:
    layouts.write_folder(tmp_path / "folder")
    with pytest.raises(SourceError, match="cannot be followed; these formats can: mcap"):
        open_source(tmp_path / "folder", follow=True)
    (tmp_path / "log.mcap").write_bytes(b"#!/bin/sh and so on")
    with pytest.raises(SourceError, match="is not an MCAP file: its first bytes differ"):
        open_source(tmp_path / "log.mcap", follow=True)
