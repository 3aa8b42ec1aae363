"""Capture in a thread: the newest images of a device, with reconnection."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import closing

from vo.base.errors import SourceError
from vo.base.failures import Gap
from vo.base.types import Rig
from vo.recordings.sources.live.device import CapturedImages, Connect

_MIN_WAIT_S, _MAX_WAIT_S = 0.25, 5.0  # between attempts to connect again
_POLL_S = 0.05
_STALL_NS, _STALL_RATIO = 2_000_000_000, 10  # without images; relative to the usual interval

_log = logging.getLogger(__name__)


class Capture:
    """Reads a device in a thread and keeps the newest images only.

    Attributes:
        dropped: images so far that were replaced by newer ones before they were taken.
        gaps: times without images: the connection was lost, or the device gave none.
        rig: calibration from the factory, as soon as images have come; None without one.
        has_stopped: whether `stop` was called.
    """

    def __init__(self, name: str, connect: Connect) -> None:
        self.dropped = 0
        self.gaps: list[Gap] = []
        self.rig: Rig | None = None
        self._name = name
        self._connect = connect
        self._newest: CapturedImages | None = None
        self._last_ns: int | None = None  # stamp of the newest images that have come
        self._usual_ns = 0  # between images
        self._lost: str | None = None  # why there is no connection
        self._error: BaseException | None = None  # that ended the thread
        self.has_stopped = False
        self._changed = threading.Condition()
        # A daemon thread: a driver that hangs must not prevent the program from ending.
        self._thread = threading.Thread(target=self._work, name="capture", daemon=True)
        self._thread.start()

    def take(self, timeout_s: float) -> CapturedImages | None:
        """Wait for images newer than those taken before; None after the timeout or `stop`."""
        give_up = time.monotonic() + timeout_s
        with self._changed:
            # Short waits, because `stop` is called by a signal, which cannot wake this thread.
            while self._newest is None and not self.has_stopped and self._error is None:
                left = give_up - time.monotonic()
                if left <= 0:
                    return None
                self._changed.wait(min(left, _POLL_S))
            newest, self._newest = self._newest, None
            if newest is None and self._error is not None:
                raise self._error
            return newest

    def forget(self) -> None:
        """Leave out what came until now, without counting it: nobody was ready for it."""
        with self._changed:
            self._newest, self.dropped = None, 0

    @property
    def trouble(self) -> str:
        """Why there are no images, as far as it is known; may be empty."""
        return self._lost or ""

    def stop(self) -> None:
        """End soon; may be called by a signal handler."""
        self.has_stopped = True

    def close(self) -> None:
        """End, and wait a moment for the device to be closed."""
        self.stop()
        self._thread.join(1.0)

    def _work(self) -> None:
        wait_s = _MIN_WAIT_S
        while not self.has_stopped:
            try:
                with closing(self._connect()) as device:
                    self.rig = device.rig
                    while not self.has_stopped:
                        self._put(device.read())
                        wait_s = _MIN_WAIT_S
            except SourceError as error:
                if not self._lose(error):
                    return
            except Exception as error:  # a bug: it is raised where the images are awaited
                self._end(error)
                return
            self._pause(wait_s)
            wait_s = min(2 * wait_s, _MAX_WAIT_S)

    def _put(self, images: CapturedImages) -> None:
        with self._changed:
            self.dropped += self._newest is not None
            self._newest = images
            lost, self._lost = self._lost, None
            since_ns, self._last_ns = self._last_ns, images.stamp_ns
            if since_ns is not None:
                taken_ns = images.stamp_ns - since_ns
                if lost is None and taken_ns > max(_STALL_NS, _STALL_RATIO * self._usual_ns):
                    lost = "no images came" if self._usual_ns else None
                if lost is not None:
                    self.gaps.append(Gap(since_ns, images.stamp_ns, lost))
                else:
                    self._usual_ns = taken_ns
            self._changed.notify()
        if lost is not None and since_ns is not None:
            missing_s = 1e-9 * (images.stamp_ns - since_ns)
            _log.warning("%s: images again, after %.1f s without", self._name, missing_s)

    def _lose(self, error: SourceError) -> bool:
        """Take note of a lost connection; whether it makes sense to connect again."""
        if self._last_ns is None:
            self._end(error)
            return False
        if self._lost is None and not self.has_stopped:
            _log.warning("%s: connection lost (%s); connecting again", self._name, error)
        self._lost = str(error)
        return True

    def _end(self, error: Exception) -> None:
        with self._changed:
            self._error = error
            self._changed.notify()

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while not self.has_stopped and time.monotonic() < until:
            time.sleep(_POLL_S)
