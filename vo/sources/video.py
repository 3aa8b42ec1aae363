"""Video files: frames with the times that the container gives them, of one camera."""

from __future__ import annotations

import bisect
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from vo.errors import SourceError
from vo.sources.assembly import Gathered, find_calibration
from vo.sources.listing import Shot
from vo.types import Bytes, Mode

_log = logging.getLogger(__name__)
_THREADS = 2


class _Index(NamedTuple):
    """Times of all frames and of those that decoding can begin at, in nanoseconds and in ticks."""

    stamps_ns: list[int]
    ticks: list[int]
    keys: list[int]


def gather_video(path: Path, calibration: Path | None, mode: Mode) -> Gathered:
    """List a video; of several pictures in it, the first is taken.

    Raises:
        SourceError: it cannot be opened or holds no frame.
        CalibrationError: there is no calibration, or it is wrong.
    """
    index = _list_frames(path)
    decoder = _Decoder(path, index)
    shots = [
        Shot(stamp, _StoredFrame(decoder, i), f"frame {i} of {path}")
        for i, stamp in enumerate(index.stamps_ns)
    ]
    return Gathered(
        name=path.stem,
        format="video",
        left=shots,
        right=None,
        calibrate=find_calibration(
            calibration, [path.with_suffix(".yaml"), path.parent / "calibration.yaml"]
        ),
        read_truth=lambda _: None,
        close=decoder.close,
    )


@dataclass(frozen=True)
class _StoredFrame:
    """A `StoredImage` in a video."""

    decoder: _Decoder
    index: int

    @property
    def name(self) -> str:
        return f"{self.index} of {self.decoder.path}"

    def read(self, colour: bool = False) -> Bytes:
        return self.decoder.read(self.index, colour)


class _Decoder:
    """Decodes on from frame to frame, and jumps only where that saves decoding."""

    def __init__(self, path: Path, index: _Index) -> None:
        self.path = path
        self._index = index
        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._reached: int | None = None  # ticks of the newest frame that was decoded
        self._newest: VideoFrame | None = None

    def read(self, index: int, colour: bool = False) -> Bytes:
        """A frame as (H, W) grey, or (H, W, 3) where `colour` is wanted and there.

        Raises:
            SourceError: it cannot be decoded.
        """
        wanted = self._index.ticks[index]
        try:
            self._go_near(wanted)
            frame = self._newest
            while frame is None or frame.pts is None or frame.pts < wanted:
                frame = self._newest = next(self._frames)
                self._reached = frame.pts if frame.pts is not None else self._reached
        except StopIteration:
            raise SourceError(f"frame {index} of {self.path} is missing: the video ends") from None
        except (av.FFmpegError, OSError) as error:
            self.close()
            raise SourceError(f"frame {index} of {self.path} is damaged: {error}") from error
        if frame.pts != wanted:
            raise SourceError(f"frame {index} of {self.path} is damaged")
        # Phones record upright pictures lying down, and note by how much to turn them.
        upright = np.rot90(frame_pixels(frame, colour), round(frame.rotation / 90))
        return np.ascontiguousarray(upright, dtype=np.uint8)

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        self._frames, self._newest, self._reached = iter(()), None, None
        if self._container is not None:
            self._container.close()
        self._container = None

    def _go_near(self, wanted: int) -> None:
        """Jump to the key frame before a time, unless decoding is already between the two."""
        at = bisect.bisect_right(self._index.keys, wanted)
        key = self._index.keys[at - 1] if at else self._index.ticks[0]
        reached = key - 1 if self._reached is None else self._reached
        if self._container is not None and key <= reached <= wanted:
            return
        if self._container is None:
            self._container = av.open(str(self.path))
            _video_stream(self.path, self._container).codec_context.thread_count = _THREADS
            _video_stream(self.path, self._container).thread_type = "AUTO"
        stream = _video_stream(self.path, self._container)
        self._container.seek(key, stream=stream)
        self._newest, self._reached = None, None
        self._frames = _decoded(self._container, stream)


def frame_pixels(frame: VideoFrame, colour: bool) -> Bytes:
    """A decoded frame as (H, W) grey, or (H, W, 3) blue, green, red, if wanted and there."""
    is_grey = not colour or frame.format.name.startswith("gray")
    return np.ascontiguousarray(frame.to_ndarray(format="gray" if is_grey else "bgr24"))


def _decoded(container: InputContainer, stream: VideoStream) -> Iterator[VideoFrame]:
    """The frames from here on, without those that damage has reached."""
    for packet in container.demux(stream):
        try:
            frames = packet.decode()
        except av.InvalidDataError:
            continue
        yield from (frame for frame in frames if not frame.is_corrupt)


def _list_frames(path: Path) -> _Index:
    """Times of all frames, from the container alone: nothing is decoded."""
    ticks: set[int] = set()
    keys: set[int] = set()
    try:
        with av.open(str(path)) as container:
            stream = _video_stream(path, container)
            unit = stream.time_base
            try:
                for packet in container.demux(stream):
                    time = packet.pts if packet.pts is not None else packet.dts
                    if time is None or not packet.size or packet.is_discard:
                        continue
                    ticks.add(time)
                    if packet.is_keyframe:
                        keys.add(time)
            except av.FFmpegError as error:
                _log.warning("%s is damaged after %d frames: %s", path, len(ticks), error)
    except (av.FFmpegError, OSError) as error:
        raise SourceError(
            f"{path} cannot be opened as a video: {error.strerror or error}; if it was cut off, "
            "an MP4 is lost, as it is written at the very end how to read it"
        ) from error
    if not ticks or unit is None:
        raise SourceError(f"{path} holds no video frame")
    ordered = sorted(ticks)
    to_ns = partial(_nanoseconds, numerator=unit.numerator, denominator=unit.denominator)
    return _Index([to_ns(time) for time in ordered], ordered, sorted(keys))


def _nanoseconds(ticks: int, numerator: int, denominator: int) -> int:
    """Rounded to the nearest, without floating point."""
    return (2 * ticks * numerator * 1_000_000_000 + denominator) // (2 * denominator)


def _video_stream(path: Path, container: InputContainer) -> VideoStream:
    if not container.streams.video:
        raise SourceError(f"{path} holds no video")
    return container.streams.video[0]
