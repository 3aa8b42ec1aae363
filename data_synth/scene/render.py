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

import numpy as np

from data_synth.scene.kernels.antialiasing import antialias_rows
from data_synth.scene.kernels.casting import cast_rows
from data_synth.scene.kernels.edges import mark_edges
from data_synth.scene.kernels.records import BAND_ROWS, Sampling, View
from data_synth.scene.sampling import sample_offsets
from data_synth.scene.shutter import Shutter
from data_synth.scene.world import World
from vo.base.geometry.cameras import normalise
from vo.base.types import Camera, Floats, Floats32


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
