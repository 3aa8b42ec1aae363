"""Ray casting of a world of boxes: grey images without aliasing, with exact depth.

Each pixel gets one ray, whose footprint on the surface chooses mip-map levels and the number of
samples along its longer side; only pixels beside an edge get more rays. Rays come as an array, so
that any camera model fits.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from data_synth.scene import kernels
from data_synth.scene.world import World
from vo.geometry.cameras import normalise
from vo.types import Camera, Floats, Floats32

_BAND_ROWS = 3 * kernels.TILE


@dataclass(frozen=True, eq=False)
class Rendered:
    """What one camera sees.

    Attributes:
        image: (H, W) float32 radiance, 0…1.
        depth: (H, W) float32 z of the surface in the camera's frame, infinite for the sky.
    """

    image: Floats32
    depth: Floats32


def camera_rays(camera: Camera) -> Floats:
    """Rays (H, W, 3) of all pixels in the camera's frame, with z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = normalise(camera, np.column_stack([u.ravel(), v.ravel()]))
    shape = (camera.height, camera.width, 3)
    return np.column_stack([rays, np.ones(len(rays))]).reshape(shape)


def render(
    world: World, rays: Floats, world_from_cam: Floats, pool: ThreadPoolExecutor
) -> Rendered:
    """Render one view; the pool's threads share its rows."""
    shape = rays.shape[:2]
    image, depth = np.empty(shape, np.float32), np.empty(shape, np.float32)
    surface = np.empty(shape, np.int32)
    rotation = np.ascontiguousarray(world_from_cam[:3, :3])
    origin = np.ascontiguousarray(world_from_cam[:3, 3])
    bands = [(top, min(top + _BAND_ROWS, shape[0])) for top in range(0, shape[0], _BAND_ROWS)]

    def first(band: tuple[int, int]) -> None:
        kernels.cast_rows(world, rays, rotation, origin, band, image, depth, surface)

    def second(band: tuple[int, int]) -> None:
        kernels.smooth_rows(world, rays, rotation, origin, band, image, surface)

    for work in (first, second):  # edges are known once all rows have been seen
        list(pool.map(work, bands))
    return Rendered(image, depth)
