"""Radiance of the sky."""

from __future__ import annotations

import numpy as np

from data_synth.scene.kernels.decorators import inlined
from data_synth.scene.kernels.records import Vector
from data_synth.scene.kernels.textures import sample_stain
from data_synth.scene.world import World

_CLOUD_TEXELS = 22.5  # of level 2 of the stain, per unit of slope overhead


@inlined
def sky_radiance(world: World, ray: Vector) -> float:
    """Radiance of the sky along a ray: paler at the horizon, with soft clouds.

    Clouds are the stain texture, projected onto a plane above and bent down to the horizon.
    """
    flat = np.sqrt(ray[0] * ray[0] + ray[1] * ray[1])
    slope = ray[2] / max(flat, 1e-9)
    radiance = world.sources.sky
    pale = 0.3 + 0.7 * radiance
    if slope <= 0.0:
        return pale
    # rise is the sine of the elevation; (1 - rise)^4 is 1 at the horizon and soon negligible.
    rise = slope / np.sqrt(1.0 + slope * slope)
    mist = (1.0 - rise) ** 4
    spread = _CLOUD_TEXELS / (ray[2] + 0.25 * flat)
    value = sample_stain(world, 2, spread * ray[0], spread * ray[1])
    cloud = min(max(2.5 * (value - 0.5), 0.0), 1.0)
    clear = radiance + (0.97 - radiance) * cloud
    return float(clear + (pale - clear) * mist)
