"""Cores, threads on busy machines, and the memory that they share."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_M_ARENA_MAX = -8  # of glibc's malloc.h


def give_way() -> None:
    """Give this helper thread a batch policy, so that it does not preempt the tracking thread.

    Its share of CPU time is unchanged. On two cores, preemption by reading, feature extraction and
    optimisation took 10 % of the run time (docs/experiments/thread-scheduling.md). Linux only;
    results do not depend on it.
    """
    if hasattr(os, "SCHED_BATCH"):
        with suppress(OSError):  # forbidden in some containers
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def share_one_heap() -> None:
    """Let all threads that start from now on take memory from one heap; Linux with glibc only.

    Each would have one of its own, and keep there what it no longer needs: 17 of 264 MiB after
    6,000 frames. CPU time is the same (docs/experiments/long-runs.md).
    """
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):  # another C library
            ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 1)


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Let OpenCV work in the threads that call it alone.

    Its other threads spin while they wait: 5 to 8 % of the CPU time of a run on two cores.
    """
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def available_cores() -> int:
    """Number of cores that this process may run on, at least 1."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
