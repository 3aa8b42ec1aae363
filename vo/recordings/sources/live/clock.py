"""Stamps of live images: when they were captured, on the host's clock."""

from __future__ import annotations

import time

_NS_PER_S = 1_000_000_000
_WINDOW_NS = 10 * _NS_PER_S
_MAX_DELAY_NS = _NS_PER_S
_MAX_DRIFT = 2e-4  # of quartz clocks


class HostClock:
    """Nanoseconds since 1970 that never jump.

    The system's clock is read once. From then on the monotonic clock counts, so that setting the
    system's clock during a run changes no time difference.
    """

    def __init__(self) -> None:
        self._epoch_ns = time.time_ns() - time.monotonic_ns()

    def now_ns(self) -> int:
        """The present time."""
        return self.of_monotonic(time.monotonic_ns())

    def of_monotonic(self, monotonic_ns: int) -> int:
        """A time of the monotonic clock."""
        return self._epoch_ns + monotonic_ns


class CaptureStamps:
    """Stamps from a stream's own times where they are sound, otherwise from arrival.

    Arrival over a network varies by milliseconds, while a camera's own times are regular but begin
    anywhere. The difference of both is least for the image that was delayed least. Its minimum
    over the last 10 to 20 s is therefore added to the stream's times: stamps are as regular as
    these, never later than arrival, and follow a camera whose clock is a little fast or slow.

    Own times that are missing, do not increase, or are more than a second older than arrival are
    not used: the image gets its time of arrival, and the minimum begins anew.
    """

    def __init__(self) -> None:
        self._last_ns = 0
        self._first_ns: int | None = None  # arrival of the first image with a time of its own
        self._least_ns = 2**63  # smallest arrival minus own time of all images
        self._lag_ns = 0
        self._forget()

    @property
    def lag_ns(self) -> int:
        """How much later the newest image came than the one that was delayed least.

        It grows if images are decoded more slowly than they come, and wait somewhere. What the
        clocks of camera and host may differ by, 200 parts in a million, is subtracted.
        """
        return self._lag_ns

    def stamp(self, arrival_ns: int, own_ns: int | None = None) -> int:
        """Stamp of the next image, later than those before.

        `own_ns`: its time in the stream, from an unknown origin; None without one.
        """
        stamp_ns = arrival_ns
        if own_ns is not None:
            self._measure_lag(arrival_ns, own_ns)
            self._add(arrival_ns, own_ns)
            stamp_ns = own_ns + min(self._offset_ns, self._offset_before_ns)
            if not max(self._last_ns, arrival_ns - _MAX_DELAY_NS) < stamp_ns <= arrival_ns:
                self._forget()
                stamp_ns = arrival_ns
        self._last_ns = max(stamp_ns, self._last_ns + 1)
        return self._last_ns

    def _forget(self) -> None:
        self._window_begun_ns: int | None = None
        self._offset_ns = self._offset_before_ns = 2**63  # arrival minus own time, minima

    def _measure_lag(self, arrival_ns: int, own_ns: int) -> None:
        if self._first_ns is None:
            self._first_ns = arrival_ns
        self._least_ns = min(self._least_ns, arrival_ns - own_ns)
        drift_ns = round(_MAX_DRIFT * (arrival_ns - self._first_ns))
        self._lag_ns = max(arrival_ns - own_ns - self._least_ns - drift_ns, 0)

    def _add(self, arrival_ns: int, own_ns: int) -> None:
        if self._window_begun_ns is None:
            self._window_begun_ns = arrival_ns
        elif arrival_ns - self._window_begun_ns > _WINDOW_NS:
            self._window_begun_ns = arrival_ns
            self._offset_before_ns, self._offset_ns = self._offset_ns, 2**63
        self._offset_ns = min(self._offset_ns, arrival_ns - own_ns)
