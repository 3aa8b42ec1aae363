from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vo.engine.mapping.lookup import rows_of

IDS = st.integers(0, 60)


@settings(deadline=None)
@given(st.sets(IDS), st.lists(IDS))
def test_every_id_is_found_where_it_is_and_no_other(known: set[int], wanted: list[int]) -> None:
    place = {landmark: row for row, landmark in enumerate(sorted(known))}
    rows = rows_of(np.array(wanted, np.int64), np.array(sorted(known), np.int64))
    assert rows.tolist() == [place.get(landmark, -1) for landmark in wanted]
