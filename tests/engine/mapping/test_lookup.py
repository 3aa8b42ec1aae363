"""Rows of ids, known ones close together or far apart."""

from __future__ import annotations

import numpy as np
import pytest

from vo.engine.mapping.lookup import rows_of


@pytest.mark.parametrize("highest", [60, 10**9])
def test_rows_are_those_of_known_ids(highest: int) -> None:
    rng = np.random.default_rng(highest)
    for known_count in (0, 1, 2, 40):
        known = np.sort(rng.integers(5, highest, known_count))
        known = known[np.diff(known, prepend=0) > 0]
        ids = np.concatenate([rng.permutation(known), rng.integers(0, 2 * highest, 50)])
        wanted = [known.tolist().index(i) if i in known else -1 for i in ids.tolist()]
        assert rows_of(ids, known).tolist() == wanted
