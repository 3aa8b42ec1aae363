from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.projection import Intrinsics, PixelObservations
from vo.base.geometry.transforms import inverse, rotation_angle, se3_exp, se3_log, transform_points
from vo.base.types import Floats
from vo.engine.geometry.pnp import PoseFit, refine_pose

FX, FY, CX, CY = INTRINSICS = Intrinsics(520.0, 510.0, 320.0, 240.0)
BASELINE = 0.2
SIGMA, SIGMA_DISPARITY = 0.5, 0.4


class Scene:
    """A camera, points in front of it and where it sees them."""

    def __init__(self, count: int = 150, seed: int = 0, spread: float = 1.0) -> None:
        self.rng = np.random.default_rng(seed)
        self.cam_from_world = se3_exp(np.array([0.2, -0.4, 0.1, 1.0, -2.0, 0.5]))
        depth = self.rng.uniform(3.0, 20.0, count)
        offset = self.rng.uniform((-310, -230), (310, 230), (count, 2))
        self.exact_xy = spread * offset + (CX, CY)
        rays = (self.exact_xy - (CX, CY)) / (FX, FY)
        in_cam = np.column_stack([rays * depth[:, None], depth])
        self.points = transform_points(inverse(self.cam_from_world), in_cam)
        self.exact_disparity = FX * BASELINE / depth
        self.xy, self.disparity = self.exact_xy.copy(), np.full(count, np.nan)

    def with_noise(self) -> Scene:
        self.xy = self.exact_xy + self.rng.normal(0, SIGMA, self.exact_xy.shape)
        return self

    def with_disparity(self, noise: float = 0.0) -> Scene:
        error = noise * self.rng.standard_normal(len(self.points))
        self.disparity = self.exact_disparity + error
        return self

    def with_outliers(self, ratio: float) -> Scene:
        count = int(ratio * len(self.points))
        self.xy[:count] = self.rng.uniform((0, 0), (640, 480), (count, 2))
        return self

    def start(self, size: float = 1.0) -> Floats:
        tangent = size * np.array([0.02, -0.03, 0.02, 0.1, 0.1, -0.2])
        return np.asarray(se3_exp(tangent) @ self.cam_from_world)

    def fit(self, start: Floats | None = None) -> PoseFit:
        return refine_pose(
            self.start() if start is None else start,
            self.points,
            self.observed(np.full(len(self.points), SIGMA)),
            INTRINSICS,
            FX * BASELINE,
        )

    def observed(self, sigma_px: Floats) -> PixelObservations:
        return PixelObservations(self.xy, self.disparity, sigma_px, SIGMA_DISPARITY)

    def error(self, fit: PoseFit) -> Floats:
        """xi with truth = exp(xi) @ estimate."""
        return se3_log(self.cam_from_world @ inverse(fit.cam_from_world))


@pytest.mark.parametrize("stereo", [False, True])
def test_the_pose_is_exact_without_noise(stereo: bool) -> None:
    scene = Scene().with_disparity() if stereo else Scene()
    fit = scene.fit()
    np.testing.assert_allclose(fit.cam_from_world, scene.cam_from_world, atol=1e-9)
    assert fit.inlier.all()
    np.testing.assert_allclose(fit.residual, 0.0, atol=1e-6)


def test_the_pose_is_found_from_far_off() -> None:
    scene = Scene()
    fit = scene.fit(scene.start(4.0))
    np.testing.assert_allclose(fit.cam_from_world, scene.cam_from_world, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_30_percent_of_outliers_are_rejected(seed: int) -> None:
    scene = Scene(300, seed).with_noise().with_outliers(0.3)
    fit = scene.fit()
    error = scene.error(fit)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05
    assert np.linalg.norm(error[3:]) < 0.02
    assert fit.inlier[:90].mean() < 0.05
    assert fit.inlier[90:].mean() > 0.98


def test_the_rotation_stays_a_rotation() -> None:
    rotation = Scene().with_noise().with_outliers(0.3).fit().cam_from_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_disparities_determine_the_distance_where_pixels_hardly_do() -> None:
    mono, stereo = [], []
    for seed in range(40):
        scene = Scene(60, seed, spread=0.03).with_noise()
        mono.append(scene.error(scene.fit())[5])
        scene.with_disparity(SIGMA_DISPARITY)
        stereo.append(scene.error(scene.fit())[5])
    assert np.std(stereo) < 0.4 * np.std(mono)


def test_disparities_add_information() -> None:
    scene = Scene()
    mono = scene.fit().information
    gained = np.linalg.eigvalsh(scene.with_disparity().fit().information - mono)
    assert gained.min() > -1e-6 * gained.max()
    assert gained.max() > 1.0


def test_observations_without_disparity_count_as_mono() -> None:
    half = Scene().with_noise().with_disparity(SIGMA_DISPARITY)
    half.disparity[::2] = np.nan
    fit = half.fit()
    assert np.linalg.norm(half.error(fit)[3:]) < 0.05
    expected = np.linalg.norm((half.xy - half.exact_xy) / SIGMA, axis=1)
    np.testing.assert_allclose(fit.residual[::2], expected[::2], atol=0.5)


def test_disparities_are_ignored_without_a_baseline() -> None:
    scene = Scene().with_noise()
    plain = scene.fit()
    scene.disparity[:] = 1e3
    sigma = np.full(len(scene.points), SIGMA)
    fit = refine_pose(scene.start(), scene.points, scene.observed(sigma), INTRINSICS, 0.0)
    np.testing.assert_array_equal(fit.cam_from_world, plain.cam_from_world)


def test_points_behind_the_camera_are_outliers() -> None:
    scene = Scene()
    behind = transform_points(
        inverse(scene.cam_from_world), np.array([[0.0, 0.0, -4.0], [1.0, 1.0, 0.0]])
    )
    scene.points[:2] = behind
    fit = scene.fit()
    assert fit.inlier.tolist() == [False, False] + [True] * 148
    np.testing.assert_allclose(fit.cam_from_world, scene.cam_from_world, atol=1e-9)


def test_less_certain_pixels_count_less() -> None:
    scene = Scene(40)
    scene.xy[:20] += (2.0, 0.0)
    sigma = np.where(np.arange(40) < 20, 20.0, 0.1)
    fit = refine_pose(scene.start(), scene.points, scene.observed(sigma), INTRINSICS, 0.0)
    assert rotation_angle((scene.cam_from_world @ inverse(fit.cam_from_world))[:3, :3]) < 1e-4


@pytest.mark.parametrize("stereo", [False, True])
def test_the_information_predicts_the_scatter_of_noisy_trials(stereo: bool) -> None:
    errors, information = [], []
    for seed in range(200):
        scene = Scene(80)
        scene.rng = np.random.default_rng(seed)
        scene.with_noise()
        fit = (scene.with_disparity(SIGMA_DISPARITY) if stereo else scene).fit()
        errors.append(scene.error(fit))
        information.append(fit.information)
    scatter = np.array(errors).T @ np.array(errors) / len(errors)
    predicted = np.linalg.inv(np.mean(information, axis=0))
    np.testing.assert_allclose(np.diag(scatter) / np.diag(predicted), 1.0, atol=0.3)
    mahalanobis = [e @ i @ e for e, i in zip(errors, information, strict=True)]
    assert np.mean(mahalanobis) / 6.0 == pytest.approx(1.0, abs=0.3)
