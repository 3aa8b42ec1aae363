"""Plain folders of images, or of left/ and right/."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

from vo.base.errors import SourceError
from vo.base.faults import Fault
from vo.base.types import Mode, Trajectory
from vo.recordings.formats.trajectory import read_tum
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, first_existing
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot, is_image_name, list_images
from vo.recordings.sources.naming import shots_from_names
from vo.recordings.sources.pairing import copy_stamps
from vo.recordings.sources.times_table import shots_from_times

_log = logging.getLogger(__name__)

_ASSUMED_INTERVAL_NS = 100_000_000
_TIMES_FILES = ("times.txt", "timestamps.txt")
_DSO_CAMERA = "camera.txt"


def gather_folder(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List images in natural order of their names, of the folder, of `left/` or of `images/`.

    Stamps come from times.txt or timestamps.txt (see `shots_from_times`), or else from the file
    names; otherwise 10 frames per second are assumed, with a warning.
    """
    is_pair = (path / "left").is_dir()
    left_folder = path / "left" if is_pair else _image_folder(path)
    times = find_times_file(path, left_folder)
    faults: list[Fault] = []
    left, named = assign_stamps(list_images(left_folder), path, times, faults)
    return RecordingContents(
        name=path.resolve().name,
        format="folder",
        left=left,
        right=_right(path / "right", left, named) if is_pair else None,
        calibrate=calibration_reader(
            calibration,
            [
                path / "calibration.yaml",
                path.parent / "calibration.yaml",
                *([path / _DSO_CAMERA] if (path / _DSO_CAMERA).is_file() else []),
            ],
        ),
        read_truth=lambda _: _truth(path),
        faults=faults,
    )


def _image_folder(path: Path) -> Path:
    """The folder `images` of a data set such as TUM monoVO, which has a picture beside it."""
    inside = path / "images"
    if inside.is_dir() and (find_times_file(path) is not None or not _has_images(path)):
        return inside
    packed = path / "images.zip"
    if packed.is_file() and find_times_file(path) is not None:
        raise SourceError(f"{packed} is packed: unzip it to a folder {inside}")
    return path


def _has_images(path: Path) -> bool:
    return any(is_image_name(entry.name) for entry in path.iterdir())


def assign_stamps(
    images: Sequence[Path],
    where: Path | str,
    times: Path | None,
    faults: list[Fault] | None = None,
) -> tuple[list[Shot], bool]:
    """Assign stamps to images, from a file, their names, or an assumed frame rate.

    Returns:
        The images with stamps, and whether the stamps come from the names.
    """
    if times is not None:
        return shots_from_times(times, images, faults), False
    shots = shots_from_names(images)
    if shots is not None:
        return shots, True
    _log.warning(
        "%s has no %s and no stamps in its file names: 10 frames per second are assumed",
        where,
        " or ".join(_TIMES_FILES),
    )
    return [
        Shot(i * _ASSUMED_INTERVAL_NS, ImageFile(image), f"file {image}")
        for i, image in enumerate(images)
    ], False


def find_times_file(*folders: Path) -> Path | None:
    """The first file of stamps in some folders, or None; reading it fails if it is a pipe."""
    candidates = [folder / name for folder in folders for name in _TIMES_FILES]
    return next((path for path in candidates if path.exists() and not path.is_dir()), None)


def _right(folder: Path, left: list[Shot], named: bool) -> list[Shot] | None:
    """The right images, with stamps from their names if the left stamps come from names too."""
    try:
        images = list_images(folder)
    except SourceError:
        return None
    own = shots_from_names(images) if named else None
    return copy_stamps(left, images) if own is None else own


def _truth(path: Path) -> Trajectory | None:
    names = ("groundtruth.tum", "groundtruth.txt", "groundtruthSync.txt")
    file = first_existing([path / name for name in names])
    return None if file is None else read_tum(file)
