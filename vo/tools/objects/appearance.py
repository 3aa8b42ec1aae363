"""Whether a place in a scene looks like a stored side, cell by cell."""

from __future__ import annotations

import cv2
import numpy as np

from vo.base.types import Bytes, Floats
from vo.tools.objects.stored_objects import Part

THUMBNAIL_PX = 128  # longer side
_CELL_PX = 16  # of the thumbnail
_MIN_CORRELATION = 0.5
_MIN_DEVIATION = 4.0  # grey levels in a cell; flatter ones say nothing


def thumbnail_of(image: Bytes) -> Bytes:
    """An image of at most `THUMBNAIL_PX`."""
    factor = THUMBNAIL_PX / max(image.shape)
    if factor >= 1.0:
        return image
    size = [max(1, round(side * factor)) for side in image.shape[1::-1]]
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def likeness(image: Bytes, part: Part, homography: Floats) -> float:
    """Ratio of the textured cells of a side that correlate with what the scene has there.

    Each cell is compared by itself, so that light may differ and a part may be hidden; cells
    outside the image count as different.

    `image`: (H, W) uint8 scene. `homography`: (3, 3) its pixels to those of the scene.
    """
    small = part.thumbnail
    scale = np.array(part.image_size) / np.array(small.shape[1::-1])
    to_full = np.array(
        [
            [scale[0], 0.0, 0.5 * scale[0] - 0.5],
            [0.0, scale[1], 0.5 * scale[1] - 0.5],
            [0.0, 0.0, 1.0],
        ]
    )
    seen, inside = _sampled(image, np.asarray(homography @ to_full), small.shape)
    rows, columns = (max(1, side // _CELL_PX) for side in small.shape)
    agree = textured = 0
    for r in np.array_split(np.arange(small.shape[0]), rows):
        for c in np.array_split(np.arange(small.shape[1]), columns):
            cell = slice(r[0], r[-1] + 1), slice(c[0], c[-1] + 1)
            a = small[cell].astype(np.float64)
            if a.std() < _MIN_DEVIATION:
                continue
            textured += 1
            b = seen[cell].astype(np.float64)
            if inside[cell].all() and b.std() > 0:
                correlation = ((a - a.mean()) * (b - b.mean())).mean() / (a.std() * b.std())
                agree += bool(correlation >= _MIN_CORRELATION)
    return agree / textured if textured else 0.0


def _sampled(image: Bytes, image_from_small: Floats, shape: tuple[int, ...]) -> tuple[Bytes, Bytes]:
    """A scene at the pixels of a thumbnail, blurred to their size, and which are inside."""
    height, width = shape[:2]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float64)
    at = np.column_stack([corners, np.ones(4)]) @ image_from_small.T
    at = at[:, :2] / at[:, 2:]
    low = np.floor(at.min(axis=0)).clip(0).astype(int)
    high = np.ceil(at.max(axis=0)).astype(int) + 1
    high = np.minimum(high, np.array(image.shape[1::-1]))
    nothing = np.zeros(shape, np.uint8)
    if (high - low < 2).any():
        return nothing, nothing
    region = image[low[1] : high[1], low[0] : high[0]]
    move = np.array([[1.0, 0.0, -low[0]], [0.0, 1.0, -low[1]], [0.0, 0.0, 1.0]])
    step = float(np.sqrt(cv2.contourArea(at.astype(np.float32)) / (width * height)))
    if step > 1.2:
        region = cv2.GaussianBlur(region, (0, 0), 0.4 * step)
    matrix = move @ image_from_small
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    seen = cv2.warpPerspective(region, matrix, (width, height), flags=flags)
    ones = np.full(region.shape, 255, np.uint8)
    inside = cv2.warpPerspective(ones, matrix, (width, height), flags=flags)
    return np.asarray(seen, np.uint8), np.asarray(inside == 255)
