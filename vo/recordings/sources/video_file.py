"""Video files of one camera: decoded by PyAV, or by OpenCV where PyAV is not installed."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from vo.base.errors import MissingExtraError
from vo.base.extras import require
from vo.base.types import Mode
from vo.recordings.sources.assembly import RecordingContents, calibration_reader
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.listing import Shot

_log = logging.getLogger(__name__)


class VideoDecoder(Protocol):
    """Reads the frames of a video file."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    @property
    def stamps_ns(self) -> Sequence[int]:
        """Times of all frames in nanoseconds, increasing."""
        ...

    def read(self, index: int, colour: bool = False) -> Pixels:
        """Read a frame as (H, W) grey, or as (H, W, 3) BGR with `colour` if it has colour.

        Grey of more than 8 bits is uint16.

        Raises:
            SourceError: it cannot be decoded.
        """
        ...

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        ...


def gather_video(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the frames of a video."""
    decoder = open_decoder(path)
    shots = [
        Shot(stamp, _StoredFrame(decoder, i), f"frame {i} of {path}")
        for i, stamp in enumerate(decoder.stamps_ns)
    ]
    return RecordingContents(
        name=path.stem,
        format="video",
        left=shots,
        calibrate=calibration_reader(
            calibration, [path.with_suffix(".yaml"), path.parent / "calibration.yaml"]
        ),
        close=decoder.close,
        film=path,
    )


def open_decoder(path: Path) -> VideoDecoder:
    """The decoder of a video file."""
    try:
        require("av", extra="video", what="exact decoding and fast seeking")
    except MissingExtraError as missing:
        from vo.recordings.sources.opencv_video import OpenCvDecoder

        decoder = OpenCvDecoder(path)
        _log.warning("%s is decoded by OpenCV; %s", path, missing)
        return decoder
    from vo.recordings.sources.video import PyavDecoder

    return PyavDecoder(path)


@dataclass(frozen=True)
class _StoredFrame:
    """A `StoredImage` in a video file."""

    decoder: VideoDecoder
    index: int

    @property
    def name(self) -> str:
        return f"{self.index} of {self.decoder.path}"

    def read(self, colour: bool = False) -> Pixels:
        return self.decoder.read(self.index, colour)
