"""A simulated flight with an inertial sensor and a camera of unknown scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vo.base.geometry.transforms import inverse, make_transform, se3_exp
from vo.base.types import Floats, ImuNoise, Ints
from vo.engine.geometry import so3
from vo.engine.inertial.initialisation import Keyframes
from vo.engine.inertial.samples import SampleReader

START_NS = 10**15
GYRO_BIAS = np.array([0.02, -0.01, 0.015])
ACCEL_BIAS = np.array([0.1, -0.05, 0.08])
NOISE = ImuNoise(gyro_noise=1.7e-4, gyro_walk=1e-5, accel_noise=2e-3, accel_walk=1e-4)
IMU_FROM_CAM = make_transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.05, 0.02, -0.03])
)


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples in memory."""

    stamps_ns: Ints
    gyro: Floats
    accel: Floats


@dataclass(frozen=True, eq=False)
class Sensor:
    """An inertial sensor with samples in memory."""

    samples: Samples
    cam0_from_imu: Floats | None = None
    noise: ImuNoise | None = NOISE
    name: str = "imu0"
    time_offset_s: float = 0.0

    @property
    def stamps_ns(self) -> Ints:
        """Times of all samples."""
        return self.samples.stamps_ns

    def read(self, first_ns: int | None = None, last_ns: int | None = None) -> Samples:
        """Samples of a range of times."""
        stamps = self.samples.stamps_ns
        chosen = (stamps >= (first_ns or 0)) & (stamps <= (last_ns or stamps[-1]))
        return Samples(stamps[chosen], self.samples.gyro[chosen], self.samples.accel[chosen])


def path(seconds: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Rotations world_from_imu, positions, velocities, accelerations and body rates."""
    t = np.asarray(seconds)
    size, speed = np.array([1.5, 1.2, 0.3]), np.array([0.9, 0.7, 1.3])
    phase = t[:, None] * speed + np.array([0.0, 1.5, 0.0])
    position, velocity = size * np.sin(phase), size * speed * np.cos(phase)
    turn, pace = np.array([0.3, 0.2, 0.4]), np.array([0.8, 1.1, 0.5])
    angle = turn * np.sin(t[:, None] * pace)
    change = turn * pace * np.cos(t[:, None] * pace)
    rate = np.einsum("nij,nj->ni", so3.right_jacobian(angle), change)
    return so3.exp(angle), position, velocity, -(speed**2) * position, rate


def sensor(*, noise: float = 0.0, seconds: float = 15.0, rate_hz: int = 200) -> Sensor:
    """The sensor on that path, with biases, and white noise of so many densities of `NOISE`."""
    rng = np.random.default_rng(7)
    step_ns = 1_000_000_000 // rate_hz
    since_ns = np.arange(int(seconds * rate_hz)) * step_ns
    rotation, _, _, acceleration, rate = path(1e-9 * since_ns)
    force = np.einsum("nji,nj->ni", rotation, acceleration + np.array([0.0, 0.0, 9.81]))
    white = noise * np.sqrt(rate_hz) * rng.standard_normal((2, *force.shape))
    gyro = rate + GYRO_BIAS + NOISE.gyro_noise * white[0]
    accel = force + ACCEL_BIAS + NOISE.accel_noise * white[1]
    return Sensor(Samples(START_NS + since_ns, gyro, accel), inverse(IMU_FROM_CAM))


def world_from_cam(stamps_ns: Ints) -> Floats:
    """True poses (n, 4, 4) of the camera in the upright world."""
    rotation, position, *_ = path(1e-9 * (stamps_ns - START_NS))
    poses = [make_transform(r, p) for r, p in zip(rotation, position, strict=True)]
    return np.asarray(np.stack(poses) @ IMU_FROM_CAM)


def keyframe_stamps(count: int, period_s: float = 0.5) -> Ints:
    """Times of keyframes from 0.1 s on."""
    return START_NS + 100_000_000 + np.arange(count) * int(period_s * 1e9)


def visual_poses(truth: Floats, scale: float, noise: float = 0.0, *, seed: int = 3) -> Floats:
    """The same poses in a map of unknown scale, with errors of 1 mrad and 1 mm a step."""
    rng = np.random.default_rng(seed)
    steps = inverse(truth[:-1]) @ truth[1:]
    poses = [np.eye(4)]
    for step in steps:
        moved = step @ se3_exp(1e-3 * noise * rng.standard_normal(6))
        moved[:3, 3] /= scale
        poses.append(poses[-1] @ moved)
    return np.stack(poses)


def step_covariance(count: int, scale: float) -> Floats:
    """Covariances (count, 6, 6) of those errors, in map units."""
    return np.tile(np.diag([1e-6] * 3 + [1e-6 / scale**2] * 3), (count, 1, 1))


def keyframes(
    source: Sensor, *, count: int = 16, scale: float = 0.5, noise: float = 0.0, metric: bool = False
) -> Keyframes:
    """Keyframes of one segment with the samples between them."""
    stamps = keyframe_stamps(count)
    reader = SampleReader(source)
    intervals = [
        reader.between(int(a), int(b)) for a, b in zip(stamps[:-1], stamps[1:], strict=True)
    ]
    return Keyframes(
        visual_poses(world_from_cam(stamps), scale, noise),
        step_covariance(count - 1, scale),
        tuple(i for i in intervals if i is not None),
        metric,
        IMU_FROM_CAM,
        NOISE,
    )
