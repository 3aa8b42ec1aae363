"""Comparison of images by their gradients, in windows."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.types import Bools, Bytes, Floats32

_SIDE_PX = 7  # of the window whose gradients are compared
_MIN_CURVATURE = 0.02  # of the correlation along an axis; less is an edge, along which all matches


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


def lies_still(now: Gradients, u: Floats32, v: Floats32, max_px: float) -> Bools:
    """(H, W) whether gradients match others at the same place better than beside it.

    The correlation's maximum along each axis is that of a parabola through shifts of -1, 0, and
    1 pixel; a shift along an edge cannot be measured and counts as none.

    Args:
        now: gradients (H, W).
        u: the others along u (H, W).
        v: the others along v (H, W).
        max_px: how far from the place the maximum may be.
    """

    def correlation_at(shift: int, axis: int) -> Floats32:
        shifted_u, shifted_v = np.roll(u, shift, axis), np.roll(v, shift, axis)
        energy = window_mean(shifted_u * shifted_u + shifted_v * shifted_v)
        return correlation(now, shifted_u, shifted_v, energy)

    centre = correlation_at(0, 0)
    squared = np.zeros_like(centre)
    for axis in (0, 1):
        before, after = correlation_at(-1, axis), correlation_at(1, axis)
        curvature = 2.0 * centre - before - after
        peak = 0.5 * (after - before) / np.maximum(curvature, _MIN_CURVATURE)
        squared += np.where(curvature > _MIN_CURVATURE, peak * peak, 0.0)
    return np.asarray(squared < max_px * max_px)
