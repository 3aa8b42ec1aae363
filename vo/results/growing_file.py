"""A text file that grows line by line under a name of its own and takes its real one when whole."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable
from pathlib import Path

from vo.errors import OutputError

PARTIAL_SUFFIX = ".partial"


class GrowingFile:
    """Lines on disk at `<path>.partial` after each call, at `path` after `finish`.

    What was written outlives the process, however it ends.

    Args:
        path: the name it takes at the end.
        heading: first line, not counted as a row.

    Raises:
        OutputError: from here and every method, the file cannot be written.
    """

    def __init__(self, path: Path, heading: str = "") -> None:
        self._path = path
        self._partial = path.with_name(path.name + PARTIAL_SUFFIX)
        self._offsets = array("q", [0])  # where each row begins, and the end
        try:
            # Unbuffered: one call to the system for each of ours, so that no line is torn.
            self._file = self._partial.open("wb", buffering=0)
            if heading:
                self._offsets[0] = self._file.write(f"{heading}\n".encode())
        except OSError as error:
            raise self._error(error) from error

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._offsets) - 1

    def append(self, line: str) -> None:
        """Add a row."""
        self.replace_from(len(self), (line,))

    def replace_from(self, row: int, lines: Iterable[str]) -> None:
        """Put lines in the place of a row and all that follow it."""
        encoded = [f"{line}\n".encode() for line in lines]
        had = self._offsets[-1]
        del self._offsets[row + 1 :]
        begin = self._offsets[-1]
        for line in encoded:
            self._offsets.append(self._offsets[-1] + len(line))
        try:
            self._file.seek(begin)
            self._write(b"".join(encoded))
            if self._offsets[-1] < had:
                self._file.truncate(self._offsets[-1])
        except OSError as error:
            raise self._error(error) from error

    def finish(self) -> None:
        """Close the file and give it its name."""
        try:
            os.fsync(self._file.fileno())
            self._file.close()
            os.replace(self._partial, self._path)
        except OSError as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Close the file and leave it partial."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:  # an almost full disk takes less than it is given
            rest = rest[self._file.write(rest) :]

    def _error(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error.strerror or error}")
