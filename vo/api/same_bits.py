"""The instructions of `vo run`, for the same bits in a program of one's own."""

from __future__ import annotations

import logging
import sys
import threading

from vo.base.compiling import processes
from vo.base.compiling.openblas import choose_kernels_again, use_one_thread
from vo.base.compiling.processor import use_common_instructions
from vo.engine.odometry import Odometry
from vo.engine.warmup import is_warm, warm_up

_log = logging.getLogger(__name__)
_PROGRAM = """
from vo.base.compiling.processor import use_common_instructions
use_common_instructions()
from vo.engine.odometry import Odometry
from vo.engine.warmup import warm_up
warm_up(Odometry)
"""
_lock = threading.Lock()


def prepare() -> None:
    """Choose the instructions, and compile the inner loops unless that was done before."""
    with _lock:
        use_common_instructions()
        choose_kernels_again()
        use_one_thread()
        if is_warm():
            return
        _log.warning("compiling the inner loops, once: about 20 s; `vo warmup` does it beforehand")
        if "numba" in sys.modules:  # it has chosen its instructions when it was imported
            process = processes.start(_PROGRAM)
            if process is not None:
                process.wait()
        warm_up(Odometry)
