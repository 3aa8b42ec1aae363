"""A file that rerun writes through a pipe, so that a full disk is an ordinary error.

After a failure, rerun's own file writer prevents the program from ending.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

_BLOCK = 1 << 20  # bytes


class PipedFile:
    """Copies data from a pipe to a file in a separate thread.

    After a failure it continues to read, and discards the data.

    Attributes:
        pipe_path: path for rerun to write to.
        error: of writing, None without one.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        read_end, self._write_end = os.pipe()
        self.pipe_path = Path(f"/dev/fd/{self._write_end}")
        self.error: OSError | None = None
        self._thread = threading.Thread(
            target=self._copy, args=(read_end,), name="rrd-file", daemon=True
        )
        self._thread.start()

    def close_pipe(self) -> None:
        """Close the pipe here, once rerun has opened it; the file ends when rerun closes it."""
        os.close(self._write_end)

    def wait(self, timeout_s: float) -> None:
        """Wait until all is written."""
        self._thread.join(timeout_s)

    def _copy(self, read_end: int) -> None:
        with open(read_end, "rb", buffering=0) as pipe, self._file:
            while data := pipe.read(_BLOCK):
                self._write(data)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while len(rest) and self.error is None:
            try:
                rest = rest[self._file.write(rest) :]
            except OSError as error:
                self.error = error
