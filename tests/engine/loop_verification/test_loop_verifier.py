"""Screening and verification of loops on simulated landmarks."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bytes, Camera, Floats
from vo.engine.geometry import sim3
from vo.engine.loop_verification.loop_verifier import LoopVerifier, Rejection, RejectionReason
from vo.engine.loop_verification.screening import Screening
from vo.engine.mapping.keyframe import FrameId
from vo.engine.places.records import PATCH_PX, Loop, Place, PlaceKey, PlaceLandmarks
from vo.engine.places.vocabulary_file import built_in_vocabulary

CAMERA = Camera(640, 480, 400.0, 400.0, 320.0, 240.0)
SHIFT = np.array([0.02, -0.05, 0.01, 0.15, 0.05, -0.1, 0.0])  # of the second visit
FAR = np.array([0.0, 0.0, 0.0, 1.8, 0.0, 0.0, 0.0])  # to the side


WALL_M, TILE_M = 4.5, 0.15  # distance of the painted wall, and size of its spots


class World:
    """Points on a rough wall, each with a descriptor and a patch of its own, and its paint."""

    def __init__(self, seed: int, count: int = 600) -> None:
        rng = np.random.default_rng(seed)
        self.paint = rng.integers(0, 256, (100, 120)).astype(np.float32)
        self.xyz = rng.uniform((-4.0, -3.0, 4.3), (4.0, 3.0, 4.7), (count, 3))
        self.descriptor = rng.integers(0, 256, (count, 32), dtype=np.uint8)
        self.patch = rng.integers(0, 256, (count, PATCH_PX, PATCH_PX), dtype=np.uint8)


def _thumbnail(world: World, pose: Floats) -> Bytes:
    """The wall as a keyframe sees it, a quarter of the camera's size."""
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
    rays = np.stack([(4 * u + 1.5 - 320) / 400, (4 * v + 1.5 - 240) / 400, np.ones_like(u)], -1)
    rays = rays @ pose[:3, :3].T
    at = pose[:3, 3] + rays * ((WALL_M - pose[2, 3]) / rays[..., 2:])
    column, row = ((at[..., axis] / TILE_M + 55.0).astype(np.float32) for axis in (0, 1))
    return np.asarray(cv2.remap(world.paint, column, row, cv2.INTER_LINEAR), np.uint8)


def _see(
    world: World, pose: Floats, number: int, *, noise: float, unit: float = 1.0, metric: bool = True
) -> Place:
    """A keyframe whose landmarks have pixels and depths with noise."""
    rng = np.random.default_rng(number)
    points = transform_points(inverse(pose), world.xyz)
    xy = 400.0 * points[:, :2] / points[:, 2:] + (320.0, 240.0)
    rows = np.flatnonzero(
        (points[:, 2] > 0.5) & (xy >= 0).all(axis=1) & (xy < (640.0, 480.0)).all(axis=1)
    )
    xyz = points[rows] * (1.0 + 0.01 * noise * rng.normal(size=(len(rows), 1))) * unit
    odom = pose.copy()
    odom[:3, 3] *= unit
    flips = rng.random((len(rows), 32, 8)) < 0.05 * noise
    landmarks = PlaceLandmarks(
        1000 * number + np.arange(len(rows)),
        xyz.astype(np.float32),
        (xy[rows] + 0.3 * noise * rng.normal(size=(len(rows), 2))).astype(np.float32),
        np.full(len(rows), 0.01, np.float32),
        world.descriptor[rows] ^ np.packbits(flips, axis=2)[:, :, 0],
        np.zeros(len(rows), np.int32),
        np.zeros(len(rows), np.float32),
        world.patch[rows],
    )
    return Place(
        PlaceKey(0, number),
        FrameId(number, number, 0),
        metric,
        odom,
        np.eye(6),
        landmarks.descriptor,
        landmarks,
        _thumbnail(world, pose),
    )


