"""Poses as lines of JSON in a file, a pipe or a terminal."""

from __future__ import annotations

import select
from typing import IO

from vo.streaming.sink import PoseUpdate


class JsonLines:
    """Writes one line for each frame, at once.

    A reader that is too slow lets the run wait, so that it gets every pose.

    Args:
        file: where to write; it stays open.
        name: what messages call it.
    """

    def __init__(self, file: IO[bytes], name: str = "standard output") -> None:
        self.name = name
        self._file = file

    def send(self, update: PoseUpdate) -> None:
        """Write a line.

        Raises:
            BrokenPipeError: the reader has closed the pipe.
            OSError: it cannot be written, as the disk is full.
        """
        rest = memoryview(update.record + b"\n")
        while rest:  # a file without a buffer may write a part only
            written = self._file.write(rest)
            if written is None:  # a full pipe that does not let its writer wait
                select.select([], [self._file], [])
            else:
                rest = rest[written:]
        self._file.flush()

    def close(self) -> None:
        """Do nothing: every line is written."""
