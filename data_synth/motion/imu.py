"""Measurements of an inertial sensor at the origin of the body."""

from __future__ import annotations

import numpy as np

from data_synth.motion.spline import PosePath
from data_synth.records import GRAVITY_M_S2, BodyTruth, Imu
from vo.base.types import Floats, ImuNoise, Ints

_MARGIN_NS = 100_000_000  # before the first frame and after the last
_SEED_GYRO, _SEED_ACCEL = 31, 32
_WARMED_UP_S = 1000.0


def measure(
    path: PosePath,
    stamps_ns: Ints,
    first_stamp_ns: int,
    *,
    rate_hz: float,
    noise: ImuNoise,
    seed: int,
) -> tuple[Imu, BodyTruth]:
    """Angular velocity and specific force with biases and white noise, and the true states.

    Samples lie at whole multiples of the period from the start of the path, from 0.1 s before the
    first frame to 0.1 s after the last. Without noise they are exact.

    Source: Kalibr, IMU noise model: a sample's white noise is density * √rate, a bias's step is
    density / √rate.

    `first_stamp_ns`: stamp of time 0 of the path. `rate_hz`: samples per second. `noise`:
    continuous-time densities.
    """
    since_ns = _sample_times_ns(np.asarray(stamps_ns) - first_stamp_ns, rate_hz)
    times_s = since_ns / 1e9
    world_from_body = path.world_from_body(times_s)
    force = path.acceleration(times_s) + np.array([0.0, 0.0, GRAVITY_M_S2])
    body_force = np.einsum("nji,nj->ni", world_from_body[:, :3, :3], force)
    rotation = path.angular_velocity(times_s)
    gyro_rng, accel_rng = (np.random.default_rng([seed, n]) for n in (_SEED_GYRO, _SEED_ACCEL))
    shape = rotation.shape
    gyro_bias = _bias(gyro_rng, noise.gyro_walk, rate_hz, shape)
    accel_bias = _bias(accel_rng, noise.accel_walk, rate_hz, shape)
    gyro_white = noise.gyro_noise * np.sqrt(rate_hz) * gyro_rng.standard_normal(shape)
    accel_white = noise.accel_noise * np.sqrt(rate_hz) * accel_rng.standard_normal(shape)
    stamps = first_stamp_ns + since_ns
    imu = Imu(
        stamps_ns=stamps,
        gyro=rotation + gyro_bias + gyro_white,
        accel=body_force + accel_bias + accel_white,
        rate_hz=rate_hz,
        noise=noise,
    )
    truth = BodyTruth(stamps, world_from_body, path.velocity(times_s), gyro_bias, accel_bias)
    return imu, truth


def _sample_times_ns(frames_ns: Ints, rate_hz: float) -> Ints:
    first = np.ceil((frames_ns.min() - _MARGIN_NS) * rate_hz / 1e9)
    last = np.floor((frames_ns.max() + _MARGIN_NS) * rate_hz / 1e9)
    return np.asarray(np.round(np.arange(first, last + 1) * 1e9 / rate_hz), dtype=np.int64)


def _bias(rng: np.random.Generator, walk: float, rate_hz: float, shape: tuple[int, ...]) -> Floats:
    """A random walk (N, 3) that has started _WARMED_UP_S before."""
    steps = walk / np.sqrt(rate_hz) * rng.standard_normal(shape)
    steps[0] = walk * np.sqrt(_WARMED_UP_S) * rng.standard_normal(3)
    return np.cumsum(steps, axis=0)
