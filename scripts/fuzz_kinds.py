"""A kind of input to be damaged."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple


class Sample(NamedTuple):
    """A kind of input."""

    kind: str
    reader: str  # how it is read, a key of `fuzz_readers.READERS`
    folder: Path
    path: str  # what is read, relative to the folder
    suffixes: tuple[str, ...] = ()  # files that are damaged; all if empty
