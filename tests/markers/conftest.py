"""A camera and views of markers with known poses."""

from __future__ import annotations

import numpy as np
import pytest

from vo.types import Camera


@pytest.fixture
def camera() -> Camera:
    return Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)
