"""Pictures and plots as files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from vo.base.errors import OutputError
from vo.base.extras import require
from vo.base.files.complete_file import writing
from vo.base.types import Bytes, Ints

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov")
_PLOT_SUFFIXES = (".png", ".pdf", ".svg")


def check_picture(path: Path) -> None:
    """Check the name of a picture.

    Raises:
        OutputError: unsupported suffix.
    """
    if path.suffix.lower() not in _PICTURE_SUFFIXES:
        raise OutputError(f"{path} must end in {', '.join(_PICTURE_SUFFIXES)}, which are written")


def write_picture(path: Path, picture: Bytes, suffix: str = "") -> None:
    """Write a grey or BGR picture, in the format of its own or this suffix, and its folder.

    Raises:
        OutputError: the file cannot be written.
    """
    data = cv2.imencode(suffix or path.suffix.lower(), picture)[1].tobytes()
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def is_video(path: Path) -> bool:
    """Whether a name is that of a video."""
    return path.suffix.lower() in VIDEO_SUFFIXES


def check_video(path: Path) -> None:
    """Check the name of a video.

    Raises:
        OutputError: unsupported suffix.
    """
    if not is_video(path):
        raise OutputError(f"{path} must end in {', '.join(VIDEO_SUFFIXES)}, which are written")


def write_video(path: Path, pictures: Iterator[Bytes], stamps_ns: Ints) -> int:
    """Write pictures (H, W, 3) BGR as a video, and its folder; returns their number.

    `stamps_ns`: of frames, whose median distance is that of the pictures.

    Raises:
        OutputError: the file cannot be written.
    """
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    steps = np.diff(stamps_ns)
    rate = 1e9 / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 10.0
    writer: cv2.VideoWriter | None = None
    count = 0
    for picture in pictures:
        height, width = picture.shape[:2]
        if writer is None:
            codec = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix.lower() == ".avi" else "mp4v"))
            size = width, height
            writer = cv2.VideoWriter(str(path), codec, float(np.clip(rate, 1, 240)), size)
            if not writer.isOpened():
                raise OutputError(f"{path} cannot be written; choose another file")
        writer.write(picture)
        count += 1
    if writer is not None:
        writer.release()
    return count


def check_plot(path: Path, kind: str = "plot", what: str = "plots") -> None:
    """Check that a plot can be made, before the figures for it are computed.

    Raises:
        OutputError: unsupported suffix.
        MissingExtraError: matplotlib is not installed.
    """
    if path.suffix.lower() not in _PLOT_SUFFIXES:
        raise OutputError(f"{path}: unsupported kind of {kind}; use {', '.join(_PLOT_SUFFIXES)}")
    require("matplotlib", extra="report", what=what)


@contextmanager
def saved_figure(
    path: Path,
    width: float,
    height: float,
    *,
    dpi: int = 100,
    layout: Literal["constrained"] | None = "constrained",
) -> Iterator[Figure]:
    """A figure of this size in inches, without a window, written when the block ends.

    Raises:
        OutputError: the file cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=dpi, layout=layout)
    FigureCanvasAgg(figure)
    yield figure
    with writing(path):
        figure.savefig(path)
