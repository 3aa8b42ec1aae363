"""A file that rerun writes through a pipe, so that a full disk is an ordinary error.

After a failure, rerun's own file writer prevents the program from ending.
"""

from __future__ import annotations

import os
import struct
import threading
from contextlib import suppress
from pathlib import Path

_BLOCK = 1 << 20  # bytes
# Layout of an .rrd file: a header, then messages: their kind, their length, their content.
_MAGIC, _HEADER_BYTES = b"RRF2", 12
_MESSAGE = struct.Struct("<QQ")


class PipedFile:
    """Copies data from a pipe to a file in a separate thread.

    After a failure it continues to read, and discards the data; the file ends with a whole message.

    `pipe_path`: path for rerun to write to. `error`: of writing, None without one.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("w+b", buffering=0)
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
                with suppress(OSError):
                    self._file.truncate(end_of_messages(self._file.fileno()))


def end_of_messages(file: int) -> int:
    """Position after the last complete message of an open `.rrd` file."""
    size = os.fstat(file).st_size
    if os.pread(file, len(_MAGIC), 0) != _MAGIC:
        return size
    position = _HEADER_BYTES
    while len(header := os.pread(file, _MESSAGE.size, position)) == _MESSAGE.size:
        end = position + _MESSAGE.size + _MESSAGE.unpack(header)[1]
        if end > size:
            break
        position = end
    return min(position, size)
