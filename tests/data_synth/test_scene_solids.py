from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scene_views import CAMERA, WALL, WHITE, bright_world, looking_along_x, points_seen

from data_synth.scene.render import camera_rays, render
from data_synth.scene.shutter import static_shutter
from data_synth.scene.solids import Kind, Solid
from vo.base.types import Floats

RAYS = camera_rays(CAMERA)
EGG = Solid((5.0, 0.2, 0.1), (2.0, 3.0, 1.5), WHITE, yaw=0.4, kind=Kind.ELLIPSOID)
DRUM = Solid((5.0, 0.2, -1.0), (1.6, 2.4, 1.0), WHITE, yaw=0.4, kind=Kind.CYLINDER)


def _local(solid: Solid, points: Floats) -> Floats:
    """Points in the solid's frame, in half sizes."""
    cosine, sine = np.cos(solid.yaw), np.sin(solid.yaw)
    turned = (points - solid.centre) @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    return np.asarray(turned / (np.array(solid.size) / 2))


def _egg_coverage(finer: int) -> Floats:
    """Coverage of each pixel by the egg, from many rays."""
    offsets = (np.arange(finer) + 0.5) / finer - 0.5
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    total = np.zeros(u.shape)
    for du in offsets:
        for dv in offsets:
            x, y = (u + du - CAMERA.cx) / CAMERA.fx, (v + dv - CAMERA.cy) / CAMERA.fy
            rays = np.stack([np.ones_like(x), -x, -y], axis=-1).reshape(-1, 3)
            start, d = _local(EGG, np.zeros((1, 3)))[0], _local(EGG, rays + EGG.centre)
            a, b, c = (d * d).sum(1), d @ start, start @ start - 1.0
            total += (b * b > a * c).reshape(u.shape)
    return total / finer**2


def test_depth_is_exact_on_an_ellipsoid(pool: ThreadPoolExecutor) -> None:
    pose = looking_along_x()
    depth = render(bright_world([EGG]), RAYS, static_shutter(pose), pool).depth.astype(float)
    points = _local(EGG, points_seen(RAYS, depth, pose))
    assert len(points) > 1000
    np.testing.assert_allclose((points**2).sum(axis=1), 1.0, atol=1e-5)
    assert (_local(EGG, np.zeros((1, 3))) * points).sum(axis=1).min() > 0.99  # its near side


def test_depth_is_exact_on_the_side_and_the_top_of_a_cylinder(pool: ThreadPoolExecutor) -> None:
    pose = looking_along_x()
    depth = render(bright_world([DRUM]), RAYS, static_shutter(pose), pool).depth.astype(float)
    x, y, z = _local(DRUM, points_seen(RAYS, depth, pose)).T
    on_top = np.abs(z - 1.0) < 1e-5
    assert on_top.sum() > 100 and (~on_top).sum() > 500
    assert (x**2 + y**2)[on_top].max() < 1.0 + 1e-5
    np.testing.assert_allclose((x**2 + y**2)[~on_top], 1.0, atol=1e-5)
    assert np.abs(z).max() < 1.0 + 1e-5


def test_cylinder_seen_from_straight_above_shows_its_top_only(pool: ThreadPoolExecutor) -> None:
    down = np.eye(4)
    down[:3, :3] = np.diag([1.0, -1.0, -1.0])
    down[:3, 3] = (5.0, 0.2, 4.0)
    depth = render(bright_world([DRUM]), RAYS, static_shutter(down), pool).depth
    assert np.unique(depth[np.isfinite(depth)]) == pytest.approx([4.5])


def test_silhouettes_are_antialiased_and_unbiased(pool: ThreadPoolExecutor) -> None:
    view = render(bright_world([EGG, WALL]), RAYS, static_shutter(looking_along_x()), pool)
    coverage = _egg_coverage(12)
    rim = (coverage > 0.0) & (coverage < 1.0)
    assert rim.sum() > 100
    assert float(np.sqrt(np.mean((view.image - coverage)[rim] ** 2))) < 0.1
    assert float(view.image.sum()) == pytest.approx(float(coverage.sum()), rel=2e-3)
    np.testing.assert_allclose(view.image[coverage == 1.0], 1.0, atol=1e-6)


def test_stains_brighten_and_darken_around_the_same_mean(pool: ThreadPoolExecutor) -> None:
    plain, stained = (
        render(
            bright_world([Solid((5.5, 0, 0), (1, 60, 60), WHITE, density=100.0, stain=stain)]),
            RAYS,
            static_shutter(looking_along_x()),
            pool,
        ).image
        for stain in (0.0, 0.5)
    )
    assert float(plain.std()) < 1e-6
    assert 0.03 < float(stained.std()) < 0.3
    assert float(stained.mean()) == pytest.approx(1.0, abs=0.15)


def test_pixels_outside_the_image_circle_are_black_and_infinitely_far(
    pool: ThreadPoolExecutor,
) -> None:
    rays = RAYS.copy()
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    outside = np.hypot(u - 50, v - 39) > 37
    rays[outside] = np.nan
    whole = render(bright_world([EGG, WALL]), RAYS, static_shutter(looking_along_x()), pool)
    view = render(bright_world([EGG, WALL]), rays, static_shutter(looking_along_x()), pool)
    assert np.all(view.image[outside] == 0.0) and np.all(np.isposinf(view.depth[outside]))
    np.testing.assert_array_equal(view.depth[~outside], whole.depth[~outside])
    inside = np.hypot(u - 50, v - 39) < 35
    np.testing.assert_allclose(view.image[inside], whole.image[inside], atol=1e-6)


def test_pixels_with_very_many_surfaces_stay_within_their_radiances(
    pool: ThreadPoolExecutor,
) -> None:
    rng = np.random.default_rng(0)
    pickets = [
        Solid((x, y, z), (0.02, 0.008, 0.008), WHITE, yaw=float(rng.uniform(0, 3)))
        for x, y, z in rng.uniform((14, -0.15, -0.15), (18, 0.15, 0.15), (3000, 3))
    ]
    world = bright_world([WALL, *pickets])
    values = rng.uniform(0.2, 1.0, len(world.lights.values)).astype(np.float32)
    world = world._replace(lights=world.lights._replace(values=values))
    view = render(world, camera_rays(CAMERA), static_shutter(looking_along_x()), pool)
    crowd = view.image[39:41, 59:61]
    assert crowd.min() > 0.05  # pickets, and the black wall between them
    assert crowd.max() < 1.0
    assert view.image.min() >= 0.0
