"""Who works first when there is more to do than cores to do it."""

from __future__ import annotations

import os
from contextlib import suppress


def give_way() -> None:
    """Do not interrupt the thread that tracks whenever this one, a helper, has something to do.

    It keeps its share of the time. On two cores, with reading, features and smoothing beside the
    tracking, a tenth of a run's time went into such interruptions (docs/accuracy.md). Linux only;
    no result depends on it.
    """
    if hasattr(os, "SCHED_BATCH"):
        with suppress(OSError):  # not allowed in some containers
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
