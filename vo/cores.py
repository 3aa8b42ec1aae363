"""How many cores there are to work on."""

from __future__ import annotations

import os


def available_cores() -> int:
    """Those that this process may run on, at least 1."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
