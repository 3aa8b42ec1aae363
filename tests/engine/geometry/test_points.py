from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.transforms import se3_exp, transform_points
from vo.base.types import Bools, Floats, Ints
from vo.engine.geometry.points import best_points, point_views

FX, FY, CX, CY = INTRINSICS = Intrinsics(520.0, 510.0, 320.0, 240.0)
BASELINE = 0.2
SIGMA, SIGMA_DISPARITY = 0.5, 0.4
VIEWS = 5


@dataclass(frozen=True, eq=False)
class Scene:
    """Exact observations of points by several cameras, and a first guess of the points."""

    truth: Floats
    guess: Floats
    cam_from_world: Floats
    point: Ints
    camera: Ints
    xy: Floats
    disparity: Floats
    sigma_px: Floats

    def refine(self, *, stereo: bool = False, huber: float = 1.5) -> Floats:
        disparity = self.disparity if stereo else np.full(len(self.point), np.nan)
        views = point_views(
            np.ones(len(self.guess), dtype=bool),
            self.point,
            self.camera,
            PixelObservations(self.xy, disparity, self.sigma_px, SIGMA_DISPARITY),
            INTRINSICS,
            FX * BASELINE if stereo else 0.0,
            huber,
        )
        return best_points(self.guess, self.cam_from_world, views, steps=10)[0]

    def errors(self, found: Floats) -> Floats:
        """Distances from the truth relative to the depth."""
        return np.asarray(np.linalg.norm(found - self.truth, axis=1) / self.truth[:, 2])

    def only(self, kept: Bools | Ints) -> Scene:
        """Some of the observations."""
        return replace(
            self,
            point=self.point[kept],
            camera=self.camera[kept],
            xy=self.xy[kept],
            disparity=self.disparity[kept],
            sigma_px=self.sigma_px[kept],
        )

    def with_noise(self, seed: int) -> Scene:
        rng = np.random.default_rng(seed)
        return replace(
            self,
            xy=self.xy + rng.normal(0, SIGMA, self.xy.shape),
            disparity=self.disparity + rng.normal(0, SIGMA_DISPARITY, self.disparity.shape),
        )


def _scene(count: int = 40, seed: int = 0) -> Scene:
    """Cameras in a row along x; observations are in no order."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform((-4, -2, 8), (4, 2, 16), (count, 3))
    guess = truth * (1 + 0.05 * rng.standard_normal((count, 1)))
    steps = np.linspace(-1, 1, VIEWS)
    cams = np.stack([se3_exp(np.array([0.02, -0.1, 0.03, 1.5, 0.1, 0.3]) * s) for s in steps])
    order = rng.permutation(count * VIEWS)
    point, camera = order // VIEWS, order % VIEWS
    seen = np.stack([transform_points(cam, truth) for cam in cams])[camera, point]
    xy = seen[:, :2] / seen[:, 2:] * (FX, FY) + (CX, CY)
    disparity, sigma = FX * BASELINE / seen[:, 2], np.full(len(point), SIGMA)
    return Scene(truth, guess, cams, point, camera, xy, disparity, sigma)


def _with_an_outlier() -> Scene:
    """The last observation of point 7 is far off."""
    scene = _scene()
    scene.xy[np.flatnonzero(scene.point == 7)[-1]] += (60.0, -40.0)
    return scene


@pytest.mark.parametrize("stereo", [False, True])
def test_points_are_exact_without_noise(stereo: bool) -> None:
    scene = _scene()
    assert np.median(scene.errors(scene.guess)) > 0.02
    np.testing.assert_allclose(scene.refine(stereo=stereo), scene.truth, atol=1e-7)


@pytest.mark.parametrize("stereo", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_noise_moves_points_by_little(stereo: bool, seed: int) -> None:
    scene = _scene(200, seed).with_noise(seed)
    errors = scene.errors(scene.refine(stereo=stereo))
    assert np.median(errors) < 0.006  # rays of 0.5 px that meet at 14 degrees
    assert errors.max() < 0.03


def test_disparities_improve_noisy_points() -> None:
    scene = _scene(400)
    scene = scene.only(np.isin(scene.camera, (0, 2))).with_noise(0)
    mono, stereo = (scene.errors(scene.refine(stereo=s)) for s in (False, True))
    assert np.mean(stereo) < 0.97 * np.mean(mono)


def test_one_image_and_its_disparity_determine_a_point() -> None:
    scene = _scene()
    scene = scene.only(scene.camera == 2)
    np.testing.assert_allclose(scene.refine(stereo=True), scene.truth, atol=1e-6)


@pytest.mark.parametrize("stereo", [False, True])
def test_an_outlier_hardly_moves_its_point_and_no_other(stereo: bool) -> None:
    scene = _with_an_outlier()
    errors = scene.errors(scene.refine(stereo=stereo))
    assert 1e-6 < errors[7] < 0.015
    assert np.delete(errors, 7).max() < 1e-7
    harm = scene.errors(scene.refine(stereo=stereo, huber=1e9))[7]  # without robust weights
    assert harm > 5 * errors[7]


def test_a_less_certain_observation_counts_less() -> None:
    scene = _scene(1)
    scene.xy[0] += (0.0, 1.0)
    before = float(scene.errors(scene.refine())[0])
    scene.sigma_px[0] *= 10
    assert scene.errors(scene.refine())[0] < 0.1 * before


def test_a_point_that_only_one_camera_sees_keeps_its_position() -> None:
    scene = _scene()
    scene = scene.only(scene.camera == 0)
    np.testing.assert_array_equal(scene.refine(), scene.guess)


@pytest.mark.parametrize("stereo", [False, True])
def test_a_point_behind_its_cameras_keeps_its_position(stereo: bool) -> None:
    scene = _scene()
    scene.guess[3] = (0.5, 0.2, -6.0)
    found = scene.refine(stereo=stereo)
    np.testing.assert_array_equal(found[3], scene.guess[3])
    np.testing.assert_allclose(np.delete(found, 3, 0), np.delete(scene.truth, 3, 0), atol=1e-7)


def test_a_point_behind_one_of_its_cameras_keeps_its_position() -> None:
    scene = _scene()
    away = se3_exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))
    cams = np.concatenate([scene.cam_from_world, away[None]])
    scene = replace(
        scene,
        cam_from_world=cams,
        point=np.append(scene.point, 3),
        camera=np.append(scene.camera, VIEWS),
        xy=np.vstack([scene.xy, (CX, CY)]),
        disparity=np.append(scene.disparity, 1.0),
        sigma_px=np.append(scene.sigma_px, SIGMA),
    )
    np.testing.assert_array_equal(scene.refine()[3], scene.guess[3])


def test_points_without_observations_keep_their_position() -> None:
    scene = _scene()
    unseen = np.isin(scene.point, (0, 5, 39))
    scene = scene.only(~unseen)
    found = scene.refine(stereo=True)
    np.testing.assert_array_equal(found[[0, 5, 39]], scene.guess[[0, 5, 39]])
    rest = np.delete(np.arange(40), (0, 5, 39))
    np.testing.assert_allclose(found[rest], scene.truth[rest], atol=1e-7)


def test_the_first_guess_is_not_modified() -> None:
    scene = _scene()
    before = scene.guess.copy()
    scene.refine(stereo=True)
    np.testing.assert_array_equal(scene.guess, before)


def test_no_observations_and_no_points() -> None:
    scene = _scene().only(np.empty(0, np.int64))
    assert replace(scene, guess=np.empty((0, 3))).refine().shape == (0, 3)
    np.testing.assert_array_equal(scene.refine(), scene.guess)
