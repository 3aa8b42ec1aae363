"""Stereo pairs from one side-by-side image, or from two devices that do not know each other."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from contextlib import closing

from vo.base.errors import SourceError
from vo.base.types import Rig
from vo.recordings.sources.live.device import CapturedImages, Connect, Device
from vo.recordings.sources.side_by_side import halves

PAIR_TOLERANCE_NS = 10_000_000
"""Largest difference between the stamps of a pair from two devices."""

_log = logging.getLogger(__name__)

_WAITING = 4  # images of each device that wait for their partner
_TIMEOUT_S = 5.0


class SideBySideDevice:
    """Divides the images of a device into a left and a right half."""

    def __init__(self, device: Device) -> None:
        self.rig: Rig | None = None
        self._device = device

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        stamp_ns, (image, *_) = self._device.read()
        return CapturedImages(stamp_ns, halves(image, "live image"))

    def close(self) -> None:
        """See `Device.close`."""
        self._device.close()


class PairedDevices:
    """Images of two devices that were captured at about the same time; the others are left out.

    The devices run freely, so the two images of a pair differ by up to `PAIR_TOLERANCE_NS`. The
    stamp of a pair is that of its left image.
    """

    def __init__(self, name: str, connect_left: Connect, connect_right: Connect) -> None:
        self.rig: Rig | None = None
        self._name, self._unpaired = name, 0
        left = connect_left()
        try:
            right = connect_right()
        except SourceError:
            left.close()
            raise
        self._images: tuple[deque[CapturedImages], ...] = tuple(
            deque(maxlen=_WAITING) for _ in range(2)
        )
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._is_closed = False
        self._least_ns: int | None = None  # difference of the best pair since the last one
        for side, device in enumerate((left, right)):
            threading.Thread(target=self._work, args=(side, device), daemon=True).start()

    def read(self) -> CapturedImages:
        """See `Device.read`."""
        give_up = time.monotonic() + _TIMEOUT_S
        with self._changed:
            self._least_ns = None
            while True:
                pair = self._take_pair()
                if pair is not None:
                    return pair
                if self._error is not None:
                    raise self._error
                if not self._changed.wait(max(give_up - time.monotonic(), 0.0)):
                    raise SourceError(self._why_no_pair())

    def close(self) -> None:
        """See `Device.close`."""
        self._is_closed = True
        if self._unpaired:
            _log.warning(
                "%s: %d images left out, without a partner within %.0f ms",
                self._name,
                self._unpaired,
                1e-6 * PAIR_TOLERANCE_NS,
            )

    def _take_pair(self) -> CapturedImages | None:
        """The oldest pair that has come, None if there is none yet."""
        left, right = self._images
        for first in left:
            if not right or right[-1].stamp_ns < first.stamp_ns - PAIR_TOLERANCE_NS:
                continue
            second = min(right, key=lambda images: abs(images.stamp_ns - first.stamp_ns))
            apart_ns = abs(second.stamp_ns - first.stamp_ns)
            self._least_ns = min(self._least_ns or apart_ns, apart_ns)
            if apart_ns <= PAIR_TOLERANCE_NS:
                for images, taken in ((left, first), (right, second)):
                    while images and images[0].stamp_ns <= taken.stamp_ns:
                        self._unpaired += images.popleft().stamp_ns != taken.stamp_ns
                return CapturedImages(first.stamp_ns, first.images + second.images)
        return None

    def _why_no_pair(self) -> str:
        if self._least_ns is None:
            return "no images from one of the two cameras"
        return (
            f"the two cameras give their images {1e-6 * self._least_ns:.0f} ms apart, more than "
            f"the {1e-6 * PAIR_TOLERANCE_NS:.0f} ms of a pair; start them again, or use cameras "
            "that are synchronised"
        )

    def _work(self, side: int, device: Device) -> None:
        with closing(device):
            while not self._is_closed and self._error is None:
                try:
                    images = device.read()
                except Exception as error:  # of any kind: it is raised where images are awaited
                    with self._changed:
                        self._error = error
                        self._changed.notify()
                    return
                with self._changed:
                    self._images[side].append(images)
                    self._changed.notify()
