"""Comparison of images by their gradients, in windows."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bools, Bytes, Floats32

_SIDE_PX, _RADIUS_PX = 7, 3  # of the window whose gradients are compared
_MIN_CURVATURE = 0.02  # of the correlation along an axis; less is an edge, along which all matches


class Gradients(NamedTuple):
    """Gradient (H, W) along u and v, and its mean square in a window."""

    u: Floats32
    v: Floats32
    energy: Floats32


class Displacement(NamedTuple):
    """Where gradients match others best.

    Attributes:
        correlation: (H, W) at the same place.
        shift_px: (2, H, W) from the maximum of the correlation, along v and u.
        is_corner: (H, W) whether the distance is known along both axes.
    """

    correlation: Floats32
    shift_px: Floats32
    is_corner: Bools

    @property
    def squared_px(self) -> Floats32:
        """(H, W) square of the distance."""
        return np.asarray(self.shift_px[0] ** 2 + self.shift_px[1] ** 2)


def gradients_of(image: Bytes) -> Gradients:
    """Gradients of an image (H, W) uint8, grey levels per pixel."""
    u, v = (np.multiply(g, np.float32(0.125)) for g in cv2.spatialGradient(image))
    return Gradients(u, v, mean_product(u, v, u, v))


def correlation(
    now: Gradients, u: Floats32, v: Floats32, energy: Floats32, down: int = 0, right: int = 0
) -> Floats32:
    """(H, W) correlation of gradients with others, which have no mean to be removed.

    The others lie `down` and `right` of a place, by a pixel at most, and none beyond the border.
    """
    product = np.asarray(_mean_product(now.u, now.v, u, v, down, right))
    _normalise(product, now.energy, energy, down, right)
    return product


def mean_product(u: Floats32, v: Floats32, other_u: Floats32, other_v: Floats32) -> Floats32:
    """(H, W) mean of the scalar product of two vectors in the window round each pixel."""
    return np.asarray(_mean_product(u, v, other_u, other_v, 0, 0))


def displacement(now: Gradients, u: Floats32, v: Floats32) -> Displacement:
    """How far gradients lie from where they match others (H, W) along u and v best.

    The correlation's maximum along each axis is that of a parabola through shifts of -1, 0, and
    1 pixel; a shift along an edge cannot be measured and counts as none.
    """
    energy = mean_product(u, v, u, v)
    centre = correlation(now, u, v, energy)
    shift, is_corner = np.empty((2, *centre.shape), np.float32), np.ones(centre.shape, dtype=bool)
    for axis, (down, right) in enumerate(((1, 0), (0, 1))):
        before = correlation(now, u, v, energy, down, right)
        after = correlation(now, u, v, energy, -down, -right)
        _find_peaks(before, centre, after, shift[axis], is_corner)
    return Displacement(centre, shift, is_corner)


@compiled(error_model="numpy")
def _find_peaks(before, centre, after, shift, is_corner):  # type: ignore[no-untyped-def]
    """Maxima of parabolas through three correlations, see `displacement`."""
    for y in range(len(centre)):
        low, at, high, peaks, corners = before[y], centre[y], after[y], shift[y], is_corner[y]
        for x in range(len(at)):
            curvature = np.float32(2.0) * at[x] - low[x] - high[x]
            peak = np.float32(0.5) * (high[x] - low[x])
            peak /= max(curvature, np.float32(_MIN_CURVATURE))
            peaks[x] = peak if curvature > np.float32(_MIN_CURVATURE) else np.float32(0.0)
            corners[x] &= curvature > np.float32(_MIN_CURVATURE)


@compiled(error_model="numpy")
def _normalise(product, now, energy, down, right):  # type: ignore[no-untyped-def]
    """Divide mean products by the root of both energies, see `correlation`."""
    height, width = product.shape
    first, last = max(0, -right), width - max(0, right)
    for y in range(height):
        row, of_now = product[y, first:last], now[y, first:last]
        of_other = energy[min(max(y + down, 0), height - 1), first + right : last + right]
        for x in range(last - first):
            row[x] /= np.sqrt(of_now[x] * of_other[x] + np.float32(1e-3))


@compiled
def _mean_product(u, v, other_u, other_v, down, right):  # type: ignore[no-untyped-def]
    """In one pass over the images, which are mirrored at their borders.

    The products of seven rows are kept, and added anew for each row, so that no errors add up.
    """
    height, width = u.shape
    kept = np.zeros((_SIDE_PX, width + 2 * _RADIUS_PX), np.float32)
    sums = np.empty(width + 2 * _RADIUS_PX, np.float32)
    mean = np.empty((height, width), np.float32)
    begin, end = max(0, -right), width - max(0, right)
    for y in range(-_RADIUS_PX, height + _RADIUS_PX):
        mirrored = height - 1 - abs(height - 1 - abs(y))
        row, products = max(mirrored, 0), kept[(y + _RADIUS_PX) % _SIDE_PX]
        other = min(max(row + down, 0), height - 1)
        this_u, that_u = u[row, begin:end], other_u[other, begin + right : end + right]
        this_v, that_v = v[row, begin:end], other_v[other, begin + right : end + right]
        inside = products[_RADIUS_PX + begin : _RADIUS_PX + end]
        for x in range(end - begin):
            inside[x] = this_u[x] * that_u[x] + this_v[x] * that_v[x]
        first, last = _RADIUS_PX, width - 1 + _RADIUS_PX
        for k in range(1, _RADIUS_PX + 1):
            products[first - k], products[last + k] = products[first + k], products[last - k]
        if y < _RADIUS_PX:
            continue
        for x in range(width + 2 * _RADIUS_PX):  # written out, the compiler adds several pixels
            sums[x] = (kept[0, x] + kept[1, x] + kept[2, x] + kept[3, x]) + (
                kept[4, x] + kept[5, x] + kept[6, x]
            )
        for x in range(width):
            total = (sums[x] + sums[x + 1] + sums[x + 2] + sums[x + 3]) + (
                sums[x + 4] + sums[x + 5] + sums[x + 6]
            )
            mean[y - _RADIUS_PX, x] = total * np.float32(1.0 / _SIDE_PX**2)
    return mean