def _visits(
    earlier: World,
    later: World,
    *,
    noise: float,
    unit: float = 1.0,
    metric: bool = True,
    shift: Floats = SHIFT,
) -> tuple[list[Place], list[Place]]:
    """The keyframes of a second visit, newest first, and that of the first one."""
    beside = sim3.retract(np.array([0.0, 0.01, 0.0, 0.1, 0.0, 0.0, 0.0]))
    first = [
        _see(earlier, pose, 1 + n, noise=noise, metric=metric)
        for n, pose in enumerate((np.eye(4), beside))
    ]
    second = []
    for step in range(3):
        pose = sim3.retract(shift * (1.0 - 0.2 * step))
        second.append(_see(later, pose, 9 - step, noise=noise, unit=unit, metric=metric))
    return second, first


@pytest.mark.parametrize(("metric", "unit"), [(True, 1.0), (False, 1.0), (False, 2.5)])
def test_exact_landmarks_give_the_exact_relation(metric: bool, unit: float) -> None:
    world = World(0)
    loop = LoopVerifier(1.44).verify(
        *_visits(world, world, noise=0.0, unit=unit, metric=metric), CAMERA
    )
    assert isinstance(loop, Loop)
    np.testing.assert_allclose(loop.earlier_from_later, sim3.retract(SHIFT), rtol=0, atol=1e-4)
    assert loop.scale == pytest.approx(1.0 / unit, rel=1e-4)
    assert loop.inliers > 100


@pytest.mark.parametrize(("metric", "unit"), [(True, 1.0), (False, 2.5)])
@pytest.mark.parametrize("aside", [0.0, 0.001])
def test_a_camera_that_is_back_at_the_very_same_point_knows_the_scale(
    metric: bool, unit: float, aside: float
) -> None:
    shift = np.array([0.0, 0.0, 0.0, aside, 0.0, 0.0, 0.0])
    for seed in range(3):  # the images are the same at any scale, but the depths are not
        world = World(seed)
        visits = _visits(world, world, noise=1.0, unit=unit, metric=metric, shift=shift)
        loop = LoopVerifier(1.44).verify(*visits, CAMERA)
        assert isinstance(loop, Loop)
        assert loop.scale * unit == pytest.approx(1.0, abs=0.01)
        assert np.linalg.norm(loop.earlier_from_later[:3, 3]) < 0.01


@pytest.mark.parametrize("metric", [True, False])
def test_noise_stays_within_the_covariance(metric: bool) -> None:
    for seed in range(5):
        world = World(seed)
        visits = _visits(world, world, noise=1.0, metric=metric)
        loop = LoopVerifier(1.44).verify(*visits, CAMERA)
        assert isinstance(loop, Loop)
        found = sim3.similarity(loop.earlier_from_later, loop.scale)
        size = 6 if metric else 7
        error = sim3.local(sim3.inverse(found) @ sim3.retract(SHIFT))[:size]
        assert np.linalg.norm(error[3:6]) < 0.02
        assert error @ np.linalg.solve(loop.covariance[:size, :size], error) < 30.0


def _reason(earlier: World, later: World, **options: Any) -> RejectionReason:
    visits = _visits(earlier, later, **options)
    verdict = LoopVerifier(1.44).verify(*visits, CAMERA)
    assert isinstance(verdict, Rejection)
    return verdict.reason


def test_another_place_is_refused() -> None:
    assert _reason(World(0), World(1), noise=1.0) is RejectionReason.FEW_MATCHES


def test_the_same_features_at_other_positions_are_refused() -> None:
    world, other = World(0), World(1)
    other.descriptor, other.patch = world.descriptor, world.patch
    assert _reason(world, other, noise=1.0) is RejectionReason.NO_RELATION


def test_the_same_positions_with_other_patches_are_refused() -> None:
    world, other = World(0), World(0)
    other.patch = World(1).patch
    assert _reason(world, other, noise=1.0) is RejectionReason.FEW_INLIERS


