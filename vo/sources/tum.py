"""TUM RGB-D layout: rgb.txt and rgb/, depth.txt and depth/."""

from __future__ import annotations

from pathlib import Path

from vo.errors import SourceError
from vo.faults import Fault
from vo.formats.trajectory import read_tum
from vo.sources.assembly import RecordingContents, calibration_reader
from vo.sources.listing import Shot, shots_from_table
from vo.types import Mode, Trajectory


def gather_tum(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording; depth.txt and groundtruth.txt are optional.

    The calibration contains the number of depth units per metre (`depth_per_metre`); the default
    is 5000, as in the recordings of TUM.

    Raises:
        SourceError: images or stamps are missing or inconsistent.
        CalibrationError: the calibration is missing or invalid.
    """
    faults: list[Fault] = []
    return RecordingContents(
        name=path.resolve().name,
        format="tum",
        left=shots_from_table(path / "rgb.txt", path, None, "s", faults),
        right=None,
        calibrate=calibration_reader(calibration, [path / "calibration.yaml"]),
        read_truth=lambda _: _truth(path / "groundtruth.txt"),
        depth=_depth(path) if mode != "mono" else None,
        faults=faults,
    )


def _depth(path: Path) -> list[Shot] | None:
    table = path / "depth.txt"
    if not table.is_file():
        return None
    try:
        return shots_from_table(table, path, None, "s")
    except SourceError as error:
        raise SourceError(f"{error}; to ignore depth, use --mode mono") from error


def _truth(file: Path) -> Trajectory | None:
    return read_tum(file) if file.is_file() else None
