"""Reading of files that may be anything."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from vo.base.files.bounded_files import open_regular, read_bytes

CONTENT = bytes(range(256)) * 40


@pytest.mark.parametrize("content", [b"", b"a", CONTENT])
def test_a_file_is_read_whole(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    assert read_bytes(path, 20_000) == content
    with open_regular(str(path)) as file:
        assert file.read() == content


def test_a_file_that_is_read_in_parts_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_bytes(CONTENT)
    sizes, read = [], os.read

    def some(number: int, size: int) -> bytes:
        sizes.append(size)
        return read(number, min(size, 4000))

    monkeypatch.setattr(os, "read", some)
    assert read_bytes(tmp_path / "file", 20_000) == CONTENT
    assert sizes == [10_240, 6_240, 2_240]


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="Linux states no size here")
def test_a_file_without_a_stated_size_is_read() -> None:
    assert read_bytes("/proc/self/status", 100_000).startswith(b"Name:")


def test_a_larger_file_a_folder_and_a_pipe_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(CONTENT)
    os.mkfifo(tmp_path / "pipe")
    before = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").is_dir() else 0
    with pytest.raises(OSError, match="it has 10240 bytes; at most 10239 are read"):
        read_bytes(tmp_path / "file", 10_239)
    with pytest.raises(OSError, match="not a file"):
        read_bytes(tmp_path / "pipe", 100)
    with pytest.raises(IsADirectoryError, match="Is a directory"):
        open_regular(tmp_path)
    if before:
        assert len(os.listdir("/proc/self/fd")) == before
