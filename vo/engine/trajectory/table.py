"""A growing table as one structured NumPy array, which needs little memory per row."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_MIN_CAPACITY = 64


class Table:
    """Rows of one structured type."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._storage = np.zeros(_MIN_CAPACITY, dtype=dtype)
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> NDArray[Any]:
        """All rows (n,), to be changed in place; invalid after the next `append`."""
        return self._storage[: self._count]

    def truncate(self, count: int) -> None:
        """Remove all rows but the first `count`."""
        self._count = min(self._count, count)

    def replace(self, rows: NDArray[Any]) -> None:
        """Take other rows (n,) of the same type instead."""
        self._storage, self._count = rows, len(rows)

    def append(self, *fields: Any) -> None:
        """Add a row of these fields."""
        if self._count == len(self._storage):
            more = max(_MIN_CAPACITY, self._count // 16)
            self._storage = np.concatenate([self._storage, np.zeros(more, self._storage.dtype)])
        self._storage[self._count] = fields
        self._count += 1
