"""Frames of video files with the time stamps of the container, decoded by PyAV."""

from __future__ import annotations

import bisect
import logging
import re
import shlex
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from av.container import InputContainer
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from vo.base.errors import SourceError
from vo.base.images.image_header import MAX_PIXELS
from vo.recordings.sources.images import Pixels

_NOT_A_VIEW = re.compile(r"depth|disparity|mask|confidence", re.IGNORECASE)
_THREADS = 2
_log = logging.getLogger(__name__)
# Without playlists (HLS, DASH, ffconcat), which name other files.
_DEMUXERS = "mov,matroska,webm,avi,mpeg,mpegvideo,mpegts,m4v,h264,hevc"


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

    def read(self, index: int, colour: bool = False) -> Pixels:
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
        return np.ascontiguousarray(upright)

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


def frame_pixels(frame: VideoFrame, colour: bool) -> Pixels:
    """A decoded frame as (H, W) grey, or as (H, W, 3) BGR with `colour` if it has colour.

    Grey of more than 8 bits is uint16.
    """
    name = "bgr24" if colour else "gray"
    if frame.format.name.startswith("gray"):
        name = "gray16le" if _grey_bits(frame.format.name) > 8 else "gray"
    return np.ascontiguousarray(frame.to_ndarray(format=name))


class VideoIndex(NamedTuple):
    """Times of the frames of a video.

    Attributes:
        stamps_ns: times of all frames, in nanoseconds, increasing.
        ticks: the same in units of the container.
        keys: times of the key frames in ticks; without display times, those at which their group
            of pictures begins.
        packet_ticks: increasing times of all packets in the order of the file, if these are not
            times of display; frames then get the times in the order in which the decoder returns
            them. Empty if each frame has its time.
        by_decode_time: whether `packet_ticks` are the packets' times of decoding (DTS), not of
            presentation (PTS).
    """

    stamps_ns: list[int]
    ticks: list[int]
    keys: list[int]
    packet_ticks: list[int]
    by_decode_time: bool

    def seek(self, container: InputContainer, stream: VideoStream, key: int) -> None:
        """Seek so that `decoded` returns all frames from a key frame on, perhaps some before.

        Without display times, decoding starts one key frame earlier: pictures that follow a key
        frame in the file but are shown before it need the group of pictures before.
        """
        if self.packet_ticks:
            before = max(bisect.bisect_left(self.keys, key) - 1, 0)
            key = self.packet_ticks[self.ticks.index(self.keys[before])]
        container.seek(key, stream=stream)

    def decoded(
        self, container: InputContainer, stream: VideoStream
    ) -> Iterator[tuple[int | None, VideoFrame]]:
        """Decode the frames from the current position, with their times, without corrupt ones."""
        if self.packet_ticks:
            yield from self._decoded_in_order(container, stream)
            return
        for packet in container.demux(stream):
            try:
                frames = packet.decode()
            except av.InvalidDataError:
                continue
            yield from ((frame.pts, frame) for frame in frames if not frame.is_corrupt)

    def _decoded_in_order(
        self, container: InputContainer, stream: VideoStream
    ) -> Iterator[tuple[int, VideoFrame]]:
        """Decode frames, and assign times by counting.

        Packets are numbered; decoders return the number with the frame. All packets before a key
        frame are shown before it and before those that follow it, so the first frame returned of
        its group of pictures is the one at the key frame's place in the file.
        """
        number_of = {tick: i for i, tick in enumerate(self.packet_ticks)}
        place_of = {tick: i for i, tick in enumerate(self.ticks)}
        starts = sorted({0, *(place_of[key] for key in self.keys)})
        first, counted_from = -1, -1
        place: int | None = None
        for packet in container.demux(stream):
            time = packet.dts if self.by_decode_time else packet.pts
            number = None if time is None else number_of.get(time)
            if number is not None:
                first = number if first < 0 else first
                packet.pts = number
            try:
                frames = packet.decode()
            except av.InvalidDataError:
                continue
            for frame in frames:
                if frame.pts is not None:
                    group = starts[bisect.bisect_right(starts, max(frame.pts, 0)) - 1]
                    if group > counted_from and (group > first or first == 0):
                        place = counted_from = group
                if place is not None and place < len(self.ticks):
                    if not frame.is_corrupt:
                        yield self.ticks[place], frame
                    place += 1


class _Packet(NamedTuple):
    """Times of a packet in ticks, None if unknown, and whether it is a key frame."""

    display: int | None
    decode: int | None
    is_key: bool


def open_video(path: Path) -> InputContainer:
    """Open a file, whatever its name looks like, and no other file or address that it names.

    Raises:
        FFmpegError: it is not a video of a known kind.
        OSError: it cannot be read.
    """
    options = {"protocol_whitelist": "file", "format_whitelist": _DEMUXERS}
    container = av.open(f"file:{path.absolute()}", options=options, metadata_errors="replace")
    for stream in container.streams.video:
        if stream.codec_context is not None:
            stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
    return container


