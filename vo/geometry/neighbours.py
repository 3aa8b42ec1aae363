"""Values of points taken from those beside them."""

from __future__ import annotations

import numba
import numpy as np

from vo.types import Floats

NEIGHBOURS = 3


def median_of_nearest(xy: Floats, known_xy: Floats, known: Floats) -> Floats:
    """The median (N,) of the values that the three points nearest to each pixel have.

    Args:
        xy: (N, 2) pixels.
        known_xy: (M, 2) pixels of the points with a value, three at least; of those equally far
            the first are taken.
        known: (M,) their values.
    """
    return np.asarray(
        _median_of_nearest(
            np.ascontiguousarray(xy), np.ascontiguousarray(known_xy), np.ascontiguousarray(known)
        )
    )


@numba.njit(cache=True, nogil=True)
def _median_of_nearest(xy, known_xy, known):  # type: ignore[no-untyped-def]
    result = np.empty(len(xy))
    for n in range(len(xy)):
        first = second = third = np.inf
        a, b, c = 0, 0, 0
        for m in range(len(known)):
            dx, dy = known_xy[m, 0] - xy[n, 0], known_xy[m, 1] - xy[n, 1]
            squared = dx * dx + dy * dy
            if squared >= third:
                continue
            if squared < first:
                first, second, third = squared, first, second
                a, b, c = m, a, b
            elif squared < second:
                second, third = squared, second
                b, c = m, b
            else:
                third, c = squared, m
        low, high = min(known[a], known[b]), max(known[a], known[b])
        result[n] = max(low, min(high, known[c]))
    return result
