"""TUM RGB-D layout: rgb.txt and rgb/, one camera; depth is not used."""

from __future__ import annotations

from pathlib import Path

from vo.formats.trajectory import read_tum, stamp_ns_from_seconds
from vo.sources.assembly import Gathered, assemble, find_calibration
from vo.sources.listing import shots_from_table
from vo.sources.source import Source
from vo.types import Mode, Trajectory


def open_tum(path: Path, calibration: Path | None, mode: Mode) -> Source:
    """Open a recording folder; groundtruth.txt may be missing.

    Raises:
        SourceError: images or stamps are missing or do not fit together.
        CalibrationError: there is no calibration, or it is wrong.
    """
    gathered = Gathered(
        name=path.resolve().name,
        format="tum",
        left=shots_from_table(path / "rgb.txt", path, None, stamp_ns_from_seconds),
        right=None,
        calibrate=find_calibration(calibration, [path / "calibration.yaml"]),
        read_truth=lambda _: _truth(path / "groundtruth.txt"),
    )
    return assemble(gathered, mode)


def _truth(file: Path) -> Trajectory | None:
    return read_tum(file) if file.is_file() else None
