"""Reads the output folder of `vo run`; missing files are allowed."""

from __future__ import annotations

import csv
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.errors import SourceError
from vo.base.files.bounded_files import read_text
from vo.base.files.bounded_json import load_json
from vo.base.types import Floats, Ints, Trajectory
from vo.outputs.report.summary_schema import check_summary
from vo.recordings.formats.trajectory import read_tum

_log = logging.getLogger(__name__)

_PARTIAL = ".partial"  # of a run that was killed
_STAGE_SUFFIX = "_ms"
_MAX_MS = 1e12
_TANGENT = ("rx", "ry", "rz", "tx", "ty", "tz")


@dataclass(frozen=True, eq=False)
class FrameTable:
    """`frames.csv`: one row per frame, as known when it was processed; arrays are (N,)."""

    frame: Ints
    stamp_ns: Ints
    state: NDArray[np.str_]
    keyframe: Ints
    matches: Ints
    inliers: Ints
    total_ms: Floats
    stage_ms: Mapping[str, Floats]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Standard deviations of keyframe poses (K,); the position in the length unit of the run."""

    stamp_ns: Ints
    segment: Ints
    covariance: Floats  # (K, 6, 6) of rotation (rad) and position, in the frame of the camera

    @property
    def position(self) -> Floats:
        """Square root of the trace of the block of the position."""
        return np.asarray(np.sqrt(np.trace(self.covariance[:, 3:, 3:], axis1=1, axis2=2)))

    @property
    def rotation_deg(self) -> Floats:
        """Square root of the trace of the block of the rotation."""
        return np.asarray(np.rad2deg(np.sqrt(np.trace(self.covariance[:, :3, :3], 0, 1, 2))))


class MappedMarker(NamedTuple):
    """A row of `markers.csv`; lengths in metres, in the world of the path."""

    segment: int  # number of the world
    id: int
    position: tuple[float, float, float]
    sigma_m: float  # standard deviation of the position
    views: int  # number of frames that show it
    first_frame: int  # number of the first of them
    last_frame: int  # number of the last one
    error: float  # RMS distance of its corners from their prediction, in standard deviations


class GivenPositions(NamedTuple):
    """`given_positions.csv`: positions of another sensor during the path, such as of GPS."""

    segment: Ints  # (P,) number of the world
    xyz: Floats  # (P, 3) in this world, metres
    geodetic: Floats  # (P, 3) latitude, longitude, height; NaN where they are not on the globe


@dataclass(frozen=True, eq=False)
class RunRecord:
    """Results of a run."""

    path: Path
    summary: Mapping[str, Any]  # `summary.json`
    config: str  # `config.yaml` as text, empty if missing
    trajectory: Trajectory  # the smoothed path, possibly empty
    # stamps (N,) in `poses.csv` and the number (N,) of the segment of each, where merged segments
    # have one number; possibly empty
    worlds: tuple[Ints, Ints]
    causal: Trajectory  # the causal path with predicted poses of lost frames, possibly empty
    odometry: Trajectory  # the path before loops, empty without any
    frames: FrameTable | None  # None if `frames.csv` is missing
    sigmas: Sigmas | None  # None without covariances
    markers: tuple[MappedMarker, ...] = ()  # where they are, empty without any
    positions: GivenPositions | None = None

    @property
    def unit(self) -> str:
        """Unit of every length."""
        return str(self.summary.get("length_unit", "m"))

    def segment_of(self, stamps_ns: Ints) -> Ints:
        """Number (N,) of the segment that contains each stamp, -1 outside of all segments."""
        numbers = np.full(len(stamps_ns), -1, dtype=np.int64)
        for segment in self.summary.get("segments", ()):
            first, last = segment["first_stamp_ns"], segment["last_stamp_ns"]
            numbers[(stamps_ns >= first) & (stamps_ns <= last)] = segment["segment"]
        known, segments = self.worlds  # merged segments may have another one in between
        if len(known):
            rows = np.minimum(np.searchsorted(known, stamps_ns), len(known) - 1)
            numbers = np.where(known[rows] == stamps_ns, segments[rows], numbers)
        return numbers


def read_run(folder: Path) -> RunRecord:
    """Read the folder of a run, finished or not.

    Raises:
        SourceError: the folder is not that of a run, or a file in it is damaged.
    """
    if not folder.is_dir():
        raise SourceError(f"{folder} is not a folder; use the `output` of a `vo run`")
    return RunRecord(
        folder,
        _summary(folder / "summary.json"),
        _text(folder / "config.yaml"),
        _trajectory(folder / "trajectory.tum"),
        _worlds(folder / "poses.csv"),
        _trajectory(folder / "causal.tum"),
        _trajectory(folder / "odometry.tum"),
        _frames(folder / "frames.csv"),
        _sigmas(folder / "covariance.csv"),
        _markers(folder / "markers.csv"),
        _positions(folder / "given_positions.csv"),
    )


def _summary(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise SourceError(f"{path.parent} has no {path.name}; use the `output` of a `vo run`")
    try:
        summary = load_json(read_text(path))
    except (OSError, ValueError) as error:
        raise SourceError(f"{path} cannot be read: {error}; run `vo run` again") from error
    if not isinstance(summary, dict) or "schema_version" not in summary:
        raise SourceError(f"{path} is not the summary of a run; use the `output` of a `vo run`")
    check_summary(str(path), summary)
    summary.setdefault("faults", [])  # older runs have none
    return summary


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except (OSError, ValueError):
        return ""


def _existing(path: Path) -> Path | None:
    """The file, or the partial file of a killed run; None without content."""
    for each in (path, path.with_name(path.name + _PARTIAL)):
        if each.is_file() and each.stat().st_size:
            return each
    return None


def _trajectory(path: Path) -> Trajectory:
    found = _existing(path)
    if found is None:
        return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)))
    return read_tum(found)


def table_rows(path: Path, *, warn: bool = True) -> list[dict[str, str]]:
    """Rows of a table of a run, none if it is not there; a line that is cut off is left out.

    Raises:
        SourceError: the file cannot be read.
    """
    found = _existing(path)
    if found is None:
        return []
    try:
        text = read_text(found)
        lines, _, cut_off = text.rpartition("\n")
        if cut_off and warn:
            _log.warning("%s: the last line is cut off and ignored", found)
        return list(csv.DictReader(lines.split("\n")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SourceError(f"{found} cannot be read: {error}; run `vo run` again") from error


def _worlds(path: Path) -> tuple[Ints, Ints]:
    rows = table_rows(path)
    try:
        stamps, segments = (
            np.array([int(row[name]) for row in rows], dtype=np.int64)
            for name in ("stamp_ns", "segment")
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error
    return stamps, segments


def _frames(path: Path) -> FrameTable | None:
    rows = table_rows(path)
    if not rows:
        return None
    try:
        counts = {
            name: np.array([int(row[name]) for row in rows], dtype=np.int64)
            for name in ("frame", "stamp_ns", "keyframe", "matches", "inliers")
        }
        times = {
            name.removesuffix(_STAGE_SUFFIX): np.array([float(row[name]) for row in rows])
            for name in rows[0]
            if name.endswith(_STAGE_SUFFIX)
        }
        if not all((np.abs(values) <= _MAX_MS).all() for values in times.values()):
            raise ValueError("a time is no finite number")
        state = np.array([row["state"] for row in rows])
        return FrameTable(**counts, state=state, total_ms=times.pop("total"), stage_ms=times)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error


def _markers(path: Path) -> tuple[MappedMarker, ...]:
    try:
        found = tuple(
            MappedMarker(
                int(row["segment"]),
                int(row["id"]),
                (float(row["tx"]), float(row["ty"]), float(row["tz"])),
                float(row["sigma_m"]),
                views=int(row["views"]),
                first_frame=int(row["first_frame"]),
                last_frame=int(row["last_frame"]),
                error=float(row["error"]),
            )
            for row in table_rows(path)
        )
        numbers = [(*each.position, each.sigma_m, each.error) for each in found]
        if not np.isfinite(numbers).all():
            raise ValueError("a position is no finite number")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error
    return found


def _positions(path: Path) -> GivenPositions | None:
    rows = table_rows(path)
    if not rows:
        return None
    try:
        names = ("tx", "ty", "tz", "latitude", "longitude", "height")
        values = np.array([[float(row[name] or "nan") for name in names] for row in rows])
        if not np.isfinite(values[:, :3]).all():
            raise ValueError("a position is no finite number")
        segment = np.array([int(row["segment"]) for row in rows], dtype=np.int64)
        return GivenPositions(segment, values[:, :3], values[:, 3:])
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error


def _sigmas(path: Path) -> Sigmas | None:
    try:
        known = [row for row in table_rows(path) if row["c_rx_rx"]]
        if not known:
            return None
        stamps, segments = (
            np.array([int(row[name]) for row in known], dtype=np.int64)
            for name in ("stamp_ns", "segment")
        )
        first, second = np.triu_indices(6)
        names = [f"c_{_TANGENT[i]}_{_TANGENT[j]}" for i, j in zip(first, second, strict=True)]
        covariance = np.zeros((len(known), 6, 6))
        covariance[:, first, second] = [[float(row[name]) for name in names] for row in known]
        covariance[:, second, first] = covariance[:, first, second]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"{path} is damaged: {error}; run `vo run` again") from error
    return Sigmas(stamps, segments, covariance)
