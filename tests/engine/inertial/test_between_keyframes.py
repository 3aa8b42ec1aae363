"""Frames between keyframes as states of one camera with an inertial sensor."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from inertial_flight import (
    IMU_FROM_CAM,
    START_NS,
    Samples,
    Sensor,
    keyframe_stamps,
    path,
    sensor,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse, se3_exp
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.inertial.between_keyframes import TrackedPose, TrackedPoses
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.estimation import estimate_states, first_prior
from vo.engine.inertial.keyframe_states import Node
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import LOG_SCALE, POSITION

_RUNS, _KEYFRAMES, _PERIOD_S = 20, 12, 0.6
_NOISE = ImuNoise(2e-4, 1e-5, 2e-2, 1e-4)
_BOB_M, _BOB_HZ = 0.03, 1.8  # steps of somebody who walks
_FRAMES_NS = 100_000_000
_SCALE = 0.5
_TURN, _MOVE = 2e-4, 1e-3  # standard deviations from keyframe to keyframe, in rad and m
# Of tracked poses, as stated; errors of their own are 0.5 of that, and 0.51 of them is left in the
# next frame.
_TRACKED = np.array([1e-4] * 3 + [5e-4 / _SCALE] * 3)
_OWN, _KEPT = 0.5, 0.513


class _Found(NamedTuple):
    """The logarithm of the scale."""

    error: float
    sigma: float


def _bob(seconds: Floats, size_m: float) -> tuple[Floats, Floats]:
    """Heights (n,) and accelerations that walking adds to the flight."""
    pace = 2.0 * np.pi * _BOB_HZ
    height = size_m * np.sin(pace * seconds)
    return height, -(pace**2) * height


def _poses(stamps_ns: Ints, bob_m: float) -> Floats:
    """True poses (n, 4, 4) of the camera."""
    poses = world_from_cam(stamps_ns)
    poses[:, 2, 3] += _bob(1e-9 * (stamps_ns - START_NS), bob_m)[0]
    return poses


def _noisy(rng: np.random.Generator, bob_m: float) -> Sensor:
    exact = sensor(seconds=_KEYFRAMES * _PERIOD_S + 1.0)
    gyro, accel = exact.samples.gyro, exact.samples.accel
    since_s = 1e-9 * (exact.stamps_ns - START_NS)
    rotation, *_ = path(since_s)
    accel = accel + rotation[:, 2] * _bob(since_s, bob_m)[1][:, None]
    white = np.sqrt(200) * rng.standard_normal((2, *gyro.shape))
    noisy = gyro + _NOISE.gyro_noise * white[0], accel + _NOISE.accel_noise * white[1]
    return Sensor(Samples(exact.stamps_ns, *noisy), exact.cam0_from_imu)


def _in_map(motion: Floats) -> Floats:
    motion = motion.copy()
    motion[..., :3, 3] /= _SCALE
    return motion


def _tracked(
    rng: np.random.Generator, *, errors: float = 1.0, bob_m: float = _BOB_M
) -> TrackedPoses:
    """Frames at 10 Hz, with so many times the errors that are stated."""
    poses, stamps = TrackedPoses(is_metric=False), keyframe_stamps(_KEYFRAMES, _PERIOD_S)
    for keyframe, begin in enumerate(stamps[:-1].tolist()):
        own = np.zeros(6)
        for n in range(1, round(_PERIOD_S * 1e9) // _FRAMES_NS):
            new = _OWN * _TRACKED * rng.standard_normal(6)
            own = new if n == 1 else _KEPT * own + np.sqrt(1.0 - _KEPT**2) * new
            ends = _poses(np.array([begin, begin + n * _FRAMES_NS]), bob_m)
            motion = _in_map(inverse(ends[0]) @ ends[1]) @ se3_exp(errors * own)
            place = 10 * keyframe + n, begin + n * _FRAMES_NS, 10 * keyframe
            poses.add(TrackedPose(*place, motion, np.diag(_TRACKED**-2.0)))
    return poses


def _chain(seed: int, tracked: TrackedPoses | None, bob_m: float = _BOB_M) -> InertialChain:
    rng = np.random.default_rng(seed)
    reader = SampleReader(_noisy(rng, bob_m))
    chain = InertialChain(reader, _NOISE, IMU_FROM_CAM, is_metric=False)
    chain.tracked = tracked or chain.tracked
    sigma = np.array([_TURN] * 3 + [_MOVE / _SCALE] * 3)
    stamps, pose = keyframe_stamps(_KEYFRAMES, _PERIOD_S), np.eye(4)
    truth = _poses(stamps, bob_m)
    for k, stamp_ns in enumerate(stamps.tolist()):
        if k:
            motion = _in_map(inverse(truth[k - 1]) @ truth[k])
            pose = pose @ motion @ se3_exp(sigma * rng.standard_normal(6))
        chain.set(Node(k, 10 * k, stamp_ns, 0, pose, np.diag(sigma**2) if k else None))
        chain.update()
    return chain


@cache
def _found(seed: int, *, with_frames: bool, errors: float = 1.0, bob_m: float = _BOB_M) -> _Found:
    rng = np.random.default_rng(100 + seed)
    frames = _tracked(rng, errors=errors, bob_m=bob_m) if with_frames else None
    solved = _chain(seed, frames, bob_m).finish()
    assert solved is not None and len(solved.nodes) == _KEYFRAMES
    row = _KEYFRAMES // 2
    variance = solved.estimate.covariance[row, LOG_SCALE, LOG_SCALE]
    error = solved.estimate.states.log_scale[row] - np.log(_SCALE)
    return _Found(float(error), float(np.sqrt(variance)))


def _rms(found: list[_Found]) -> float:
    return float(np.sqrt(np.mean([each.error**2 for each in found])))


def test_errors_of_the_scale_are_smaller_and_as_stated() -> None:
    without = [_found(seed, with_frames=False) for seed in range(_RUNS)]
    found = [_found(seed, with_frames=True) for seed in range(_RUNS)]
    assert _rms(without) > 0.005
    assert _rms(found) < 0.7 * _rms(without)
    assert max(each.sigma for each in found) < 0.7 * min(each.sigma for each in without)
    # 95 % of the means of 20 squares are above 0.48 and below 1.71, if all errors are as stated.
    assert 0.48 < np.mean([(each.error / each.sigma) ** 2 for each in found]) < 1.71


def test_a_slow_flight_is_as_without_frames() -> None:
    # Its keyframes follow each other quicker than it accelerates.
    assert _found(0, with_frames=True, bob_m=0.0) == _found(0, with_frames=False, bob_m=0.0)


def test_frames_that_disagree_are_left_out() -> None:
    # With errors of 10 standard deviations.
    assert _found(0, with_frames=True, errors=10.0) == _found(0, with_frames=False)


def test_what_was_found_at_the_end_stays() -> None:
    chain = _chain(0, _tracked(np.random.default_rng(100)))
    before, finished, after = chain.smoothed(), chain.finish(), chain.smoothed()
    assert before is not None and finished is not None and after is finished
    sigma = [np.sqrt(s.estimate.covariance[:, LOG_SCALE, LOG_SCALE]) for s in (before, finished)]
    assert (sigma[1] < 0.7 * sigma[0]).all()


def test_the_path_keeps_its_shape() -> None:
    solved = [_chain(0, t).finish() for t in (None, _tracked(np.random.default_rng(100)))]
    before, after = (each.estimate.states for each in solved if each is not None)
    unit = np.exp(after.log_scale - before.log_scale)
    assert np.ptp(unit) < 1e-12
    assert abs(unit[0] - 1.0) > 0.003
    steps = [np.linalg.norm(np.diff(each.position, axis=0), axis=1) for each in (before, after)]
    np.testing.assert_allclose(steps[1], unit[0] * steps[0], rtol=1e-9)
    turns = [np.swapaxes(s.rotation[:-1], 1, 2) @ s.rotation[1:] for s in (before, after)]
    np.testing.assert_allclose(turns[0], turns[1], atol=1e-12)


def test_states_are_those_of_the_most_probable_drift() -> None:
    solved = _chain(1, None).smoothed()
    assert solved is not None
    found = solved.estimate
    assert found.errors.drift < found.steps.errors.drift  # covariances are those of the larger
    prior = first_prior(found.states.rows(slice(0, 1)), is_metric=False)
    drifts = []
    for errors in (found.errors, found.steps.errors):
        again = estimate_states(found.states, replace(found.steps, errors=errors), prior, _NOISE)
        drifts.append(np.ptp(again.states.log_scale))
    drift = np.ptp(found.states.log_scale)
    assert drift == pytest.approx(drifts[0], rel=0.05)
    assert drifts[1] > 2.0 * drift


def test_covariances_lose_what_frames_tell_of_the_scale() -> None:
    solved = [_chain(0, t).finish() for t in (None, _tracked(np.random.default_rng(100)))]
    before, after = (each.estimate.covariance for each in solved if each is not None)
    assert (np.linalg.eigvalsh(before - after) > -1e-9 * np.abs(before).max()).all()
    assert (np.linalg.eigvalsh(after[1:]) > 0.0).all()
    sigma = [np.sqrt(np.trace(c[-1, POSITION, POSITION])) for c in (before, after)]
    assert sigma[1] < 0.97 * sigma[0]


def test_frames_are_where_the_path_has_them_at_the_end() -> None:
    poses, path = _tracked(np.random.default_rng(0)), world_from_cam(keyframe_stamps(22, 0.1))
    poses.follow(np.arange(1, 16), path[1:16])  # neither the first keyframe nor later frames
    first, second, third = (poses.by_keyframe()[k] for k in (0, 10, 20))
    assert_allclose = np.testing.assert_allclose
    assert_allclose([p.keyframe_from_cam for p in second], inverse(path[10]) @ path[11:16])
    kept = _tracked(np.random.default_rng(0)).by_keyframe()
    for before, after in ((kept[0], first), (kept[20], third)):
        assert_allclose([p.keyframe_from_cam for p in before], [p.keyframe_from_cam for p in after])


def test_frames_that_are_tracked_anew_are_forgotten() -> None:
    poses = _tracked(np.random.default_rng(0))
    poses.forget_from(13)
    kept = poses.by_keyframe()
    assert sorted(kept) == [0, 10]
    assert [pose.frame_index for pose in kept[10]] == [11, 12]


@pytest.mark.parametrize(("rate_hz", "expected"), [(10, 10), (30, 10), (200, 11), (4, 4)])
def test_about_one_frame_in_a_tenth_of_a_second_is_kept(rate_hz: int, expected: int) -> None:
    poses = TrackedPoses(is_metric=False)
    for n in range(rate_hz):
        poses.add(TrackedPose(n, round(1e9 * n / rate_hz), 0, np.eye(4), np.eye(6)))
    assert len(poses.by_keyframe()[0]) == expected
