"""Video files of one camera, with the time stamps of the container."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame

from vo.errors import SourceError
from vo.sources.assembly import RecordingContents, calibration_reader
from vo.sources.listing import Shot
from vo.sources.video_index import VideoIndex, open_video, read_index, video_stream
from vo.types import Bytes, Mode

_THREADS = 2


def gather_video(path: Path, calibration: Path | None, mode: Mode) -> RecordingContents:
    """List the frames of the first video stream.

    Raises:
        SourceError: the file cannot be opened or has no frames.
        CalibrationError: the calibration is missing or invalid.
    """
    index = read_index(path)
    decoder = _Decoder(path, index)
    shots = [
        Shot(stamp, _StoredFrame(decoder, i), f"frame {i} of {path}")
        for i, stamp in enumerate(index.stamps_ns)
    ]
    return RecordingContents(
        name=path.stem,
        format="video",
        left=shots,
        right=None,
        calibrate=calibration_reader(
            calibration, [path.with_suffix(".yaml"), path.parent / "calibration.yaml"]
        ),
        read_truth=lambda _: None,
        close=decoder.close,
    )


@dataclass(frozen=True)
class _StoredFrame:
    """A `StoredImage` in a video file."""

    decoder: _Decoder
    index: int

    @property
    def name(self) -> str:
        return f"{self.index} of {self.decoder.path}"

    def read(self, colour: bool = False) -> Bytes:
        return self.decoder.read(self.index, colour)


class _Decoder:
    """Decodes frames sequentially, and seeks only if that saves decoding."""

    def __init__(self, path: Path, index: VideoIndex) -> None:
        self.path = path
        self._index = index
        self._container: InputContainer | None = None
        self._frames: Iterator[tuple[int | None, VideoFrame]] = iter(())
        self._position: int | None = None  # ticks of the last decoded frame
        self._last_frame: VideoFrame | None = None

    def read(self, index: int, colour: bool = False) -> Bytes:
        """Read a frame as (H, W) grey, or as (H, W, 3) with `colour` if it has colour.

        Raises:
            SourceError: it cannot be decoded.
        """
        target = self._index.ticks[index]
        try:
            self._seek(target)
            frame = self._last_frame
            while frame is None or self._position is None or self._position < target:
                position, frame = next(self._frames)
                self._last_frame = frame
                self._position = position if position is not None else self._position
        except StopIteration:
            raise SourceError(f"frame {index} of {self.path} is missing: the video ends") from None
        except (av.FFmpegError, OSError) as error:
            self.close()
            raise SourceError(f"frame {index} of {self.path} is damaged: {error}") from error
        if self._position != target:
            raise SourceError(f"frame {index} of {self.path} is damaged")
        # Phones store upright images rotated, with the angle in the metadata.
        upright = np.rot90(frame_pixels(frame, colour), round(frame.rotation / 90))
        return np.ascontiguousarray(upright, dtype=np.uint8)

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        self._frames, self._last_frame, self._position = iter(()), None, None
        if self._container is not None:
            self._container.close()
        self._container = None

    def _seek(self, target: int) -> None:
        """Seek the key frame before a time, unless the decoder is already between the two."""
        at = bisect.bisect_right(self._index.keys, target)
        key = self._index.keys[at - 1] if at else self._index.ticks[0]
        position = key - 1 if self._position is None else self._position
        if self._container is not None and key <= position <= target:
            return
        if self._container is None:
            self._container = open_video(self.path)
            video_stream(self.path, self._container).codec_context.thread_count = _THREADS
            video_stream(self.path, self._container).thread_type = "AUTO"
        stream = video_stream(self.path, self._container)
        self._index.seek(self._container, stream, key)
        self._last_frame, self._position = None, None
        self._frames = self._index.decoded(self._container, stream)


def frame_pixels(frame: VideoFrame, colour: bool) -> Bytes:
    """A decoded frame as (H, W) grey, or as (H, W, 3) BGR with `colour` if it has colour."""
    is_grey = not colour or frame.format.name.startswith("gray")
    return np.ascontiguousarray(frame.to_ndarray(format="gray" if is_grey else "bgr24"))
