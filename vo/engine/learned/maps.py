"""Maps that networks give: padding of their input, maxima, and values between pixels."""

from __future__ import annotations

import math

import cv2
import numpy as np

from vo.base.compiling.function import compiled
from vo.base.types import Bytes, Floats, Floats32, Ints, Keypoints

MIN_SIDE_OF_32 = 33
"""Smallest side of an image for networks whose coarsest cells have 32 pixels: two cells.

With one row or column of cells OpenCV 5.0 gives wrong values, which change from call to call.
"""
_CELL = 8  # pixels of the image a side for each cell of a map of descriptors
_CUBIC = -0.75  # parameter of the interpolation kernel (Keys 1981)


def padded(image: Bytes, multiple: int) -> Bytes:
    """The image (H, W), continued to multiples of a size by its last row and column."""
    height, width = (-size % multiple for size in image.shape)
    border = cv2.BORDER_REPLICATE
    return np.asarray(cv2.copyMakeBorder(image, 0, height, 0, width, border), dtype=np.uint8)


def network_input(image: Bytes, multiple: int) -> Floats32:
    """(1, 1, H, W) between 0 and 1 of an image, continued to multiples of a size."""
    given = padded(image, multiple).astype(np.float32)[None, None]
    given /= np.float32(255.0)
    return given


def masked(values: Floats32, mask: Bytes | None) -> Floats32:
    """The map (H, W) with 0 where a mask is 0; without a mask the map itself."""
    return values if mask is None else np.where(mask > 0, values, np.float32(0.0))


def without_neighbours(score: Floats32, radius: int) -> Floats32:
    """The map (H, W) where it is the maximum of the square around it, 0 elsewhere.

    Points that only maxima suppress which are suppressed themselves are found in two more rounds,
    as in SuperGlue (Sarlin et al., CVPR 2020), whose detectors were trained and tested so.
    """
    kernel = np.ones((2 * radius + 1,) * 2, np.uint8)
    is_maximum = score == cv2.dilate(score, kernel)
    for _ in range(2):
        is_near = cv2.dilate(is_maximum.astype(np.uint8), kernel) > 0
        rest = np.where(is_near, np.float32(0.0), score)
        is_maximum |= (rest == cv2.dilate(rest, kernel)) & ~is_near
    return np.where(is_maximum, score, np.float32(0.0))


def without_border(score: Floats32, border: int) -> Floats32:
    """The map (H, W) with 0 at pixels that are nearer to its edge than a number of pixels."""
    height, width = score.shape
    inside = np.zeros_like(score)
    rows, columns = slice(border, max(height - border, 0)), slice(border, max(width - border, 0))
    inside[rows, columns] = score[rows, columns]
    return inside


def strongest(peaks: Floats32, count: int) -> tuple[Ints, Ints]:
    """Rows and columns of the highest positive values of a map, from the highest; ties by row."""
    v, u = np.nonzero(peaks > 0)
    order = np.lexsort((u, v, -peaks[v, u]))[:count]
    return v[order], u[order]


def parabola_offsets(values: Floats | Floats32, v: Ints, u: Ints) -> Floats:
    """(N, 2) x, y from maxima to the vertices of parabolas through them and their neighbours.

    At most half a pixel, 0 at the border.
    """
    height, width = values.shape
    offsets = np.zeros((len(u), 2))
    for axis, (dv, du, limit, at) in enumerate(((0, 1, width, u), (1, 0, height, v))):
        inside = np.flatnonzero((at > 0) & (at < limit - 1))
        y, x = v[inside], u[inside]
        before, peak, after = (
            values[y + s * dv, x + s * du].astype(np.float64) for s in (-1, 0, 1)
        )
        curvature = before - 2.0 * peak + after
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = 0.5 * (before - after) / curvature
        offsets[inside, axis] = np.where(curvature < -1e-9, offset.clip(-0.5, 0.5), 0.0)
    return offsets


def learned_keypoints(
    xy: Floats, score: Floats | Floats32, descriptor: Floats | Floats32
) -> Keypoints:
    """Features without scale and angle; descriptors (N, D) are made unit vectors."""
    length = np.maximum(np.linalg.norm(descriptor, axis=1, keepdims=True), 1e-12)
    return unit_keypoints(xy, score, descriptor / length)


def unit_keypoints(
    xy: Floats, score: Floats | Floats32, descriptor: Floats | Floats32
) -> Keypoints:
    """Features without scale and angle, with descriptors (N, D) of unit length."""
    return Keypoints(
        xy.astype(np.float32),
        np.zeros(len(xy), np.int32),
        np.full(len(xy), np.nan, np.float32),
        score.astype(np.float32),
        descriptor.astype(np.float32),
    )


def no_keypoints(width: int) -> Keypoints:
    """No features, of descriptors of a width."""
    return unit_keypoints(np.empty((0, 2)), np.empty(0), np.empty((0, width)))


def to_cells(xy: Floats) -> Floats:
    """Positions (N, 2) in a map of cells of 8 x 8 pixels; the centre of its first cell is 0."""
    return (xy + 0.5) / _CELL - 0.5


def bilinear(values: Floats32, at: Floats) -> Floats:
    """(..., N) values of maps (..., H, W) at positions (N, 2) x, y; outside, those of the edge."""
    height, width = values.shape[-2:]
    x, y = at[:, 0].clip(0, width - 1), at[:, 1].clip(0, height - 1)
    left = np.minimum(x.astype(np.int64), max(width - 2, 0))
    top = np.minimum(y.astype(np.int64), max(height - 2, 0))
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    a, b = x - left, y - top
    upper = values[..., top, left] * (1 - a) + values[..., top, right] * a
    lower = values[..., bottom, left] * (1 - a) + values[..., bottom, right] * a
    return np.asarray(upper * (1 - b) + lower * b, dtype=np.float64)


def bicubic(values: Floats32, at: Floats) -> Floats:
    """(N, C) values of maps (C, H, W) at positions (N, 2) x, y, 0 outside.

    Source: Keys, "Cubic convolution interpolation for digital image processing", 1981.
    """
    result = np.zeros((len(at), len(values)))
    if len(at) > 0:
        # All maps of a pixel side by side, so that they are read in one piece.
        by_pixel = cv2.transpose(values.reshape(len(values), -1)).reshape(*values.shape[1:], -1)
        _add_weighted(by_pixel, at, result)
    return result


@compiled
def _add_weighted(values, at, result):  # type: ignore[no-untyped-def]
    """Add the 4 x 4 values of maps (H, W, C) around positions (N, 2) by the kernel's weights."""
    height, width, channels = values.shape
    for n in range(len(at)):
        left, top = math.floor(at[n, 0]) - 1, math.floor(at[n, 1]) - 1
        for j in range(4):
            v = top + j
            for i in range(4):
                u = left + i
                if 0 <= u < width and 0 <= v < height:
                    weight = _kernel(at[n, 0] - u) * _kernel(at[n, 1] - v)
                    for c in range(channels):
                        result[n, c] += weight * values[v, u, c]


@compiled
def _kernel(distance):  # type: ignore[no-untyped-def]
    d, a = abs(distance), _CUBIC
    if d <= 1:
        return (a + 2) * (d * d * d) - (a + 3) * (d * d) + 1
    if d < 2:
        return a * (d * d * d) - 5 * a * (d * d) + 8 * a * d - 4 * a
    return 0.0
