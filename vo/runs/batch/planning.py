"""From sources to jobs: folders, patterns, URLs and manifests, each recording with a name."""

from __future__ import annotations

import csv
import glob
import io
import os
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import Any

from vo.base.errors import ConfigError, SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.recordings.sources.listing import IMAGE_SUFFIXES
from vo.recordings.sources.registry import VIDEO_SUFFIXES, detect_format
from vo.runs.batch.datasets import sequences_of
from vo.runs.batch.job import Job
from vo.runs.batch.object_store import is_url, list_recordings

MANIFEST_SUFFIXES = (".csv", ".json")
_RECORDING_SUFFIXES = (".mcap", ".bag", ".db3", *VIDEO_SUFFIXES)
_MAX_DEPTH = 6  # of recordings below a folder
_RESERVED = {"failed", "batch.json", "batch.csv", "index.html", "table.md"}
_NAME_LENGTH = 120
_MAX_BYTES = 64 << 20
_TEXTS = ("source", "config", "mode", "calibration", "format", "truth", "name")
_NUMBERS = ("start", "end", "stride")
_LISTS = ("overrides", "topics")


@dataclass(frozen=True)
class Plan:
    """The jobs of a batch, with unique names.

    The names `renamed` had to be told apart; folders `left_out` contain no recording.
    """

    jobs: tuple[Job, ...]
    renamed: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    dataset: str | None = None


def plan(
    sources: Sequence[str],
    options: Job,
    manifest: Path | None = None,
    dataset: str | None = None,
) -> Plan:
    """The jobs of all sources, and of a manifest.

    Args:
        sources: recordings, folders of recordings, patterns, or URLs.
        options: for all of them; its name and source are not used.
        manifest: CSV or JSON file with a recording in each row, and its options.
        dataset: the public data set that is in the folders `sources`.

    Raises:
        SourceError: there is no recording at all, or no sequence of the data set in a folder, or
            the manifest is damaged.
        ConfigError: an option in the manifest is unknown or has a wrong value.
    """
    jobs: list[Job] = []
    left_out: list[str] = []
    for text in sources:
        if dataset is not None:
            jobs += sequences_of(dataset, Path(text), options)
            continue
        found, without = _found(text)
        left_out += without
        jobs += [replace(options, source=each) for each in found]
    if manifest is not None:
        jobs += _of_manifest(manifest, options)
    unique = list({repr(job): job for job in jobs}.values())
    if not unique:
        where = ", ".join(sources) or str(manifest)
        raise SourceError(f"there is no recording in {where}; see docs/recordings.md for formats")
    named, renamed = _with_names(unique)
    return Plan(tuple(named), renamed, tuple(left_out), dataset)


def _found(text: str) -> tuple[list[str], list[str]]:
    """Recordings of a source, and folders without any; a missing one will fail by itself."""
    if is_url(text):
        if text.endswith("/") or any(mark in text for mark in "*?["):
            return list_recordings(text), []
        return [text], []
    path = Path(text)
    if not path.exists() and glob.has_magic(text):
        matches = sorted(glob.glob(text))
        if matches and all(m.lower().endswith(tuple(IMAGE_SUFFIXES)) for m in matches):
            return [text], []  # the images of one recording
        return (matches or [text]), []
    if path.is_dir() and not _is_recording(path):
        return _below(path)
    return [text], []


def _below(folder: Path) -> tuple[list[str], list[str]]:
    """Recordings below a folder; one that is empty is listed, so that it is not overlooked."""
    found: list[str] = []
    left_out: list[str] = []
    try:
        children = sorted(each for each in folder.iterdir() if not each.name.startswith("."))
    except OSError:
        return [str(folder)], []
    if not children:
        return [str(folder)], []
    for child in children:
        inside = [str(each) for each in _recordings(child, _MAX_DEPTH)]
        found += inside
        if not inside and child.is_dir():
            left_out.append(str(child))
    return (found, left_out) if found else ([str(folder)], [])


def _recordings(path: Path, depth: int) -> Iterator[Path]:
    if not path.is_dir():  # also a pipe or a link to nothing: its run says so
        if path.suffix.lower() in _RECORDING_SUFFIXES:
            yield path
        return
    if depth == 0:
        return
    if _is_recording(path):
        yield path
        return
    children = sorted(each for each in path.iterdir() if not each.name.startswith("."))
    if not children:
        yield path  # an empty recording: its run says so
    for child in children:
        yield from _recordings(child, depth - 1)


def _is_recording(path: Path) -> bool:
    try:
        return bool(detect_format(path))
    except (SourceError, OSError):
        return False


