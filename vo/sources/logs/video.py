"""Video in the messages of a log: H.264 and H.265, a message for every frame."""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field

import av
from av.codec import CodecContext
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame

from vo.errors import SourceError
from vo.formats.messages import CompressedVideoMessage
from vo.sources.logs.log import Entry, Log, Topic
from vo.sources.video import frame_pixels
from vo.types import Bytes

_CODECS = {"h264": "h264", "avc": "h264", "h265": "hevc", "hevc": "hevc"}
_START = re.compile(rb"\x00\x00\x01")
_LONGEST_GROUP = 600
"""Messages looked back through for a frame that can be decoded by itself; 20 s at 30 Hz."""

_MOST_WAITING = 16
"""Messages a decoder may be given before it has to hand out a frame."""


class LogVideo:
    """The frames of a topic, decoded on from one to the next.

    A frame that is asked for out of turn is decoded from the last one before it that stands alone.
    """

    def __init__(self, log: Log, topic: Topic, entries: Sequence[Entry]) -> None:
        self.log = log
        self.topic = topic
        self._entries = entries
        self._lock = threading.Lock()
        self._decoder: VideoCodecContext | None = None
        self._next = 0  # number of the message that the decoder is to be given
        self._due = 0  # number of the frame that it has not handed out yet
        self._decoded: dict[int, VideoFrame] = {}

    def read(self, number: int, colour: bool = False) -> Bytes:
        """The frame of a message as (H, W) grey, or (H, W, 3) where `colour` is wanted and there.

        Raises:
            SourceError: it is damaged, or no frame before it can be decoded by itself.
        """
        with self._lock:
            try:
                return frame_pixels(self._read(number), colour)
            except (av.FFmpegError, SourceError) as error:
                self._decoder = None
                raise SourceError(f"the video frame cannot be decoded: {error}") from error

    def _read(self, number: int) -> VideoFrame:
        self._go_near(number)
        while number not in self._decoded:
            if self._next > number + _MOST_WAITING:
                raise SourceError("the decoder gave no frame for it")
            self._feed()
        frame = self._decoded[number]
        self._due = number + 1
        self._decoded = {n: kept for n, kept in self._decoded.items() if n > number}
        return frame

    def _go_near(self, number: int) -> None:
        """Begin anew, unless going on from where the decoder is leads to the frame sooner."""
        is_ahead = self._decoder is not None and number >= self._due
        if is_ahead and number <= self._next:
            return
        start = self._standing_alone(number)
        if not is_ahead or start > self._next:
            self._begin_at(start)

    def _feed(self) -> None:
        """Give the decoder the next message, or tell it that there is none."""
        assert self._decoder is not None
        packet = None
        if self._next < len(self._entries):
            packet = av.Packet(self._message(self._next).data)
            packet.pts = packet.dts = self._next
        for frame in self._decoder.decode(packet):
            if frame.pts is not None and not frame.is_corrupt:
                self._decoded[frame.pts] = frame
        self._next += 1 if packet is not None else _MOST_WAITING + 1

    def _begin_at(self, number: int) -> None:
        decoder = CodecContext.create(_name(self._message(number).codec), "r")
        assert isinstance(decoder, VideoCodecContext)
        decoder.thread_count = 1  # several would hold frames back
        self._decoder, self._next, self._due, self._decoded = decoder, number, number, {}

    def _standing_alone(self, number: int) -> int:
        for at in range(number, max(-1, number - _LONGEST_GROUP), -1):
            message = self._message(at)
            if stands_alone(message.data, message.codec):
                return at
        raise SourceError("the video begins in the middle: no frame before can be decoded alone")

    def _message(self, number: int) -> CompressedVideoMessage:
        message = self.topic.codec.decode(self.log.read(self._entries[number]))
        assert isinstance(message, CompressedVideoMessage)
        return message


@dataclass(frozen=True, eq=False)
class VideoImage:
    """A `StoredImage` in a video in a log."""

    video: LogVideo
    number: int
    entry: Entry = field(repr=False)

    @property
    def name(self) -> str:
        """Topic and time of logging, as other tools show it."""
        video = self.video
        return f"{video.log.path}: {video.topic.name} logged at {self.entry.log_ns} ns"

    def read(self, colour: bool = False) -> Bytes:
        """The frame as `StoredImage.read` has it; also raises as that does."""
        try:
            return self.video.read(self.number, colour)
        except SourceError as error:
            raise SourceError(f"image {self.name}: {error}") from error


def stands_alone(data: bytes, codec: str) -> bool:
    """Whether a frame begins with what a decoder needs to start: parameters or a key picture.

    Raises:
        SourceError: the codec is not known.

    Source: ITU-T H.264, table 7-1; H.265, table 7-1.
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
            return False  # the picture has begun
    return False


def _name(codec: str) -> str:
    """What the decoder is called."""
    name = codec.strip().lower()
    if name not in _CODECS:
        raise SourceError(f"video is encoded as '{codec}'; h264 and h265 are known")
    return _CODECS[name]
