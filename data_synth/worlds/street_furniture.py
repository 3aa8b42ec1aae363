"""Street furniture, and fences and walls of front gardens."""

from __future__ import annotations

from data_synth.scene.builder import Builder, Place
from data_synth.scene.solids import Kind
from data_synth.worlds.palette import Palette
from data_synth.worlds.trees import bush


def lamp_post(build: Builder, palette: Palette, place: Place) -> None:
    """A lamp on a mast, with its arm along -y."""
    mast = (0.15, 0.15, 7.2)
    build.add(place.at(0, 0, 3.6), mast, palette.metal, place.yaw, 120.0, Kind.CYLINDER)
    build.add(
        place.at(0, 0, 0.6), (0.24, 0.24, 1.2), palette.metal, place.yaw, 120.0, Kind.CYLINDER
    )
    build.add(place.at(0, -0.75, 7.15), (0.09, 1.7, 0.09), palette.metal, place.yaw, 120.0)
    build.add(place.at(0, -1.7, 7.12), (0.3, 0.75, 0.16), palette.dark, place.yaw)


def road_sign(build: Builder, palette: Palette, place: Place) -> None:
    """One or two traffic signs on a post, facing x and -x."""
    high = float(build.rng.uniform(2.5, 3.1))
    post = (0.07, 0.07, high)
    build.add(place.at(0, 0, high / 2), post, palette.metal, place.yaw, 120.0, Kind.CYLINDER)
    for k in range(int(build.rng.integers(1, 3))):
        sign = int(build.rng.choice(palette.signs))
        build.add(
            place.at(0.05, 0, high - 0.35 - 0.68 * k), (0.04, 0.6, 0.6), sign, place.yaw, None
        )


def advertising_column(build: Builder, palette: Palette, place: Place) -> None:
    """A thick column with a poster around it."""
    print_ = int(build.rng.choice(palette.prints))
    size = (1.2, 1.2, 2.7)
    build.add(place.at(0, 0, 1.5), size, print_, place.yaw, 100.0, Kind.CYLINDER)
    for z, wide in ((0.1, 1.35), (2.9, 1.4)):
        base = (wide, wide, 0.2)
        build.add(place.at(0, 0, z), base, palette.concrete, place.yaw, 90.0, Kind.CYLINDER)


def cabinet_or_bins(build: Builder, palette: Palette, place: Place) -> None:
    """A grey cabinet with a poster, or bins."""
    if build.rng.random() < 0.5:
        build.add(place.at(0, 0, 0.6), (0.9, 0.4, 1.2), palette.metal, place.yaw, 120.0)
        print_ = int(build.rng.choice(palette.prints))
        build.add(place.at(0.1, 0, 0.7), (0.4, 0.42, 0.5), print_, place.yaw, None)
        return
    for k in range(int(build.rng.integers(1, 4))):
        x = 0.68 * k
        build.add(place.at(x, 0, 0.5), (0.55, 0.65, 1.0), palette.metal, place.yaw, 120.0)
        build.add(place.at(x, 0, 1.04), (0.6, 0.72, 0.1), palette.dark, place.yaw)


def bollards(build: Builder, palette: Palette, place: Place, count: int) -> None:
    """Low posts in a row along x."""
    for k in range(count):
        x = 1.3 * (k - 0.5 * (count - 1))
        post = (0.13, 0.13, 0.95)
        build.add(place.at(x, 0, 0.47), post, palette.metal, place.yaw, 120.0, Kind.CYLINDER)
        cap = (0.17, 0.17, 0.12)
        build.add(place.at(x, 0, 0.93), cap, palette.white, place.yaw, 60.0, Kind.ELLIPSOID)


def tub(build: Builder, palette: Palette, place: Place) -> None:
    """A tub of concrete with a bush in it."""
    build.add(place.at(0, 0, 0.28), (1.2, 1.2, 0.56), palette.concrete, place.yaw, 120.0)
    bush(build, palette, place.at(0, 0, 0.45), 1.1, 1.0)


def fence(build: Builder, palette: Palette, place: Place, length: float) -> None:
    """Slats on two rails along x, with posts."""
    slats = max(2, round(length / 0.34))
    for k in range(slats):
        x = length * ((k + 0.5) / slats - 0.5)
        high = 1.05 + float(build.rng.uniform(-0.04, 0.04))
        build.add(
            place.at(x, 0, 0.1 + high / 2), (0.11, 0.03, high), palette.bark, place.yaw, 120.0
        )
    for z in (0.35, 0.95):
        build.add(place.at(0, 0.04, z), (length, 0.04, 0.08), palette.bark, place.yaw, 120.0)


def wall(build: Builder, palette: Palette, place: Place, length: float, height: float) -> None:
    """A garden wall along x with a coping."""
    texture = palette.bricks if build.rng.random() < 0.6 else palette.coats[0]
    build.add(
        place.at(0, 0, height / 2), (length, 0.3, height), texture, place.yaw, 90.0, stain=0.5
    )
    coping = (length + 0.02, 0.4, 0.09)
    build.add(place.at(0, 0, height + 0.04), coping, palette.kerb, place.yaw, 90.0)
