"""Texture look-up in fixed point, and texture coordinates on solids.

Textures and the stain, the last texture of the atlas, wrap around. Their sides are powers of two,
so that wrapping is a mask. Coordinates are integers in units of 2^-16 texels of a mip-map level,
because integer shifts and masks are faster than rounding floats. Values are grey levels (0…255)
times 2^32 after bilinear interpolation, 2^16 for each axis, and become 0…1 at the very end.

The stain is a smooth random texture of large spots; a texture value is multiplied by
1 + 2 strength (stain - 0.5), so that a repeated texture does not look the same everywhere.
"""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import FRACTION_BITS, ONE_TEXEL, Filter, Pair, Vector, index
from data_synth.scene.world import LEVELS, World

_MAX_ANISOTROPY = 8  # samples
_ONE_SAMPLE = 1.6**2  # squared ratio of a footprint's sides, up to which one sample is enough
INVERSE_COUNTS = (0.0, *(1.0 / n for n in range(1, _MAX_ANISOTROPY + 1)))
NO_FILTER = Filter(0, 1, 0.0, 1.0, 0.0, 0.0, 0, 1.0)


@inlined
def mip_level(square: float) -> tuple[int, float, float]:
    """Mip-map level for a footprint of `square` texels squared.

    The level is log2 of the side of the footprint in texels, log4(square): its whole part, and its
    fraction as the weight of the next level. Returns level, 2^-level and that weight.
    """
    level, shrink = 0, 1.0
    while square >= 4.0 and level < LEVELS - 1:
        square, level, shrink = 0.25 * square, level + 1, 0.5 * shrink
    # In place of log4(square), two straight lines, clipped to 0…1, so that for some footprints one
    # level is enough: for squares below 1.5, and above 3.
    weight = square - 1.5 if square < 2.0 else 0.5 * square - 0.5
    if level == LEVELS - 1:
        weight = 0.0
    return level, shrink, min(max(weight, 0.0), 1.0)


@inlined
def footprint_filter(first: Pair, second: Pair, su: float, sv: float, stain: float) -> Filter:
    """Filter for a footprint with the sides `first` and `second`, in metres right and down.

    The shorter side chooses the level; samples along the longer side make up for the rest, up to
    _MAX_ANISOTROPY (Heckbert, Fundamentals of Texture Mapping, 1989). `su` and `sv` are texels per
    metre of the texture, `stain` those of the stain.
    """
    size = stain * max(abs(first[0]) + abs(second[0]), abs(first[1]) + abs(second[1]))
    stain_level, stain_scale, weight = mip_level(size * size)
    if weight > 0.5:  # it is smooth: the nearest level is enough
        stain_level, stain_scale = stain_level + 1, 0.5 * stain_scale
    first, second = (su * first[0], sv * first[1]), (su * second[0], sv * second[1])
    long = first[0] * first[0] + first[1] * first[1]
    short = second[0] * second[0] + second[1] * second[1]
    along = first
    if short > long:
        long, short, along = short, long, second
    count, wide = 1, max(short, 1.0)
    if long > _ONE_SAMPLE * wide:
        count = 2
        while count < _MAX_ANISOTROPY and long >= (count + 0.6) ** 2 * wide:
            count += 1
    step = INVERSE_COUNTS[count]
    # A footprint at least as wide as the distance of samples: slightly blurred, but no aliasing
    level, shrink, weight = mip_level(max(short, long * step * step))
    return Filter(
        level, count, weight, shrink * ONE_TEXEL, along[0], along[1], stain_level, stain_scale
    )


_FRACTION = (1 << FRACTION_BITS) - 1  # mask
_PER_GREY = 1.0 / (255.0 * ONE_TEXEL * ONE_TEXEL)


@inlined
def surface_texture(
    world: World, solid: int, axis: int, is_side: bool, at: Pair, filter_: Filter
) -> float:
    """Filtered texture, with stains, at a point of a face given in metres right and down."""
    right, low = at
    # Texels from the corner of the texture, whose middle is the middle of the face
    su, sv = world.scales[index(solid), index(axis), 0], world.scales[index(solid), index(axis), 1]
    texture = world.textures[index(solid)]
    u = su * right + world.offsets[index(solid), 0] + 0.5 * world.atlas.levels[texture, 0, 2]
    v = sv * low + world.offsets[index(solid), 1] + 0.5 * world.atlas.levels[texture, 0, 1]
    value = sample_filtered(world, texture, u, v, filter_)
    if world.stains[index(solid), 0] > 0.0:
        scale = world.stains[index(solid), 1]
        shift = 57.3 * solid  # texels, so that no two solids have the same stains
        # Mirrored on cylinders, so that it has no seam.
        aside = abs(right) if is_side else right
        stain = filtered_stain(world, scale * aside + shift, scale * low + 0.7 * shift, filter_)
        value *= 1.0 + 2.0 * world.stains[index(solid), 0] * (stain - 0.5)
    return value


