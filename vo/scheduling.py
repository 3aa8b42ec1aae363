"""Scheduling of helper threads on busy machines."""

from __future__ import annotations

import os
from contextlib import suppress


def give_way() -> None:
    """Give this helper thread a batch policy, so that it does not preempt the tracking thread.

    Its share of CPU time is unchanged. On two cores, preemption by reading, feature extraction and
    smoothing took 10 % of the run time (docs/accuracy.md). Linux only; results do not depend on it.
    """
    if hasattr(os, "SCHED_BATCH"):
        with suppress(OSError):  # forbidden in some containers
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
