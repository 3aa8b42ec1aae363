"""Rows that images lack: found where other images have them, and left out."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.random import default_rng

from vo.base.types import Bytes, Frame
from vo.engine.frontend.missing_rows import MissingRows

WHOLE = np.asarray(default_rng(0).integers(0, 256, (200, 320)), np.uint8)


def cut(bottom: int, grey: int = 128) -> Bytes:
    image = WHOLE.copy()
    image[200 - bottom :] = grey
    return image


def faded() -> Bytes:
    """A dark floor: grey levels fall to 0 row by row."""
    return np.asarray(WHOLE * np.clip((120 - np.arange(200)) / 120, 0, 1)[:, None], np.uint8)


def found(*images: Bytes) -> list[tuple[Frame, float]]:
    rows = MissingRows()
    frames = [rows.update(Frame(i, i * 50_000_000, (image,))) for i, image in enumerate(images)]
    return [(frame, sum(fault.value for fault in faults)) for frame, faults in frames]


@pytest.mark.parametrize("grey", [0, 128])
@pytest.mark.parametrize("turned", [lambda i: i, np.flipud], ids=["bottom", "top"])
def test_a_band_that_other_images_lack_is_left_out(
    grey: int, turned: Callable[[Bytes], Bytes]
) -> None:
    images = [np.ascontiguousarray(turned(i)) for i in (WHOLE, cut(60, grey), WHOLE)]
    (first, none), (second, ratio), (_, last) = found(*images)
    assert (none, ratio, last) == (0.0, 0.3, 0.0)
    assert first.mask is None
    assert second.mask is not None
    assert np.array_equal(turned(second.mask) == 0, np.arange(200)[:, None] >= np.full(320, 140))


@pytest.mark.parametrize(
    "images",
    [
        [cut(60), cut(60), cut(60)],
        [WHOLE, cut(60, 255)],
        [WHOLE, faded()],
        [WHOLE, np.full_like(WHOLE, 128)],
        [WHOLE, cut(5)],
    ],
    ids=["letterbox", "overexposed", "dark floor", "covered", "few rows"],
)
def test_other_bands_are_not(images: list[Bytes]) -> None:
    assert all(frame.mask is None and ratio == 0.0 for frame, ratio in found(*images))
