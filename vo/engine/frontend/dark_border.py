"""Dark borders around what a camera sees: of letterboxed video, round lenses, or rectification.

What is seen lies within a convex area, also if it is cut off by the image. Dark parts of a scene
are no such border: others beside them are lit, and they move.
"""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.types import Bools, Bytes

_DARK = 20  # grey levels: 16 is black in most videos
_MIN_FIELD, _MIN_CONVEX = 0.25, 0.95  # of the image, and of the convex hull of what is seen


class DarkBorder:
    """Collects what has been seen of a scene."""

    def __init__(self) -> None:
        self._seen: Bytes | None = None

    def update(self, image: Bytes) -> None:
        """Add an image (H, W), as small as possible, since noise then matters less."""
        lit = cv2.compare(image, _DARK, cv2.CMP_GT)
        self._seen = lit if self._seen is None else cv2.bitwise_or(self._seen, lit, self._seen)

    def near(self, shape: tuple[int, ...], distance_px: int) -> Bools:
        """(H, W) where the border is, and up to a distance from it; nowhere without a border."""
        field = None if self._seen is None else _convex_field(self._seen)
        if field is None:
            return np.zeros(shape, dtype=bool)
        side = 2 * distance_px + 1
        full = cv2.resize(field, shape[::-1], interpolation=cv2.INTER_NEAREST)
        # Beyond the image there is no border.
        inside = cv2.erode(full, np.ones((side, side), np.uint8))
        return np.asarray(inside == 0)


def _convex_field(seen: Bytes) -> Bytes | None:
    """The convex hull (H, W), 255 inside, of what has been seen, if all of it has; else None."""
    at = cv2.findNonZero(seen)
    if at is None:
        return None
    field = cv2.fillConvexPoly(np.zeros_like(seen), cv2.convexHull(at), 255)
    size = int(np.count_nonzero(field))
    is_field = size >= _MIN_FIELD * field.size
    is_filled = int(np.count_nonzero(seen)) >= _MIN_CONVEX * size
    return np.asarray(field) if is_field and is_filled else None
