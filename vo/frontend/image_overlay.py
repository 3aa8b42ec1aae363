"""Detection of a picture that lies over all of the image and does not move with the scene.

A reflection in a windscreen, or the dots of an infrared projector. Scene and picture add up, so
that no place stays the same. But in the mean over many images the gradients of a scene that moves
cancel out, and those of the picture remain.
"""

from __future__ import annotations

import numpy as np

from vo.frontend.image_gradients import Gradients, correlation, window_mean
from vo.geometry.quantiles import median
from vo.types import Bools, Floats32

# Correlation of gradients below which a place has moved, above which it has not, the ratio of
# texture that must have moved, and the maximum of what is between, relative to it.
_MOVED, _SAME, _MIN_MOVED, _MAX_BETWEEN = 0.65, 0.9, 0.4, 0.25
_WEIGHT, _MIN_IMAGES = 0.2, 8  # of the newest image in the mean
# Median over the image of the energy of the mean gradient to the mean energy. Without such a
# picture it was at most 0.19, with a faint one, of 20 % of the brightness, 0.26 in the mean.
_MIN_COHERENCE = 0.22
_MIN_IN_A_ROW = 3
_MAX_IMAGES = 60  # after which such a picture is no longer looked for
_MIN_ENERGY = 9.0
_STEP = 4  # every fourth pixel of every fourth row is enough for a median


class OverlayDetector:
    """Averages the gradients of images between which the scene has moved clearly."""

    def __init__(self) -> None:
        self._last: Gradients | None = None
        self._mean: tuple[Floats32, Floats32, Floats32]  # gradient along u and v, energy
        self._images = 0
        self._in_a_row = 0

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
            self._last, self._mean = now, (now.u.copy(), now.v.copy(), now.energy.copy())
        elif self._images < _MAX_IMAGES and textured.any():
            if other is not self._last:
                similar = correlation(now, self._last.u, self._last.v, self._last.energy)
            if _has_moved(similar[textured]):
                self._add(now, textured)
        return self._in_a_row >= _MIN_IN_A_ROW

    def _add(self, now: Gradients, textured: Bools) -> None:
        self._last = now
        self._images += 1
        weight = np.float32(max(_WEIGHT, 1.0 / (1 + self._images)))
        for mean, value in zip(self._mean, now, strict=True):
            mean += weight * (value - mean)
        if self._images >= _MIN_IMAGES:
            is_coherent = self._coherence(textured) > _MIN_COHERENCE
            self._in_a_row = self._in_a_row + 1 if is_coherent else 0

    def _coherence(self, textured: Bools) -> float:
        u, v, energy = self._mean
        step = slice(None, None, _STEP)
        remaining, energy = window_mean(u * u + v * v)[step, step], energy[step, step]
        at = textured[step, step] & (energy > _MIN_ENERGY)
        return median(remaining[at] / energy[at]) if at.any() else 0.0


def _has_moved(similar: Floats32) -> bool:
    """Whether nearly all places, by their correlation (N,), have moved or are the same."""
    moved, same = float(np.mean(similar < _MOVED)), float(np.mean(similar > _SAME))
    return moved > _MIN_MOVED and 1.0 - moved - same < _MAX_BETWEEN * moved
