"""Plain folders of images, or of left/ and right/, and images that match a pattern."""

from __future__ import annotations

import glob
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from vo.base.errors import CalibrationError, SourceError
from vo.base.faults import Fault
from vo.base.files.bounded_files import read_text
from vo.base.types import Mode
from vo.recordings.formats.calibration import Calibration, ImageSize
from vo.recordings.sources.assembly import RecordingContents, calibration_reader, tum_truth
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import (
    Shot,
    is_image_name,
    list_images,
    make_shots,
    natural_key,
    shots_from_names,
    shots_from_times,
)
from vo.recordings.sources.pairing import copy_stamps
from vo.recordings.sources.series import Series, find_cameras
from vo.recordings.sources.series_content import warn_of_turns

_log = logging.getLogger(__name__)

_ASSUMED_INTERVAL_NS = 100_000_000
_TIMES_FILES = ("times.txt", "timestamps.txt")
_DSO_CAMERA = "camera.txt"
_TRUTH_FILES = ("groundtruth.tum", "groundtruth.txt", "groundtruthSync.txt")


def gather_folder(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List images in natural order of their names, of the folder, of `left/` or of `images/`.

    Stamps come from times.txt or timestamps.txt (see `shots_from_times`), or else from the file
    names; otherwise 10 frames per second are assumed, with a warning.
    """
    is_pair = (path / "left").is_dir()
    left_folder = path / "left" if is_pair else _image_folder(path)
    times = find_times_file(path, left_folder)
    faults: list[Fault] = []
    images = list_images(left_folder)
    is_one = is_pair or (times is not None and _count_lines(times) == len(images))
    found = _cameras(images, path, times, faults, is_one=is_one)
    left = found.left
    depth = None if mode == "mono" else found.depth
    return RecordingContents(
        name=path.resolve().name,
        format="folder",
        left=left,
        right=_right(path / "right", left, found.named) if is_pair else found.right,
        depth=depth,
        calibrate=_calibration(
            depth,
            calibration,
            [
                path / "calibration.yaml",
                path.parent / "calibration.yaml",
                *([path / _DSO_CAMERA] if (path / _DSO_CAMERA).is_file() else []),
            ],
        ),
        read_truth=lambda _: tum_truth([path / name for name in _TRUTH_FILES]),
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


class _Listed(NamedTuple):
    """Images with stamps, and whether these come from the names."""

    left: list[Shot]
    named: bool
    right: list[Shot] | None = None
    depth: list[Shot] | None = None


def _cameras(
    images: Sequence[Path],
    where: Path | str,
    times: Path | None,
    faults: list[Fault],
    *,
    is_one: bool = False,
) -> _Listed:
    """The images by their cameras: all of one camera, or told apart by `find_cameras`."""
    if is_one:
        return _Listed(*assign_stamps(images, where, times, faults))
    cameras = find_cameras(images)
    if cameras.right is None and cameras.depth is None:
        warn_of_turns(cameras.left.images)
    one = cameras.left
    left, named = assign_stamps(one.images, where, times, faults, one.stems)
    return _Listed(
        left,
        named,
        _beside(cameras.right, one, left, named),
        _beside(cameras.depth, one, left, named),
    )


def _beside(series: Series | None, one: Series, left: list[Shot], named: bool) -> list[Shot] | None:
    """Images of another camera, with stamps of their own names, or of the images they go with."""
    if series is None:
        return None
    own = shots_from_names(series.images, series.stems) if named else None
    if own is not None:
        return own
    stamp_of = {shot.image.name: shot.stamp_ns for shot in left}
    shot_of = {key: stamp_of[str(image)] for key, image in zip(one.keys, one.images, strict=True)}
    found = [
        Shot(shot_of[key], ImageFile(image), f"file {image}")
        for key, image in zip(series.keys, series.images, strict=True)
        if key in shot_of
    ]
    return sorted(found, key=lambda shot: shot.stamp_ns)


def _calibration(
    depth: list[Shot] | None, chosen: Path | None, candidates: Sequence[Path]
) -> Callable[[ImageSize], Calibration]:
    """As `calibration_reader`; with depth images it has to state their unit."""
    read = calibration_reader(chosen, candidates)

    def with_unit(size: ImageSize) -> Calibration:
        found = read(size)
        if depth and found.depth_per_metre is None:
            raise CalibrationError(
                f"the unit of depth images such as {depth[0].image.name} is unknown: add "
                f"`depth_per_metre: 1000` (millimetres, as of most cameras) to {found.file}, or "
                "leave them out by `mode=mono`"
            )
        return found

    return with_unit


def assign_stamps(
    images: Sequence[Path],
    where: Path | str,
    times: Path | None,
    faults: list[Fault] | None = None,
    stems: Sequence[str] | None = None,
) -> tuple[list[Shot], bool]:
    """Assign stamps to images, from a file, their names, or an assumed frame rate.

    Returns:
        The images with stamps, and whether the stamps come from the names.
    """
    if times is not None:
        return shots_from_times(times, images, faults), False
    shots = shots_from_names(images, stems)
    if shots is not None:
        return shots, True
    _log.warning(
        "%s has no %s and no stamps in its file names: 10 frames per second are assumed",
        where,
        " or ".join(_TIMES_FILES),
    )
    stamps = range(0, len(images) * _ASSUMED_INTERVAL_NS, _ASSUMED_INTERVAL_NS)
    return make_shots(stamps, images, [f"file {image}" for image in images]), False


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
    times = _times(folder, len(images))
    found = _cameras(images, pattern, times, faults, is_one=times is not None)
    depth = None if mode == "mono" else found.depth
    return RecordingContents(
        name=folder.resolve().name,
        format="glob",
        left=found.left,
        right=found.right or _right_of_pattern(str(pattern), found.left),
        depth=depth,
        calibrate=_calibration(
            depth, calibration, [folder / "calibration.yaml", folder.parent / "calibration.yaml"]
        ),
        faults=faults,
    )


def _matching(pattern: str) -> list[Path]:
    found = (Path(name) for name in glob.glob(pattern, recursive=True))
    images = [path for path in found if is_image_name(path.name) and path.is_file()]
    return sorted(images, key=lambda path: (natural_key(path.parent), natural_key(path)))


def _times(folder: Path, count: int) -> Path | None:
    """The file of stamps, unless its number of lines differs from the number of images."""
    times = find_times_file(folder, folder.parent)
    return times if times is not None and _count_lines(times) == count else None


def _count_lines(times: Path) -> int:
    """The number of lines with a stamp; 0 if there is no such text."""
    try:
        lines = [text for text in read_text(times).splitlines() if text.strip()]
    except (OSError, UnicodeDecodeError):
        return 0
    return len([text for text in lines if text.lstrip()[0].isdigit()])


def _right_of_pattern(pattern: str, left: list[Shot]) -> list[Shot] | None:
    before, word, after = pattern.rpartition("left")
    images = _matching(f"{before}right{after}") if word else []
    return copy_stamps(left, images) if images else None
