"""Where the program `vo` begins and ends: Ctrl-C is answered there too, and with no traceback."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from types import FrameType

from vo.cli.loading import loading
from vo.compiling.processor import use_common_instructions

_INTERRUPTED = 128 + signal.SIGINT


def main() -> None:
    """Load the command line and hand over to it."""
    answers = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if answers:
        # While modules are loaded, an exception could be swallowed or turned into another one.
        signal.signal(signal.SIGINT, _leave)
    # Matrices are small here: a second thread of BLAS only waits, at the cost of the core it waits
    # on, and the bits of a result may depend on their number.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    use_common_instructions()
    # Nothing here uses scipy; numba would load it, where it is installed, to look for a BLAS.
    sys.modules.setdefault("scipy", None)  # type: ignore[arg-type]
    # Others' plugins for pydantic are not wanted: it would look through all packages for them.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    with loading():
        from vo.cli.app import app, keep_only

        keep_only(sys.argv[1:2])

    atexit.register(gc.freeze)  # as the program ends there is nothing to be gained by a search
    if answers:
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # all is done by then
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        app()
    except KeyboardInterrupt:  # before a command began, or after it
        _leave(signal.SIGINT, None)


def _leave(number: int, frame: FrameType | None) -> None:
    """End at once: nothing has been begun that would have to be tidied up."""
    os._exit(_INTERRUPTED)
