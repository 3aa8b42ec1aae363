"""Images of markers with a known pose: what a camera with square pixels of full fill sees."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.cameras import distort, normalise
from vo.base.geometry.transforms import make_transform
from vo.base.types import Bytes, Camera, Floats
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.patterns import marker_cells, square_cells

SUPERSAMPLING = 4


class Placed(NamedTuple):
    """A marker of a dictionary in front of a camera."""

    name: str
    id: int
    length_m: float
    cam_from_marker: Floats


def texture(name: str, number: int) -> Bytes:
    """A marker of one pixel for each cell, with a white margin of one cell."""
    return np.pad(marker_cells(name, number), 1, constant_values=255)


def render(
    camera: Camera, placed: Placed, background: Bytes, *, dark: float = 25.0, bright: float = 220.0
) -> Floats:
    """Grey levels (H, W) of a marker before a background, which are averages over each pixel."""
    image = background.astype(np.float64)
    pattern = texture(placed.name, placed.id)
    cells = len(pattern) - 2
    size = placed.length_m / square_cells(placed.name)  # of a cell
    outer = square_points(size * (cells + 2))
    low, high = _box(camera, placed.cam_from_marker, outer)
    if (high <= low).any():
        return image
    n = SUPERSAMPLING
    u = (np.arange((high[0] - low[0]) * n) + 0.5) / n - 0.5 + low[0]
    v = (np.arange((high[1] - low[1]) * n) + 0.5) / n - 0.5 + low[1]
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    rays = normalise(camera, grid.reshape(-1, 2))
    rotation, translation = placed.cam_from_marker[:3, :3], placed.cam_from_marker[:3, 3]
    normal = rotation[:, 2]
    directions = np.column_stack([rays, np.ones(len(rays))])
    depth = (normal @ translation) / (directions @ normal)
    on_plane = (directions * depth[:, None] - translation) @ rotation
    column = np.floor(on_plane[:, 0] / size + cells / 2 + 1).astype(np.int64)
    row = np.floor(cells / 2 + 1 - on_plane[:, 1] / size).astype(np.int64)
    inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < cells + 2) & (depth > 0)
    part = image[low[1] : high[1], low[0] : high[0]]
    fine = np.kron(part, np.ones((n, n))).ravel()
    levels = np.where(pattern > 0, bright, dark)
    fine[inside] = levels[row[inside], column[inside]]
    shape = (high[1] - low[1], n, high[0] - low[0], n)
    image[low[1] : high[1], low[0] : high[0]] = fine.reshape(shape).mean(axis=(1, 3))
    return image


def developed(
    levels: Floats, rng: np.random.Generator, *, blur_px: float = 0.6, noise: float = 2.0
) -> Bytes:
    """Grey levels with blur and noise, in 8 bits."""
    blurred = cv2.GaussianBlur(levels, (0, 0), blur_px) if blur_px > 0 else levels
    return np.clip(np.rint(blurred + rng.normal(0.0, noise, levels.shape)), 0, 255).astype(np.uint8)


def random_background(rng: np.random.Generator, shape: tuple[int, int]) -> Bytes:
    """Cloudy grey levels."""
    coarse = rng.uniform(40, 200, (shape[0] // 40 + 2, shape[1] // 40 + 2)).astype(np.float32)
    large = cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(large, 0, 255).astype(np.uint8)


def looking_at(position: Floats, tilt: float, azimuth: float, roll: float) -> Floats:
    """cam_from_marker of a marker at a position (3,), turned by a tilt from the line of sight."""
    z = -position / np.linalg.norm(position)
    helper = np.array([0.0, -1.0, 0.0])
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    facing = np.column_stack([x, np.cross(z, x), z])
    axis = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turn = cv2.Rodrigues(tilt * axis)[0] @ cv2.Rodrigues(np.array([0.0, 0.0, roll]))[0]
    return make_transform(facing @ turn, position)


def _box(camera: Camera, cam_from_marker: Floats, outer: Floats) -> tuple[Floats, Floats]:
    ends = np.roll(outer, -1, axis=0)
    along = np.linspace(0.0, 1.0, 20)[:, None, None]
    points = (outer + along * (ends - outer)).reshape(-1, 3)
    in_cam = points @ cam_from_marker[:3, :3].T + cam_from_marker[:3, 3]
    pixels = distort(camera, in_cam[:, :2] / in_cam[:, 2:])
    low = np.maximum(np.floor(np.nanmin(pixels, axis=0)).astype(np.int64) - 2, 0)
    size = np.array([camera.width, camera.height])
    high = np.minimum(np.ceil(np.nanmax(pixels, axis=0)).astype(np.int64) + 3, size)
    return low, high
