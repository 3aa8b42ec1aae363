"""Light baked into a world: lamps and the sun with their shadows, and darker corners."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from data_synth.scene.height_field import HeightField
from data_synth.scene.kernels.baking import bake_faces, bake_ground
from data_synth.scene.solids import Lamp, Lighting
from data_synth.scene.world import Lights, Sources, World
from vo.base.types import Floats, Ints

_LAMP_GRID = 4
_SKY_RAYS = 24
_POINTS_PER_TASK = 4000
_MAX_GROUND_POINTS = 1024

_SUN_TURN_RAD = (0.25, 0.7)
_SUN_HEIGHT = (0.75, 1.3)
_LAMP_POWER = (0.7, 1.3)
_AMBIENT = (0.88, 1.12)
_SEED_SESSION = 29


def bake_lighting(world: World, lighting: Lighting) -> World:
    """Bake the light on all surfaces of a world."""
    sizes = _sizes(world, lighting)
    counts = sizes.prod(axis=2).ravel()
    ends = np.cumsum(counts)
    values = np.zeros(ends[-1] if len(ends) else 0, np.float32)
    grids = np.dstack([(ends - counts).reshape(-1, 6), sizes])
    world = world._replace(
        lights=Lights(values, grids),
        sources=_sources(lighting),
        height_field=_height_field(world, lighting),
    )
    lamps = world.sources.lamps
    points = np.array([_lamp_points(lamp) for lamp in lighting.lamps])
    points = points.reshape(len(lamps), _LAMP_GRID**2, 3)
    to_sky = _sky_directions() * lighting.corner_m

    def work(faces: tuple[int, int]) -> None:
        bake_faces(world, faces, lamps, points, to_sky)

    def work_below(row: int) -> None:
        bake_ground(world, (row, row + 1), lamps, points, to_sky[::2])

    with ThreadPoolExecutor() as pool:
        list(pool.map(work, _tasks(ends)))
        if world.height_field.exists:
            list(pool.map(work_below, range(len(world.height_field.light))))
    return world


def light_of_session(lighting: Lighting, seed: int, session: int) -> Lighting:
    """The light of a world at another visit: a moved sun, and lamps of other strength.

    `lighting`: the light of session 0. `seed`: of the world. `session`: number of the visit.
    """
    if session == 0:
        return lighting
    rng = np.random.default_rng([seed, session, _SEED_SESSION])
    turn = float(rng.uniform(*_SUN_TURN_RAD) * rng.choice((-1.0, 1.0)))
    height, ambient = float(rng.uniform(*_SUN_HEIGHT)), float(rng.uniform(*_AMBIENT))
    powers = rng.uniform(*_LAMP_POWER, len(lighting.lamps))
    sun = lighting.sun
    if sun is not None:
        x, y, z = sun
        cosine, sine = float(np.cos(turn)), float(np.sin(turn))
        sun = (cosine * x - sine * y, sine * x + cosine * y, height * z)
    return replace(
        lighting,
        sun=sun,
        ambient=ambient * lighting.ambient,
        lamps=tuple(
            replace(lamp, power=float(factor) * lamp.power)
            for lamp, factor in zip(lighting.lamps, powers, strict=True)
        ),
    )


def _tasks(ends: Ints) -> list[tuple[int, int]]:
    """Ranges of faces with about equal numbers of points."""
    cuts = np.flatnonzero(np.diff(ends // _POINTS_PER_TASK)) + 1
    edges = [0, *(int(c) for c in cuts), len(ends)] if len(ends) else [0]
    return list(zip(edges[:-1], edges[1:], strict=True))


def _sources(lighting: Lighting) -> Sources:
    sun = np.zeros(3) if lighting.sun is None else np.array(lighting.sun, dtype=np.float64)
    sun = sun / max(float(np.linalg.norm(sun)), 1e-12)
    lamps = np.array([[*a.centre, a.power, a.reach_m] for a in lighting.lamps]).reshape(-1, 5)
    return Sources(lighting.sky, sun, lighting.sun_power, lighting.ambient, lamps)


def _height_field(world: World, lighting: Lighting) -> HeightField:
    """The ground with a dark grid for its light."""
    height_field = world.height_field
    if not height_field.exists:
        return height_field
    cells = np.array(height_field.heights.shape) - 1
    finer = max(1, round(height_field.cell * lighting.points_per_m))
    finer = max(1, min(finer, _MAX_GROUND_POINTS // int(cells.max())))
    return height_field._replace(light=np.zeros(finer * cells + 1, np.float32), finer=finer)


def _sizes(world: World, lighting: Lighting) -> Ints:
    """Rows and columns (N, 6, 2) of the grid on each face."""
    sides = 2.0 * world.shapes[: len(world.bounds), 3:6]
    counts = 2 + np.ceil(sides * lighting.points_per_m).astype(np.int64)
    counts = np.minimum(counts, max(2, lighting.max_points))
    rows, columns = counts[:, [2, 2, 1]], counts[:, [1, 0, 0]]
    return np.repeat(np.stack([rows, columns], axis=2), 2, axis=1)


def _lamp_points(lamp: Lamp) -> Floats:
    """Points (P, 3) of a lamp, the corners first."""
    steps = ((np.arange(_LAMP_GRID) + 0.5) / _LAMP_GRID - 0.5) * lamp.side_m
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps))
    inner = np.argsort(-np.maximum(np.abs(x), np.abs(y)) - np.minimum(np.abs(x), np.abs(y)))
    points = np.column_stack([x, y, np.zeros_like(x)]) + np.array(lamp.centre)
    return np.asarray(points[inner])


def _sky_directions() -> Floats:
    """Directions above a face along two tangents and its normal, distributed by the cosine law."""
    k = np.arange(_SKY_RAYS) + 0.5
    radius, turn = np.sqrt(k / _SKY_RAYS), k * np.pi * (3.0 - np.sqrt(5.0))
    flat = np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])
    return np.asarray(np.column_stack([flat, np.sqrt(1.0 - radius**2)]))
