"""Stamps of the messages of a topic: missing ones, clocks that were set back, and repetitions."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from vo.base.errors import VoError
from vo.base.faults import Fault, FaultKind
from vo.base.types import Ints
from vo.recordings.formats.stamp_units import MAX_STAMP_NS
from vo.recordings.formats.warning_kinds import warning_kind
from vo.recordings.sources.listing import median_interval_ns
from vo.recordings.sources.logs.log import Entry, Log, Topic

_log = logging.getLogger(__name__)

_MIN_SET_BACK = 3
"""Messages stamped before an earlier one in a row; fewer were only delivered out of order."""

_MAX_JUMPS = 5
"""With more jumps the messages are in no order, and are sorted by stamp."""

_MAX_BACKWARD = 0.25  # of all steps; with more, too, the messages are in no order
_MAX_FIRST_INTERVALS = 10
"""A first stamp of 0 is one if the next follows within this number of median intervals."""


def message_stamps(
    log: Log, topic: Topic, entries: Sequence[Entry], faults: list[Fault] | None = None
) -> list[int]:
    """The stamps of messages, in nanoseconds; not sorted.

    These are the stamps in the headers. The log time replaces missing ones, and all of them if
    most are repetitions. Where the clock of the headers was set back, the order of the log is kept
    by moving the later stamps forward. Each is reported by a warning.

    `faults`: receives a clock that was set back.
    """
    stamps = [stamp_of(log, topic, entry) for entry in entries]
    log_ns = [entry.log_ns for entry in entries]
    if len(stamps) > 1 and 2 * len(set(stamps) - {0}) < np.count_nonzero(stamps):
        _log.warning(
            "%s: %d of %d header stamps repeat another; the log time of all messages is used",
            topic.name,
            len(stamps) - len(set(stamps)),
            len(stamps),
        )
        return log_ns
    resolved = with_log_time(stamps, log_ns)
    unstamped = sum(stamp != used for stamp, used in zip(stamps, resolved, strict=True))
    if unstamped:
        _log.warning(
            "%s: %d of %d messages have no stamp; their log time is used",
            topic.name,
            unstamped,
            len(entries),
        )
    ordered, set_back_ns = in_order_of_log(resolved, log_ns)
    if set_back_ns:
        _log.warning(
            "%s: the clock of the header stamps was set back by %.3f s; the order of the log is "
            "used, and later stamps are moved forward",
            topic.name,
            1e-9 * set_back_ns,
            extra=warning_kind("fault"),
        )
        if faults is not None:
            size_s = 1e-9 * set_back_ns
            faults.append(Fault(FaultKind.CLOCK_SET_BACK, is_handled=True, value=size_s))
    return ordered


def stamp_of(log: Log, topic: Topic, entry: Entry) -> int:
    """The stamp in the header of a message; 0 if there is none."""
    stamp_ns = entry.stamp_ns
    if stamp_ns is None:
        try:
            stamp_ns = topic.codec.decode(log.read(entry)).stamp_ns
        except VoError:
            return 0
    return stamp_ns if 0 < stamp_ns <= MAX_STAMP_NS else 0


def with_log_time(stamps: Sequence[int], log_ns: Sequence[int]) -> list[int]:
    """The stamps, with the log time in place of 0; a first 0 that the others continue stays."""
    if 0 not in stamps:
        return list(stamps)
    others = [stamp for stamp in stamps if stamp]
    is_single = len(others) == len(stamps) - 1 and len(others) > 1 and stamps[0] == 0
    interval_ns = median_interval_ns(others)
    if is_single and 0 < min(others) <= _MAX_FIRST_INTERVALS * interval_ns:
        return list(stamps)
    return [stamp or time for stamp, time in zip(stamps, log_ns, strict=True)]


def in_order_of_log(stamps: Sequence[int], log_ns: Sequence[int]) -> tuple[list[int], int]:
    """Stamps that follow the order of the log where the clock was set back.

    Where it was, the stamps continue by whole median intervals, as many as the log times show, so
    that the stamps of cameras that are triggered together stay equal.

    Returns:
        The stamps, and by how many nanoseconds the clock was set back; 0 if it was not.
    """
    if max([*stamps, *log_ns], default=0) > MAX_STAMP_NS:  # damaged; left out later
        return list(stamps), 0
    times, logged = np.array(stamps, dtype=np.int64), np.array(log_ns, dtype=np.int64)
    jumps = _jumps(times, logged)
    if not len(jumps):
        return list(stamps), 0
    steps = np.diff(times)
    interval = int(np.median(steps[steps > 0])) if (steps > 0).any() else 1
    largest = 0
    for at in jumps.tolist():
        elapsed = max(1, round(float(logged[at] - logged[at - 1]) / interval))
        shift = int(times[at - 1]) + elapsed * interval - int(times[at])
        largest = max(largest, shift)
        times[at:] += shift
    return times.tolist(), largest


def _jumps(times: Ints, logged: Ints) -> Ints:
    """Numbers of the first messages after the clock was set back.

    Messages in another order than that of time, such as those of joined files, are no such jump:
    their log times go back as well, and the parts do not overlap.
    """
    found: list[int] = []
    backward = np.count_nonzero(np.diff(times) < 0)
    if backward == 0 or backward > _MAX_BACKWARD * len(times):
        return np.array(found, dtype=np.int64)
    first, latest = int(times[0]), int(times[0])
    for at, time in enumerate(times.tolist()):
        if time >= latest:
            latest = time
            continue
        later = times[at:] >= latest
        behind = int(later.argmax()) if later.any() else len(later)
        goes_back = logged[at] < logged[at - 1]
        overlaps = times[at : at + behind].max() > first
        if behind >= _MIN_SET_BACK and (overlaps or not goes_back):
            found.append(at)
            first = latest = time
        if len(found) > _MAX_JUMPS:
            return np.empty(0, dtype=np.int64)
    return np.array(found, dtype=np.int64)
