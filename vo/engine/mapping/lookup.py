"""Rows of landmarks by their ids."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Ints


def rows_of(ids: Ints, known: Ints) -> Ints:
    """Rows (n,) of ids (n,) among increasing known ids (m,); -1 for unknown ids.

    Galloping search: fast where the ids increase too, as in most observations of a keyframe.
    """
    return np.asarray(_rows_of(np.ascontiguousarray(ids), known))


@compiled
def _rows_of(ids, known):  # type: ignore[no-untyped-def]
    rows = np.full(len(ids), -1)
    if len(known) == 0:
        return rows
    row = 0
    for n in range(len(ids)):
        wanted = ids[n]
        low, high = row, row + 1
        if wanted < known[row]:
            low = 0
        else:  # usually a few rows further: steps double
            while high < len(known) and known[high] <= wanted:
                low, high = high, high + 2 * (high - low)
            high = min(high, len(known))
        while high - low > 1:
            middle = (low + high) // 2
            if known[middle] <= wanted:
                low = middle
            else:
                high = middle
        row = low
        if known[row] == wanted:
            rows[n] = row
    return rows
