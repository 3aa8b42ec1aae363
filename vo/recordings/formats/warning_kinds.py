"""Kinds of warnings, attached to log records so that a reader need not parse messages.

Usage: `_log.warning("…", extra=warning_kind("repeated_stamps"))`.
"""

from __future__ import annotations

import logging
from typing import Literal, get_args

WarningKind = Literal["repeated_stamps", "unpaired_images", "large_baseline"]


def warning_kind(kind: WarningKind) -> dict[str, str]:
    """The `extra` argument of a logging call."""
    return {"warning_kind": kind}


def kind_of(record: logging.LogRecord) -> WarningKind | None:
    """The kind of a warning; None for warnings without a kind."""
    kind = getattr(record, "warning_kind", None)
    return kind if kind in get_args(WarningKind) else None
