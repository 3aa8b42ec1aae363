"""Distance between binary descriptors, for compiled loops."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from vo.types import Bytes


@intrinsic
def _population_count(typing_context: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate


@numba.njit(cache=True, nogil=True, inline="always")
def hamming(a: Any, b: Any) -> Any:
    """Number of bits in which two rows of four uint64 words differ."""
    return (
        _population_count(a[0] ^ b[0])  # type: ignore[call-arg]
        + _population_count(a[1] ^ b[1])  # type: ignore[call-arg]
        + _population_count(a[2] ^ b[2])  # type: ignore[call-arg]
        + _population_count(a[3] ^ b[3])  # type: ignore[call-arg]
    )


def as_words(descriptor: Bytes) -> NDArray[np.uint64]:
    """(N, 32) uint8 descriptors as (N, 4) words."""
    return np.ascontiguousarray(descriptor).view(np.uint64).reshape(-1, 4)
