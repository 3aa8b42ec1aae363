"""Network streams through PyAV, with the stream's own times."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence

import av
import numpy as np
from av.container import InputContainer
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from vo.base.errors import SourceError
from vo.base.types import Rig
from vo.recordings.sources.live.address import without_credentials
from vo.recordings.sources.live.clock import CaptureStamps, HostClock
from vo.recordings.sources.live.device import CapturedImages
from vo.recordings.sources.live.http_stream import HttpFile, HttpHosts
from vo.recordings.sources.video import choose_track

_OPEN_TIMEOUT_S, _READ_TIMEOUT_S = 5.0, 5.0
# Over TCP, because lost packets of UDP damage images; without buffers, which would delay them.
_OPTIONS = {
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
    "analyzeduration": "1000000",  # microseconds
    # Without `file`: a playlist from the network must not name files of this machine.
    "protocol_whitelist": "rtsp,rtsps,rtp,srtp,udp,tcp,tls,http,https,httpproxy,rtmp,rtmps,srt",
}
_MIN_LAG_NS, _MAX_LAG_NS = 1_500_000_000, 60_000_000_000  # more is a clock that was set
_MIN_LATE = 60  # images in a row: a network that stalls once catches up
_INVENTED_TIMES = {"mpjpeg", "mjpeg"}  # formats without times, to which a rate of 25/s is given

_log = logging.getLogger(__name__)
logging.getLogger("libav").addHandler(logging.NullHandler())


class PyAvStream:
    """A `Device` for a network stream.

    `allow_hosts`: to which HTTP may lead besides its own.
    """

    def __init__(self, url: str, clock: HostClock, allow_hosts: Sequence[str] = ()) -> None:
        self.rig: Rig | None = None
        self._http: HttpFile | None = None
        self._allow_hosts = allow_hosts
        self._name = without_credentials(url)
        self._clock = clock
        self._stamps = CaptureStamps()
        self._late = 0  # images in a row that came late
        self._container = self._open(url)
        try:
            self._frames = self._begin(url)
        except SourceError:
            self.close()
            raise

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        try:
            frame = next(self._frames, None)
        except (av.FFmpegError, OSError) as error:
            raise SourceError(f"{self._name}: {_reason(error)}") from error
        if frame is None:
            raise SourceError(f"{self._name}: the stream ended")
        arrival_ns = self._clock.now_ns()
        own_ns = None
        if self._has_times and frame.pts is not None and frame.time_base is not None:
            own_ns = int(frame.pts * frame.time_base * 1_000_000_000)
        stamp_ns = self._stamps.stamp(arrival_ns, own_ns)
        self._warn_of_lag()
        return CapturedImages(stamp_ns, (np.ascontiguousarray(frame.to_ndarray(format="gray")),))

    def _warn_of_lag(self) -> None:
        lag_ns = self._stamps.lag_ns
        self._late = self._late + 1 if _MIN_LAG_NS < lag_ns < _MAX_LAG_NS else 0
        if self._late != _MIN_LATE:
            return
        _log.warning(
            "%s: images come %.1f s later than at first, and so do poses: this machine or the "
            "network is too slow for the stream; choose a smaller one",
            self._name,
            1e-9 * lag_ns,
        )

    def close(self) -> None:
        """See `Device.close`."""
        self._container.close()
        if self._http is not None:
            self._http.close()

    def _open(self, url: str) -> InputContainer:
        timeouts = (_OPEN_TIMEOUT_S, _READ_TIMEOUT_S)
        try:
            if not url.lower().startswith("http"):
                return av.open(url, options=_OPTIONS, timeout=timeouts)
            hosts = HttpHosts(url, self._allow_hosts, _READ_TIMEOUT_S)
            self._http = file = hosts.open(url)
            options = {**_OPTIONS, "http_persistent": "0"}
            return av.open(
                file, "r", format=file.format, options=options, timeout=timeouts, io_open=hosts.open
            )
        except (av.FFmpegError, OSError, ValueError) as error:
            raise SourceError(f"{self._name} cannot be opened: {_reason(error)}") from error

    def _begin(self, url: str) -> Iterator[VideoFrame]:
        """The frames, as they come."""
        if not self._container.streams.video:
            raise SourceError(f"{self._name} has no video")
        if url.lower().startswith("http") and (self._container.duration or 0) > 0:
            raise SourceError(f"{self._name} is a file: download it, and run on the file")
        stream = choose_track(self._container.streams.video)
        stream.thread_type = "SLICE"  # threads that work on several frames delay them
        self._has_times = self._container.format.name not in _INVENTED_TIMES
        return (frame for frame in self._decoded(stream) if not frame.is_corrupt)

    def _decoded(self, stream: VideoStream) -> Iterator[VideoFrame]:
        for packet in self._container.demux(stream):
            try:
                yield from packet.decode()
            except av.InvalidDataError:  # until the first key frame, and after lost packets
                continue


def _reason(error: Exception) -> str:
    if isinstance(error, av.ExitError | TimeoutError):
        return f"no answer for {_READ_TIMEOUT_S:g} s"
    return without_credentials(getattr(error, "strerror", None) or str(error))
