"""Rows of landmarks by their ids."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Ints

_MAX_SPAN = 20  # of known ids for a table of them all, times the number of ids


def rows_of(ids: Ints, known: Ints) -> Ints:
    """Rows (n,) of ids (n,) among increasing known ids (m,); -1 for unknown ids."""
    return np.asarray(_rows_of(np.ascontiguousarray(ids), known))


@compiled
def _rows_of(ids, known):  # type: ignore[no-untyped-def]
    """By a table, unless the known ids are too far apart; steps of a search are mispredicted."""
    rows = np.full(len(ids), -1)
    if len(known) == 0:
        return rows
    first, span = known[0], known[-1] - known[0] + 1
    is_dense = span <= _MAX_SPAN * (len(ids) + len(known))
    place = np.full(span if is_dense else 0, -1)
    if is_dense:
        for m in range(len(known)):
            place[known[m] - first] = m
    for n in range(len(ids)):
        wanted = ids[n]
        if is_dense:
            if first <= wanted < first + span:
                rows[n] = place[wanted - first]
            continue
        low, high = 0, len(known)
        while high - low > 1:
            middle = (low + high) // 2
            if known[middle] <= wanted:
                low = middle
            else:
                high = middle
        if known[low] == wanted:
            rows[n] = low
    return rows
