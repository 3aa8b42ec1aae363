"""A live source as a stream of frames."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Iterator
from typing import Protocol

import numpy as np

from vo.base.errors import SourceError
from vo.base.failures import Gap
from vo.base.faults import Fault
from vo.base.types import Bytes, Frame, Rig, Skipped, Trajectory
from vo.recordings.sources.images import ImageKind
from vo.recordings.sources.live.capture import Capture
from vo.recordings.sources.live.clock import HostClock
from vo.recordings.sources.live.device import CapturedImages

_log = logging.getLogger(__name__)


class FrameTap(Protocol):
    """Receives every frame that is handed out, for example to record it; must not wait."""

    unrecorded: int

    def add(self, frame: Frame) -> None:
        """Receive a frame."""
        ...

    def close(self) -> None:
        """End."""
        ...


class LiveFrames:
    """The newest images of a device whenever a frame is asked for; see `LiveStream`.

    Frames are numbered as they are handed out. Images are grey, whatever kind is asked for.

    Args:
        timeout_s: time without images after which the stream ends.
        duration_s: time after which it ends anyway.
    """

    def __init__(
        self,
        name: str,
        rig: Rig,
        capture: Capture,
        clock: HostClock,
        *,
        timeout_s: float,
        duration_s: float = math.inf,
    ) -> None:
        self.name, self.format, self.rig = name, "live", rig
        self.ground_truth: Trajectory | None = None
        self.skipped: list[Skipped] = []
        self.unpaired = 0
        self.tap: FrameTap | None = None
        self.faults: list[Fault] = []
        self._capture = capture
        self._clock = clock
        self._timeout_s = timeout_s
        self._duration_s = duration_s

    @property
    def dropped(self) -> int:
        """See `LiveStream`."""
        return self._capture.dropped

    @property
    def gaps(self) -> list[Gap]:
        """See `LiveStream`."""
        return self._capture.gaps

    @property
    def unrecorded(self) -> int | None:
        """See `LiveStream`."""
        return None if self.tap is None else self.tap.unrecorded

    def now_ns(self) -> int:
        """See `LiveStream.now_ns`."""
        return self._clock.now_ns()

    def stop(self) -> None:
        """See `LiveStream.stop`."""
        self._capture.stop()

    def close(self) -> None:
        """See `LiveStream.close`."""
        self._capture.close()
        if self.tap is not None:
            self.tap.close()

    def frames(
        self, start: int = 0, end: int | None = None, stride: int = 1, images: ImageKind = "grey"
    ) -> Iterator[Frame]:
        """Hand out frames start, start + stride, ... below end, as they come."""
        self._capture.forget()
        ends_at = time.monotonic() + self._duration_s
        number = 0
        while end is None or number < end:
            captured = self._next(ends_at)
            if captured is None:
                return
            if number >= start and (number - start) % stride == 0:
                frame = Frame(number, captured.stamp_ns, self._checked(captured.images))
                if self.tap is not None:
                    self.tap.add(frame)
                yield frame
            number += 1

    def _next(self, ends_at: float) -> CapturedImages | None:
        """The next images; None at the end."""
        left_s = ends_at - time.monotonic()
        captured = None if left_s <= 0 else self._capture.take(min(self._timeout_s, left_s))
        is_silent = captured is None and not self._capture.has_stopped
        if is_silent and time.monotonic() < ends_at:
            trouble = self._capture.trouble
            _log.warning(
                "%s: no image for %g s%s; the run ends here (`timeout_s` sets this time)",
                self.name,
                self._timeout_s,
                f" ({trouble})" if trouble else "",
            )
        return captured

    def _checked(self, images: tuple[Bytes, ...]) -> tuple[Bytes, ...]:
        used = images[: len(self.rig.cameras)]
        for image, camera in zip(used, self.rig.cameras, strict=True):
            height, width = np.shape(image)
            if (width, height) != (camera.width, camera.height):
                raise SourceError(
                    f"{self.name}: the images are now {width}x{height}, before they were "
                    f"{camera.width}x{camera.height}"
                )
        return used
