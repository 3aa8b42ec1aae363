"""Detection of a picture that lies over all of the image and does not move with the scene.

A reflection in a windscreen, or the dots of an infrared projector. Scene and picture add up, so
that no place stays the same. But in the mean over several images the gradients of a scene that
moves cancel out, and those of the picture remain: the means of different images have its corners at
the same places. Edges say nothing, as those that point to the focus of expansion don't move either.
"""

from __future__ import annotations

import numpy as np

from vo.base.types import Bools, Floats32
from vo.engine.frontend.image_gradients import Gradients, correlation, displacement, mean_product

# Correlation of gradients below which a place has moved, above which it has not, the ratio of
# texture that must have moved, and the maximum of what is between, relative to it.
_MOVED, _SAME, _MIN_MOVED, _MAX_BETWEEN = 0.65, 0.9, 0.4, 0.25
_MEAN_OF = 5  # images
_MIN_CORRELATION, _MAX_SHIFT_PX = 0.6, 0.3  # of the corners of two means
# Ratio of such corners to the texture that changes, where the correlation is below the limit. It
# was at most 0.031 without such a picture (a corridor), 0.032 beside a body, 0.050 to 0.061 with a
# reflection of 40 % of the brightness, and 0.06 to 0.11 of 60 %.
_CHANGED, _MIN_RATIO = 0.8, 0.042
_MAX_IMAGES = 60  # after which such a picture is no longer looked for
_MIN_ENERGY = 9.0


class OverlayDetector:
    """Averages the gradients of images between which the scene has moved clearly."""

    def __init__(self) -> None:
        self._last: Gradients | None = None
        self._sum: Gradients | None = None
        self._mean: Gradients | None = None  # of the images before
        self._images = 0
        self._is_found = False  # in the newest mean

    def update(self, now: Gradients, textured: Bools, other: Gradients, similar: Floats32) -> bool:
        """Add an image.

        Args:
            now: the gradients of the image.
            textured: (H, W) where it is textured.
            other: the gradients of an image before it.
            similar: (H, W) correlation of the two, used if that was the last one added here.

        Returns:
            Whether a picture lies over the scene.
        """
        if self._last is None:
            self._last = now
        elif self._images < _MAX_IMAGES and textured.any():
            if other is not self._last:
                similar = correlation(now, self._last.u, self._last.v, self._last.energy)
            if _has_moved(similar[textured]):
                self._add(now, textured & (similar < _CHANGED))
        return self._is_found

    def _add(self, now: Gradients, places: Bools) -> None:
        self._last = now
        self._images += 1
        if self._sum is None:
            self._sum = Gradients(*(np.zeros_like(value) for value in now))
        for total, value in zip(self._sum, now, strict=True):
            total += value
        if self._images % _MEAN_OF == 0:
            mean = Gradients(*(np.asarray(total / np.float32(_MEAN_OF)) for total in self._sum))
            if self._mean is not None:
                self._is_found = _has_same_corners(mean, self._mean, places)
            self._mean, self._sum = mean, None


def _has_same_corners(mean: Gradients, before: Gradients, places: Bools) -> bool:
    """Whether enough places (H, W) have corners in the same position in two means of gradients."""
    at = places & (np.minimum(mean.energy, before.energy) > _MIN_ENERGY)
    fewest = _MIN_RATIO * max(1, int(np.count_nonzero(at)))
    u, v = before.u, before.v
    remaining = mean._replace(energy=mean_product(mean.u, mean.v, mean.u, mean.v))
    # Mostly too few, which spares the comparison with shifted means.
    at &= correlation(remaining, u, v, mean_product(u, v, u, v)) > _MIN_CORRELATION
    if np.count_nonzero(at) <= fewest:
        return False
    found = displacement(remaining, u, v)
    at &= found.is_corner & (found.squared_px < _MAX_SHIFT_PX**2)
    return bool(np.count_nonzero(at) > fewest)


def _has_moved(similar: Floats32) -> bool:
    """Whether nearly all places, by their correlation (N,), have moved or are the same."""
    of_kinds = similar < _MOVED, similar > _SAME
    moved, same = (int(np.count_nonzero(at)) / len(at) for at in of_kinds)
    return moved > _MIN_MOVED and 1.0 - moved - same < _MAX_BETWEEN * moved
