"""Overlap of outlines, so that nothing is reported twice and tracks are continued."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vo.base.types import Floats
from vo.tools.objects.records import FoundObject

_SAME_OBJECT, _OTHER_OBJECT = 0.2, 0.5  # overlap from which two reports exclude each other


def overlap(a: Floats, b: Floats) -> float:
    """Intersection over union of the convex hulls of two outlines (M, 2)."""
    first, second = (cv2.convexHull(each.astype(np.float32)) for each in (a, b))
    areas = cv2.contourArea(first), cv2.contourArea(second)
    common = float(cv2.intersectConvexConvex(first, second)[0])
    union = areas[0] + areas[1] - common
    return common / union if union > 0 else 0.0


def without_overlaps(found: Sequence[FoundObject]) -> list[int]:
    """Rows of the instances that do not lie on a better one, the most confident first.

    Of two objects that look the same, and of two parts of one object, the better one is kept.
    """
    kept: list[int] = []
    order = sorted(range(len(found)), key=lambda n: (-found[n].confidence, -found[n].inliers, n))
    for n in order:
        if all(
            overlap(found[n].outline, found[k].outline) < _limit(found[n], found[k]) for k in kept
        ):
            kept.append(n)
    return kept


def _limit(a: FoundObject, b: FoundObject) -> float:
    return _SAME_OBJECT if a.name == b.name else _OTHER_OBJECT
