"""Outputs replace neither inputs, nor each other, nor files of others, nor a running run's."""

from __future__ import annotations

import errno
import fcntl
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath

from vo.base.errors import OutputError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.outputs.results.folder import PARTIAL_FILES, RESULTS, SUMMARY


def refuse_to_overwrite(inputs: Iterable[Path | None], outputs: Iterable[Path | None]) -> None:
    """Protect what a command reads from what it writes.

    Nothing is written in a recording that is a folder. The folder of an earlier run is no part of
    a recording, even if it is inside of one.

    `inputs`: recording (a folder, a file or a pattern of files), calibration; None and missing
    files are ignored. `outputs`: files and folders to write; None is ignored.

    Raises:
        OutputError: an output is an input, in a folder that is an input, or a symbolic link to a
            file, which would be replaced behind it.
    """
    read = [path for path in inputs if path is not None]
    targets = [path for path in outputs if path is not None]
    for target in targets:
        for path in read:
            _check(path, target)
    refuse_links(targets)


def _check(path: Path, target: Path) -> None:
    source, place = Path(os.path.realpath(path)), Path(os.path.realpath(target))
    if not path.exists():
        is_replaced = any(mark in str(path) for mark in "*?[") and not place.is_dir()
        if is_replaced and PurePath(place).match(str(path.absolute())):  # a pattern
            raise _would_be_replaced(target)
    elif source == place:
        raise _would_be_replaced(target)
    elif source in place.parents and not _is_in_run_folder(place, source):
        if place.is_file():
            raise _would_be_replaced(target)
        beside = source.parent / f"{source.name}_{place.name}"
        raise OutputError(
            f"{target} is inside the recording {path}, where nothing is written; choose another "
            f"place, such as {min(os.path.relpath(beside), str(beside), key=len)}"
        )


def _would_be_replaced(target: Path) -> OutputError:
    return OutputError(f"{target} is an input and would be replaced; choose another file")


def _is_in_run_folder(place: Path, recording: Path) -> bool:
    """Whether a path is, or is in, the folder of an earlier run below a recording."""
    folders = [folder for folder in (place, *place.parents) if recording in folder.parents]
    return any(is_run_folder(folder) for folder in folders)


def is_run_folder(folder: Path) -> bool:
    """Whether a folder has the summary of a run."""
    try:
        return "schema_version" in load_json(read_text(folder / SUMMARY))
    except (OSError, ValueError, TypeError):
        return False


def refuse_to_collide(folder: Path, outputs: Iterable[Path | None]) -> None:
    """Check that the outputs of a run differ from its results and from each other.

    `outputs`: other files to write; None is ignored.

    Raises:
        OutputError: two of them are the same file.
    """
    taken = {Path(os.path.realpath(folder / name)) for name in (*RESULTS, *PARTIAL_FILES)}
    for target in (path for path in outputs if path is not None):
        place = Path(os.path.realpath(target))  # also through a loop of links
        if place in taken:
            raise OutputError(f"{target} is already an output of this run; choose another file")
        taken.add(place)


def refuse_links(outputs: Iterable[Path | None]) -> None:
    """Check that no output is a symbolic link to a file, which would be replaced behind it.

    Raises:
        OutputError: one is; links to folders, pipes and devices are followed.
    """
    for target in (path for path in outputs if path is not None):
        if target.is_symlink() and (target.is_file() or not target.exists()):
            raise OutputError(
                f"{target} is a symbolic link, which is not followed; choose another file"
            )


def refuse_existing(outputs: Iterable[Path | None], *, force: bool) -> None:
    """Check that no output exists without `force`, or is a link, as `refuse_links` says.

    Raises:
        OutputError: one does.
    """
    targets = [path for path in outputs if path is not None]
    refuse_links(targets)
    for target in targets:
        if target.is_file() and not force:
            raise OutputError(f"{target} exists already; choose another file, or `force=True`")


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
