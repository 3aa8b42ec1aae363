"""A text file that is written line by line under a temporary name, and renamed when complete."""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Iterable
from contextlib import suppress
from itertools import accumulate
from pathlib import Path

from vo.base.errors import OutputError
from vo.base.files.complete_file import is_full_disk

PARTIAL_SUFFIX = ".partial"


class GrowingFile:
    """Lines of a file, at `<path>.partial` until `finish`, then at `path`.

    Every line is on disk when a method returns, so that it survives a killed process.

    `heading`: first line, not counted as a row; empty for none. `make_room`: frees space on a full
    disk; whether there was some.

    Raises:
        OutputError: here and in every method: the file cannot be written.
    """

    def __init__(
        self, path: Path, heading: str = "", make_room: Callable[[], bool] = lambda: False
    ) -> None:
        self._path = path
        self._make_room = make_room
        self._partial = path.with_name(path.name + PARTIAL_SUFFIX)
        self._offsets = array("q", [0])  # of the beginning of each row, and of the end
        try:
            # Unbuffered: one system call per method call, so that no line is split.
            self._file = self._partial.open("wb", buffering=0)
            if heading:
                self._write(f"{heading}\n".encode())
                self._offsets[0] = self._file.tell()
        except OSError as error:
            raise self._error(error) from error

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._offsets) - 1

    def append(self, line: str) -> None:
        """Add a row."""
        self.replace_from(len(self), (line,))

    def replace_from(self, row: int, lines: Iterable[str]) -> None:
        """Replace a row and all rows after it. After an error the file ends with a whole line."""
        encoded = [f"{line}\n".encode() for line in lines]
        if row == len(self) and not encoded:
            return
        old_end = self._offsets[-1]
        del self._offsets[row + 1 :]
        begin = self._offsets.pop()
        self._offsets.extend(accumulate(map(len, encoded), initial=begin))
        try:
            if begin < old_end:
                self._file.seek(begin)
            self._write(b"".join(encoded))
            if self._offsets[-1] < old_end:
                self._file.truncate(self._offsets[-1])
        except OSError as error:
            self._drop_incomplete_rows()
            raise self._error(error) from error

    def finish(self) -> None:
        """Close the file and give it its final name, also if the system could not store all."""
        if self._file.closed:
            return
        try:
            try:
                os.fsync(self._file.fileno())
            finally:
                self._file.close()
                os.replace(self._partial, self._path)
        except OSError as error:
            raise self._error(error) from error

    def close(self) -> None:
        """Close the file under its temporary name."""
        self._file.close()

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:  # on an almost full disk, a call may write a part only
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                if not is_full_disk(error) or not self._make_room():
                    raise

    def _drop_incomplete_rows(self) -> None:
        """Cut the file after the last row that was written completely."""
        with suppress(OSError):
            written = self._file.tell()  # rows from the first replaced one until here are new
            while self._offsets[-1] > written:
                self._offsets.pop()
            self._file.truncate(self._offsets[-1])
            self._file.seek(self._offsets[-1])

    def _error(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error.strerror or error}")


_SUMMARY_BYTES = (1 << 16, 1 << 14, 1 << 12)  # the first that there is space for; it takes 3 kB
_ROW_BYTES = 1024  # of a frame in all tables
_MIN_ROWS, _MAX_ROWS = 256, 1 << 15
_STEP_BYTES = 1 << 14


class RowSpace:
    """Space for the tables of a run, which recordings on the same disk cannot take.

    On a nearly full disk half of what is left is reserved. `rows`: expected frames, 0 if unknown.
    """

    def __init__(self, folder: Path, rows: int) -> None:
        wanted = _ROW_BYTES * min(max(rows, _MIN_ROWS), _MAX_ROWS)
        sizes = [wanted, *(1 << power for power in range(24, 12, -1) if 1 << power < wanted)]
        self._file, self._size = _held(folder, sizes)
        if self._size < wanted:
            self._cut(self._size // 2)

    def release(self) -> bool:
        """Free some of it; whether there was some."""
        had = self._size > 0
        self._cut(max(self._size - _STEP_BYTES, 0))
        return had

    def close(self) -> None:
        """Free the rest."""
        if self._file is not None:
            os.close(self._file)
        self._file, self._size = None, 0

    def _cut(self, size: int) -> None:
        if self._file is not None:
            with suppress(OSError):
                os.ftruncate(self._file, size)
        self._size = size


class ReservedSpace:
    """Space in a folder, held by a file without a name, which vanishes with the process.

    Nothing is reserved where the system does not support such files.

    `folder`: where the file will be.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file: int | None = None
        self._reserve()

    def write(self, path: Path, partial: Path, data: bytes) -> bool:
        """Write a file into the reserved space; whether there was space.

        `path`: its name, in the folder; an existing file is replaced. `partial`: its name before it
        is complete.
        """
        if self._file is None:
            return False
        file, self._file = self._file, None
        try:
            os.pwrite(file, data, 0)
            os.ftruncate(file, len(data))
            partial.unlink(missing_ok=True)
            _name(file, partial)
            os.replace(partial, path)
        except OSError:
            return False
        finally:
            os.close(file)
        self._reserve()  # the space of the replaced file is free now
        return True

    def close(self) -> None:
        """Free the space."""
        if self._file is not None:
            os.close(self._file)
            self._file = None

    def _reserve(self) -> None:
        self._file, _ = _held(self._folder, _SUMMARY_BYTES)


def _held(folder: Path, sizes: Iterable[int]) -> tuple[int | None, int]:
    """A file without a name of the first size that there is space for; (None, 0) without one."""
    with suppress(OSError, AttributeError):
        file = os.open(folder, os.O_TMPFILE | os.O_WRONLY, 0o666)
        for size in sizes:
            with suppress(OSError):
                os.posix_fallocate(file, 0, size)
                return file, size
        os.close(file)
    return None, 0


def _name(file: int, path: Path) -> None:
    """Give an open file without a name one; see open(2), O_TMPFILE."""
    open_files = os.open("/proc/self/fd", os.O_RDONLY)
    try:  # links are followed only if a folder is given
        os.link(str(file), path, src_dir_fd=open_files, follow_symlinks=True)
    finally:
        os.close(open_files)
