"""Tests of medians and percentiles."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.quantiles import median, percentiles


@pytest.mark.parametrize("count", [1, 2, 3, 10, 257])
def test_median_and_percentiles_are_those_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).normal(size=(7, count))
    assert median(values) == np.median(values)
    assert percentiles(values, [0, 20, 99]) == pytest.approx(np.percentile(values, [0, 20, 99]))
