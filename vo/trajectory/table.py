"""Rows that grow at the end, as one NumPy structure: bytes of memory a row, not Python objects."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_LEAST_ROOM = 64


class Table:
    """Rows of one structured type."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._block = np.zeros(_LEAST_ROOM, dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Any]:
        """All rows, (n,); to be changed in place, and not to be kept over an `append`."""
        return self._block[: self._count]

    def append(self, *fields: Any) -> None:
        """Add a row of these fields."""
        if self._count == len(self._block):
            room = max(_LEAST_ROOM, self._count // 16)
            self._block = np.concatenate([self._block, np.zeros(room, self._block.dtype)])
        self._block[self._count] = fields
        self._count += 1
