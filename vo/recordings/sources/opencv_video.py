"""Frames of video files, decoded by OpenCV, for installations without PyAV.

Times are those of the container, rounded to a nanosecond, but counted from the beginning of the
stream, which may be later than that of the file. OpenCV converts to grey by way of BGR, which
changes grey levels by a few units. It cannot list frames without decoding them, nor seek exactly:
a file is decoded once to list its frames, and from its beginning to go back.
"""

from __future__ import annotations

import logging
import math
import os
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.images.image_decoding import quiet_opencv
from vo.base.images.image_header import MAX_PIXELS
from vo.base.types import Bytes

_log = logging.getLogger(__name__)
_HEAD_BYTES = 12
_QUICKTIME_BOXES = (b"ftyp", b"moov", b"mdat", b"free", b"wide", b"skip")  # first ones of MP4
_MATROSKA = b"\x1aE\xdf\xa3"
_MPEG = (b"\x00\x00\x01\xba", b"\x00\x00\x01\xb3")  # pack and sequence headers
_MAX_DAMAGED_FRAMES = 300
"""Damaged frames in a row after which a video ends; OpenCV does not tell damage from the end."""

_FFMPEG_QUIET = "-8"
_NS_PER_MS, _NS_PER_S = 1e6, 1_000_000_000


class OpenCvDecoder:
    """Decodes frames sequentially."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._capture: cv2.VideoCapture | None = None
        self._next = 0  # index of the next frame that is decoded
        _check_kind(path)
        self.stamps_ns = _list_stamps(path)

    def read(self, index: int, colour: bool = False) -> Bytes:
        """See `VideoDecoder.read`."""
        if self._capture is None or index < self._next:
            self.close()
            self._capture = _open(self.path)
        decoded = [_decode_next(self._capture) for _ in range(index + 1 - self._next)]
        is_read, image = self._capture.retrieve()
        self._next = index + 1
        if None in decoded or not is_read:
            self.close()
            raise SourceError(f"frame {index} of {self.path} cannot be decoded")
        is_grey = image.ndim == 2
        if not colour and not is_grey:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return np.ascontiguousarray(image, dtype=np.uint8)

    def close(self) -> None:
        """See `VideoDecoder.close`."""
        if self._capture is not None:
            self._capture.release()
        self._capture, self._next = None, 0


def _check_kind(path: Path) -> None:
    """Refuse what is no video by its first bytes, above all lists that name other files."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        raise SourceError(
            f"{path} cannot be opened as a video: {error.strerror or error}"
        ) from error
    is_known = (
        head[4:8] in _QUICKTIME_BOXES
        or head[:4] in (_MATROSKA, *_MPEG)
        or (head[:4] == b"RIFF" and head[8:12] == b"AVI ")
    )
    if not is_known:
        raise SourceError(
            f"{path} cannot be opened as a video: it is not MP4, MOV, MKV, WebM, AVI or MPEG"
        )


def _open(path: Path) -> cv2.VideoCapture:
    """Open a file."""
    silence_ffmpeg()
    with quiet_opencv:
        capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise SourceError(
            f"{path} cannot be opened as a video; a truncated MP4 file cannot be recovered, "
            "because its index is written at the end"
        )
    pixels = capture.get(cv2.CAP_PROP_FRAME_WIDTH) * capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    if pixels > MAX_PIXELS:
        capture.release()
        raise SourceError(f"{path} has pictures of {pixels:.0f} pixels, more than {MAX_PIXELS}")
    return capture


def silence_ffmpeg() -> None:
    """Keep OpenCV's FFmpeg from printing damaged pictures, and addresses, on standard error.

    To be called before every video or stream is opened: the first one of a process counts.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _FFMPEG_QUIET)


def _list_stamps(path: Path) -> list[int]:
    """Times of all frames, by decoding them."""
    capture = _open(path)
    stamps_ns: list[int] = []
    damaged = 0
    while (failures := _decode_next(capture)) is not None:
        damaged += failures
        stamps_ns.append(round(capture.get(cv2.CAP_PROP_POS_MSEC) * _NS_PER_MS))
    rate_hz = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    if not stamps_ns:
        raise SourceError(f"{path} has no video frames that OpenCV can decode")
    if damaged:
        _log.warning("%s is damaged: %d frames cannot be decoded", path, damaged)
    if all(a < b for a, b in pairwise(stamps_ns)):
        return stamps_ns
    if not (math.isfinite(rate_hz) and rate_hz > 0.0):
        raise SourceError(f"{path} has frames without times, and no frame rate")
    _log.warning(
        "%s has frames without times of display; their times follow from its rate of %g Hz",
        path,
        rate_hz,
    )
    return [round(number * _NS_PER_S / rate_hz) for number in range(len(stamps_ns))]


def _decode_next(capture: cv2.VideoCapture) -> int | None:
    """Decode the next intact frame; the number of damaged ones before it, None at the end."""
    for failures in range(_MAX_DAMAGED_FRAMES):
        if capture.grab():
            return failures
    return None
