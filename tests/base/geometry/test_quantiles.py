"""Medians and percentiles are those of numpy."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.quantiles import median, percentiles


@pytest.mark.parametrize("shape", [1, 2, 7, 100, (3, 4)])
def test_quantiles_equal_those_of_numpy(shape: int | tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(size=shape)
    assert median(values) == np.median(values)
    np.testing.assert_allclose(
        percentiles(values, (0, 5, 50, 95, 100)),
        np.percentile(values, (0, 5, 50, 95, 100)),
        rtol=1e-14,
    )


def test_quantiles_of_lists_and_integers() -> None:
    assert median([3, 1, 2, 10]) == 2.5
    assert median(np.array([200, 250], np.uint8)) == 225.0
    assert percentiles(np.array([[0, 200], [100, 0]], np.uint8), (50,)) == [50.0]
