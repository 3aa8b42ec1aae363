"""Textures that outdoor objects share, each painted once for a world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_synth.scene.builder import Builder, Rng
from data_synth.worlds import outdoor_textures as paint
from vo.base.types import Floats32


def shade(value: float) -> Floats32:
    """An even grey; 4 x 4 texels."""
    return np.full((4, 4), value, np.float32)


@dataclass(frozen=True)
class Palette:
    """Numbers of the textures."""

    asphalt: int
    tar: int
    paving: int
    cobbles: int
    kerb: int
    concrete: int
    bricks: int
    coats: tuple[int, ...]
    tiles: int
    leaves: tuple[int, ...]
    bark: int
    grass: int
    metal: int
    marking: int
    zebra: int
    manhole: int
    glass: int
    white: int
    dark: int
    signs: tuple[int, ...]
    shop_signs: tuple[int, ...]
    prints: tuple[int, ...]


def paint_palette(build: Builder) -> Palette:
    """Paint the textures of a palette."""
    large, medium = (2048, 2048), (1024, 1024)
    return Palette(
        asphalt=build.paint(paint.asphalt, large),
        tar=build.paint(_tar),
        paving=build.paint(paint.paving, medium),
        cobbles=build.paint(paint.cobbles, medium),
        kerb=build.paint(paint.concrete),
        concrete=build.paint(paint.concrete, medium),
        bricks=build.paint(paint.brickwork, medium),
        coats=tuple(build.paint(paint.render_coat) for _ in range(3)),
        tiles=build.paint(paint.roof_tiles),
        leaves=tuple(build.paint(paint.leaves) for _ in range(3)),
        bark=build.paint(paint.bark, (256, 256)),
        grass=build.paint(paint.grass, medium),
        metal=build.paint(paint.metal, (256, 256)),
        marking=build.paint(paint.white_paint),
        zebra=build.paint(paint.zebra, (256, 1024)),
        manhole=build.paint(paint.manhole, (256, 256)),
        glass=build.paint(paint.glass, (64, 64)),
        white=build.paint(lambda rng, shape: shade(0.82)),
        dark=build.paint(lambda rng, shape: shade(0.09)),
        signs=tuple(build.paint(paint.road_sign, (128, 128)) for _ in range(6)),
        shop_signs=tuple(build.paint(paint.shop_sign, (64, 512)) for _ in range(12)),
        prints=tuple(build.paint(paint.placard, (256, 256)) for _ in range(6)),
    )


def _tar(rng: Rng, shape: tuple[int, int]) -> Floats32:
    return np.asarray(0.62 * paint.asphalt(rng, shape), dtype=np.float32)
