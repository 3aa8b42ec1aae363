"""A file that rerun writes through a pipe, so that a full disk is an error here, not a hang there.

Rerun's own writer, once it has failed, keeps the program from ending.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

_AT_ONCE = 1 << 20


class GrowingRrd:
    """Writes what comes through a pipe to a file, in a thread of its own.

    After a failure it goes on reading, and throws away what it reads.

    Attributes:
        inlet: path that rerun is to write to.
        error: why writing has failed, or None.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        outlet, self._inlet = os.pipe()
        self.inlet = Path(f"/dev/fd/{self._inlet}")
        self.error: OSError | None = None
        self._thread = threading.Thread(
            target=self._copy, args=(outlet,), name="rrd-file", daemon=True
        )
        self._thread.start()

    def opened(self) -> None:
        """Tell that rerun has opened the inlet; the file ends when rerun closes it."""
        os.close(self._inlet)

    def wait(self, timeout_s: float) -> None:
        """Until all is on disk."""
        self._thread.join(timeout_s)

    def _copy(self, outlet: int) -> None:
        with open(outlet, "rb", buffering=0) as pipe, self._file:
            while data := pipe.read(_AT_ONCE):
                self._write(data)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while len(rest) and self.error is None:
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.error = error
