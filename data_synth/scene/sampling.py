"""Offsets, in area and exposure time of a pixel, of the rays for its mean radiance."""

from __future__ import annotations

from functools import cache

import numpy as np

from vo.base.types import Floats, Ints

COUNTS = (6, 8, 12, 16, 24, 32)

_TRIES = 400


@cache
def sample_offsets() -> tuple[Ints, Floats]:
    """Counts (C,) and offsets (C, 32, 3) across, down and in time, -0.5…0.5.

    They are evenly spaced in each of the three, and each is followed by its mirror image about the
    middle, so that edges are unbiased. The start and the end of the exposure come first.
    """
    offsets = np.zeros((len(COUNTS), max(COUNTS), 3))
    for i, count in enumerate(COUNTS):
        offsets[i, :count] = _spread(count)
    return np.array(COUNTS, dtype=np.int64), offsets


def _spread(count: int) -> Floats:
    """Best-candidate sampling: the largest minimum distance in each plane, of many random offsets.

    The outermost offsets across and down are in the first half, which may decide a pixel alone.
    """
    rng = np.random.default_rng([count, 51])
    half = (np.arange(count // 2)[::-1] + 0.5) / count
    best, result = -1.0, np.zeros((count, 3))
    for _ in range(_TRIES):
        signs = rng.choice([-1.0, 1.0], (2, len(half)))
        across, down = (rng.permutation(half) * s for s in signs)
        first = max(2, count // 4)
        if max(np.abs(across[first:]).max(), np.abs(down[first:]).max()) == half[0]:
            continue
        offsets = np.column_stack([across, down, half])
        offsets = np.stack([offsets, -offsets], axis=1).reshape(-1, 3)
        apart = min(_apart(offsets[:, pair]) for pair in ([0, 1], [0, 2], [1, 2]))
        if apart > best:
            best, result = apart, offsets
    return result


def _apart(points: Floats) -> float:
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    return float(distances[~np.eye(len(points), dtype=bool)].min())
