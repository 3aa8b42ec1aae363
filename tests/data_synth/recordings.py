"""Small recordings with random images, to be written and read back."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from data_synth.records import BodyTruth, Imu, MoverTruth, Recording, Shot
from vo.base.geometry.transforms import make_transform, se3_exp, so3_exp
from vo.base.types import Camera, Floats, ImuNoise, Ints, Rig, Trajectory

FRAMES = 7
FPS = 20.0
IMU_HZ = 200.0
START_NS = 1_403_636_579_763_555_584  # seconds as floats would lose its last digits
STEREO_DROPS = ((3,), (3, 5))
RADTAN = Camera(48, 32, 40.0, 41.0, 23.3, 15.7, "radtan", (-0.28, 0.07, 0.0002, 1.8e-5))
FISHEYE = Camera(48, 32, 30.0, 30.5, 24.1, 16.2, "equidistant", (0.01, -0.02, 0.003, -0.001))
BODY_FROM_CAM0 = make_transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]) @ so3_exp(np.full(3, 0.02)),
    np.array([0.1, 0.05, -0.02]),
)
CAM1_FROM_CAM0 = make_transform(
    so3_exp(np.array([0.01, -0.02, 0.005])), np.array([-0.11, 0.0, 0.0])
)


def make_recording(
    camera: Camera = RADTAN,
    *,
    stereo: bool = True,
    inertial: bool = True,
    depth: bool = True,
    drops: tuple[tuple[int, ...], ...] = STEREO_DROPS,
    frames: int = FRAMES,
) -> Recording:
    """A recording with jittered stamps, one mover, and `drops[k]` the lost frames of camera k."""
    rng = np.random.default_rng(7)
    true_ns = START_NS + np.rint(np.arange(frames) * 1e9 / FPS).astype(np.int64)
    cameras = 2 if stereo else 1
    stamps = tuple(true_ns + rng.integers(-400_000, 400_000, frames) for _ in range(cameras))
    dropped = tuple(np.isin(np.arange(frames), drops[k]) for k in range(cameras))
    imu_ns = START_NS + np.arange(int(frames * IMU_HZ / FPS), dtype=np.int64) * 5_000_000
    world_from_body = _motion(imu_ns)
    return Recording(
        name="small",
        rig=Rig(camera, camera, CAM1_FROM_CAM0) if stereo else Rig(camera),
        body_from_cam0=BODY_FROM_CAM0,
        fps=FPS,
        stamps_ns=stamps,
        dropped=dropped,
        cam0_truth=Trajectory(stamps[0], _motion(true_ns) @ BODY_FROM_CAM0),
        body_truth=BodyTruth(
            stamps_ns=imu_ns,
            world_from_body=world_from_body,
            velocity=rng.normal(size=(imu_ns.size, 3)),
            gyro_bias=rng.normal(size=(imu_ns.size, 3)) * 1e-3,
            accel_bias=rng.normal(size=(imu_ns.size, 3)) * 1e-2,
        ),
        imu=_imu(imu_ns, rng) if inertial else None,
        movers=(MoverTruth("walker", _motion(true_ns + 2_000_000_000)),),
        has_depth=depth,
    )


def make_shots(recording: Recording, seed: int = 1) -> Iterator[Shot]:
    """Random images; depth with sky in its first row where the recording has depth."""
    rng = np.random.default_rng(seed)
    cameras = [recording.rig.cam0, recording.rig.cam1][: len(recording.dropped)]
    for index in range(len(recording)):
        images = tuple(
            None
            if camera is None or recording.dropped[number][index]
            else rng.integers(0, 256, (camera.height, camera.width), dtype=np.uint8)
            for number, camera in enumerate(cameras)
        )
        cam0 = recording.rig.cam0
        depth = rng.uniform(0.5, 20.0, (cam0.height, cam0.width)).astype(np.float32)
        depth[0] = np.inf
        yield Shot(index, images, depth if recording.has_depth else None)


def _motion(stamps_ns: Ints) -> Floats:
    seconds = (stamps_ns - START_NS) / 1e9
    tangents = np.column_stack(
        [seconds, np.sin(seconds), -seconds, 2 * seconds, seconds**2, seconds]
    )
    return np.stack([se3_exp(each) for each in tangents])


def _imu(stamps_ns: Ints, rng: np.random.Generator) -> Imu:
    noise = ImuNoise(gyro_noise=1.7e-4, gyro_walk=1.9e-5, accel_noise=2e-3, accel_walk=3e-3)
    gyro, accel = rng.normal(size=(2, stamps_ns.size, 3))
    return Imu(stamps_ns, gyro, accel + (0.0, 0.0, 9.81), IMU_HZ, noise)
