"""Rows that an image lacks, as where a stream is damaged: a band of one grey at an edge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes, Frame

_MIN_ROWS = 8
_WHITE = 255  # overexposed sky is a band of one grey, too
# Of the first row beside the band, this ratio of pixels differs from it by so many grey levels;
# where light fades, or a dark floor begins, fewer do.
_MIN_RATIO, _MIN_STEP = 0.75, 4


class MissingRows:
    """Masks rows at the top or bottom of left images that some images have, and others lack."""

    def __init__(self) -> None:
        self._usual: list[int] = []  # rows of one grey that all images have had, by edge

    def update(self, frame: Frame) -> tuple[Frame, tuple[Fault, ...]]:
        """The next frame, with a mask if rows are missing, and the fault."""
        image = frame.image0
        found = [_band(image), _band(image[::-1])]
        self._usual = list(map(min, found, self._usual or found))
        height, missing = len(image), [0, 0]
        for i, rows in enumerate((image, image[::-1])):
            if self._usual[i] + _MIN_ROWS <= found[i] < height and _is_cut(rows, found[i]):
                missing[i] = found[i]
        if not any(missing):
            return frame, ()
        mask = np.full(image.shape, 255, np.uint8) if frame.mask is None else frame.mask.copy()
        mask[: missing[0]] = mask[height - missing[1] :] = 0
        fault = Fault(FaultKind.MISSING_ROWS, is_handled=True, value=sum(missing) / height)
        return replace(frame, mask=mask), (fault,)


def _band(image: Bytes) -> int:
    """Number of rows from the first one on of an (H, W) image that have its first pixel's grey."""
    grey = image[0, 0]
    if grey != image[0, -1] or grey == _WHITE or (image[0] != grey).any():
        return 0
    other = (image != grey).any(axis=1)
    return int(np.argmax(other)) if other.any() else len(image)


def _is_cut(image: Bytes, rows: int) -> bool:
    """Whether the content of an image begins at once beside so many rows of one grey."""
    step = np.abs(image[rows].astype(np.int16) - int(image[0, 0]))
    return float((step > _MIN_STEP).mean()) >= _MIN_RATIO
