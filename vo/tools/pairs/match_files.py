"""Matches of many images as files: CSV, NPZ, HDF5, COLMAP database."""

from __future__ import annotations

import csv
import io
import os
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.files.complete_file import writing
from vo.base.types import Camera
from vo.recordings.formats.colmap_database import ColmapDatabase, TwoViewGeometry, is_own_database
from vo.tools.pairs.image_pair import ImageFeatures, ImagePair

_COLUMNS = ("image_a", "image_b", "x_a", "y_a", "x_b", "y_b", "distance", "inlier")


class MatchFile(Protocol):
    """A file that takes images in order, then pairs of them by their numbers."""

    def add_image(self, name: str, features: ImageFeatures, camera: Camera | None) -> None:
        """The next image."""

    def add_pair(self, first: int, second: int, pair: ImagePair) -> None:
        """What relates two images."""

    def close(self) -> None:
        """Complete the file."""


class _CsvFile:
    """A row for each match, in pixels; `distance` is that of the descriptors."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w", encoding="utf-8", newline="")
        self._rows = csv.writer(self._file, lineterminator="\n")
        self._rows.writerow(_COLUMNS)
        self._names: list[str] = []

    def add_image(self, name: str, features: ImageFeatures, camera: Camera | None) -> None:
        self._names.append(name)

    def add_pair(self, first: int, second: int, pair: ImagePair) -> None:
        names = (self._names[first], self._names[second])
        xy = np.round(np.hstack([pair.first_xy, pair.second_xy]), 3).tolist()
        columns = zip(xy, pair.matches.score.tolist(), pair.inlier.tolist(), strict=True)
        self._rows.writerows(
            (*names, *at, f"{score:.6g}", int(good)) for at, score, good in columns
        )

    def close(self) -> None:
        self._file.close()


class _Arrays:
    """Named arrays: `keypoints/NAME` (N, 2) in pixels; of pairs `matches/A/B` (M, 2) rows of both.

    Further `inlier/A/B` (M,), and with a model `fundamental/A/B`, `essential/A/B` or
    `homography/A/B` (3, 3).
    """

    def __init__(self) -> None:
        self._names: list[str] = []

    def add_image(self, name: str, features: ImageFeatures, camera: Camera | None) -> None:
        self._names.append(name)
        self._write(f"keypoints/{name}", np.asarray(features.keypoints.xy, np.float32))

    def add_pair(self, first: int, second: int, pair: ImagePair) -> None:
        names = f"{self._names[first]}/{self._names[second]}"
        self._write(f"matches/{names}", pair.matched_rows.astype(np.int32))
        self._write(f"inlier/{names}", pair.inlier)
        if pair.fit is not None:
            self._write(f"{pair.fit.kind.value}/{names}", pair.fit.matrix)

    def _write(self, name: str, values: Any) -> None:
        raise NotImplementedError


class _NpzFile(_Arrays):
    """For `numpy.load`."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file = zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True)

    def _write(self, name: str, values: Any) -> None:
        data = io.BytesIO()
        np.lib.format.write_array(data, np.asarray(values), allow_pickle=False)
        self._file.writestr(f"{name}.npy", data.getbuffer())

    def close(self) -> None:
        self._file.close()


class _Hdf5File(_Arrays):
    """For `h5py.File`, with the same names."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file: Any = require("h5py", extra="hdf5", what="HDF5 files").File(path, "w")

    def _write(self, name: str, values: Any) -> None:
        self._file.create_dataset(name, data=values)

    def close(self) -> None:
        self._file.close()


class _DatabaseFile:
    """A COLMAP database."""

    def __init__(self, path: Path) -> None:
        self._database = ColmapDatabase(path)

    def add_image(self, name: str, features: ImageFeatures, camera: Camera | None) -> None:
        xy = np.asarray(features.keypoints.xy, np.float64)
        self._database.add_image(name, features.size, camera, xy)

    def add_pair(self, first: int, second: int, pair: ImagePair) -> None:
        geometry = None
        if pair.fit is not None:
            pose = None if pair.pose is None else pair.pose.second_from_first
            geometry = TwoViewGeometry(pair.fit.kind.value, pair.fit.matrix, pair.inlier, pose)
        self._database.add_pair(first, second, pair.matched_rows, geometry)

    def close(self) -> None:
        self._database.close()


_KINDS: dict[str, type[Any]] = {
    ".csv": _CsvFile,
    ".npz": _NpzFile,
    ".h5": _Hdf5File,
    ".hdf5": _Hdf5File,
    ".db": _DatabaseFile,
}


def check_match_files(paths: Sequence[Path]) -> None:
    """Check that files of matches can be made, before anything is computed.

    Raises:
        OutputError: unknown suffix, one file twice, or a database of others would be replaced.
        MissingExtraError: h5py is not installed.
    """
    for number, path in enumerate(paths):
        suffix = path.suffix.lower()
        if suffix not in _KINDS:
            raise OutputError(f"{path} must end in {', '.join(_KINDS)}, which are written")
        if _KINDS[suffix] is _Hdf5File:
            require("h5py", extra="hdf5", what="HDF5 files")
        if path in paths[:number]:
            raise OutputError(f"{path} is given twice; choose another file")
        if suffix == ".db" and path.exists() and not is_own_database(path):
            raise OutputError(f"{path} is a database of others, and kept; choose another file")


@contextmanager
def match_files(paths: Sequence[Path]) -> Iterator[Sequence[MatchFile]]:
    """Files of matches, by their suffixes; they appear under their names when they are complete.

    Raises:
        OutputError: one cannot be written.
    """
    with ExitStack() as opened:
        yield [opened.enter_context(_complete(path)) for path in paths]


@contextmanager
def _complete(path: Path) -> Iterator[MatchFile]:
    partial = path.with_name(f"{path.name}.partial")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        file: MatchFile = _KINDS[path.suffix.lower()](partial)
        try:
            yield file
            file.close()
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
