"""Ray casting of a world: grey images without aliasing, with motion blur and exact depth.

One ray for each pixel is cast in the middle of the exposure; its footprint on the surface
determines mip-map levels and the number of samples along its longer side. Where one surface fills a
pixel during the whole exposure, motion blur is the mean of that sharp image along its motion; only
pixels that an edge passes get more rays, distributed over area and time. Rays are an array, so that
any camera model can be rendered.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache

import numpy as np

from data_synth.scene.kernels.antialiasing import antialias_rows
from data_synth.scene.kernels.casting import cast_rows
from data_synth.scene.kernels.edges import mark_edges
from data_synth.scene.kernels.records import BAND_ROWS, Sampling, View
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.geometry.cameras import normalise
from vo.base.types import Camera, Floats, Floats32, Ints


@dataclass(frozen=True, eq=False)
class Rendered:
    """A rendered view."""

    image: Floats32  # (H, W) float32 radiance, 0…1
    # (H, W) float32 z of the surface in the camera's frame, in the middle of the row's exposure;
    # infinite for the sky and outside the image circle of the lens
    depth: Floats32


def camera_rays(camera: Camera) -> Floats:
    """Rays (H, W, 3) of all pixels in the camera's frame, with z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = normalise(camera, np.column_stack([u.ravel(), v.ravel()]))
    shape = (camera.height, camera.width, 3)
    return np.column_stack([rays, np.ones(len(rays))]).reshape(shape)


def render(world: World, rays: Floats, shutter: Shutter, pool: ThreadPoolExecutor) -> Rendered:
    """Render one view; the pool's threads share its rows.

    `world`: the world. `rays`: (H, W, 3) of the pixels in the camera's frame, z = 1; NaN outside
    the image circle of the lens. `shutter`: where the camera is, row by row, and exposure time of
    each row.
    """
    shape = rays.shape[:2]
    sharp, image, depth = (np.empty(shape, np.float32) for _ in range(3))
    view = View(sharp, depth, np.empty(shape, np.int32))
    sampling = Sampling(*sample_offsets())
    marks = np.zeros((len(sampling.counts), *shape), np.uint8)
    step = BAND_ROWS
    bands = [(top, min(top + step, shape[0])) for top in range(0, shape[0], step)]

    def cast(band: tuple[int, int]) -> None:
        cast_rows(world, shutter, rays, band, view)

    def mark(band: tuple[int, int]) -> None:
        mark_edges(world, shutter, rays, band, view, sampling.counts, marks)

    def antialias(band: tuple[int, int]) -> None:
        antialias_rows(world, shutter, rays, band, view, marks, sampling, image)

    for work in (cast, mark, antialias):  # each pass needs all rows of the one before
        list(pool.map(work, bands))
    return Rendered(image, depth)


COUNTS = (6, 8, 12, 16, 24, 32)

_TRIES = 400


@cache
def sample_offsets() -> tuple[Ints, Floats]:
    """Counts (C,) and offsets (C, 32, 3) across, down and in time, -0.5…0.5.

    They are evenly spaced in each of the three, and each is followed by its mirror image about the
    middle, so that edges are unbiased. The start and the end of the exposure come first.
    """
    offsets = np.zeros((len(COUNTS), max(COUNTS), 3))
    for i, count in enumerate(COUNTS):
        offsets[i, :count] = _spread(count)
    return np.array(COUNTS, dtype=np.int64), offsets


def _spread(count: int) -> Floats:
    """Best-candidate sampling: the largest minimum distance in each plane, of many random offsets.

    The outermost offsets across and down are in the first half, which may decide a pixel alone.
    """
    rng = np.random.default_rng([count, 51])
    half = (np.arange(count // 2)[::-1] + 0.5) / count
    best, result = -1.0, np.zeros((count, 3))
    for _ in range(_TRIES):
        signs = rng.choice([-1.0, 1.0], (2, len(half)))
        across, down = (rng.permutation(half) * s for s in signs)
        first = max(2, count // 4)
        if max(np.abs(across[first:]).max(), np.abs(down[first:]).max()) == half[0]:
            continue
        offsets = np.column_stack([across, down, half])
        offsets = np.stack([offsets, -offsets], axis=1).reshape(-1, 3)
        apart = min(_apart(offsets[:, pair]) for pair in ([0, 1], [0, 2], [1, 2]))
        if apart > best:
            best, result = apart, offsets
    return result


def _apart(points: Floats) -> float:
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    return float(distances[~np.eye(len(points), dtype=bool)].min())
