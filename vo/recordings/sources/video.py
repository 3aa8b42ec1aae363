"""Frames of video files with the time stamps of the container, decoded by PyAV."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame

from vo.base.errors import SourceError
from vo.base.types import Bytes
from vo.recordings.sources.video_index import open_video, read_index, video_stream

_THREADS = 2


class PyavDecoder:
    """Decodes frames sequentially, and seeks only if that saves decoding."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._index = read_index(path)
        self.stamps_ns = self._index.stamps_ns
        self._container: InputContainer | None = None
        self._frames: Iterator[tuple[int | None, VideoFrame]] = iter(())
        self._position: int | None = None  # ticks of the last decoded frame
        self._last_frame: VideoFrame | None = None

    def read(self, index: int, colour: bool = False) -> Bytes:
        """See `VideoDecoder.read`."""
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
        """See `VideoDecoder.close`."""
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
