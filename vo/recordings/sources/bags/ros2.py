"""ROS 2 bags: a folder of metadata.yaml and SQLite or MCAP files, or one of these files."""

from __future__ import annotations

import logging
import shutil
import tempfile
import weakref
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vo.base.errors import SourceError
from vo.base.files.bounded_files import lfs_pointer_message, read_text
from vo.base.files.bounded_yaml import load_yaml
from vo.recordings.formats.decompression import copy_decompressed
from vo.recordings.sources.bags.sqlite_file import SqliteFile
from vo.recordings.sources.listing import natural_key
from vo.recordings.sources.logs.log import Entry, Log, Topic, unread_topics
from vo.recordings.sources.mcap.file import McapFile

_log = logging.getLogger(__name__)
_MAX_METADATA_BYTES = 4 * 2**20
_MIN_FILE_LIMIT = 2**28  # of a decompressed file
_MAX_RATIO = 200  # of larger ones


class _Metadata(NamedTuple):
    files: list[Path]
    compression: str  # unit of compression: `file`, `message` or `none`


class Bag:
    """A `Log` in one or more files."""

    def __init__(self, path: Path) -> None:
        """Open all existing files."""
        self.path = path
        self._decompressed: Path | None = None
        found = _metadata(path)
        self._parts: list[Log] = [self._open(file, found.compression) for file in found.files]
        names = sorted({topic.name for part in self._parts for topic in part.topics})
        self.topics = [_joined(name, self._parts) for name in names]
        self.unread = unread_topics((each for part in self._parts for each in part.unread), names)

    def entries(self, names: Collection[str]) -> dict[str, list[Entry]]:
        """See `Log.entries`; the files are in the order of metadata.yaml or of their numbers."""
        joined: dict[str, list[Entry]] = {name: [] for name in names}
        for number, part in enumerate(self._parts):
            own = [topic.name for topic in part.topics if topic.name in joined]
            for name, entries in part.entries(own).items():
                joined[name] += [entry._replace(address=(number, entry)) for entry in entries]
        return joined

    def metadata(self, name: str) -> Mapping[str, str]:
        """See `Log.metadata`; of the first file that has any."""
        return next((found for part in self._parts if (found := part.metadata(name))), {})

    def read(self, entry: Entry) -> bytes:
        """Read the bytes of a message."""
        address: tuple[int, Entry] = entry.address
        return self._parts[address[0]].read(address[1])

    def _open(self, file: Path, compression: str) -> Log:
        pointer = lfs_pointer_message(file)
        if pointer:
            raise SourceError(pointer)
        if file.suffix == ".zstd":
            file = self._decompress(file)
        if file.suffix == ".mcap":
            if compression == "message":
                raise SourceError(
                    f"{file} has individually compressed messages, which are not supported in "
                    "MCAP; compression of MCAP chunks is"
                )
            return McapFile(file)
        return SqliteFile(file, compressed=compression == "message")

    def _decompress(self, file: Path) -> Path:
        """Decompress a file into a temporary folder."""
        if self._decompressed is None:
            self._decompressed = Path(tempfile.mkdtemp(prefix="vo-bag-"))
            weakref.finalize(self, shutil.rmtree, self._decompressed, ignore_errors=True)
        folder = self._decompressed
        decompressed = folder / file.stem
        try:
            max_bytes = max(_MIN_FILE_LIMIT, _MAX_RATIO * file.stat().st_size)
            with file.open("rb") as compressed, decompressed.open("wb") as stream:
                copy_decompressed(compressed, stream, max_bytes)
        except OSError as error:
            reason = error.strerror or error
            raise SourceError(f"{file} cannot be decompressed in {folder}: {reason}") from error
        except SourceError as error:
            raise SourceError(f"{file}: {error}") from error
        return decompressed


def _metadata(path: Path) -> _Metadata:
    if path.is_file():
        return _Metadata([path], "none")
    table = path / "metadata.yaml"
    listed, compression = _read_metadata(table) if table.is_file() else ([], "none")
    files = [file for file in listed if file.is_file()]
    if listed and len(files) < len(listed):
        _log.warning("%s: %d of %d files are missing", path, len(listed) - len(files), len(listed))
    if not files:
        kinds = ("*.db3", "*.mcap", "*.db3.zstd", "*.mcap.zstd")
        files = sorted((f for kind in kinds for f in path.glob(kind)), key=natural_key)
        if files and not listed:
            _log.warning("%s has no metadata.yaml, as after a crash; all its files are read", path)
    if not files:
        raise SourceError(f"{path} has no .db3 or .mcap file; a ROS 2 bag has one or more")
    return _Metadata(files, compression)


def _read_metadata(table: Path) -> tuple[list[Path], str]:
    """The files of a bag, and the unit of compression: `file`, `message` or `none`."""
    try:
        data: Any = load_yaml(read_text(table, _MAX_METADATA_BYTES))
        about = data["rosbag2_bagfile_information"]
        files = [table.parent / Path(str(name)).name for name in about["relative_file_paths"]]
        algorithm = str(about.get("compression_format") or "zstd").lower()
        compression = str(about.get("compression_mode") or "none").lower()
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        _log.warning("%s cannot be read; all files in its folder are read", table)
        return [], "none"
    if compression != "none" and algorithm != "zstd":
        raise SourceError(f"{table}: compressed with '{algorithm}'; zstd is supported")
    return files, compression


def _joined(name: str, parts: Sequence[Log]) -> Topic:
    own = [topic for part in parts for topic in part.topics if topic.name == name]
    first = own[0]
    count, span_ns = sum(t.count for t in own), sum(t.span_ns for t in own)
    return Topic(name, first.schema, first.codec, count, span_ns)
