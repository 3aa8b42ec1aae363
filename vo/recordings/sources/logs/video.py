"""Video in the messages of a log: H.264 and H.265, one message per frame."""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import av
from av.codec import CodecContext
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame

from vo.base.errors import SourceError
from vo.base.images.image_header import MAX_PIXELS
from vo.recordings.formats.messages import CompressedVideoMessage, video_decoder
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.logs.log import Entry, Log, Topic
from vo.recordings.sources.video import frame_pixels

_START = re.compile(rb"\x00\x00\x01")
_MAX_KEYFRAME_DISTANCE = 600
"""Messages searched backwards for a key frame; 20 s at 30 Hz."""

_MAX_DELAY = 16
"""Messages sent to the decoder without an output before a frame counts as missing."""


class LogVideo:
    """The frames of a topic, decoded sequentially.

    A frame out of sequence is decoded from the last key frame before it.
    """

    def __init__(self, log: Log, topic: Topic, entries: Sequence[Entry]) -> None:
        self.log = log
        self.topic = topic
        self._entries = entries
        self._lock = threading.Lock()
        self._decoder: VideoCodecContext | None = None
        self._next_input = 0  # number of the next message for the decoder
        self._next_output = 0  # number of the frame after the last one that was read
        self._decoded: dict[int, VideoFrame] = {}

    def read(self, number: int, colour: bool = False) -> Pixels:
        """Read a frame as (H, W) grey, or as (H, W, 3) with `colour` if it has colour."""
        with self._lock:
            try:
                return frame_pixels(self._read(number), colour)
            except (av.FFmpegError, SourceError) as error:
                self._decoder = None
                raise SourceError(f"the video frame cannot be decoded: {error}") from error

    def _read(self, number: int) -> VideoFrame:
        self._seek(number)
        while number not in self._decoded:
            if self._next_input > number + _MAX_DELAY:
                raise SourceError("the decoder returned no frame")
            self._send_message()
        frame = self._decoded[number]
        self._next_output = number + 1
        self._decoded = {n: kept for n, kept in self._decoded.items() if n > number}
        return frame

    def _seek(self, number: int) -> None:
        """Restart the decoder at a key frame, unless decoding on reaches the frame earlier."""
        is_ahead = self._decoder is not None and number >= self._next_output
        if is_ahead and number <= self._next_input:
            return
        start = self._keyframe_before(number)
        if not is_ahead or start > self._next_input:
            self._restart(start)

    def _send_message(self) -> None:
        """Send the next message to the decoder, or flush the decoder at the end."""
        assert self._decoder is not None
        packet = None
        if self._next_input < len(self._entries):
            packet = av.Packet(self._message(self._next_input).data)
            packet.pts = packet.dts = self._next_input
        for frame in self._decoder.decode(packet):
            if frame.pts is not None and not frame.is_corrupt:
                self._decoded[frame.pts] = frame
        self._next_input += 1 if packet is not None else _MAX_DELAY + 1

    def _restart(self, number: int) -> None:
        decoder = CodecContext.create(_name(self._message(number).codec), "r")
        assert isinstance(decoder, VideoCodecContext)
        decoder.options = {"max_pixels": str(MAX_PIXELS)}
        decoder.thread_count = 1  # several threads would delay frames
        self._decoder, self._decoded = decoder, {}
        self._next_input = self._next_output = number

    def _keyframe_before(self, number: int) -> int:
        for at in range(number, max(-1, number - _MAX_KEYFRAME_DISTANCE), -1):
            message = self._message(at)
            if is_keyframe(message.data, message.codec):
                return at
        raise SourceError("there is no key frame before it")

    def _message(self, number: int) -> CompressedVideoMessage:
        message = self.topic.codec.decode(self.log.read(self._entries[number]))
        if not isinstance(message, CompressedVideoMessage):
            raise SourceError("an image among frames of a video")
        return message


@dataclass(frozen=True, eq=False)
class VideoImage:
    """A `StoredImage` in a video of a log."""

    video: LogVideo
    number: int
    entry: Entry = field(repr=False)

    @property
    def name(self) -> str:
        """Topic and log time, as shown by other tools."""
        video = self.video
        return f"{video.log.path}: {video.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Pixels:
        """See `StoredImage.read`."""
        try:
            return self.video.read(self.number, colour)
        except SourceError as error:
            raise SourceError(f"image {self.name}: {error}") from error


def is_keyframe(data: bytes, codec: str) -> bool:
    """Whether decoding can start at a frame: it begins with parameter sets or a key picture.

    Source: ITU-T H.264, table 7-1; H.265, table 7-1 (types of NAL units).
    """
    is_h264 = _name(codec) == "h264"
    for start in _START.finditer(data):
        if start.end() >= len(data):
            return False
        first = data[start.end()]
        kind = first & 0x1F if is_h264 else (first >> 1) & 0x3F
        if kind in (5, 7) if is_h264 else 16 <= kind <= 21 or kind in (32, 33):
            return True
        if kind in (1, 2) if is_h264 else kind < 16:
            return False  # slice of a picture that is not a key picture
    return False


def _name(codec: str) -> str:
    """Name of the decoder."""
    name = video_decoder(codec)
    if not name:
        raise SourceError(f"unknown video codec '{codec}'; h264 and h265 are supported")
    return name
