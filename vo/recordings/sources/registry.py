"""Known formats of recordings, their detection, and `open_source`."""

from __future__ import annotations

import fnmatch
import glob
import importlib
import logging
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from vo.base.errors import SourceError
from vo.base.files.bounded_files import lfs_pointer_message
from vo.base.types import Mode
from vo.recordings.formats.foreign_files import foreign_message
from vo.recordings.sources.assembly import RecordingContents, assemble
from vo.recordings.sources.listing import IMAGE_SUFFIXES, is_image_name
from vo.recordings.sources.live.address import parse_address
from vo.recordings.sources.side_by_side import not_side_by_side, split_side_by_side
from vo.recordings.sources.source import Recording

if TYPE_CHECKING:
    from vo.recordings.sources.logs.log import Log

_log = logging.getLogger(__name__)
_MAX_ENTRIES = 1000

Gather = Callable[[Path, Path | None, Mode], RecordingContents]
"""Lists a recording that is no log, given path, calibration and mode."""


class Format(NamedTuple):
    """Detection and opening of a format.

    Attributes:
        opener: `module:function` of a `Gather`, or `module:class` of a `Log`; imported on demand.
        folder_patterns: names or patterns; a folder of this format contains at least one of them.
        suffixes: suffixes of single files of this format.
        has_topics: whether it is a log.
        can_grow: whether it can be read while it is being written.
    """

    opener: str
    folder_patterns: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    has_topics: bool = False
    can_grow: bool = False


_SCENES = "sample_data.json"
VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg")

FORMATS: dict[str, Format] = {
    "mcap": Format(
        "vo.recordings.sources.mcap.file:McapFile",
        suffixes=(".mcap",),
        has_topics=True,
        can_grow=True,
    ),
    "rosbag1": Format(
        "vo.recordings.sources.bags.ros1:Bag", suffixes=(".bag", ".active"), has_topics=True
    ),
    "kitti": Format("vo.recordings.sources.kitti:gather_kitti", ("image_0", "image_2")),
    "kitti_raw": Format(
        "vo.recordings.sources.kitti_raw:gather_kitti_raw", ("image_00", "image_02")
    ),
    "4seasons": Format(
        "vo.recordings.sources.four_seasons:gather_four_seasons", ("undistorted_images",)
    ),
    "euroc": Format("vo.recordings.sources.euroc:gather_euroc", ("mav0", "cam0")),
    "tum": Format(
        "vo.recordings.sources.tum:gather_tum", ("rgb.txt", "assoc*.txt", "rgbd_assoc*.txt")
    ),
    "tartanair": Format(
        "vo.recordings.sources.tartanair:gather_tartanair", ("image_left", "image_lcam_front")
    ),
    "rosbag2": Format(
        "vo.recordings.sources.bags.ros2:Bag",
        ("metadata.yaml", "*.db3", "*.db3.zstd", "*_0.mcap"),
        suffixes=(".db3",),
        has_topics=True,
    ),
    "nerf": Format(
        "vo.recordings.sources.nerf:gather_nerf",
        ("transforms.json", "transforms_train.json"),
        (".json",),
    ),
    "nuscenes": Format("vo.recordings.sources.nuscenes:gather_nuscenes", (_SCENES,)),
    "glob": Format("vo.recordings.sources.folder:gather_glob"),
    "video": Format("vo.recordings.sources.clip:gather_clip", suffixes=VIDEO_SUFFIXES),
    "folder": Format(
        "vo.recordings.sources.folder:gather_folder",
        ("left", *(f"*{s}" for s in IMAGE_SUFFIXES), "images", "images.zip"),
    ),
    "stray": Format("vo.recordings.sources.clip:gather_stray", ("camera_matrix.csv",)),
}
"""Formats in the order of detection: the first that matches a path is used."""


def open_source(
    path: Path | str,
    *,
    format: str | None = None,
    calibration: Path | str | None = None,
    mode: Mode = "auto",
    topics: Sequence[str] = (),
    follow: bool = False,
    right_offset_ns: int | None = None,
    side_by_side: bool = False,
) -> Recording:
    """Open a recording.

    Args:
        path: folder or file of the recording.
        format: a key of `FORMATS`; by default detected from the path.
        calibration: file that overrides the recording's own calibration.
        mode: `mono` ignores the right camera, `stereo` requires it, `auto` uses it if there is
            one with a calibration.
        topics: topics of a log, `left=/a` and `right=/b`, or one name; by default detected.
        follow: whether it is still being written; frames are then read as they arrive.
        right_offset_ns: added to the stamps of right images before they are paired; by default 0,
            or the offset that all right stamps have against left ones.
        side_by_side: whether each image has the left and the right one beside each other.

    Raises:
        SourceError: the recording is missing, empty, damaged or of unknown format.
        CalibrationError: its calibration is missing or invalid.
    """
    path = Path(path)
    name = choose_format(path, format)
    _log.info("%s: recording of format %s", path, name)
    chosen = None if calibration is None else Path(calibration)
    if side_by_side and (follow or FORMATS[name].has_topics):
        raise not_side_by_side(path, name)
    if follow and not FORMATS[name].can_grow:
        growing = ", ".join(n for n, entry in FORMATS.items() if entry.can_grow)
        raise SourceError(f"{path} ({name}) cannot be followed; these formats can: {growing}")
    if FORMATS[name].has_topics:
        from vo.recordings.sources.logs.opening import open_log
        from vo.recordings.sources.mcap.follow import open_growing

        if follow:
            return open_growing(path, chosen, mode, topics, right_offset_ns)
        log = open_container(path, name)
        return open_log(log, name, chosen, mode, topics, right_offset_ns)
    if topics:
        raise SourceError(f"{path} ({name}) has no topics; leave `topics` out")
    contents = gather(path, name, chosen, mode)
    if side_by_side:
        contents = split_side_by_side(contents)
    return assemble(replace(contents, right_offset_ns=right_offset_ns), mode)


