"""A map of keyframes with known truth, adjusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from windows import blank_keypoints

from vo.base.config import Config
from vo.base.geometry.rectification import RectifiedRig
from vo.base.geometry.transforms import adjoint, inverse, se3_exp, se3_log, transform_points
from vo.base.stopwatch import Stopwatch
from vo.base.types import Floats, Ints
from vo.engine.backend.optimizer import DeferredOptimizer
from vo.engine.backend.sliding_window import SlidingWindow
from vo.engine.backend.solution import WindowSolution
from vo.engine.frontend.contracts import DescriptorFormat
from vo.engine.mapping.keyframe import FrameId, Keyframe, NewObservations
from vo.engine.mapping.local_map import LocalMap

WIDTH, HEIGHT = 64, 40  # of images that nothing looks at
RIG = RectifiedRig(WIDTH, HEIGHT, 500.0, 500.0, 320.0, 200.0, 0.25, np.eye(4))
KEYFRAMES, SHARED, NEWEST = 6, 200, 60
SIGMA_DISPARITY_PX = 0.4


@dataclass(frozen=True, eq=False)
class Scene:
    """All keyframes but the last see the first landmarks; only the last two see the others."""

    map: LocalMap
    world_from_cam: Floats
    xyz: Floats

    def error(self, keyframe: int) -> float:
        """How far a keyframe is from the truth, in the norm of the tangent (rad and m)."""
        found = self.map.keyframes[keyframe].world_from_cam
        return float(np.linalg.norm(se3_log(inverse(self.world_from_cam[keyframe]) @ found)))

    def point_errors(self) -> Floats:
        return np.asarray(np.linalg.norm(self.map.xyz - self.xyz, axis=1))


def _scene(noise_px: float = 0.0) -> Scene:
    rng = np.random.default_rng(0)
    xyz = rng.uniform((-3, -1.5, 5), (3, 1.5, 12), (SHARED + NEWEST, 3))
    poses = [se3_exp(np.array([0.0, 0.01, 0.0, 0.1, 0.02, 0.15]) * k) for k in range(KEYFRAMES)]
    world = LocalMap(RIG, KEYFRAMES, DescriptorFormat(32, np.dtype(np.uint8)))
    keyframes = [_add_keyframe(world, k, pose) for k, pose in enumerate(poses)]
    ids = _add_landmarks(world, xyz, keyframes[0])
    for k, keyframe in enumerate(keyframes):
        first = 0 if k < KEYFRAMES - 1 else SHARED
        last = SHARED if k < KEYFRAMES - 2 else SHARED + NEWEST
        _observe(keyframe, ids[first:last], xyz[first:last], noise_px, rng)
    keyframes[0].covariance = np.zeros((6, 6))
    return Scene(world, np.stack(poses), xyz)


def _add_keyframe(world: LocalMap, number: int, pose: Floats) -> Keyframe:
    count = SHARED + NEWEST
    image, free = np.zeros((HEIGHT, WIDTH), np.uint8), np.ones(count, dtype=bool)
    return world.add_keyframe(FrameId(number, number, 0), image, pose, blank_keypoints(count), free)


def _add_landmarks(world: LocalMap, xyz: Floats, reference: Keyframe) -> Ints:
    return world.add_landmarks(xyz.copy(), reference, np.arange(len(xyz)), reference)


def _observe(
    keyframe: Keyframe, ids: Ints, xyz: Floats, noise_px: float, rng: np.random.Generator
) -> None:
    in_cam = transform_points(inverse(keyframe.world_from_cam), xyz)
    xy = RIG.project(in_cam) + noise_px * rng.standard_normal((len(ids), 2))
    disparity = RIG.fx * RIG.baseline_m / in_cam[:, 2] + noise_px * rng.standard_normal(len(ids))
    sigma_px = np.full(len(ids), 0.5)
    keyframe.add_observations(NewObservations(ids, xy, xy.copy(), disparity, sigma_px))


def _move(scene: Scene, keyframe: int, size: float = 1.0) -> None:
    step = se3_exp(size * np.array([0.005, -0.01, 0.005, 0.04, -0.02, 0.03]))
    scene.map.keyframes[keyframe].world_from_cam = scene.world_from_cam[keyframe] @ step


def _config(max_landmarks: int) -> Config:
    config = Config()
    smoothing = config.smoothing.model_copy(
        update={"max_landmarks": max_landmarks, "iterations": 30, "relative_error_tolerance": 1e-9}
    )
    return config.model_copy(update={"smoothing": smoothing})


class Unsolvable(DeferredOptimizer):
    """Gives results that have not converged."""

    def result(self) -> WindowSolution:
        return super().result()._replace(converged=False)


def _submitted(
    scene: Scene, config: Config, optimizer: DeferredOptimizer | None = None
) -> SlidingWindow:
    optimizer = optimizer or DeferredOptimizer(config.smoothing)
    window = SlidingWindow(scene.map, optimizer, SIGMA_DISPARITY_PX, config.smoothing, Stopwatch())
    window.submit(calibration_weight=1)
    return window


def _apply(window: SlidingWindow) -> list[Keyframe]:
    update = window.apply()
    assert update is not None
    return update.moved


def _adjust(scene: Scene, config: Config) -> list[Keyframe]:
    return _apply(_submitted(scene, config))


@pytest.mark.parametrize("max_landmarks", [1000, 60])
def test_poses_are_exact_without_noise(max_landmarks: int) -> None:
    scene = _scene()
    for k in range(1, KEYFRAMES):
        _move(scene, k, 0.3)
    moved = _adjust(scene, _config(max_landmarks))
    assert moved == scene.map.keyframes[1:]
    assert max(scene.error(k) for k in range(KEYFRAMES)) < 1e-4
    assert scene.point_errors().max() < 1e-3
    assert all(k.covariance is not None for k in scene.map.keyframes)


def test_a_keyframe_that_has_turned_away_gets_its_share_of_few_landmarks() -> None:
    scene = _scene(noise_px=0.1)
    _move(scene, KEYFRAMES - 1)
    before = scene.error(KEYFRAMES - 1)
    moved = _adjust(scene, _config(60))
    assert before > 0.05
    assert scene.map.keyframes[-1] in moved
    assert scene.error(KEYFRAMES - 1) < 0.02
    assert scene.map.keyframes[-1].covariance is not None


def test_landmarks_that_take_no_part_follow_the_poses() -> None:
    scene = _scene()
    guess = np.random.default_rng(1).normal(1.0, 0.03, (len(scene.xyz), 1))
    scene.map.xyz = scene.xyz * guess
    assert np.median(scene.point_errors()) > 0.1
    _adjust(scene, _config(50))
    assert scene.point_errors().max() < 1e-3


def test_the_first_keyframe_alone_is_no_window() -> None:
    scene = _scene()
    scene.map.keyframes = scene.map.keyframes[:1]
    assert _submitted(scene, _config(1000)).apply() is None


def test_an_observation_that_disagrees_is_dropped_and_no_other() -> None:
    scene = _scene()
    second = scene.map.keyframes[1]
    seen = [len(k.landmark) for k in scene.map.keyframes]
    wrong = int(second.landmark[17])
    second.xy[17] += (40.0, 25.0)
    _adjust(scene, _config(1000))
    assert wrong not in second.landmark
    assert [len(k.landmark) for k in scene.map.keyframes] == [
        n - (i == 1) for i, n in enumerate(seen)
    ]


# What has changed in the map since the window was handed in


def test_a_keyframe_made_since_is_carried_along_with_the_newest_of_the_window() -> None:
    scene, later = _scene(), se3_exp(np.array([0.0, 0.02, 0.0, 0.1, 0.0, 0.2]))
    _move(scene, KEYFRAMES - 1)
    window = _submitted(scene, _config(1000))
    newest = scene.map.keyframes[-1]
    since = _add_keyframe(scene.map, KEYFRAMES, newest.world_from_cam @ later)
    moved = _apply(window)
    assert moved[-1] is since
    away = inverse(scene.world_from_cam[-1] @ later) @ since.world_from_cam
    assert np.linalg.norm(se3_log(away)) < 1e-4
    assert since.covariance is None


def test_landmarks_made_since_are_carried_along_with_the_keyframe_of_their_patch() -> None:
    scene, config = _scene(), _config(1000)
    _move(scene, KEYFRAMES - 1)
    window = _submitted(scene, config)
    newest = scene.map.keyframes[-1]
    in_cam = np.array([[0.5, 0.2, 6.0], [-1.0, 0.4, 9.0]])
    ids = _add_landmarks(scene.map, transform_points(newest.world_from_cam, in_cam), newest)
    _apply(window)
    found = scene.map.xyz[scene.map.rows(ids)]
    np.testing.assert_allclose(found, transform_points(scene.world_from_cam[-1], in_cam), atol=1e-3)


def test_landmarks_and_keyframes_dropped_since_do_not_matter() -> None:
    scene, config = _scene(), _config(1000)
    for k in range(1, KEYFRAMES):
        _move(scene, k, 0.3)
    window = _submitted(scene, config)
    scene.map.keep_landmarks(np.arange(len(scene.map)) % 3 > 0)
    newest = scene.map.keyframes[-1]
    for keyframe in (scene.map.keyframes[1], newest):
        rows = scene.map.rows(keyframe.landmark)
        scene.map.set_reference(keyframe, np.arange(len(rows)), rows)
    _add_keyframe(scene.map, KEYFRAMES, newest.world_from_cam)  # in place of the oldest
    _apply(window)
    assert [k.id for k in scene.map.keyframes] == list(range(1, KEYFRAMES + 1))
    for k, keyframe in enumerate(scene.map.keyframes[:-1], start=1):
        error = se3_log(inverse(scene.world_from_cam[k]) @ keyframe.world_from_cam)
        assert np.linalg.norm(error) < 1e-4
    np.testing.assert_allclose(scene.map.xyz, scene.xyz[scene.map.id], atol=1e-3)


def test_a_window_without_an_answer_changes_nothing() -> None:
    scene, config = _scene(), _config(1000)
    _move(scene, 2)
    window = _submitted(scene, config, Unsolvable(config.smoothing))
    before, xyz = scene.error(2), scene.map.xyz.copy()
    assert _apply(window) == []
    assert scene.error(2) == before
    np.testing.assert_array_equal(scene.map.xyz, xyz)


# Uncertainty


def test_keyframes_err_with_those_that_were_held() -> None:
    """If all that is held errs by one common motion, so does all that hangs on it."""
    scene, config = _scene(), _config(1000)
    config = config.model_copy(
        update={"smoothing": config.smoothing.model_copy(update={"window": 2})}
    )
    root = np.random.default_rng(3).normal(0, [[0.1]] * 3 + [[1.0]] * 3, (6, 6))
    common = root @ root.T  # large beside what the window itself does not know
    keyframes, poses = scene.map.keyframes, scene.world_from_cam
    carry = [adjoint(inverse(pose) @ poses[0]) for pose in poses]
    for k, keyframe in enumerate(keyframes[:4]):
        keyframe.covariance = carry[k] @ common @ carry[k].T
        keyframe.cross_covariance = {j: carry[k] @ common @ carry[j].T for j in range(k)}
    _adjust(scene, config)
    for k in (4, 5):
        expected, found = carry[k] @ common @ carry[k].T, keyframes[k].covariance
        assert found is not None
        np.testing.assert_allclose(found, expected, atol=1e-3 * np.abs(expected).max())
        own = found - expected
        assert np.linalg.eigvalsh(0.5 * (own + own.T)).min() > -1e-6 * np.abs(expected).max()
        np.testing.assert_allclose(
            keyframes[k].cross_covariance[0], carry[k] @ common, atol=1e-3 * np.abs(common).max()
        )


def test_a_held_keyframe_without_covariance_gets_one() -> None:
    scene = _scene()
    _adjust(scene, _config(1000))
    scene.map.keyframes[1].covariance = None
    narrow = _config(1000).smoothing.model_copy(update={"window": 2})
    _adjust(scene, _config(1000).model_copy(update={"smoothing": narrow}))
    assert all(k.covariance is not None for k in scene.map.keyframes)
