"""Whether the stated covariances of inertial states are those of their errors, over many runs.

The normalised estimation error squared (NEES) of a consistent estimate has the mean of its number
of dimensions. Source: Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and
navigation", 2001, sec. 5.4.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from inertial_flight import (
    ACCEL_BIAS,
    GYRO_BIAS,
    IMU_FROM_CAM,
    NOISE,
    START_NS,
    Samples,
    Sensor,
    keyframe_stamps,
    path,
    world_from_cam,
)

from vo.base.geometry.transforms import inverse, se3_exp, se3_log
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.inertial.chain import InertialChain
from vo.engine.inertial.keyframe_states import KeyframeStates, Node
from vo.engine.inertial.prediction import (
    InertialPredictor,
    known_motion,
    without_inertial,
)
from vo.engine.inertial.samples import SampleReader
from vo.engine.inertial.states import States
from vo.engine.inertial.world_alignment import placed_at_origin

_RUNS, _KEYFRAMES = 20, 24  # of 0.5 s
_RATE_HZ = 200
# Errors of a motion by images: standard deviations in rad and m, and of the logarithm of the scale.
_TURN, _MOVE, _DRIFT = 1e-3, 3e-3, 0.0015
_SCALE = 0.5
_COMMON = 0.02  # standard deviation of the scale that all motions have in common
_WALKING = ImuNoise(NOISE.gyro_noise, 2e-5, NOISE.accel_noise, 1e-3)

_AFTER_GAP = _KEYFRAMES - 3
_WEAK_TURN, _WEAK_MOVE = 0.01, 0.02  # of the motion through a gap

_PARTS: dict[str, slice] = {
    "pose": slice(0, 6),
    "velocity": slice(6, 9),
    "gyro_bias": slice(9, 12),
    "accel_bias": slice(12, 15),
    "log_scale": slice(15, 16),
}


def _sensor(rng: np.random.Generator) -> tuple[Sensor, Floats]:
    """A sensor with noise and walking biases; (n, 6) its biases."""
    since_s = np.arange(int((_KEYFRAMES * 0.5 + 1.0) * _RATE_HZ)) / _RATE_HZ
    rotation, _, _, acceleration, rate = path(since_s)
    force = np.einsum("nji,nj->ni", rotation, acceleration + np.array([0.0, 0.0, 9.81]))
    walk = np.repeat([_WALKING.gyro_walk, _WALKING.accel_walk], 3) / np.sqrt(_RATE_HZ)
    steps = np.cumsum(rng.standard_normal((len(since_s), 6)) * walk, axis=0)
    biases = np.concatenate([GYRO_BIAS, ACCEL_BIAS]) + steps
    density = np.repeat([_WALKING.gyro_noise, _WALKING.accel_noise], 3) * np.sqrt(_RATE_HZ)
    white = rng.standard_normal((len(since_s), 6)) * density
    values = np.concatenate([rate, force], axis=1) + biases + white
    stamps = START_NS + np.round(1e9 * since_s).astype(np.int64)
    return Sensor(Samples(stamps, values[:, :3], values[:, 3:]), inverse(IMU_FROM_CAM)), biases


def _visual(stamps: Ints, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Poses (n, 4, 4) of the camera in a map whose scale drifts; the scale of each step."""
    truth = world_from_cam(stamps)
    scale = _SCALE * np.exp(np.cumsum(_DRIFT * rng.standard_normal(len(stamps))))
    poses = [np.eye(4)]
    for k, step in enumerate(inverse(truth[:-1]) @ truth[1:]):
        moved = step @ se3_exp(rng.standard_normal(6) * np.repeat([_TURN, _MOVE], 3))
        moved[:3, 3] /= scale[k]
        poses.append(poses[-1] @ moved)
    return np.stack(poses), scale


def _covariance(motion: Floats, scale: float, common: float) -> Floats:
    """(6, 6) as the windows of one camera state it: with the common error of the scale."""
    along = np.concatenate([np.zeros(3), motion[:3, :3].T @ motion[:3, 3]])
    own = np.diag([_TURN**2] * 3 + [(_MOVE / scale) ** 2] * 3)
    return np.asarray(own + common**2 * np.outer(along, along))


def _true_states(stamps: Ints, biases: Floats, scale: Floats) -> States:
    since_s = 1e-9 * (stamps - START_NS)
    rotation, position, velocity, *_ = path(since_s)
    rows = np.round(since_s * _RATE_HZ).astype(np.int64)
    states = States(rotation, position, velocity, biases[rows, :3], biases[rows, 3:], np.log(scale))
    return placed_at_origin(states, IMU_FROM_CAM)


def _window_motion(
    chain: InertialChain, reader: SampleReader, stamps: Ints, scale: float, *, counts_twice: bool
) -> tuple[Floats, Floats]:
    """Motion to the keyframe after a gap, and its covariance, of a window that uses the sensor.

    Images alone determine it badly.

    Args:
        chain: knows the states before the gap.
        reader: gives the samples.
        stamps: (2,) of the keyframes beside the gap.
        scale: metres of one unit of the map.
        counts_twice: whether the part by the sensor stays in.
    """
    assert chain.newest is not None
    estimate, times = chain.newest.estimate, stamps.tolist()
    known = known_motion(times[0], estimate.states.rows(slice(-1, None)), estimate.covariance[-1])
    inertial = InertialPredictor(reader, _WALKING, IMU_FROM_CAM).motion(known, *times)
    assert inertial is not None
    rng = np.random.default_rng(times[0] + round(1e6 * scale))
    sigma = np.array([_WEAK_TURN] * 3 + [_WEAK_MOVE / scale] * 3)
    truth = world_from_cam(stamps)
    seen = inverse(truth[0]) @ truth[1]
    seen[:3, 3] /= scale
    seen = seen @ se3_exp(sigma * rng.standard_normal(6))
    information = np.diag(sigma**-2.0), np.linalg.inv(inertial.covariance)
    covariance = np.linalg.inv(information[0] + information[1])
    off = se3_log(inverse(seen) @ inertial.first_from_last)
    motion = seen @ se3_exp(covariance @ information[1] @ off)
    alone = without_inertial(covariance, inertial.covariance)
    return motion, covariance if counts_twice else alone


@cache
def _errors(
    seed: int,
    stated: float = 1.0,
    counts_twice: bool | None = None,
    common: float = _COMMON,
) -> tuple[Floats, Floats]:
    """Errors (n, 16) of the states of a run, and their covariances (n, 16, 16).

    Args:
        seed: of all noise.
        stated: stated covariance of the motions by images, relative to the true one.
        counts_twice: as in `_window_motion`; None without a gap.
        common: stated standard deviation of the scale that all of them have in common.
    """
    rng = np.random.default_rng(seed)
    stamps = keyframe_stamps(_KEYFRAMES)
    sensor, biases = _sensor(rng)
    poses, scale = _visual(stamps, rng)
    reader = SampleReader(sensor)
    chain = InertialChain(reader, _WALKING, IMU_FROM_CAM, is_metric=False)
    for k in range(_KEYFRAMES):
        covariance = None
        if k:
            motion = inverse(poses[k - 1]) @ poses[k]
            covariance = stated * _covariance(motion, float(scale[k - 1]), common)
        if counts_twice is not None and k == _AFTER_GAP:
            times, at = stamps[k - 1 : k + 1], float(scale[k - 1])
            motion, covariance = _window_motion(chain, reader, times, at, counts_twice=counts_twice)
            poses[k:] = poses[k - 1] @ motion @ inverse(poses[k]) @ poses[k:]
        chain.set(Node(k, k, int(stamps[k]), 0, poses[k], covariance))
        chain.update()
    solved = chain.finish()
    assert solved is not None and len(solved.nodes) == _KEYFRAMES
    estimate = solved.estimate
    return estimate.states.since(_true_states(stamps, biases, scale)), estimate.covariance


def _nees(part: str, row: int, stated: float = 1.0, *, counts_twice: bool | None = None) -> float:
    """Mean over the runs."""
    columns = _PARTS[part]
    total = 0.0
    for seed in range(_RUNS):
        # A window that uses the sensor knows the scale.
        common = _COMMON if counts_twice is None else 0.0
        errors, covariances = _errors(seed, stated, counts_twice, common)
        error, covariance = errors[row, columns], covariances[row][columns, columns]
        total += float(error @ np.linalg.solve(covariance, error))
    return total / _RUNS


def _band(dimensions: int) -> tuple[float, float]:
    """95 % of the means of so many squares over the runs (Wilson and Hilferty)."""
    freedom = _RUNS * dimensions
    spread = 1.96 * np.sqrt(2.0 / (9.0 * freedom))
    low, high = ((1.0 - 2.0 / (9.0 * freedom) + s * spread) ** 3 for s in (-1.0, 1.0))
    return dimensions * float(low), dimensions * float(high)


@pytest.mark.parametrize("part", _PARTS)
def test_stated_covariances_are_those_of_the_errors(part: str) -> None:
    # The scale of the last keyframe is that of a step that follows.
    last = _KEYFRAMES - (2 if part == "log_scale" else 1)
    low, high = _band(_PARTS[part].stop - _PARTS[part].start)
    if part == "log_scale":
        low *= 0.75  # the largest of several drifts that fit is stated
    for row in (last // 2, last):
        assert low < _nees(part, row) < high


def test_motions_by_images_with_too_small_covariances_are_not_consistent() -> None:
    assert _nees("pose", _KEYFRAMES - 1, stated=0.1) > 1.5 * _band(6)[1]


@pytest.mark.parametrize("part", ["pose", "velocity", "gyro_bias"])
def test_samples_that_a_window_has_used_are_counted_once(part: str) -> None:
    once = _nees(part, _AFTER_GAP, counts_twice=False)
    low, high = _band(_PARTS[part].stop - _PARTS[part].start)
    assert low < once < high
    assert once < 0.95 * _nees(part, _AFTER_GAP, counts_twice=True)


def test_common_error_of_the_scale_changes_no_state() -> None:
    errors, covariances = _errors(0)
    expected, expected_covariances = _errors(0, common=0.0)
    sigma = np.sqrt(np.diagonal(expected_covariances, axis1=1, axis2=2))
    assert np.abs((errors - expected) / sigma).max() < 0.05
    found = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    np.testing.assert_allclose(found, sigma, rtol=0.02)


_SURE = np.repeat([1e-4, 3e-4], 3)  # errors of a motion by two cameras: rad and m


@cache
def _metric_run(seed: int, stated: float) -> tuple[KeyframeStates, KeyframeStates, Floats]:
    """States of a run of two cameras, those with motions as stated, and the first's errors (n, 6).

    `stated`: variances of the motions by images, relative to the true ones. Errors are of poses.
    """
    rng = np.random.default_rng(100 + seed)
    stamps, (sensor, biases) = keyframe_stamps(_KEYFRAMES), _sensor(rng)
    chain = InertialChain(SampleReader(sensor), _WALKING, IMU_FROM_CAM, is_metric=True)
    truth, pose = world_from_cam(stamps), np.eye(4)
    for k in range(_KEYFRAMES):
        if k:
            moved = se3_exp(_SURE * rng.standard_normal(6))
            pose = pose @ inverse(truth[k - 1]) @ truth[k] @ moved
        covariance = np.diag(stated * _SURE**2) if k else None
        chain.set(Node(k, k, int(stamps[k]), 0, pose, covariance))
        chain.update()
    as_stated = chain.smoothed()
    solved = chain.finish()
    assert solved is not None and as_stated is not None
    true = _true_states(stamps, biases, np.ones(_KEYFRAMES))
    return solved, as_stated, solved.estimate.states.since(true)[:, :6]


def _metric_nees(stated: float) -> tuple[float, float]:
    """Means over runs of the pose's NEES at the last keyframe, and with covariances as stated."""
    total = np.zeros(2)
    for seed in range(_RUNS):
        *both, errors = _metric_run(seed, stated)
        covariances = [each.estimate.covariance[-1][:6, :6] for each in both]
        total += [errors[-1] @ np.linalg.solve(c, errors[-1]) for c in covariances]
    return float(total[0] / _RUNS), float(total[1] / _RUNS)


def test_variances_of_two_cameras_that_are_stated_too_large_are_found() -> None:
    low, high = _band(6)
    assert low < _metric_nees(1.0)[0] < high
    found, as_stated = _metric_nees(4.0)
    assert as_stated < 0.6 * low and low < found < high


def test_variances_of_two_cameras_never_grow() -> None:
    for seed in range(_RUNS):
        solved, as_stated, _ = _metric_run(seed, 0.25)
        found, before = (np.trace(s.estimate.covariance[-1][:6, :6]) for s in (solved, as_stated))
        assert 0.5 * before < found < 1.02 * before
