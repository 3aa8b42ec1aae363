"""A binary file whose parts are on disk as soon as they are complete."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path


class DurableFile:
    """An unbuffered file that can be cut back to its last complete part, as on a full disk.

    `path`: the file; an existing one is replaced.

    Raises:
        OSError: here and in every method but `cut`: the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb", buffering=0)
        self._complete = 0

    def write(self, data: bytes | memoryview) -> int:
        """Write all of the data, also where the system takes a part at a time."""
        rest = memoryview(data).cast("B")
        while rest:
            rest = rest[self._file.write(rest) :]
        return len(data)

    def tell(self) -> int:
        """Position in bytes."""
        return self._file.tell()

    def flush(self) -> None:
        """Mark everything until here as complete; it is on disk already."""
        self._complete = self._file.tell()

    def cut(self) -> None:
        """Remove what was written since the last `flush`, and close."""
        with suppress(OSError):
            self._file.truncate(self._complete)
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
