"""Smooth noise for stains on surfaces and for clouds."""

from __future__ import annotations

import numpy as np

from vo.base.types import Floats32


def soft_noise(side: int, slope: float, seed: int) -> Floats32:
    """Noise (side, side) with amplitude ~ 1/f^slope, about 0.5, in 0…1; periodic."""
    white = np.random.default_rng([seed, 50]).standard_normal((side, side), dtype=np.float32)
    fv, fu = np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :]
    frequency = np.hypot(fv, fu)
    frequency[0, 0] = np.inf
    grains = np.fft.irfft2(np.fft.rfft2(white) * frequency**-slope, s=(side, side))
    return np.asarray(np.clip(0.5 + 0.2 * grains / grains.std(), 0.0, 1.0), dtype=np.float32)
