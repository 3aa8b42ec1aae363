"""Images that match a pattern: `left/*.png`, `walk_?/frame*.jpg`, `**/*.tif`."""

from __future__ import annotations

import glob
from pathlib import Path

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.files.bounded_files import read_text
from vo.base.types import Mode
from vo.recordings.sources.assembly import RecordingContents, calibration_reader
from vo.recordings.sources.folder import assign_stamps, find_times_file
from vo.recordings.sources.listing import Shot, is_image_name, natural_key
from vo.recordings.sources.pairing import copy_stamps


def gather_glob(pattern: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the matching images in natural order of their names.

    If the pattern contains `left`, the right images are those that match it with `right` instead.
    Stamps come from a times.txt in the folder with one line per image, or else from the file
    names; otherwise 10 frames per second are assumed, with a warning.
    """
    images = _matching(str(pattern))
    if not images:
        raise SourceError(f"no image matches {pattern}; check the pattern, and put it in quotes")
    folder = images[0].parent
    faults: list[Fault] = []
    left, _ = assign_stamps(images, str(pattern), _times(folder, len(images)), faults)
    return RecordingContents(
        name=folder.resolve().name,
        format="glob",
        left=left,
        right=_right(str(pattern), left),
        calibrate=calibration_reader(
            calibration, [folder / "calibration.yaml", folder.parent / "calibration.yaml"]
        ),
        read_truth=lambda _: None,
        faults=faults,
    )


def _matching(pattern: str) -> list[Path]:
    found = (Path(name) for name in glob.glob(pattern, recursive=True))
    images = [path for path in found if is_image_name(path.name) and path.is_file()]
    return sorted(images, key=lambda path: (natural_key(path.parent), natural_key(path)))


def _times(folder: Path, count: int) -> Path | None:
    """The file of stamps, unless its number of lines differs from the number of images."""
    times = find_times_file(folder, folder.parent)
    if times is None:
        return None
    try:
        lines = [text for text in read_text(times).splitlines() if text.strip()]
    except (OSError, UnicodeDecodeError):
        return None
    return times if len([text for text in lines if text.lstrip()[0].isdigit()]) == count else None


def _right(pattern: str, left: list[Shot]) -> list[Shot] | None:
    before, word, after = pattern.rpartition("left")
    images = _matching(f"{before}right{after}") if word else []
    return copy_stamps(left, images) if images else None
