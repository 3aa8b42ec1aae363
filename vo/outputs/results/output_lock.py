"""Lock on an output folder, and protection of files that are not results of a run."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vo.base.errors import OutputError
from vo.outputs.results.folder import PARTIAL_FILES, RESULTS
from vo.outputs.results.output_paths import is_run_folder

_LOCKED = (errno.EAGAIN, errno.EACCES)


@contextmanager
def locked_folder(path: Path) -> Iterator[None]:
    """Lock a folder against other runs inside this block; create it if it is missing.

    The files in it are not changed.

    Raises:
        OutputError: the folder cannot be written to, another run is writing to it, or it contains
            files with the names of results that are not results of a run.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY)
    except OSError as error:
        is_file = path.exists() and not path.is_dir()
        reason = "it is a file" if is_file else error.strerror or str(error)
        raise _refusal(path, reason) from error
    try:
        if not os.access(path, os.W_OK):
            raise _refusal(path, os.strerror(errno.EACCES))
        _lock(folder, path)
        _refuse_foreign_files(path)
        yield
    finally:
        os.close(folder)  # releases the lock


def _lock(folder: int, path: Path) -> None:
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _LOCKED:  # other errors: network file systems without locks, continue
            raise _refusal(path, "another run is writing there") from error


def _refuse_foreign_files(path: Path) -> None:
    found = [path / name for name in RESULTS if (path / name).exists()]
    partial = any((path / name).exists() for name in PARTIAL_FILES)
    if found and not partial and not is_run_folder(path):
        raise OutputError(
            f"{found[0]} is not a result of an earlier run and would be replaced; "
            "choose another `output`"
        )


def _refusal(path: Path, reason: str) -> OutputError:
    return OutputError(f"cannot write to folder {path}: {reason}; choose another `output`")
