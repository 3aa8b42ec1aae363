"""What every decoding of images with OpenCV needs: cut-off files found, and its log silenced."""

from __future__ import annotations

import threading

import cv2

from vo.base.images import png

JPEG = b"\xff\xd8"
_JPEG_END = b"\xff\xd9"
_JPEG_SCAN = 0xDA


class _QuietOpenCv:
    """Context manager that silences OpenCV's log, which would repeat our errors; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._level = 0

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                silent = cv2.utils.logging.LOG_LEVEL_SILENT
                self._level = cv2.utils.logging.setLogLevel(silent)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                cv2.utils.logging.setLogLevel(self._level)


quiet_opencv = _QuietOpenCv()
"""Silences OpenCV's log inside a `with` block."""


def is_complete(data: bytes) -> bool:
    """Whether a PNG or JPEG file is intact up to its end marker; True for other formats."""
    if data.startswith(png.SIGNATURE):
        return png.is_complete(data)
    if data.startswith(JPEG):
        return _jpeg_is_complete(data)
    return True


def _jpeg_is_complete(data: bytes) -> bool:
    """Find the end marker after the start of the first scan, past any embedded thumbnail."""
    position = len(JPEG)
    while position + 4 <= len(data) and data[position] == 0xFF:
        if data[position + 1] == _JPEG_SCAN:
            return data.find(_JPEG_END, position) >= 0
        position += 2 + int.from_bytes(data[position + 2 : position + 4], "big")
    return False
