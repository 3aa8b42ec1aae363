"""Further processes that compile."""

from __future__ import annotations

import os
import subprocess
import sys

_SAME_MODULES = "import sys\nsys.path[:0] = {path!r}\n"


def start(program: str) -> subprocess.Popen[bytes] | None:
    """Run a program that finds the same modules and shows nothing; None if that is impossible."""
    if hasattr(sys, "frozen"):  # the executable is not Python
        return None
    # An empty entry means the working directory.
    path = list(map(os.path.abspath, sys.path))
    command = [sys.executable, "-P", "-c", _SAME_MODULES.format(path=path) + program]
    nowhere = subprocess.DEVNULL
    try:
        return subprocess.Popen(command, stdin=nowhere, stdout=nowhere, stderr=nowhere)
    except OSError:
        return None
