"""TUM RGB-D layout: rgb.txt and rgb/, depth.txt and depth/, or associations.txt for both."""

from __future__ import annotations

from pathlib import Path

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.types import Mode
from vo.recordings.formats.stamp_units import StampText, parse_stamps
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, tum_truth
from vo.recordings.sources.listing import (
    Shot,
    check_existing,
    inside,
    make_shots,
    read_lines,
    shots_from_table,
)

_ASSOCIATIONS = ("assoc*.txt", "rgbd_assoc*.txt")


def gather_tum(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording; depth.txt and groundtruth.txt are optional.

    Without rgb.txt, images and depth images are those of associations.txt, as TUM's associate.py
    and ORB-SLAM write it.

    The calibration contains the number of depth units per metre (`depth_per_metre`); the default
    is 5000, as in the recordings of TUM.
    """
    faults: list[Fault] = []
    if (path / "rgb.txt").is_file():
        left = shots_from_table(path / "rgb.txt", path, None, "s", faults)
        depth = _depth(path) if mode != "mono" else None
    else:
        left, depth = _associated(_association_file(path), path, faults)
    return RecordingContents(
        name=path.resolve().name,
        format="tum",
        left=left,
        calibrate=calibration_reader(calibration, [path / "calibration.yaml"]),
        read_truth=lambda _: tum_truth([path / "groundtruth.txt"]),
        depth=depth,
        faults=faults,
    )


def _association_file(path: Path) -> Path:
    """The file `associations.txt`, or one with a similar name."""
    found = sorted(file for name in _ASSOCIATIONS for file in path.glob(name) if file.is_file())
    if not found:
        raise SourceError(f"{path} has neither rgb.txt nor associations.txt")
    return found[0]


def _associated(
    table: Path, path: Path, faults: list[Fault]
) -> tuple[list[Shot], list[Shot] | None]:
    """Images and depth images of lines with a stamp and a file name for each.

    A depth image gets the stamp of its image, to which it belongs whatever the difference.
    """
    rows = [(line, line.text.split()) for line in read_lines(table)]
    columns = len(rows[0][1])
    for line, fields in rows:
        if len(fields) != columns or columns not in (2, 4):
            raise SourceError(
                f"{line.location}: '{line.text}' is not a stamp and a file name, for an image and, "
                "optionally, a depth image"
            )
    colour, depth = 0, 2
    if columns == 4 and "depth" in rows[0][1][1] and "depth" not in rows[0][1][3]:
        colour, depth = 2, 0
    texts = [StampText(line.location, fields[colour]) for line, fields in rows]
    stamps = parse_stamps(texts, "s", faults)

    def files(column: int) -> list[Path]:
        found = [inside(path, path / fields[column + 1], line.location) for line, fields in rows]
        check_existing(found, table)
        return found

    places = [line.location for line, _ in rows]
    left = make_shots(stamps, files(colour), places)
    return left, make_shots(stamps, files(depth), places) if columns == 4 else None


def _depth(path: Path) -> list[Shot] | None:
    table = path / "depth.txt"
    if not table.is_file():
        return None
    try:
        return shots_from_table(table, path, None, "s")
    except SourceError as error:
        raise SourceError(f"{error}; to ignore depth, use `mode=mono`") from error
