"""Files of results: they appear under their names when complete, and errors name them."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from vo.base.errors import OutputError


def is_full_disk(error: BaseException) -> bool:
    """Whether an error, or its cause, is a full disk."""
    cause = error.__cause__ if isinstance(error, OutputError) else error
    return isinstance(cause, OSError) and cause.errno in (errno.ENOSPC, errno.EDQUOT)


@contextmanager
def writing(path: object, advice: str = "") -> Iterator[None]:
    """Report an `OSError` of the block as an `OutputError`: what cannot be written, why, advice."""
    try:
        yield
    except OSError as error:
        reason = f"{error.strerror or error}{advice and '; '}{advice}"
        raise OutputError(f"{path} cannot be written: {reason}") from error


@contextmanager
def complete_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write; at the end it is on disk and replaces an existing one, also through links.

    A pipe or a device is written to directly.

    Raises:
        OSError: the file cannot be written; one that was there is as before.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        with target.open("wb") as file:
            yield file
        return
    partial = target.with_name(f"{target.name}.partial")
    try:
        with partial.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, target)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise
