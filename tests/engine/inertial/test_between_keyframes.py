"""Frames between keyframes as states of one camera with an inertial sensor."""

from __future__ import annotations

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
from vo.engine.inertial.keyframe_states import Node
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import LOG_SCALE

_RUNS, _KEYFRAMES, _PERIOD_S = 20, 12, 0.6
_NOISE = ImuNoise(2e-4, 1e-5, 2e-2, 1e-4)
_BOB_M, _BOB_HZ = 0.03, 1.8  # steps of somebody who walks
_FRAMES_NS = 100_000_000
_SCALE = 0.5
_TURN, _MOVE = 2e-4, 1e-3  # standard deviations from keyframe to keyframe, in rad and m
# Of tracked poses, as stated; errors of their own are 0.8 of that, and 0.51 of them is left in the
# next frame.
_TRACKED = np.array([1e-4] * 3 + [5e-4 / _SCALE] * 3)
_OWN, _KEPT = 0.8, 0.513


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
            place = 10 * keyframe + n, begin + n * _FRAMES_NS, keyframe
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


def test_frames_that_are_tracked_anew_are_forgotten() -> None:
    poses = _tracked(np.random.default_rng(0))
    poses.forget_from(13)
    kept = poses.by_keyframe()
    assert sorted(kept) == [0, 1]
    assert [pose.frame_index for pose in kept[1]] == [11, 12]


@pytest.mark.parametrize(("rate_hz", "expected"), [(10, 10), (30, 10), (200, 11), (4, 4)])
def test_about_one_frame_in_a_tenth_of_a_second_is_kept(rate_hz: int, expected: int) -> None:
    poses = TrackedPoses(is_metric=False)
    for n in range(rate_hz):
        poses.add(TrackedPose(n, round(1e9 * n / rate_hz), 0, np.eye(4), np.eye(6)))
    assert len(poses.by_keyframe()[0]) == expected
