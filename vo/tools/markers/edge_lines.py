"""Corners of a marker as intersections of the lines along its four sides."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from vo.base.geometry.cameras import distort, normalise
from vo.base.types import Bools, Bytes, Camera, Floats

_MARGIN = 0.12  # of a side, at both ends, where blur mixes it with the next side
_MAX_SAMPLES, _MIN_SAMPLES = 120, 8  # along a side
_STEP_PX = 0.5  # of profiles across a side
_MAX_REACH_PX, _MIN_REACH_PX = 6.0, 1.5
_ROUNDS = 3
_MIN_CONTRAST_RATIO = 0.4  # of a profile, relative to the median of the marker
_MIN_CONTRAST = 12.0  # grey levels between the border and what is around it
_MIN_USED = 0.45  # of the samples of a side
_CUT = 2.5  # standard deviations at which a sample is left out
_MODEL_SIGMA_PX = 0.02  # of a corner: what blur, aliasing and rounding leave
_SMALL_CELL_SIGMA_PX = 0.6  # divided by the square of a cell's side: blur reaches the next cell
_MAX_RESIDUAL_PX, _MAX_RESIDUAL_RATIO = 0.35, 0.012  # RMS distance from the line; of the side


class RefinedCorners(NamedTuple):
    """Corners (4, 2) in pixels, and the standard deviation of their coordinates."""

    corners: Floats
    sigma_px: float


def refine_corners(
    image: Bytes, corners: Floats, cells: int, camera: Camera | None = None
) -> RefinedCorners | None:
    """Corners by lines through the edges between the black border and its surroundings.

    Edges are measured along each side, every pixel or so, as the mean position of the grey-level
    gradient; lines are straight in ideal pixels, so that a lens does not bend them.

    `image`: (H, W) uint8. `corners`: (4, 2) pixels, right to a pixel or two. `camera`: of the
    image; None for one without distortion.

    Returns None where a side is not a straight edge from dark to bright for about half of its
    length.
    """
    camera = camera if camera is not None and camera.is_distorted else None
    current = corners if camera is None else _to_ideal(camera, corners)
    if not np.isfinite(current).all():
        return None
    levels: Floats = image.astype(np.float64)
    sigma = np.inf
    for number in range(_ROUNDS):
        lines = _lines(levels, current, cells, camera, is_first=number == 0)
        if lines is None:
            return None
        normals, offsets, sigmas = lines
        refined = _intersections(normals, offsets)
        if refined is None:
            return None
        moved = float(np.abs(refined - current).max())
        current, sigma = refined, float(np.sqrt(np.mean(sigmas**2)))
        if moved < 0.01:
            break
    pixels = current if camera is None else _to_image(camera, current)
    side = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).min()
    if not np.isfinite(pixels).all() or np.abs(pixels - corners).max() > max(3.0, 0.1 * side):
        return None
    small = _SMALL_CELL_SIGMA_PX * (cells / side) ** 2
    return RefinedCorners(pixels, float(np.sqrt(_MODEL_SIGMA_PX**2 + small**2 + sigma**2)))


def _lines(
    image: Floats, corners: Floats, cells: int, camera: Camera | None, *, is_first: bool
) -> tuple[Floats, Floats, Floats] | None:
    """Normals (4, 2) and offsets (4,) of the sides, n . p = c, and sigmas of their ends (4,)."""
    ends = np.roll(corners, -1, axis=0)
    centre = corners.mean(axis=0)
    normals, offsets, sigmas = np.empty((4, 2)), np.empty(4), np.empty(4)
    sides = [_side(image, corners[i], ends[i], centre, cells, camera, is_first) for i in range(4)]
    typical = float(np.median([side.contrast for side in sides]))
    if typical < _MIN_CONTRAST:
        return None
    for i, side in enumerate(sides):
        used = side.contrasts > _MIN_CONTRAST_RATIO * typical
        line = _fit(side.edge, used)
        if line is None:
            return None
        normals[i], offsets[i], sigmas[i], rms = line
        length = float(np.linalg.norm(ends[i] - corners[i]))
        if rms > max(_MAX_RESIDUAL_PX, _MAX_RESIDUAL_RATIO * length):
            return None
    return normals, offsets, sigmas


class _Side(NamedTuple):
    """Edge points (N, 2) in ideal pixels along a side, and the contrast at each (N,)."""

    edge: Floats
    contrasts: Floats

    @property
    def contrast(self) -> float:
        return float(np.median(self.contrasts))


def _side(
    image: Floats,
    begin: Floats,
    end: Floats,
    centre: Floats,
    cells: int,
    camera: Camera | None,
    is_first: bool,
) -> _Side:
    length = float(np.linalg.norm(end - begin))
    count = int(np.clip(length * (1 - 2 * _MARGIN), _MIN_SAMPLES, _MAX_SAMPLES))
    along = np.linspace(_MARGIN, 1.0 - _MARGIN, count)[:, None]
    points = begin + along * (end - begin)
    direction = (end - begin) / max(length, 1e-9)
    outward = np.array([direction[1], -direction[0]])
    height = float(outward @ (begin - centre))
    outward = outward if height > 0 else -outward
    # The side of a cell across this side: the marker's depth as seen, not its length.
    cell = 2.0 * abs(height) / cells
    most = _MAX_REACH_PX if is_first else 0.7 * _MAX_REACH_PX
    reach = float(np.clip(0.8 * cell, _MIN_REACH_PX, most))
    steps = np.arange(-reach, reach + 0.5 * _STEP_PX, _STEP_PX)
    grid = points[:, None] + steps[None, :, None] * outward
    profiles = _sample(image, grid, camera)
    gradient = np.maximum(np.diff(profiles, axis=1), 0.0)
    between = 0.5 * (steps[:-1] + steps[1:])
    # Gradients far below the largest one are noise and neighbours; they would pull to the middle.
    gradient = np.maximum(gradient - 0.2 * gradient.max(axis=1, keepdims=True), 0.0)
    total = gradient.sum(axis=1)
    offset = (gradient @ between) / np.maximum(total, 1e-6)
    third = max(1, len(steps) // 4)
    contrasts = profiles[:, -third:].mean(axis=1) - profiles[:, :third].mean(axis=1)
    return _Side(points + offset[:, None] * outward, np.asarray(contrasts, dtype=np.float64))


def _fit(edge: Floats, used: Bools) -> tuple[Floats, float, float, float] | None:
    """Normal, offset, standard deviation at the ends, and RMS distance of a line."""
    count = len(edge)
    limit = np.inf
    for _ in range(3):
        rows = edge[used]
        if len(rows) < max(_MIN_USED * count, 4):
            return None
        mean = rows.mean(axis=0)
        _, _, axes = np.linalg.svd(rows - mean, full_matrices=False)
        normal = axes[1]
        distance = (edge - mean) @ normal
        spread = 1.4826 * float(np.median(np.abs(distance[used])))
        limit = max(_CUT * spread, 0.05)
        used = used & (np.abs(distance) < limit)
    rows = edge[used]
    if len(rows) < max(_MIN_USED * count, 4):
        return None
    mean = rows.mean(axis=0)
    normal = np.linalg.svd(rows - mean, full_matrices=False)[2][1]
    rms = float(np.sqrt(np.mean(((rows - mean) @ normal) ** 2)))
    # At an end of a line through n equal points the variance is 4 / n of theirs, and neighbouring
    # profiles share pixels.
    return normal, float(normal @ mean), rms * np.sqrt(8.0 / len(rows)), rms


def _sample(image: Floats, grid: Floats, camera: Camera | None) -> Floats:
    xy = grid if camera is None else _to_image(camera, grid.reshape(-1, 2)).reshape(grid.shape)
    xy = np.nan_to_num(xy, nan=-1e4).astype(np.float32)
    return np.asarray(
        cv2.remap(image, xy[..., 0], xy[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float64,
    )


def _intersections(normals: Floats, offsets: Floats) -> Floats | None:
    """(4, 2) where each side meets the one before it."""
    found = np.empty((4, 2))
    for i in range(4):
        matrix = normals[[i - 1, i]]
        if abs(np.linalg.det(matrix)) < 0.05:
            return None
        found[i] = np.linalg.solve(matrix, offsets[[i - 1, i]])
    return found


def _to_ideal(camera: Camera, pixels: Floats) -> Floats:
    return np.asarray(normalise(camera, pixels) * (camera.fx, camera.fy) + (camera.cx, camera.cy))


def _to_image(camera: Camera, ideal: Floats) -> Floats:
    return distort(camera, (ideal - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
