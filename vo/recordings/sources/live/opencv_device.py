"""Cameras of this machine, and network streams, through OpenCV."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import cv2

from vo.base.errors import SourceError
from vo.base.images.image_decoding import quiet_opencv
from vo.base.types import Rig
from vo.recordings.formats.calibration import ImageSize
from vo.recordings.sources.images import Pixels
from vo.recordings.sources.live.address import without_credentials
from vo.recordings.sources.live.clock import CaptureStamps, HostClock
from vo.recordings.sources.live.device import CapturedImages, as_grey
from vo.recordings.sources.opencv_video import silence_ffmpeg

_TIMEOUT_MS = 5000
_LARGE = 640 * 480  # pixels; more of them do not fit through USB 2 at 30 frames/s unless packed
_NS_PER_MS = 1e6


class VideoCapture(Protocol):
    """The part of `cv2.VideoCapture` that is used."""

    def isOpened(self) -> bool:
        """Whether images can be read."""
        ...

    def set(self, property: int, value: float) -> bool:
        """Request a value of a property."""
        ...

    def get(self, property: int) -> float:
        """Value of a property, 0 if it has none."""
        ...

    def read(self) -> tuple[bool, Pixels | None]:
        """Wait for the next image; whether there is one, and the image."""
        ...

    def release(self) -> None:
        """Close the device."""
        ...


OpenCapture = Callable[..., VideoCapture]


class OpenCvDevice:
    """A `Device` around an opened capture.

    Args:
        has_times: whether the capture's own times can be used for stamps.
    """

    def __init__(
        self, name: str, capture: VideoCapture, clock: HostClock, *, has_times: bool
    ) -> None:
        self.rig: Rig | None = None
        self._name = name
        self._capture = capture
        self._clock = clock
        self._has_times = has_times
        self._stamps = CaptureStamps()

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        try:
            with quiet_opencv:
                is_read, image = self._capture.read()
                arrival_ns = self._clock.now_ns()
                own_ms = self._capture.get(cv2.CAP_PROP_POS_MSEC) if self._has_times else 0.0
        except cv2.error as error:
            raise SourceError(f"{self._name} cannot be read: {error.err}") from error
        if not is_read or image is None:
            raise SourceError(f"{self._name} gives no more images")
        own_ns = round(own_ms * _NS_PER_MS) if own_ms > 0 else None
        return CapturedImages(self._stamps.stamp(arrival_ns, own_ns), (as_grey(image),))

    def close(self) -> None:
        """See `Device.close`."""
        self._capture.release()


def open_camera(
    target: str, size: ImageSize | None, clock: HostClock, open_capture: OpenCapture | None = None
) -> OpenCvDevice:
    """Open a camera of this machine.

    `size`: width and height to request; None for the camera's default.
    """
    name = f"camera:{target}" if target.isdigit() else target
    capture = _opened(
        open_capture,
        [_number(target)],
        f"{name} cannot be opened: there is no such camera, another program uses it, or this user "
        "may not",
    )
    if size is not None:
        width, height = size
        if width * height > _LARGE:
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, height)
    return OpenCvDevice(name, capture, clock, has_times=True)


def open_opencv_stream(
    url: str, clock: HostClock, open_capture: OpenCapture | None = None
) -> OpenCvDevice:
    """Connect to a network stream."""
    name = without_credentials(url)
    timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _TIMEOUT_MS]
    timeouts += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, _TIMEOUT_MS]
    capture = _opened(
        open_capture, [url, cv2.CAP_FFMPEG, timeouts], f"{name} does not answer, or gives no video"
    )
    # Times of an HTTP stream are often invented by the decoder, from a nominal rate.
    return OpenCvDevice(name, capture, clock, has_times=url.lower().startswith("rtsp"))


def _number(target: str) -> int | str:
    """The number of a camera; its file if that is no usual one."""
    if target.isdigit():
        return int(target)
    real = os.path.realpath(target)  # of a link such as /dev/v4l/by-id/...
    match = re.fullmatch(r"/dev/video(\d+)", real)
    return real if match is None else int(match[1])


def _opened(
    open_capture: OpenCapture | None, arguments: Sequence[Any], problem: str
) -> VideoCapture:
    silence_ffmpeg()
    try:
        with quiet_opencv:
            capture: VideoCapture = (open_capture or cv2.VideoCapture)(*arguments)
            if capture.isOpened():
                return capture
            capture.release()
    except cv2.error as error:
        raise SourceError(f"{problem} ({error.err})") from error
    raise SourceError(problem)
