"""Stand-ins for cameras: devices and captures that give numbered images."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import cv2
import numpy as np

from vo.base.errors import SourceError
from vo.base.types import Rig
from vo.recordings.sources.live.device import CapturedImages


def numbered(number: int, shape: tuple[int, int] = (8, 8)) -> np.ndarray:
    return np.full(shape, number % 256, dtype=np.uint8)


class FakeDevice:
    """Gives images as fast as they are taken from `gate`, and fails after `end` of them."""

    def __init__(self, end: int | None = None, first: int = 0) -> None:
        self.gate = threading.Semaphore(0)
        self.is_closed = False
        self.rig: Rig | None = None
        self._end, self._number = end, first

    def read(self) -> CapturedImages:
        if self._end is not None and self._number >= self._end:
            raise SourceError("the cable was pulled")
        if not self.gate.acquire(timeout=5.0):
            raise SourceError("nothing came")
        self._number += 1
        return CapturedImages(1000 * self._number, (numbered(self._number),))

    def close(self) -> None:
        self.is_closed = True

    def give(self, count: int) -> None:
        for _ in range(count):
            self.gate.release()


class FakeCapture:
    """As `cv2.VideoCapture` on a camera of 640x480 that accepts the sizes in `sizes`."""

    def __init__(self, target: object, *_: object, sizes: tuple[tuple[int, int], ...] = ()) -> None:
        self.target = target
        self.size = (640, 480)
        self.is_released = False
        self.requested: dict[int, float] = {}
        self._sizes = sizes
        self._number = 0

    def isOpened(self) -> bool:  # noqa: N802
        return self.target != 9

    def set(self, property: int, value: float) -> bool:
        self.requested[property] = value
        width, height = (
            self.requested.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        )
        if (width, height) in self._sizes:
            self.size = (int(width or 0), int(height or 0))
        return True

    def get(self, property: int) -> float:
        return 100.0 * self._number if property == cv2.CAP_PROP_POS_MSEC else 0.0

    def read(self) -> tuple[bool, np.ndarray | None]:
        time.sleep(0.001)
        self._number += 1
        return True, np.full((self.size[1], self.size[0], 3), self._number, dtype=np.uint8)

    def release(self) -> None:
        self.is_released = True


def wait_for(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    give_up = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < give_up, "it did not happen"
        time.sleep(0.002)
