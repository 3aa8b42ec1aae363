"""The known formats, and the way from a path to a source."""

from __future__ import annotations

import fnmatch
import glob
import importlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, cast

from vo.errors import SourceError
from vo.sources.listing import IMAGE_SUFFIXES
from vo.sources.source import Source
from vo.types import Mode

Opener = Callable[..., Source]
"""Takes path, calibration (Path or None) and mode; logs take the chosen topics as a fourth."""


class Format(NamedTuple):
    """How to open a format and how to know it.

    Attributes:
        opener: `module:function` of an `Opener`, imported when it is needed.
        inside: names or patterns of which a folder of this format holds at least one.
        suffixes: of single files of this format.
        has_topics: whether it is a log, of which topics can be chosen.
        can_grow: whether it can be followed while it is being written.
    """

    opener: str
    inside: tuple[str, ...] = ()
    suffixes: tuple[str, ...] = ()
    has_topics: bool = False
    can_grow: bool = False


VIDEO_SUFFIXES = (".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg")

FORMATS: dict[str, Format] = {
    "mcap": Format(
        "vo.sources.mcap.source:open_mcap", suffixes=(".mcap",), has_topics=True, can_grow=True
    ),
    "rosbag1": Format(
        "vo.sources.bags.ros1:open_rosbag1", suffixes=(".bag", ".active"), has_topics=True
    ),
    "kitti": Format("vo.sources.kitti:open_kitti", ("image_0", "image_2")),
    "kitti_raw": Format("vo.sources.kitti_raw:open_kitti_raw", ("image_00", "image_02")),
    "euroc": Format("vo.sources.euroc:open_euroc", ("mav0", "cam0")),
    "tum": Format("vo.sources.tum:open_tum", ("rgb.txt",)),
    "rosbag2": Format(
        "vo.sources.bags.ros2:open_rosbag2",
        ("metadata.yaml", "*.db3", "*.db3.zstd", "*_0.mcap"),
        suffixes=(".db3",),
        has_topics=True,
    ),
    "glob": Format("vo.sources.glob:open_glob"),
    "video": Format("vo.sources.video:open_video", suffixes=VIDEO_SUFFIXES),
    "folder": Format("vo.sources.folder:open_folder", ("left", *(f"*{s}" for s in IMAGE_SUFFIXES))),
}
"""Asked in this order; the first that knows the path has it."""


def open_source(
    path: Path | str,
    *,
    format: str | None = None,
    calibration: Path | str | None = None,
    mode: Mode = "auto",
    topics: Sequence[str] = (),
    follow: bool = False,
) -> Source:
    """Open a recording.

    Args:
        path: folder or file of the recording.
        format: a key of `FORMATS`; by default found out from the path.
        calibration: file that overrides the recording's own calibration.
        mode: `mono` ignores the right camera, `stereo` insists on it, `auto` uses it if there is
            one with a calibration.
        topics: of a log, `left=/a` and `right=/b`, or one name alone; by default found out.
        follow: whether it is still being written; frames are then handed out as they come.

    Raises:
        SourceError: the recording is missing, empty, damaged or of no known format.
        CalibrationError: its calibration is missing or cannot be true.
    """
    path = Path(path)
    if not path.exists() and not _is_pattern(path):
        raise SourceError(f"{path} does not exist; give the folder of a recording")
    name = detect_format(path) if format is None else format
    if name not in FORMATS:
        raise SourceError(f"format '{name}' is not known; known are {', '.join(FORMATS)}")
    chosen = None if calibration is None else Path(calibration)
    open_it = _load(FORMATS[name].opener)
    if follow:
        if not FORMATS[name].can_grow:
            growing = ", ".join(n for n, known in FORMATS.items() if known.can_grow)
            raise SourceError(f"{path} ({name}) cannot be followed; what can is {growing}")
        return open_it(path, chosen, mode, topics, follow=True)
    if FORMATS[name].has_topics:
        return open_it(path, chosen, mode, topics)
    if topics:
        raise SourceError(f"{path} ({name}) has no topics; leave --topic out")
    return open_it(path, chosen, mode)


def detect_format(path: Path) -> str:
    """The name of the first format that knows the path.

    Raises:
        SourceError: none does.
    """
    if not path.exists() and _is_pattern(path):
        return "glob"
    names = [entry.name.lower() for entry in path.iterdir()] if path.is_dir() else []
    for name, known in FORMATS.items():
        if any(fnmatch.filter(names, pattern) for pattern in known.inside):
            return name
        if path.is_file() and path.suffix.lower() in known.suffixes:
            return name
    if path.is_file():
        raise SourceError(f"{path} is a file of no known kind; give the folder of a recording")
    looked_for = ", ".join(
        f"{known.inside[0]} ({n})" for n, known in FORMATS.items() if known.inside
    )
    raise SourceError(
        f"folder {path} holds no images and no recording of a known format; looked for "
        f"{looked_for} and images ({' '.join(IMAGE_SUFFIXES)})"
    )


def _is_pattern(path: Path) -> bool:
    return glob.has_magic(str(path))


def _load(opener: str) -> Opener:
    module, _, function = opener.partition(":")
    return cast(Opener, getattr(importlib.import_module(module), function))
