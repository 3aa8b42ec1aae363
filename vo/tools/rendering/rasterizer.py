"""Triangles to pixels, with a depth buffer."""

from __future__ import annotations

import numpy as np

from vo.base.compiling.function import compiled, compiled_here
from vo.base.geometry import cameras
from vo.base.types import Bytes, Camera, Floats, Ints

_SAMPLES = 2  # along each axis of a pixel
_NEAR_RATIO = 1e-3  # of the size of the model: nearer triangles are not drawn
_LIGHT = np.array([0.3, -0.8, -0.5]) / np.linalg.norm([0.3, -0.8, -0.5])  # from above, in the world
_AMBIENT = 0.45


def draw(
    image: Bytes, camera: Camera, vertices: Floats, triangles: Ints, rgb: Bytes, shade: Floats
) -> Bytes:
    """Draw triangles over an image, each in one colour, with four samples per pixel.

    Vertices are distorted by the lens, edges between them are straight. Nothing in the image hides
    the model.

    `image`: (H, W, 3) uint8 BGR. `vertices`: (V, 3) in the frame of the camera. `triangles`: (T,
    3). `rgb`: (V, 3). `shade`: (T,) brightness of each triangle.
    """
    size = float(np.ptp(vertices, axis=0).max())
    depth = vertices[:, 2]
    pixels = cameras.project(camera, vertices)
    corners = pixels[triangles]
    is_visible = np.isfinite(corners).all(axis=(1, 2))
    is_visible &= (depth[triangles] > _NEAR_RATIO * size).all(axis=1)
    if not is_visible.any():
        return image
    height, width = image.shape[:2]
    # Pixel centres are whole numbers: sample k of pixel u is at u + (k + 0.5) / samples - 0.5.
    xy = np.ascontiguousarray((corners[is_visible] + 0.5) * _SAMPLES - 0.5)
    inverse_depth = np.ascontiguousarray(1.0 / depth[triangles[is_visible]])
    colour = rgb[triangles[is_visible]].mean(axis=1) * shade[is_visible, None]
    buffer = np.zeros((height * _SAMPLES, width * _SAMPLES))
    drawn = np.zeros((height * _SAMPLES, width * _SAMPLES, 3))
    _rasterize(xy, inverse_depth, np.ascontiguousarray(colour[:, ::-1]), buffer, drawn)
    shape = (height, _SAMPLES, width, _SAMPLES)
    covered = (buffer > 0.0).reshape(shape).mean(axis=(1, 3))[..., None]
    total = drawn.reshape(*shape, 3).mean(axis=(1, 3))
    return np.asarray(np.clip(total + (1.0 - covered) * image + 0.5, 0, 255).astype(np.uint8))


def warm_up() -> bool:
    """Compile what `draw` needs, and return whether anything had to be compiled."""
    before = compiled_here()
    camera, corners = Camera(8, 8, 8.0, 8.0, 4.0, 4.0), np.eye(3) + (0.0, 0.0, 1.0)
    image, rgb = np.zeros((8, 8, 3), np.uint8), np.zeros((3, 3), np.uint8)
    draw(image, camera, corners, np.arange(3)[None], rgb, np.ones(1))
    return compiled_here() != before


def shading(world_vertices: Floats, triangles: Ints) -> Floats:
    """(T,) brightness of triangles in a world with y down, from both sides alike."""
    a, b, c = (world_vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    return np.asarray(_AMBIENT + (1.0 - _AMBIENT) * np.abs(normal @ _LIGHT))


@compiled
def _rasterize(xy, inverse_depth, colour, buffer, drawn):  # type: ignore[no-untyped-def]
    """Fill `buffer` with the largest inverse depth, which is linear in the image, and `drawn`."""
    height, width = buffer.shape
    for t in range(xy.shape[0]):
        x0, y0 = xy[t, 0, 0], xy[t, 0, 1]
        x1, y1 = xy[t, 1, 0], xy[t, 1, 1]
        x2, y2 = xy[t, 2, 0], xy[t, 2, 1]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        left = max(min(x0, x1, x2), 0.0)
        right = min(max(x0, x1, x2), width - 1.0)
        top = max(min(y0, y1, y2), 0.0)
        bottom = min(max(y0, y1, y2), height - 1.0)
        if left > right or top > bottom:
            continue
        for row in range(int(np.ceil(top)), int(bottom) + 1):
            for column in range(int(np.ceil(left)), int(right) + 1):
                w0 = ((x1 - column) * (y2 - row) - (x2 - column) * (y1 - row)) / area
                w1 = ((x2 - column) * (y0 - row) - (x0 - column) * (y2 - row)) / area
                w2 = 1.0 - w0 - w1
                if w0 < 0.0 or w1 < 0.0 or w2 < 0.0:
                    continue
                near = (
                    w0 * inverse_depth[t, 0] + w1 * inverse_depth[t, 1] + w2 * inverse_depth[t, 2]
                )
                if near > buffer[row, column]:
                    buffer[row, column] = near
                    drawn[row, column, 0] = colour[t, 0]
                    drawn[row, column, 1] = colour[t, 1]
                    drawn[row, column, 2] = colour[t, 2]
