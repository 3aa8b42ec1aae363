"""Pictures, plots and videos (H.264 by PyAV, or MPEG-4 by OpenCV without it) as files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Literal

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
_MIN_RATE, _MAX_RATE = 1.0, 240.0
_QUALITY = "20"  # of H.264: constant rate factor


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
    steps = np.diff(stamps_ns)
    rate = 1e9 / float(np.median(steps)) if len(steps) and np.median(steps) > 0 else 10.0
    with VideoFile(path, rate) as video:
        for picture in pictures:
            video.write(picture)
    return video.count


class VideoFile:
    """A video that grows; complete up to the last image if it is closed early.

    Raises:
        OutputError: in `write`: it cannot be written.
    """

    def __init__(self, path: Path, rate: float) -> None:
        self.path, self.count = path, 0
        self._rate = float(np.clip(rate, _MIN_RATE, _MAX_RATE))
        self._writer: _PyavWriter | _OpencvWriter | None = None

    def write(self, image: Bytes) -> None:
        """Add a BGR image (H, W, 3); all are of the size of the first, made even."""
        height, width = (side + side % 2 for side in image.shape[:2])
        if image.shape[:2] != (height, width):
            down, right = height - image.shape[0], width - image.shape[1]
            image = np.pad(image, ((0, down), (0, right), (0, 0)), mode="edge")
        pyav = _pyav()
        failures = (OSError,) if pyav is None else (OSError, pyav.FFmpegError)
        try:
            if self._writer is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                make = _OpencvWriter if pyav is None else _PyavWriter
                self._writer = make(self.path, self._rate, (width, height), pyav)
            self._writer.write(image)
        except failures as error:
            raise OutputError(
                f"{self.path} cannot be written: {error}; choose another `output`"
            ) from error
        self.count += 1

    def close(self) -> None:
        """Finish the file."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _pyav() -> ModuleType | None:
    try:
        import av
    except ImportError:
        return None
    return av if "libx264" in av.codecs_available else None


class _PyavWriter:
    def __init__(self, path: Path, rate: float, size: tuple[int, int], av: Any) -> None:
        self._av = av
        self._container = av.open(f"file:{path.absolute()}", "w")
        self._stream = self._container.add_stream(
            "libx264", rate=Fraction(rate).limit_denominator(1000)
        )
        self._stream.width, self._stream.height = size
        self._stream.pix_fmt = "yuv420p"  # what all players show
        self._stream.options = {"crf": _QUALITY, "preset": "fast"}

    def write(self, image: Bytes) -> None:
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="bgr24")
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()


class _OpencvWriter:
    def __init__(self, path: Path, rate: float, size: tuple[int, int], _: Any) -> None:
        codec = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix.lower() == ".avi" else "mp4v"))
        self._writer = cv2.VideoWriter(str(path), codec, rate, size)
        if not self._writer.isOpened():
            raise OSError("OpenCV has no encoder; pip install 'visual-odometry[video]'")

    def write(self, image: Bytes) -> None:
        self._writer.write(image)

    def close(self) -> None:
        self._writer.release()


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
