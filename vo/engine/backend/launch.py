"""Start and end of a solver's process."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import IO

# So that writing seldom blocks.
_PIPE_BYTES = 1 << 20
# Not multiprocessing: that runs the caller's main module again. The child finds its modules
# where this process finds them, never in the folder that it happens to be started in (-P): a file
# `signal.py` there would be run.
# numba would load scipy, where it is installed, to look for a BLAS that nothing here uses.
# Ctrl-C is handled by the parent. Loaded modules are no garbage, see `vo.cli.garbage`.
_PROGRAM = """
import gc, signal, sys
gc.disable()
signal.signal(signal.SIGINT, signal.SIG_IGN)
sys.path[:], sys.modules["scipy"] = {path!r}, None
from vo.engine.backend.worker import main
main()
"""


def start_child() -> subprocess.Popen[bytes]:
    """Start the process, which waits for problems on its standard input.

    Raises:
        OSError: it cannot be started.
    """
    child = subprocess.Popen(
        [sys.executable, "-P", "-c", _PROGRAM.format(path=_import_path())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        # On such small matrices a second BLAS thread only occupies a core.
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        process_group=0,  # Ctrl-C in a terminal is sent to a whole group
    )
    for pipe in (child.stdin, child.stdout):
        assert pipe is not None
        _widen(pipe)
    return child


def _import_path() -> list[str]:
    """Folders where this process finds modules, without those relative to the current folder."""
    package = str(Path(__file__).resolve().parents[3])
    return [*dict.fromkeys([*filter(os.path.isabs, sys.path), package])]


def _widen(pipe: IO[bytes]) -> None:
    """Enlarge the buffer of a pipe where the system allows it."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)


def end_child(child: subprocess.Popen[bytes]) -> int:
    """Kill the process if it has not ended; its exit status."""
    child.kill()
    status = child.wait()
    for pipe in (child.stdin, child.stdout):
        assert pipe is not None
        with suppress(OSError):  # an incomplete problem is left in it
            pipe.close()
    return status
