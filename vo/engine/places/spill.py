"""Blocks of bytes in memory up to a total size, and the others in a file without a name.

The file is unlinked as soon as it is open, so that it is gone at the end of the process, whatever
ends it.
"""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path
from typing import BinaryIO

from vo.base.errors import OutputError


class SpilledBlocks:
    """Blocks by number, the first `memory_bytes` of them in memory."""

    def __init__(self, memory_bytes: int, folder: Path | None = None) -> None:
        self._budget = memory_bytes
        self._folder = folder
        self._in_memory: dict[int, bytes] = {}
        self._in_file: dict[int, tuple[int, int]] = {}
        self._file: BinaryIO | None = None
        self._end = 0
        self._free: dict[int, list[int]] = {}  # offsets of removed blocks in the file, by size

    @property
    def file_bytes(self) -> int:
        """Size of the file."""
        return self._end

    def add(self, number: int, data: bytes) -> None:
        """Keep a block.

        Raises:
            OutputError: the file cannot be written, such as on a full disk; the others stay.
        """
        if len(data) <= self._budget:
            self._budget -= len(data)
            self._in_memory[number] = data
            return
        try:
            self._write(number, data)
        except OSError as error:
            where = self._folder or tempfile.gettempdir()
            reason = os.strerror(error.errno or errno.EIO)
            raise OutputError(
                f"keyframes cannot be kept in {where}: {reason}; make room, or set TMPDIR to a "
                "folder with more"
            ) from error

    def get(self, number: int) -> bytes:
        """A block.

        Raises:
            OutputError: the file cannot be read.
        """
        if number in self._in_memory:
            return self._in_memory[number]
        begin, size = self._in_file[number]
        assert self._file is not None
        try:
            self._file.seek(begin)
            data = self._file.read(size)
        except OSError as error:
            raise OutputError(f"kept keyframes cannot be read: {error.strerror}") from error
        if len(data) != size:
            raise OutputError("kept keyframes cannot be read: the file is cut off")
        return data

    def remove(self, number: int) -> None:
        """Forget a block; its room is used again."""
        data = self._in_memory.pop(number, None)
        if data is not None:
            self._budget += len(data)
            return
        begin, size = self._in_file.pop(number)
        self._free.setdefault(_rounded(size), []).append(begin)

    def close(self) -> None:
        """Forget all blocks."""
        self._in_memory.clear()
        self._in_file.clear()
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, number: int, data: bytes) -> None:
        if self._file is None:
            # Unbuffered: an error belongs to the block that is being written.
            self._file = tempfile.TemporaryFile(buffering=0, dir=self._folder)  # noqa: SIM115
        room = _rounded(len(data))
        free = self._free.get(room)
        begin = free[-1] if free else self._end
        self._file.seek(begin)
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) or 0 :]
        if free:
            free.pop()
        else:
            self._end += room
        self._in_file[number] = begin, len(data)


def _rounded(size: int) -> int:
    """Room of a block in the file: a multiple of 4 kB, so that others fit where one was removed."""
    return -(-size // 4096) * 4096
