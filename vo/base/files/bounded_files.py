"""Reading of files that may be anything: only regular files, and only up to a number of bytes."""

from __future__ import annotations

import codecs
import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

MAX_TABLE_BYTES = 256 * 2**20  # 3 million poses
MAX_LINE_BYTES = 100_000
_LFS_POINTER = b"version https://git-lfs.github.com/spec/"
_LFS_REASON = "is a Git LFS pointer, not the file: git lfs pull"
_ENCODING = "utf-8-sig"
_NO_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)


def read_bytes(path: Path | str, max_bytes: int) -> bytes:
    """The content of a file.

    Raises:
        OSError: it cannot be read, is a device, a pipe or a folder, is larger, or is a pointer of
            Git LFS.
    """
    number, status = _opened(path)
    try:
        size = status.st_size
        if size > max_bytes:
            reason = f"it has {size} bytes; at most {max_bytes} are read"
            raise OSError(errno.EFBIG, reason, str(path))
        data = _read(number, size or max_bytes)  # some file systems state no size
    finally:
        os.close(number)
    if data.startswith(_LFS_POINTER):
        raise OSError(errno.EINVAL, f"it {_LFS_REASON}", str(path))
    return data


def open_regular(path: Path | str) -> BinaryIO:
    """A file that is open for reading, without waiting for the other end of a pipe.

    Raises:
        OSError: it cannot be read, or is a device, a pipe or a folder.
    """
    return open(_opened(path)[0], "rb")


def _opened(path: Path | str) -> tuple[int, os.stat_result]:
    """Descriptor and status of a regular file, see `open_regular`."""
    number = os.open(path, os.O_RDONLY | _NO_WAITING)
    try:
        status = os.fstat(number)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, "it is a device or a pipe, not a file", str(path))
        return number, status
    except BaseException:
        os.close(number)
        raise


def _read(number: int, size: int) -> bytes:
    """So many bytes, or all up to the end of the file; a call of the system may return fewer."""
    pieces = []
    while size and (piece := os.read(number, size)):
        pieces.append(piece)
        size -= len(piece)
    return b"".join(pieces)


def lfs_pointer_message(path: Path) -> str:
    """The error message for a file that Git has not fetched; empty for any other."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            begin = file.read(len(_LFS_POINTER))
    except OSError:
        return ""
    return f"{path} {_LFS_REASON}" if begin == _LFS_POINTER else ""


def read_text(path: Path | str, max_bytes: int = MAX_TABLE_BYTES) -> str:
    r"""The content of a text file in UTF-8 or marked UTF-16, with `\n` as the only end of lines.

    Raises:
        OSError: as for `read_bytes`.
        UnicodeDecodeError: it is not text, or has a NUL inside.
    """
    return _decoded(read_bytes(path, max_bytes))


def read_table_text(path: Path | str) -> str:
    """As `read_text`, of a file with lines of a few numbers or names.

    Raises:
        OSError: as for `read_bytes`.
        UnicodeDecodeError: as for `read_text`, or a line is longer than `MAX_LINE_BYTES`.
    """
    data = read_bytes(path, MAX_TABLE_BYTES)
    begin = 0
    while len(data) - begin > MAX_LINE_BYTES:
        stop = begin + MAX_LINE_BYTES
        last = max(data.rfind(b"\n", begin, stop), data.rfind(b"\r", begin, stop))
        if last < 0:
            raise UnicodeDecodeError(_ENCODING, data[:1], 0, 1, "a line is endless")
        begin = last + 1
    return _decoded(data)


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):  # Windows PowerShell writes it
        data = data.decode("utf-16").encode()
    if b"\0" in data.rstrip(b"\0"):  # a power failure may leave some at the end
        raise UnicodeDecodeError(_ENCODING, b"\0", 0, 1, "there is a NUL in it")
    return data.decode(_ENCODING).replace("\r\n", "\n").replace("\r", "\n")