def gather(path: Path, name: str, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List a recording of a format without topics; no image is read."""
    return cast(Gather, _load(FORMATS[name].opener))(path, calibration, mode)


def open_container(path: Path, name: str) -> Log:
    """Open a log of a format with topics, whatever its topics are."""
    return cast("Log", _load(FORMATS[name].opener)(path))


def choose_format(path: Path, format: str | None) -> str:
    """The format chosen by the user, or else the one detected from the path."""
    _refuse_live(path)
    if not path.exists() and not _is_pattern(path) and not _is_scene(path):
        raise SourceError(f"{path} does not exist; give the folder or file of a recording")
    if path.exists() and not path.is_file() and not path.is_dir():  # opening it may never end
        raise SourceError(f"{path} is neither a file nor a folder; a pipe is read with `-`")
    _refuse_lfs_pointer(path)
    name = detect_format(path) if format is None else format
    _refuse_foreign(path, by_name=False)
    if name not in FORMATS:
        raise SourceError(f"format '{name}' is unknown; known formats: {', '.join(FORMATS)}")
    return name


def detect_format(path: Path) -> str:
    """The name of the first format that matches a path."""
    if not path.exists() and _is_pattern(path):
        return "glob"
    if not path.exists() and _is_scene(path):
        return "nuscenes"
    _refuse_lfs_pointer(path)
    names = [entry.name.lower() for entry in path.iterdir()] if path.is_dir() else []
    for name, entry in FORMATS.items():
        if any(fnmatch.filter(names, pattern) for pattern in entry.folder_patterns):
            return name
        if path.is_file() and path.suffix.lower() in entry.suffixes:
            return name
    _refuse_foreign(path)
    if path.is_file():
        raise SourceError(f"{path} is a file of unknown format; give the folder of a recording")
    if not path.is_dir():
        raise SourceError(f"{path} is neither a file nor a folder; a pipe is read with `-`")
    inside = [entry for entry in sorted(path.iterdir()) if entry.is_dir() and _has_images(entry)]
    if inside:
        others = f", or of {', '.join(e.name for e in inside[1:4])}" if inside[1:] else ""
        raise SourceError(
            f"folder {path} has no images, but folders with images: give {inside[0]}{others}"
        )
    looked_for = ", ".join(
        f"{entry.folder_patterns[0]} ({n})" for n, entry in FORMATS.items() if entry.folder_patterns
    )
    raise SourceError(
        f"folder {path} has no images and is not a recording of a known format; looked for "
        f"{looked_for} and images ({' '.join(IMAGE_SUFFIXES)})"
    )


def _refuse_live(path: Path) -> None:
    # A path has one slash of the two in a URL.
    address = parse_address(re.sub(r"^(\w+):/(?!/)", r"\1://", str(path)))
    if address is not None:
        raise SourceError(
            f"{address.public_name} is live: `vo run` reads it, and with `record=FILE.mcap` it "
            "keeps the images for other commands"
        )


def _refuse_lfs_pointer(path: Path) -> None:
    message = lfs_pointer_message(path)
    if message:
        raise SourceError(message)


def _has_images(folder: Path) -> bool:
    return any(is_image_name(entry.name) for entry in islice(folder.iterdir(), _MAX_ENTRIES))


def _refuse_foreign(path: Path, *, by_name: bool = True) -> None:
    message = foreign_message(path, by_name=by_name) if by_name or path.is_file() else ""
    if message:
        raise SourceError(message)


def _is_pattern(path: Path) -> bool:
    return glob.has_magic(str(path))


def _is_scene(path: Path) -> bool:
    """Whether a path names a scene in a folder of nuScenes' tables."""
    return not path.exists() and (path.parent / _SCENES).is_file()


def _load(name: str) -> Callable[..., Any]:
    module, _, attribute = name.partition(":")
    return cast("Callable[..., Any]", getattr(importlib.import_module(module), attribute))
