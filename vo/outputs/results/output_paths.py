"""Checks that outputs replace neither inputs nor each other, and stay out of the recording."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path, PurePath

from vo.base.errors import OutputError
from vo.base.files.bounded_documents import load_json
from vo.base.files.bounded_files import read_text
from vo.outputs.results.folder import PARTIAL_FILES, RESULTS, SUMMARY


def refuse_to_overwrite(inputs: Iterable[Path | None], outputs: Iterable[Path | None]) -> None:
    """Protect what a command reads from what it writes.

    Nothing is written in a recording that is a folder. The folder of an earlier run is no part of
    a recording, even if it is inside of one.

    `inputs`: recording (a folder, a file or a pattern of files), calibration; None and missing
    files are ignored. `outputs`: files and folders to write; None is ignored.

    Raises:
        OutputError: an output is an input, or in a folder that is an input.
    """
    read = [path for path in inputs if path is not None]
    for target in (path for path in outputs if path is not None):
        for path in read:
            _check(path, target)


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
