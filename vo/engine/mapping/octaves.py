"""Pyramid level on which a landmark should be detected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo.base.types import Floats


def predicted_octave(
    octave: NDArray[np.int32], scale: Floats, scale_factor: float
) -> NDArray[np.int32]:
    """Octaves (n,) of landmarks whose size changed by `scale` (n,) since their reference."""
    if scale_factor == 1.0:  # features of one scale only
        return octave
    change = np.round(np.log(scale) / np.log(scale_factor))
    level: NDArray[np.int32] = np.maximum(octave + change, 0).astype(np.int32)
    return level
