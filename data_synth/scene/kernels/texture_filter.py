"""Mip-map levels and samples for the footprint of a ray on a texture."""

from __future__ import annotations

from data_synth.scene.atlas import LEVELS
from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import ONE_TEXEL, Filter, Pair

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
