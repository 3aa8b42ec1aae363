"""Measurements of an inertial sensor at the origin of the body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from data_synth.motion.spline import PosePath
from data_synth.recipe import ImuRecipe
from data_synth.records import GRAVITY_M_S2, BodyTruth, Imu
from vo.base.geometry.transforms import make_transform, so3_exp
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


_VIBRATION_M_S2, _VIBRATION_RAD_S = 2.0, 0.03
_VIBRATION_HZ = (85.0, 170.0, 110.0)  # two rotors with a harmonic; aliased by slow sensors
_BUMP_M_S2, _BUMP_S, _BUMPS_PER_S = 20.0, 0.04, 0.2
_SEED_VIBRATION, _SEED_BUMPS, _SEED_POSE = 33, 34, 35


def with_effects(imu: Imu, settings: ImuRecipe, seed: int) -> Imu:
    """The measurements as a faulty sensor records them."""
    times_s = (imu.stamps_ns - imu.stamps_ns[0]) / 1e9
    accel, gyro = imu.accel, imu.gyro
    if settings.vibration > 0.0:
        rng = np.random.default_rng([seed, _SEED_VIBRATION])
        accel = accel + settings.vibration * _VIBRATION_M_S2 * _hum(times_s, rng)
        gyro = gyro + settings.vibration * _VIBRATION_RAD_S * _hum(times_s, rng)
    if settings.bumps > 0.0:
        accel = accel + _bumps(times_s, settings.bumps, seed)
    if settings.gyro_range_deg_s > 0.0:
        limit = np.deg2rad(settings.gyro_range_deg_s)
        gyro = np.clip(gyro, -limit, limit)
    if settings.accel_range_g > 0.0:
        limit = settings.accel_range_g * GRAVITY_M_S2
        accel = np.clip(accel, -limit, limit)
    return replace(
        imu,
        stamps_ns=imu.stamps_ns + round(1e6 * settings.time_offset_ms),
        gyro=gyro,
        accel=accel,
        recorded_pose=_wrong_pose(settings, seed),
    )


def _hum(times_s: Floats, rng: np.random.Generator) -> Floats:
    """Oscillations (N, 3) of RMS 1, with random phases and directions."""
    hum = np.zeros((len(times_s), 3))
    for frequency in _VIBRATION_HZ:
        phase, size = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(0.3, 1.0, 3)
        hum += size * np.sin(2.0 * np.pi * frequency * times_s[:, None] + phase)
    return np.asarray(hum / np.sqrt(np.mean(np.sum(hum**2, axis=1))))


def _bumps(times_s: Floats, strength: float, seed: int) -> Floats:
    """Accelerations (N, 3) of jolts along z, which end at the height and speed of their start.

    The height is h sin²(π t / T), so that the acceleration is a cosine of period T.
    """
    rng = np.random.default_rng([seed, _SEED_BUMPS])
    count = rng.poisson(strength * _BUMPS_PER_S * float(times_s[-1]))
    accel = np.zeros((len(times_s), 3))
    for start in np.sort(rng.uniform(0.0, times_s[-1], count)):
        within = (times_s >= start) & (times_s < start + _BUMP_S)
        turn = 2.0 * np.pi * (times_s[within] - start) / _BUMP_S
        accel[within, 2] += _BUMP_M_S2 * np.cos(turn)
    return accel


def _wrong_pose(settings: ImuRecipe, seed: int) -> Floats | None:
    if settings.rotation_error_deg == 0.0 and settings.translation_error_m == 0.0:
        return None
    directions = np.random.default_rng([seed, _SEED_POSE]).standard_normal((2, 3))
    axis, side = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    turn = so3_exp(np.deg2rad(settings.rotation_error_deg) * axis)
    return make_transform(turn, settings.translation_error_m * side)
