"""Recordings in object stores (`s3://…`, `gs://…`, any file system of fsspec)."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from vo.base.errors import SourceError, VoError
from vo.base.extras import require
from vo.base.printable import one_line

_URL = re.compile(r"[a-z][a-z0-9+.-]+://")


def is_url(source: str) -> bool:
    """Whether a recording is in an object store, or in another file system of fsspec."""
    return _URL.match(source) is not None


def list_recordings(url: str) -> list[str]:
    """What is directly below a URL: files and folders, each as a URL.

    A pattern gives what it matches, and the URL of a file gives itself.

    Raises:
        SourceError: it does not exist, or the store cannot be reached.
        MissingExtraError: fsspec, or its part for this kind of store, is missing.
    """
    files, path = _opened(url)
    with _errors_of(url):
        if any(mark in path for mark in "*?["):
            found = files.glob(path)
        elif files.isfile(path):
            return [url]
        else:
            # Some stores list the folder itself too.
            found = [
                name for name in files.ls(path, detail=False) if name.strip("/") != path.strip("/")
            ]
    if not found:
        raise SourceError(f"{url} has no files; check bucket and prefix")
    return [str(files.unstrip_protocol(name)) for name in sorted(found)]


def identity(url: str) -> list[tuple[str, int, str]]:
    """Name, size and version of every file of a recording, in order.

    Raises:
        SourceError: it does not exist, or the store cannot be reached.
    """
    files, path = _opened(url)
    with _errors_of(url):
        found = files.find(path, detail=True)
    if not found:
        raise SourceError(f"{url} does not exist; check bucket and prefix")
    return [(name, int(info.get("size") or 0), _version(info)) for name, info in found.items()]


@contextmanager
def local_copy(source: str) -> Iterator[str]:
    """A recording as a path: itself, or a copy of what a URL holds, removed at the end.

    Raises:
        SourceError: it does not exist, or the store cannot be reached.
    """
    if not is_url(source):
        yield source
        return
    files, path = _opened(source)
    with TemporaryDirectory(prefix="vo-batch-") as folder:
        target = Path(folder, PurePosixPath(path.rstrip("/")).name or "recording")
        with _errors_of(source):
            if not files.exists(path):
                raise SourceError(f"{source} does not exist; check bucket and prefix")
            if files.isfile(path):
                files.get_file(path, str(target))
            else:
                files.get(path.rstrip("/") + "/", f"{target}/", recursive=True)
        try:
            yield str(target)
        except VoError as error:  # the copy is gone when the message is read
            raise type(error)(str(error).replace(str(target), source)) from error


def _version(info: dict[str, Any]) -> str:
    for name in ("ETag", "etag", "md5Hash", "LastModified", "mtime", "created"):
        if info.get(name) is not None:
            return str(info[name])
    return ""


def _opened(url: str) -> tuple[Any, str]:
    fsspec = require("fsspec", extra="cluster", what="recordings in object stores")
    try:
        files, path = fsspec.core.url_to_fs(url)
    except ImportError as error:
        raise SourceError(f"{url}: {error}") from error
    except ValueError as error:
        raise SourceError(f"{url} is not a URL that fsspec knows: {error}") from error
    return files, path


@contextmanager
def _errors_of(url: str) -> Iterator[None]:
    """Errors of stores, which have no class in common, as `SourceError`."""
    try:
        yield
    except SourceError:
        raise
    except FileNotFoundError as error:
        raise SourceError(f"{url} does not exist; check bucket and prefix") from error
    except Exception as error:
        reason = one_line(f"{type(error).__name__}: {error}")
        raise SourceError(f"{url} cannot be read: {reason}") from error
