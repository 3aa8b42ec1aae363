"""Space on disk that is kept for one small file, so that it can be written on a full disk too."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

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
