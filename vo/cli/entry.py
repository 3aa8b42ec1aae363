"""Entry point of the program `vo`: start-up, Ctrl-C at any time, and exit."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from types import FrameType, SimpleNamespace
from typing import Any

from vo.base.compiling.processor import use_common_instructions
from vo.cli.frame_stack import with_room
from vo.cli.garbage import collection_paused

_INTERRUPTED = 128 + signal.SIGINT


def main() -> None:
    """Load the command line and execute the command."""
    with_room(_main)()


def _main() -> None:
    handles_interrupts = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if handles_interrupts:
        # While modules are loaded, an exception could be swallowed or turned into another one.
        signal.signal(signal.SIGINT, _exit_at_once)
    # Matrices are small here: a second BLAS thread would only wait and occupy a core, and results
    # may depend on the number of threads.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Of image formats of which `vo.base.images.image_header` does not know the header.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(2**27))
    use_common_instructions()
    # scipy is not used; numba would load it, if installed, to search for a BLAS.
    sys.modules.setdefault("scipy", None)  # type: ignore[arg-type]
    # pydantic would search all installed packages for plugins, with modules that take 10 ms.
    no_plugins: Any = SimpleNamespace(get_plugins=tuple)
    sys.modules.setdefault("pydantic.plugin._loader", no_plugins)
    with collection_paused():
        from vo.cli.app import command_line

        app = command_line(sys.argv[1:])

    atexit.register(gc.freeze)  # a garbage collection at exit would be wasted time
    if handles_interrupts:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        app()
    except KeyboardInterrupt:  # before or after the command
        _exit_at_once(signal.SIGINT, None)
    finally:
        if handles_interrupts:  # everything is done: libraries must not be interrupted at exit
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def _exit_at_once(number: int, frame: FrameType | None) -> None:
    """End the process without clean-up, as there is nothing to clean up."""
    os._exit(_INTERRUPTED)
