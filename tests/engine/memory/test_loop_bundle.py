"""Bundle adjustment of a path of one camera with loops."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from vo.base.config import SmoothingConfig
from vo.base.geometry.projection import Intrinsics
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Floats, Keypoints
from vo.engine.mapping.keyframe import FrameId, Keyframe
from vo.engine.mapping.keyframe_store import StoredLandmarks
from vo.engine.memory import loop_bundle
from vo.engine.memory.loop_bundle import LoopBundle
from vo.engine.places.records import Loop, PlaceKey, RegisteredKeyframes

_CAMERA = Intrinsics(200.0, 200.0, 160.0, 100.0)
_COUNT = 40
_NO_FEATURES = Keypoints(
    np.zeros((0, 2), np.float32),
    np.zeros(0, np.int32),
    np.zeros(0, np.float32),
    np.zeros(0, np.float32),
    np.zeros((0, 32), np.uint8),
)


@dataclass(frozen=True, eq=False)
class _Circle:
    """A camera that looks outwards from a circle of 1 m, around twice.

    Attributes:
        truth: (n, 4, 4).
        drifted: (n, 4, 4) with a scale that grows by 1 % a keyframe.
        scale: (n,) that growth.
        bundle: has all observations.
        loops: exact ones, between the two rounds.
    """

    truth: Floats
    drifted: Floats
    scale: Floats
    bundle: LoopBundle
    loops: list[Loop]


@pytest.mark.parametrize(("largest", "stored"), [(40, 40), (39, 0)])
def test_what_keyframes_of_a_segment_that_is_too_large_observe_is_not_kept(
    monkeypatch: pytest.MonkeyPatch, largest: int, stored: int
) -> None:
    monkeypatch.setattr(loop_bundle, "_MAX_KEYFRAMES", largest)
    circle = _circle()
    assert len(circle.bundle._stored) == stored
    adjusted = circle.bundle.adjusted(_placed(circle), circle.loops)
    assert (adjusted is None) == (stored == 0)


@pytest.mark.parametrize(("widest", "stored"), [(39, 40), (20, 0)])
def test_what_is_too_wide_to_be_adjusted_is_forgotten_before_the_end(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, widest: int, stored: int
) -> None:
    monkeypatch.setattr(loop_bundle, "MAX_WIDTH", widest)
    circle = _circle()
    circle.bundle.forget_wide(0, [])
    assert len(circle.bundle._stored) == 40  # without loops nothing is adjusted that is wide
    circle.bundle.forget_wide(0, circle.loops)
    assert len(circle.bundle._stored) == stored
    assert ("will not be adjusted" in caplog.text) == (stored == 0)
    _add_another(circle)
    assert len(circle.bundle._stored) == (41 if stored else 0)


def _add_another(circle: _Circle) -> None:
    pose, points = circle.truth[0], np.array([[0.0, 0.0, 4.0], [0.1, 0.0, 4.0]])
    _add(circle.bundle, _COUNT, pose, pose, 1.0, points, 0)


def _circle() -> _Circle:
    random = np.random.default_rng(3)
    angle = np.linspace(0.0, 4 * np.pi, _COUNT, endpoint=False)
    truth = np.tile(np.eye(4), (_COUNT, 1, 1))
    truth[:, 0, 0] = truth[:, 2, 2] = np.cos(angle)
    truth[:, 0, 2], truth[:, 2, 0] = np.sin(angle), -np.sin(angle)
    truth[:, 0, 3], truth[:, 2, 3] = np.sin(angle), np.cos(angle)
    truth = inverse(truth[0]) @ truth
    scale = 1.01 ** np.arange(_COUNT)
    drifted = truth.copy()
    steps = inverse(truth[:-1]) @ truth[1:]
    for k, step in enumerate(steps):
        moved = step.copy()
        moved[:3, 3] *= scale[k]
        drifted[k + 1] = drifted[k] @ moved
    bundle = LoopBundle(_CAMERA, SmoothingConfig())
    direction = random.normal(size=(3000, 3))
    points = 4.0 * direction / np.linalg.norm(direction, axis=1)[:, None]
    for k in range(_COUNT):  # the landmarks of the second round are others
        _add(bundle, k, truth[k], drifted[k], scale[k], points, 3000 * (2 * k // _COUNT))
    loops = [_loop(truth, drifted, scale, k, k + _COUNT // 2) for k in range(0, _COUNT // 2, 4)]
    return _Circle(truth, drifted, scale, bundle, loops)


def _add(
    bundle: LoopBundle,
    number: int,
    true_pose: Floats,
    pose: Floats,
    scale: float,
    points: Floats,
    first_id: int,
) -> None:
    """Add a keyframe whose odometry frame is the drifted one."""
    seen = transform_points(inverse(true_pose), points)
    u = _CAMERA.fx * seen[:, 0] / seen[:, 2] + _CAMERA.cx
    v = _CAMERA.fy * seen[:, 1] / seen[:, 2] + _CAMERA.cy
    rows = np.flatnonzero((seen[:, 2] > 0.1) & (abs(u - 160) < 160) & (abs(v - 100) < 100))
    xy = np.stack([u[rows], v[rows]], axis=1)
    count, ids = len(rows), rows + first_id
    nothing = np.zeros((0, 2))
    keyframe = Keyframe(
        id=number,
        frame=FrameId(number, number, 0),
        slot=0,
        world_from_cam=pose,
        covariance=None,
        cross_covariance={},
        keypoints=_NO_FEATURES,
        undistorted=lambda: nothing,
        free=np.zeros(0, bool),
        landmark=ids,
        xy=xy,
        image_xy=xy,
        disparity=np.full(count, np.nan),
        sigma_px=np.full(count, 0.5),
    )
    xyz = transform_points(pose, scale * seen[rows])
    landmarks = StoredLandmarks(
        ids,
        xyz,
        xyz,
        np.zeros((count, 32), np.uint8),
        np.zeros(count, np.int32),
        np.zeros(count, np.float32),
        np.zeros(count),
    )
    bundle.add(PlaceKey(0, number), keyframe, landmarks)


def _loop(truth: Floats, drifted: Floats, scale: Floats, earlier: int, later: int) -> Loop:
    """The true relation of two keyframes, in the unit of the earlier one."""
    relation = inverse(truth[earlier]) @ truth[later]
    relation[:3, 3] *= scale[earlier]
    covariance = np.diag([*[1e-3] * 6, 1e-3]) ** 2
    ratio = float(scale[earlier] / scale[later])
    keys = PlaceKey(0, earlier), PlaceKey(0, later)
    return Loop(*keys, relation, ratio, covariance, 100)


def _placed(circle: _Circle) -> RegisteredKeyframes:
    """Where a pose graph without a drift of the scale would leave them: as by odometry."""
    keys = tuple(PlaceKey(0, k) for k in range(_COUNT))
    covariance = np.tile(1e-4 * np.eye(6), (_COUNT, 1, 1))
    return RegisteredKeyframes(
        keys, np.zeros(_COUNT, np.int64), circle.drifted, np.ones(_COUNT), covariance, ()
    )


def _error(truth: Floats, poses: Floats) -> float:
    """RMS position error after scaling to the truth; the first pose is common."""
    a, b = truth[:, :3, 3], poses[:, :3, 3]
    return float(np.sqrt(((a - (a * b).sum() / (b * b).sum() * b) ** 2).sum(axis=1).mean()))


def test_the_drift_of_the_scale_is_removed() -> None:
    circle = _circle()
    registered = _placed(circle)
    assert _error(circle.truth, registered.world_from_cam) > 0.1
    adjusted = circle.bundle.adjusted(registered, circle.loops)
    assert adjusted is not None
    assert _error(circle.truth, adjusted.world_from_cam) < 0.01
    np.testing.assert_array_equal(adjusted.world_from_cam[0], registered.world_from_cam[0])
    before, after = (
        np.linalg.norm(np.diff(p.world_from_cam[:, :3, 3], axis=0), axis=1).sum()
        for p in (registered, adjusted)
    )
    np.testing.assert_allclose(after, before, rtol=1e-9)
    # The unit of each keyframe's odometry has grown as the scale drifted.
    expected = circle.scale[0] / circle.scale
    np.testing.assert_allclose(adjusted.scale / adjusted.scale[0], expected, rtol=0.02)


def test_an_adjustment_that_contradicts_the_scales_at_loops_is_refused() -> None:
    circle = _circle()
    loops = [replace(loop, scale=1.0) for loop in circle.loops]  # as the graph has them
    assert circle.bundle.adjusted(_placed(circle), loops) is None


def test_a_world_without_a_loop_or_without_observations_is_left_alone() -> None:
    circle = _circle()
    registered = _placed(circle)
    assert circle.bundle.adjusted(registered, []) is None
    circle.bundle.remove_from(_COUNT - 1)  # the last keyframe is tracked anew
    assert circle.bundle.adjusted(registered, circle.loops) is None
