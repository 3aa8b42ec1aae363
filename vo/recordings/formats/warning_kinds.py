"""Kinds of warnings, attached to log records so that a reader need not parse messages.

Usage: `_log.warning("…", extra=warning_kind("repeated_stamps"))`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, NamedTuple, get_args

WarningKind = Literal[
    "repeated_stamps", "unpaired_images", "large_baseline", "calibration", "stamps", "fault"
]
"""`calibration` and `stamps` are likely wrong; of a `fault` there is a record in the summary."""

_DOUBTS = ("large_baseline", "calibration", "stamps")


class LoggedWarning(NamedTuple):
    """The message of a warning on one line, and its kind, if any."""

    text: str
    kind: WarningKind | None = None

    @property
    def is_doubt(self) -> bool:
        """Whether a path from this recording may be wrong."""
        return self.kind in _DOUBTS


def warning_kind(kind: WarningKind) -> dict[str, str]:
    """The `extra` argument of a logging call."""
    return {"warning_kind": kind}


def kind_of(record: logging.LogRecord) -> WarningKind | None:
    """The kind of a warning; None for warnings without a kind."""
    kind = getattr(record, "warning_kind", None)
    return kind if kind in get_args(WarningKind) else None


@contextmanager
def collected_warnings(*, are_shown: bool = False) -> Iterator[list[LoggedWarning]]:
    """Collect warnings of `vo` in a list, instead of showing them or besides."""
    warnings: list[LoggedWarning] = []
    handler = _Collector(warnings)
    logger = logging.getLogger("vo")
    propagate = logger.propagate
    logger.addHandler(handler)
    logger.propagate = propagate and are_shown
    try:
        yield warnings
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagate


@contextmanager
def warned_once(logger: logging.Logger) -> Iterator[None]:
    """Drop what a logger repeats."""
    seen: set[str] = set()

    def is_new(record: logging.LogRecord) -> bool:
        count = len(seen)
        seen.add(record.getMessage())
        return len(seen) > count

    logger.addFilter(is_new)
    try:
        yield
    finally:
        logger.removeFilter(is_new)


class _Collector(logging.Handler):
    def __init__(self, warnings: list[LoggedWarning]) -> None:
        super().__init__(logging.WARNING)
        self._warnings = warnings

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())
        self._warnings.append(LoggedWarning(text, kind_of(record)))
