"""Poses as lines of JSON in a file, a pipe or a terminal."""

from __future__ import annotations

import logging
import select
from typing import IO

from vo.outputs.streaming.sink import PoseUpdate

_log = logging.getLogger(__name__)


class JsonLines:
    """Writes one line for each frame, at once.

    A reader that is too slow lets the run wait, so that it gets every pose. A live source does not
    wait: then poses are left out while the pipe is full.

    `file`: where to write; it stays open. `name`: what messages call it.
    """

    def __init__(self, file: IO[bytes], name: str = "standard output") -> None:
        self.name = name
        self._file = file
        self._left_out = 0

    def send(self, update: PoseUpdate) -> None:
        """Write a line.

        Raises:
            BrokenPipeError: the reader has closed the pipe.
            OSError: it cannot be written, as the disk is full.
        """
        # A pipe that can be written to takes at least 512 bytes, on Linux and macOS a whole line.
        if update.is_live and not self._is_writable(timeout_ms=0):
            self._leave_out()
            return
        rest = memoryview(update.record + b"\n")
        while rest:  # a file without a buffer may write a part only
            written = self._file.write(rest)
            if written is None:  # a full pipe that does not let its writer wait
                self._is_writable()
            else:
                rest = rest[written:]
        self._file.flush()

    def _is_writable(self, timeout_ms: int | None = None) -> bool:
        """Whether the file can be written to, after waiting for that."""
        try:
            number = self._file.fileno()
        except OSError:  # an object in memory
            return True
        poll = select.poll()
        poll.register(number, select.POLLOUT)
        return bool(poll.poll(timeout_ms))

    def _leave_out(self) -> None:
        self._left_out += 1
        if self._left_out == 1:
            _log.warning("%s: poses are left out, as they are read too slowly", self.name)

    def close(self) -> None:
        """Report how many poses were left out; every other line is written."""
        if self._left_out:
            _log.warning("%s: %d poses were left out", self.name, self._left_out)
