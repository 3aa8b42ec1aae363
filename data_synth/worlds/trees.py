"""Trees, bushes and hedges: trunks, and crowns of many overlapping ellipsoids."""

from __future__ import annotations

import numpy as np

from data_synth.scene.builder import Builder, Point
from data_synth.scene.solids import Kind
from data_synth.worlds.palette import Palette

_LEAF_DENSITY = 90.0


def tree(
    build: Builder,
    palette: Palette,
    foot: Point,
    height: float,
    spread: float,
    clumps: int = 18,
    bare: float = 0.4,
) -> None:
    """A broad-leaved tree.

    `height`: metres. `spread`: diameter of its crown, metres. `bare`: fraction of its height below
    the crown.
    """
    x, y, z = foot
    trunk = 0.028 * height + 0.06
    top = height * (bare + 0.25)
    centre = (x, y, z + top / 2 - 0.1)
    build.add(centre, (trunk, trunk, top + 0.2), palette.bark, 0.0, 120.0, Kind.CYLINDER)
    leaf = int(build.rng.choice(palette.leaves))
    half_high = 0.5 * height * (1.0 - bare)
    middle = z + height - half_high
    size = 1.15 * spread / np.cbrt(clumps)
    for k in range(clumps):
        # Clumps are on a shell, fewer towards the poles, so that there are gaps between them.
        up = 1.0 - 2.0 * (k + 0.5) / clumps
        turn = k * np.pi * (3.0 - np.sqrt(5.0)) + float(build.rng.uniform(-0.6, 0.6))
        up *= float(build.rng.uniform(0.6, 1.0))
        out = np.sqrt(1.0 - up * up) * float(build.rng.uniform(0.5, 1.05))
        scale = size * float(build.rng.uniform(0.65, 1.3))
        wide, deep, high = (float(s) for s in scale * build.rng.uniform(0.8, 1.2, 3))
        reach = 0.5 * (spread - size) * out
        at = (
            x + float(reach * np.cos(turn)),
            y + float(reach * np.sin(turn)),
            middle + (half_high - 0.4 * high) * up,
        )
        yaw = float(build.rng.uniform(0, np.pi))
        build.add(at, (wide, deep, 0.75 * high), leaf, yaw, _LEAF_DENSITY, Kind.ELLIPSOID, 0.5)


def bush(build: Builder, palette: Palette, foot: Point, width: float, height: float) -> None:
    """A bush of a few ellipsoids, sunk a little into the ground."""
    x, y, z = foot
    leaf = int(build.rng.choice(palette.leaves))
    for _ in range(4):
        dx, dy = (float(d) for d in build.rng.uniform(-0.28, 0.28, 2) * width)
        scale = float(build.rng.uniform(0.6, 1.0))
        at = (x + dx, y + dy, z + 0.38 * height * scale)
        size = (0.75 * width * scale, 0.7 * width * scale, height * scale)
        yaw = float(build.rng.uniform(0, np.pi))
        build.add(at, size, leaf, yaw, _LEAF_DENSITY, Kind.ELLIPSOID, 0.5)


def hedge(
    build: Builder, palette: Palette, centre: Point, length: float, height: float, yaw: float
) -> None:
    """A clipped hedge along its own x, standing on `centre`, not quite straight on top."""
    x, y, z = centre
    leaf = int(build.rng.choice(palette.leaves))
    core = (length, 0.55, 0.9 * height)
    build.add((x, y, z + 0.45 * height), core, leaf, yaw, _LEAF_DENSITY, stain=0.5)
    count = max(2, round(length / 1.1))
    for k in range(count):
        along = length * ((k + 0.5) / count - 0.5)
        at = (
            x + float(np.cos(yaw)) * along,
            y + float(np.sin(yaw)) * along,
            z + float(build.rng.uniform(0.5, 0.62)) * height,
        )
        size = (1.9 * length / count, float(build.rng.uniform(0.7, 0.85)), 0.85 * height)
        build.add(at, size, leaf, yaw, _LEAF_DENSITY, Kind.ELLIPSOID, 0.5)
