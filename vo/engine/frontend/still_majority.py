"""Detection of images of which most stays the same while a part keeps changing.

Either the camera stands while something passes, or most of the image is fixed to the camera, and
hides that it moves. Such a recording never moves as a whole, so that the fixed content cannot be
told from the scene.
"""

from __future__ import annotations

import numpy as np

from vo.base.geometry.quantiles import percentiles
from vo.base.types import Bools, Floats32
from vo.engine.frontend.image_gradients import Gradients

_STEP = 2  # every second pixel of every second row is enough
_FLATTEST_PERCENT = 5  # of the image, which show the noise
# Correlation of gradients, without their noise, below which a place has changed. A camera that
# stands has at most 2 % of such places, in the dark and under flickering lamps, too.
_SAME = 0.85
_MIN_CHANGED = 0.08
# Comparisons with the same image. On clean recordings it is replaced after at most 9.
_MIN_COMPARISONS = 12


class StillMajority:
    """Counts comparisons with an image that is kept because too little has changed since."""

    def __init__(self) -> None:
        self._count = 0

    def restart(self) -> None:
        """Begin with another image."""
        self._count = 0

    def update(self, now: Gradients, kept: Gradients, similar: Floats32, textured: Bools) -> bool:
        """Add a comparison.

        Args:
            now: gradients of an image.
            kept: those of the image that is kept.
            similar: (H, W) their correlation.
            textured: (H, W) where there is texture.

        Returns:
            Whether a part has changed in many comparisons, while most has stayed the same.
        """
        sample = slice(None, None, _STEP)
        at = textured[sample, sample]
        signal = _signal(now.energy[sample, sample]) * _signal(kept.energy[sample, sample])
        is_changed = similar[sample, sample] < _SAME * np.sqrt(signal)
        count = int(np.count_nonzero(at))
        changed = int(np.count_nonzero(at & is_changed)) / max(1, count)
        self._count += changed >= _MIN_CHANGED
        return self._count >= _MIN_COMPARISONS


def _signal(energy: Floats32) -> Floats32:
    """Ratio of the energy of gradients (H, W) that is not noise."""
    noise = np.float32(percentiles(energy[::2, ::2], (_FLATTEST_PERCENT,))[0])
    return np.asarray(1.0 - noise / np.maximum(energy, noise + np.float32(1e-3)))