def _of_manifest(path: Path, options: Job) -> list[Job]:
    try:
        text = read_text(path, _MAX_BYTES)
    except OSError as error:
        raise SourceError(f"manifest {path} cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise SourceError(f"manifest {path} cannot be read: {error}") from error
    if path.suffix.lower() == ".json":
        rows = _json_rows(path, text)
    else:
        rows = list(csv.DictReader(io.StringIO(text)))
    return [_job(path, number, row, options) for number, row in enumerate(rows, start=1)]


def _json_rows(path: Path, text: str) -> list[Mapping[str, Any]]:
    try:
        rows = load_json(text)
    except ValueError as error:
        raise SourceError(f"manifest {path} is not JSON: {error}") from error
    rows = rows.get("jobs") if isinstance(rows, dict) else rows
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise SourceError(
            f'manifest {path} is not a list of recordings such as [{{"source": "a.mcap"}}]'
        )
    return rows


def _job(path: Path, number: int, row: Mapping[str, Any], options: Job) -> Job:
    """A row as a job; unknown columns are tags. Paths are relative to the manifest."""
    where = f"manifest {path}, recording {number}"
    given = {k.strip(): v for k, v in row.items() if k and v not in (None, "", [])}
    if not isinstance(given.get("source"), str):
        raise ConfigError(f"{where} has no source; give a path or URL in the column `source`")
    values: dict[str, Any] = {}
    tags = dict(options.tags)
    for name, value in given.items():
        if name in _NUMBERS:
            values[name] = _number(where, name, value)
        elif name in _LISTS or name == "set":
            texts = value if isinstance(value, list) else str(value).split(";")
            key = "overrides" if name == "set" else name
            values[key] = tuple(str(each).strip() for each in texts if str(each).strip())
        elif name == "side_by_side":
            values[name] = str(value).lower() in ("1", "true", "yes")
        elif name == "tags" and isinstance(value, dict):
            tags |= {str(k): str(v) for k, v in value.items()}
        elif name in _TEXTS:
            values[name] = str(value)
        else:
            tags[name] = str(value)
    if values.get("mode", "auto") not in ("auto", "mono", "stereo"):
        raise ConfigError(f"{where}: mode is {values['mode']!r}; give auto, mono or stereo")
    for name in ("source", "calibration", "truth"):
        if name in values and not is_url(values[name]):
            values[name] = str(path.parent / values[name])
    overrides = (*options.overrides, *values.pop("overrides", ()))
    return replace(options, **{"name": "", **values}, overrides=overrides, tags=tags)


def _number(where: str, name: str, value: Any) -> int:
    try:
        number = int(value)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where}: {name} is {value!r}; give a whole number") from error
    if number < (1 if name == "stride" else 0):
        raise ConfigError(f"{where}: {name} is {number}, which is too small")
    return number


def _with_names(jobs: Sequence[Job]) -> tuple[list[Job], dict[str, str]]:
    """Jobs with unique names: the last parts of their paths, as few as tell them apart."""
    parts = [_parts(job) for job in jobs]
    lengths = [1] * len(jobs)
    for _ in range(max(map(len, parts))):
        names = [_joined(p, n) for p, n in zip(parts, lengths, strict=True)]
        counts = Counter(name.lower() for name in names)  # some file systems ignore case
        doubled = [n for n, name in enumerate(names) if counts[name.lower()] > 1]
        if not doubled:
            break
        for n in doubled:
            lengths[n] = min(lengths[n] + 1, len(parts[n]))
    taken: set[str] = set(_RESERVED)
    named: list[Job] = []
    renamed: dict[str, str] = {}
    for job, own, length in zip(jobs, parts, lengths, strict=True):
        name = base = _joined(own, length)
        number = 2
        while name.lower() in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name.lower())
        named.append(replace(job, name=name))
        if name != (job.name or _joined(own, 1)):
            renamed[name] = job.source
    return named, renamed


def _parts(job: Job) -> list[str]:
    if job.name:
        return [_safe(job.name)]
    if is_url(job.source):
        path = PurePosixPath(job.source.partition("://")[2])
    else:
        path = PurePosixPath(os.path.abspath(job.source))
    parts = [part for part in path.parts if part != "/"]
    if parts and Path(parts[-1]).suffix.lower() in _RECORDING_SUFFIXES:
        parts[-1] = Path(parts[-1]).stem or parts[-1]
    return [_safe(part) for part in parts] or ["recording"]


def _joined(parts: Sequence[str], count: int) -> str:
    return "_".join(parts[-count:])[-_NAME_LENGTH:].lstrip(".-") or "recording"


def _safe(part: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", part)