def test_a_few_equal_landmarks_among_different_ones_are_refused() -> None:
    """All over the image, as of posters in two rooms; the other expected landmarks are missing."""
    world, other = World(0), World(1)
    equal = np.arange(600) < 45
    for name in ("xyz", "descriptor", "patch"):
        getattr(other, name)[equal] = getattr(world, name)[equal]
    assert _reason(world, other, noise=0.5) is RejectionReason.MISSING_LANDMARKS


def test_the_same_door_in_another_wall_is_refused() -> None:
    """A small part of the image agrees in everything."""
    world, other = World(0), World(1)
    door = np.arange(600) < 60
    world.xyz[door] = world.xyz[door] * (0.15, 0.3, 0.1) + (1.0, 0.3, 4.0)
    for name in ("xyz", "descriptor", "patch"):
        getattr(other, name)[door] = getattr(world, name)[door]
    assert _reason(world, other, noise=0.5) is RejectionReason.SMALL_AREA


def test_equal_landmarks_beside_another_poster_are_refused() -> None:
    """A corridor like another: all landmarks agree, but a twentieth of the wall looks different."""
    world, other = World(0), World(0)
    other.paint[44:55, 55:68] = World(1).paint[44:55, 55:68]
    visits = _visits(world, other, noise=0.5)
    verdict = LoopVerifier(1.44).verify(*visits, CAMERA)
    assert isinstance(verdict, Rejection)
    assert verdict.reason is RejectionReason.DIFFERENT_IMAGES
    assert 0.04 < verdict.value < 0.2


def test_other_light_is_no_difference() -> None:
    world, other = World(0), World(0)
    other.paint = 40.0 + 0.5 * other.paint
    assert isinstance(LoopVerifier(1.44).verify(*_visits(world, other, noise=1.0), CAMERA), Loop)


def test_images_in_which_nothing_can_be_compared_are_refused() -> None:
    world = World(0)
    world.paint[:] = 128.0
    assert _reason(world, world, noise=0.5) is RejectionReason.FEW_WINDOWS


@pytest.mark.parametrize("metric", [True, False])
def test_the_same_landmarks_from_far_away_are_refused(metric: bool) -> None:
    world = World(0)
    assert _reason(world, world, noise=0.5, metric=metric, shift=FAR) is RejectionReason.FAR_APART


def test_metric_keyframes_with_landmarks_of_another_size_are_refused() -> None:
    world = World(0)
    assert _reason(world, world, noise=0.5, unit=1.5) is RejectionReason.NO_RELATION


def test_one_keyframe_alone_is_not_enough() -> None:
    world = World(0)
    later, earlier = _visits(world, world, noise=1.0)
    verdict = LoopVerifier(1.44).verify(later[:1], earlier, CAMERA)
    assert verdict == Rejection(RejectionReason.ONLY_ONCE, 1, 3)


def test_the_same_bits_come_out_again() -> None:
    world = World(0)
    visits = _visits(world, world, noise=1.0)
    first, second = (LoopVerifier(1.44).verify(*visits, CAMERA) for _ in range(2))
    assert isinstance(first, Loop)
    assert isinstance(second, Loop)
    np.testing.assert_array_equal(first.earlier_from_later, second.earlier_from_later)
    np.testing.assert_array_equal(first.covariance, second.covariance)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("metric", "unit"), [(True, 1.0), (False, 2.5)])
def test_the_same_place_passes_the_screening(metric: bool, unit: float, seed: int) -> None:
    world = World(seed)
    later, earlier = _visits(world, world, noise=1.0, metric=metric, unit=unit)
    assert Screening(built_in_vocabulary(), 1.44).passes(later[0], earlier[0], CAMERA)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("same_features", [False, True])
def test_another_place_does_not_pass_the_screening(
    same_features: bool, metric: bool, seed: int
) -> None:
    world, other = World(seed), World(seed + 1)
    if same_features:
        other.descriptor = world.descriptor
    later, earlier = _visits(world, other, noise=1.0, metric=metric)
    assert not Screening(built_in_vocabulary(), 1.44).passes(later[0], earlier[0], CAMERA)
