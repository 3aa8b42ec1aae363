"""Comparison of images by their gradients, in windows."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.types import Bytes, Floats32

_SIDE_PX = 7  # of the window whose gradients are compared


class Gradients(NamedTuple):
    """Gradient (H, W) along u and v, and its mean square in a window."""

    u: Floats32
    v: Floats32
    energy: Floats32


def gradients_of(image: Bytes) -> Gradients:
    """Gradients of an image (H, W) uint8, grey levels per pixel."""
    u, v = (g.astype(np.float32) * np.float32(0.125) for g in cv2.spatialGradient(image))
    return Gradients(u, v, window_mean(u * u + v * v))


def correlation(now: Gradients, u: Floats32, v: Floats32, energy: Floats32) -> Floats32:
    """(H, W) correlation of gradients with others, which have no mean to be removed."""
    product = window_mean(now.u * u + now.v * v)
    return np.asarray(product / np.sqrt(now.energy * energy + np.float32(1e-3)))


def window_mean(values: Floats32) -> Floats32:
    """(H, W) mean of values (H, W) in the window round each pixel."""
    return np.asarray(cv2.boxFilter(values, -1, (_SIDE_PX, _SIDE_PX)))
