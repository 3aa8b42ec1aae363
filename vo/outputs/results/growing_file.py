"""A text file that is written line by line under a temporary name, and renamed when complete."""

from __future__ import annotations

import os
from array import array
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from vo.base.errors import OutputError

PARTIAL_SUFFIX = ".partial"


class GrowingFile:
    """Lines of a file, at `<path>.partial` until `finish`, then at `path`.

    Every line is on disk when a method returns, so that it survives a killed process.

    `heading`: first line, not counted as a row; empty for none.

    Raises:
        OutputError: here and in every method: the file cannot be written.
    """

    def __init__(self, path: Path, heading: str = "") -> None:
        self._path = path
        self._partial = path.with_name(path.name + PARTIAL_SUFFIX)
        self._offsets = array("q", [0])  # of the beginning of each row, and of the end
        try:
            # Unbuffered: one system call per method call, so that no line is split.
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
        """Replace a row and all rows after it. After an error the file ends with a whole line."""
        encoded = [f"{line}\n".encode() for line in lines]
        old_end = self._offsets[-1]
        del self._offsets[row + 1 :]
        begin = self._offsets[-1]
        for line in encoded:
            self._offsets.append(self._offsets[-1] + len(line))
        try:
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
            rest = rest[self._file.write(rest) :]

    def _drop_incomplete_rows(self) -> None:
        """Cut the file after the last row that was written completely."""
        with suppress(OSError):
            written = self._file.tell()  # rows from the first replaced one until here are new
            while self._offsets[-1] > written:
                self._offsets.pop()
            self._file.truncate(self._offsets[-1])

    def _error(self, error: OSError) -> OutputError:
        return OutputError(f"{self._path} cannot be written: {error.strerror or error}")


_BYTES = (1 << 16, 1 << 14, 1 << 12)  # the first that there is space for; a summary takes 3 kB


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
        with suppress(OSError, AttributeError):
            file = os.open(self._folder, os.O_TMPFILE | os.O_WRONLY, 0o666)
            for size in _BYTES:
                with suppress(OSError):
                    os.posix_fallocate(file, 0, size)
                    self._file = file
                    return
            os.close(file)


def _name(file: int, path: Path) -> None:
    """Give an open file without a name one; see open(2), O_TMPFILE."""
    open_files = os.open("/proc/self/fd", os.O_RDONLY)
    try:  # links are followed only if a folder is given
        os.link(str(file), path, src_dir_fd=open_files, follow_symlinks=True)
    finally:
        os.close(open_files)
