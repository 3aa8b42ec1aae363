"""A camera with an inertial sensor that is moved in front of a board."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from data_synth.motion.imu import measure
from data_synth.motion.spline import PosePath
from data_synth.records import Imu
from vo.base.geometry.cameras import project
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.types import Camera, Floats, ImuNoise, Ints
from vo.tools.calibrating.board import Board
from vo.tools.calibrating.detection import Detection
from vo.tools.calibrating.views import DetectedViews, View

FIRST_NS = 1_700_000_000_000_000_000
SILENT = ImuNoise(0.0, 0.0, 0.0, 0.0)
MEMS = ImuNoise(1.7e-4, 1.9e-5, 2.0e-3, 3.0e-3)
BODY_FROM_CAM0 = make_transform(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    @ so3_exp(np.array([0.05, -0.08, 0.03])),
    np.array([0.06, -0.03, 0.02]),
)
CAM0_FROM_IMU = inverse(BODY_FROM_CAM0)
_STEP_S = 0.05


class BoardMotion(NamedTuple):
    """The truth of a recording.

    Attributes:
        stamps_ns: (N,) of the images.
        cam_from_board: (N, 4, 4).
        imu: samples on their own clock.
    """

    stamps_ns: Ints
    cam_from_board: Floats
    imu: Imu


def move(
    board: Board,
    seconds: float = 20.0,
    fps: float = 20.0,
    *,
    noise: ImuNoise = SILENT,
    offset_s: float = 0.0,
    distance_m: float = 0.6,
    axes: tuple[float, float, float] = (1.0, 1.0, 1.0),
) -> BoardMotion:
    """Swing a camera about all three axes (yaw, pitch, roll), with the board in view."""
    world_from_board = make_transform(
        np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
        @ so3_exp(np.array([0.03, 0.02, -0.01])),
        np.array([distance_m, 0.0, 1.0]),
    )
    middle = 0.5 * board.square_m * np.array([board.columns + 1, board.rows + 1, 0.0])
    centre = transform_points(world_from_board, middle[None])[0]
    t = np.arange(-10, round(seconds / _STEP_S) + 10) * _STEP_S
    swing = np.stack(
        [
            centre[0] - distance_m + 0.06 * np.sin(2.9 * t + 0.3),
            centre[1] + 0.07 * np.sin(3.7 * t),
            centre[2] + 0.05 * np.sin(4.3 * t + 1.0),
            axes[0] * 0.16 * np.sin(5.1 * t + 0.5),
            axes[1] * 0.14 * np.sin(6.3 * t + 1.5),
            axes[2] * 0.35 * np.sin(4.7 * t + 2.5),
        ],
        axis=1,
    )
    path = PosePath(swing, _STEP_S, 10, seconds)
    times = np.arange(round(seconds * fps)) / fps
    stamps = FIRST_NS + np.round(1e9 * times).astype(np.int64)
    imu, _ = measure(path, stamps, FIRST_NS, rate_hz=200.0, noise=noise, seed=3)
    moved = Imu(imu.stamps_ns + round(1e9 * offset_s), imu.gyro, imu.accel, imu.rate_hz, imu.noise)
    world_from_cam = path.world_from_body(times) @ BODY_FROM_CAM0
    poses = np.stack([inverse(pose) @ world_from_board for pose in world_from_cam])
    return BoardMotion(stamps, poses, moved)


def corners(
    board: Board, camera: Camera, motion: BoardMotion, noise_px: float = 0.0
) -> DetectedViews:
    """What a detector would find, with errors of its corners."""
    rng = np.random.default_rng(11)
    views = []
    for number, (stamp, pose) in enumerate(
        zip(motion.stamps_ns.tolist(), motion.cam_from_board, strict=True)
    ):
        xy = project(camera, transform_points(pose, board.points))
        xy = xy + noise_px * rng.standard_normal(xy.shape)
        size = (camera.width - 1, camera.height - 1)
        seen = np.flatnonzero(((xy >= 0) & (xy <= size)).all(axis=1))
        found = Detection(seen, xy[seen], np.zeros((4, 2)), 0.5) if len(seen) > 8 else None
        views.append(View(number, stamp, (found,)))
    return DetectedViews(len(views), 1, tuple(views))
