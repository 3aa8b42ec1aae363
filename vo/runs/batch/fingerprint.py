"""What the result of a job depends on, as one number: input, settings and versions."""

from __future__ import annotations

import glob
import hashlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from vo.base.config import Config
from vo.outputs.results.environment import versions
from vo.runs.batch.job import Job
from vo.runs.batch.object_store import identity, is_url


def fingerprint(job: Job, config: Config) -> str:
    """SHA-256 of everything that the results of a job depend on, but the machine.

    Recordings are known by the names, sizes and modification times of their files: their content
    is not read. The number of threads is left out, as results do not depend on it.

    Raises:
        OSError: files cannot be listed.
        SourceError: an object store cannot be reached.
    """
    settings = config.model_dump(mode="json")
    settings.pop("threads")
    options = job.to_dict()
    for name in ("name", "tags", "config", "overrides"):  # settings are merged
        options.pop(name)
    files = [job.calibration, job.truth, *config.masks.files]
    known = {
        "source": _source_identity(job.source),
        "files": [list(_listed(Path(f))) for f in files if f is not None],
        "options": options,
        "settings": settings,
        "versions": versions(),
    }
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()


def _source_identity(source: str) -> Any:
    if is_url(source):
        return identity(source)
    if glob.has_magic(source) and not Path(source).exists():
        return [each for path in sorted(glob.glob(source)) for each in _listed(Path(path))]
    return list(_listed(Path(source)))


def _listed(path: Path) -> Iterator[tuple[str, int, int]]:
    """Name, size and modification time of a file, or of all files in a folder, in order."""
    if not path.is_dir():
        if path.exists():
            yield _described(path, path.name)
        return
    for folder, folders, files in os.walk(path):
        folders.sort()
        for name in sorted(files):
            file = Path(folder, name)
            yield _described(file, file.relative_to(path).as_posix())


def _described(file: Path, name: str) -> tuple[str, int, int]:
    status = file.lstat() if file.is_symlink() and not file.exists() else file.stat()
    return name, status.st_size, status.st_mtime_ns