@inlined
def cylinder_coordinates(world: World, solid: int, hit: Vector) -> Pair:
    """Metres right and down on the side of a cylinder.

    A texture too wide for the cylinder runs half around and back, so that it has no seam.
    """
    shape = world.shapes[index(solid)]
    angle = np.arctan2(hit[1] * shape[9], hit[0] * shape[8])
    radius = 0.5 * (shape[3] + shape[4])
    return radius * (angle if texture_follows_angle(world, solid, hit) else -angle), -hit[2]


@inlined
def texture_follows_angle(world: World, solid: int, hit: Vector) -> bool:
    """Whether the texture on the side of a cylinder runs to the right with growing angle."""
    return bool(world.goes_round[index(solid)] or hit[1] >= 0.0)


@inlined
def face_coordinates(axis: int, sign: float, local: Vector) -> Pair:
    """Metres right and down on a face as seen from outside, so that print is not mirrored."""
    if axis == 0:
        return sign * local[1], -local[2]
    if axis == 1:
        return -sign * local[0], -local[2]
    return local[0], -sign * local[1]


@inlined
def filtered_stain(world: World, u: float, v: float, filter_: Filter) -> float:
    """The stain, 0…1, at a point in texels of its level 0."""
    scale = filter_.stain_scale
    return sample_stain(world, filter_.stain_level, scale * u, scale * v)


@inlined
def sample_filtered(world: World, texture: int, u: float, v: float, filter_: Filter) -> float:
    """Mean, 0…1, of samples along the longer side of the footprint about a point in texels."""
    level, count, next_weight, scale, right, low, _, _ = filter_
    # `count` samples in the middles of equal parts: the first is (count - 1) / 2 parts before the
    # middle, as a fraction of the side 0.5 (1 / count - 1).
    step = INVERSE_COUNTS[count]
    first_sample = 0.5 * (step - 1.0)
    x, y = int(scale * (u + first_sample * right)), int(scale * (v + first_sample * low))
    dx, dy = int(scale * step * right), int(scale * step * low)
    total = 0.0
    if next_weight < 1.0:
        total = sum_samples(world, texture, level, (x, y), (dx, dy), count)
    if next_weight > 0.0:
        x, y, dx, dy = x >> 1, y >> 1, dx >> 1, dy >> 1  # in texels of twice the width
        softer = sum_samples(world, texture, level + 1, (x, y), (dx, dy), count)
        total += next_weight * (softer - total)
    return step * total * _PER_GREY


@inlined
def sum_samples(
    world: World,
    texture: int,
    level: int,
    at: tuple[int, int],
    step: tuple[int, int],
    count: int,
) -> float:
    """Sum of `count` evenly spaced samples of a level."""
    (x, y), total = at, 0
    for _ in range(count):
        total += sample_bilinear(world, texture, level, x, y)
        x, y = x + step[0], y + step[1]
    return float(total)


@inlined
def sample_bilinear(world: World, texture: int, level: int, x: int, y: int) -> int:
    """Bilinear interpolation of a level of a texture, 0…255 * 2^32, at (x, y) in 2^-16 texels.

    The centre of texel 0 is at half a texel. Levels have a start, a height and a width in `texels`.
    """
    levels = world.atlas.levels
    start, height, width = (
        levels[index(texture), index(level), 0],
        levels[index(texture), index(level), 1],
        levels[index(texture), index(level), 2],
    )
    x, y = x - (1 << (FRACTION_BITS - 1)), y - (1 << (FRACTION_BITS - 1))
    j, i = (x >> FRACTION_BITS) & (width - 1), (y >> FRACTION_BITS) & (height - 1)
    j1, i1 = (j + 1) & (width - 1), (i + 1) & (height - 1)
    fu, fv = x & _FRACTION, y & _FRACTION
    upper, lower = start + i * width, start + i1 * width
    a, b = load_texel(world, upper + j), load_texel(world, lower + j)
    a = (a << FRACTION_BITS) + fu * (load_texel(world, upper + j1) - a)
    b = (b << FRACTION_BITS) + fu * (load_texel(world, lower + j1) - b)
    return (a << FRACTION_BITS) + fv * (b - a)


@inlined
def load_texel(world: World, at: int) -> int:
    """A texel as a signed integer, because sums of unsigned and signed ones become floats."""
    return int(np.int64(world.atlas.texels[index(at)]))


@inlined
def sample_stain(world: World, level: int, u: float, v: float) -> float:
    """The stain, 0…1, at a point in texels of a level."""
    x, y = int(ONE_TEXEL * u), int(ONE_TEXEL * v)
    return sample_bilinear(world, len(world.atlas.levels) - 1, level, x, y) * _PER_GREY
