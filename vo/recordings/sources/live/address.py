"""Addresses of live sources, as given to `vo run`."""

from __future__ import annotations

import re
from enum import StrEnum

from vo.base.errors import SourceError
from vo.base.frozen import frozen


class LiveKind(StrEnum):
    """Kind of a live source; the value is the word before the colon of its address."""

    CAMERA = "camera"
    NETWORK = "network"
    REALSENSE = "realsense"
    OAK = "oak"
    ZED = "zed"


_CAMERA_FILE = re.compile(r"/dev/(video\d+|v4l/by-(id|path)/[^,/]+)")
_URL = re.compile(r"(rtsps?|rtmps?|https?|udp|rtp|srt|tcp)://.", re.IGNORECASE)
_NEXT = re.compile(r",(?=[a-z]+://|/dev/|\d+$)", re.IGNORECASE)
_USER = re.compile(r"://[^\s,]*@")
_SECRET = re.compile(r"(?<=[?&])([^=&\s]*(?:pass|pwd|token|key|secret|auth)[^=&\s]*)=[^&\s]*", re.I)
_MAX_CAMERAS = 2


@frozen()
class LiveAddress:
    """Where the images come from.

    Attributes:
        targets: for a camera, numbers or device files; for a network stream, URLs; otherwise
            a serial number, or nothing for the first device. Two are a stereo pair, left first.
    """

    kind: LiveKind
    targets: tuple[str, ...]

    @property
    def public_name(self) -> str:
        """The address as printed and written to files: without passwords."""
        text = ",".join(self.targets)
        if self.kind is not LiveKind.NETWORK:
            text = f"{self.kind.value}:{text}" if text else self.kind.value
        return without_credentials(text)


def parse_address(text: str) -> LiveAddress | None:
    """The live source that a text names, None if it is a path.

    `camera:0`, `camera:/dev/video0` and `/dev/video0` are cameras of this machine, `rtsp://…` and
    `http://…` streams; `camera:0,1` and `rtsp://a,rtsp://b` pairs; `realsense:`, `oak:` and `zed:`
    stereo cameras, with an optional serial number.
    """
    if _URL.match(text):
        return _checked(LiveAddress(LiveKind.NETWORK, tuple(_NEXT.split(text))))
    if _CAMERA_FILE.match(text):
        return _checked(LiveAddress(LiveKind.CAMERA, tuple(text.split(","))))
    word, colon, rest = text.partition(":")
    kinds = {kind.value: kind for kind in LiveKind if kind is not LiveKind.NETWORK}
    if not colon or word not in kinds:
        return None
    if kinds[word] is LiveKind.CAMERA:
        return _checked(LiveAddress(LiveKind.CAMERA, tuple(rest.split(","))))
    return LiveAddress(kinds[word], (rest,) if rest else ())


def without_credentials(text: str) -> str:
    """A text with `***` in place of the passwords and keys in its URLs."""

    def hide(match: re.Match[str]) -> str:
        user = match.group()[3:-1].partition(":")[0]
        return f"://{user}:***@" if ":" in match.group()[3:] else "://***@"

    return _SECRET.sub(r"\1=***", _USER.sub(hide, text))


def _checked(address: LiveAddress) -> LiveAddress:
    if len(address.targets) > _MAX_CAMERAS:
        raise SourceError(
            f"{address.public_name} names {len(address.targets)} cameras; give one, or two as a "
            "stereo pair"
        )
    for target in address.targets:
        is_known = _CAMERA_FILE.fullmatch(target) or target.isascii() and target.isdigit()
        if address.kind is LiveKind.CAMERA and not is_known:
            raise SourceError(
                f"camera '{target}' is neither a number nor a device file; use camera:0 or "
                "/dev/video0, and camera:0,1 for a stereo pair"
            )
        if address.kind is LiveKind.NETWORK and not _URL.match(target):
            raise SourceError(
                f"{address.public_name}: a pair is two URLs, such as rtsp://host/left,"
                "rtsp://host/right"
            )
    return address