def read_index(path: Path) -> VideoIndex:
    """List the times of all frames, without decoding."""
    packets: list[_Packet] = []
    try:
        with open_video(path) as container:
            stream = video_stream(path, container)
            _warn_of_tracks(path, container.streams.video, stream)
            unit = stream.time_base
            codec = stream.codec_context
            may_reorder = bool(codec.has_b_frames)
            is_avi, is_mpeg4 = container.format.name == "avi", codec.name == "mpeg4"
            try:
                for packet in container.demux(stream):
                    if packet.size and not packet.is_discard:
                        packets.append(_Packet(packet.pts, packet.dts, packet.is_keyframe))
            except av.FFmpegError as error:
                _log.warning("%s is damaged after %d frames: %s", path, len(packets), error)
    except av.ArgumentError as error:
        raise SourceError(
            f"{path} is not a video of a known kind (MP4, MKV, AVI, MPEG), or a list of other files"
        ) from error
    except (av.FFmpegError, OSError) as error:
        raise SourceError(
            f"{path} cannot be opened as a video: {error.strerror or error}; a truncated MP4 file "
            "cannot be recovered, because its index is written at the end"
        ) from error
    displays = [packet.display for packet in packets]
    by_decode_time = is_avi or not _increases(displays)
    packet_ticks = [packet.decode for packet in packets] if by_decode_time else displays
    # Times of display would not increase from packet to packet. AVI has none, and those of MPEG-4
    # Part 2 are wrong where a packet contains two pictures (`packed bitstream` of DivX and XviD).
    lacks_times = not by_decode_time or is_avi or is_mpeg4 or None in displays
    if may_reorder and lacks_times and _increases(packet_ticks):
        ticks, keys = _times_by_count(packets)
    else:
        ticks, keys = _times_of_packets(packets)
        packet_ticks = []
    if not ticks or unit is None:
        raise SourceError(f"{path} has no video frames")
    to_ns = partial(_nanoseconds, numerator=unit.numerator, denominator=unit.denominator)
    return VideoIndex(
        [to_ns(time) for time in ticks],
        ticks,
        keys,
        [tick for tick in packet_ticks if tick is not None],
        by_decode_time,
    )


def _increases(times: list[int | None]) -> bool:
    """Whether all times are known and each is later than the one before."""
    known = [time for time in times if time is not None]
    return len(known) == len(times) and all(a < b for a, b in pairwise(known))


def _times_by_count(packets: list[_Packet]) -> tuple[list[int], list[int]]:
    """One time per packet, and the times at the places of key frames."""
    display = {packet.display for packet in packets if packet.display is not None}
    decode = [packet.decode for packet in packets if packet.decode is not None]
    ticks = sorted(display) if len(display) == len(packets) else decode
    keys = [tick for tick, packet in zip(ticks, packets, strict=True) if packet.is_key]
    return ticks, keys


def _times_of_packets(packets: list[_Packet]) -> tuple[list[int], list[int]]:
    """The times of all packets and of key frames; the decoding time replaces a missing one."""
    ticks: set[int] = set()
    keys: set[int] = set()
    for packet in packets:
        time = packet.display if packet.display is not None else packet.decode
        if time is not None:
            ticks.add(time)
            if packet.is_key:
                keys.add(time)
    return sorted(ticks), sorted(keys)


def _nanoseconds(ticks: int, numerator: int, denominator: int) -> int:
    """Convert ticks to nanoseconds, rounded to nearest, in integer arithmetic."""
    return (2 * ticks * numerator * 1_000_000_000 + denominator) // (2 * denominator)


def video_stream(path: Path, container: InputContainer) -> VideoStream:
    """The chosen track (see `choose_track`)."""
    if not container.streams.video:
        raise SourceError(f"{path} has no video stream")
    stream = choose_track(container.streams.video)
    if stream.codec_context is None:
        raise SourceError(f"{path} is compressed by an unknown codec")
    return stream


def choose_track(tracks: Sequence[VideoStream]) -> VideoStream:
    """The first track in colour, else in grey of 8 bits, else of 16; depth and covers come last."""
    return min(tracks, key=_track_order)


def _track_order(track: VideoStream) -> tuple[bool, bool, int]:
    is_depth = bool(_NOT_A_VIEW.search(track.metadata.get("title", "")))
    return _is_cover(track), is_depth, _grey_bits(_pixel_format(track))


def _is_cover(track: VideoStream) -> bool:
    return bool(track.disposition & Disposition.attached_pic)


def _pixel_format(track: VideoStream) -> str:
    return (track.codec_context and track.codec_context.pix_fmt) or "unknown"


def _grey_bits(pixel_format: str) -> int:
    """Bits of a grey pixel; 0 for colour."""
    if not pixel_format.startswith("gray"):
        return 0
    return int("".join(filter(str.isdigit, pixel_format)) or 8)


def _warn_of_tracks(path: Path, tracks: Sequence[VideoStream], used: VideoStream) -> None:
    """Warn of several tracks, and say how to use another one."""
    others = [i for i, track in enumerate(tracks) if track is not used and not _is_cover(track)]
    if not others:
        return
    listed = [
        f"{i} ({', '.join(filter(None, [track.metadata.get('title'), _pixel_format(track)]))})"
        for i, track in enumerate(tracks)
    ]
    copied = path.with_name(f"{path.stem}-{others[0]}.mkv")
    _log.warning(
        "%s has %d video tracks: %s; track %d is used; for another one, `%s` copies it to a file",
        path,
        len(tracks),
        ", ".join(listed),
        list(tracks).index(used),
        shlex.join(
            ["ffmpeg", "-i", str(path), "-map", f"0:v:{others[0]}", "-c", "copy", str(copied)]
        ),
    )
