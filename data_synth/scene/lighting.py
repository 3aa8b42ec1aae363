"""Light baked into a world: a soft lamp with its shadows, and darker corners."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from data_synth.scene import kernels
from data_synth.scene.world import Lights, World
from vo.types import Floats, Floats32, Ints

_POINTS_PER_M = 16.0
_AMBIENT = 0.62
_LAMP = 0.95
_LAMP_REACH_M = 3.5
_LAMP_SIDE_M = 0.5
_LAMP_GRID = 4
_SKY_REACH_M = 0.9
_SKY_RAYS = 24
_DARKEST = 0.35


def lit(world: World, lamp: tuple[float, float, float]) -> World:
    """The same world with light from a square lamp centred at `lamp`."""
    sizes = _sizes(world)
    counts = sizes.prod(axis=2).ravel()
    offsets = np.concatenate([[0], np.cumsum(counts)])
    values = np.empty(offsets[-1], np.float32)
    lamps, sky = _lamp_points(lamp), _sky_directions()

    def work(face: int) -> None:
        box, side = divmod(face, 6)
        light = np.zeros((*sizes[box, side], 2), np.float32)
        kernels.light_face(world, box, side, lamps, sky, _LAMP_REACH_M, light)
        values[offsets[face] : offsets[face + 1]] = _mixed(light, side).ravel()

    with ThreadPoolExecutor() as pool:
        list(pool.map(work, range(len(counts))))
    starts = offsets[:-1].reshape(-1, 6).astype(np.int64)
    return world._replace(lights=Lights(values, starts, sizes))


def _mixed(light: Floats32, face: int) -> Floats32:
    # Faces get a little different ambient light, so that edges show also in the shade.
    tint = 1.0 + (-0.04, 0.08, -0.07, 0.03, -0.1, 0.1)[face]
    ambient = _AMBIENT * tint * (_DARKEST + (1.0 - _DARKEST) * light[..., 0])
    return np.asarray(ambient + _LAMP * light[..., 1], dtype=np.float32)


def _sizes(world: World) -> Ints:
    """Rows and columns (N, 6, 2) of the grid on each face."""
    counts = 2 + np.ceil(2.0 * world.halves * _POINTS_PER_M).astype(np.int64)
    rows, columns = counts[:, [2, 2, 1]], counts[:, [1, 0, 0]]
    return np.repeat(np.stack([rows, columns], axis=2), 2, axis=1)


def _lamp_points(lamp: tuple[float, float, float]) -> Floats:
    steps = ((np.arange(_LAMP_GRID) + 0.5) / _LAMP_GRID - 0.5) * _LAMP_SIDE_M
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    return np.asarray(np.column_stack([x, y, np.zeros_like(x)]) + np.array(lamp))


def _sky_directions() -> Floats:
    """Directions above a face, its outward last, dense where they count most (cosine law)."""
    k = np.arange(_SKY_RAYS) + 0.5
    radius, turn = np.sqrt(k / _SKY_RAYS), k * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
    return np.asarray(np.column_stack([flat, np.sqrt(1.0 - radius**2)]) * _SKY_REACH_M)
