"""Whose an output folder is: no other run's at this moment, and not full of files of others."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from vo.errors import OutputError
from vo.results.folder import PARTIAL_FILES, RESULTS, SUMMARY

_TAKEN = (errno.EAGAIN, errno.EACCES)


@contextmanager
def claimed(path: Path) -> Iterator[None]:
    """A folder that no other run writes to inside this block; made if it is missing.

    Nothing in it is touched.

    Raises:
        OutputError: it cannot be written to, another run writes to it at this moment, or it
            holds files of others that are called like those of a run.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        folder = os.open(path, os.O_RDONLY)
    except OSError as error:
        is_file = path.exists() and not path.is_dir()
        why = "it is a file" if is_file else error.strerror or str(error)
        raise _refusal(path, why) from error
    try:
        if not os.access(path, os.W_OK):
            raise _refusal(path, os.strerror(errno.EACCES))
        _lock(folder, path)
        _refuse_foreign(path)
        yield
    finally:
        os.close(folder)  # the lock goes with it


def refuse_to_overwrite(
    inputs: Iterable[Path | None], outputs: Iterable[Path | None], results: Path | None = None
) -> None:
    """Protect what a run reads from what it writes.

    Args:
        inputs: recording, calibration; those that are None or do not exist do not count.
        outputs: files to write.
        results: a folder of results; where it is in a recording, what is in it is not the
            recording's.

    Raises:
        OutputError: an output is an input, or is a file anywhere in a recording that is a folder.
    """
    read = [Path(os.path.realpath(path)) for path in inputs if path is not None and path.exists()]
    own = None if results is None else Path(os.path.realpath(results))
    for target in outputs:
        if target is None or not target.exists():
            continue
        place = Path(os.path.realpath(target))
        if own in place.parents and own not in read:
            continue
        if any(path.samefile(target) or path in place.parents for path in read):
            raise OutputError(f"{target} belongs to what is read; choose another file to write")


def refuse_to_collide(folder: Path, outputs: Iterable[Path | None]) -> None:
    """Keep what a run writes apart from its own results and from each other.

    Args:
        folder: of the results.
        outputs: what is written beside them; those that are None do not count.

    Raises:
        OutputError: two of them are the same.
    """
    taken = {Path(os.path.realpath(folder / name)) for name in (*RESULTS, *PARTIAL_FILES)}
    for target in (path for path in outputs if path is not None):
        place = Path(os.path.realpath(target))  # also through a loop of links
        if place in taken:
            raise OutputError(f"{target} is written already by this run; choose another file")
        taken.add(place)


def _lock(folder: int, path: Path) -> None:
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _TAKEN:  # some file systems of a network know no locks: go on there
            raise _refusal(path, "another run is writing there") from error


def _refuse_foreign(path: Path) -> None:
    found = [path / name for name in RESULTS if (path / name).exists()]
    partial = any((path / name).exists() for name in PARTIAL_FILES)
    if found and not partial and not _is_summary(path / SUMMARY):
        raise OutputError(
            f"{found[0]} is not of an earlier run and would be replaced; give another --output"
        )


def _is_summary(path: Path) -> bool:
    try:
        return "schema_version" in json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, TypeError):
        return False


def _refusal(path: Path, why: str) -> OutputError:
    return OutputError(f"cannot write to folder {path}: {why}; give another --output")
