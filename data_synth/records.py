"""Records that the parts of the generator exchange.

Conventions as in `vo.base.types`. The body frame has x ahead, y to the left and z up; it is also
the frame of the inertial sensor. The world has z up and gravity (0, 0, -9.81) m/s². A frame's stamp
is the middle of the exposure of the image's middle row.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import inverse
from vo.base.types import Bools, Floats, Floats32, ImuNoise, Ints, Rig, Trajectory

GRAVITY_M_S2 = 9.81

Pixels = NDArray[np.unsignedinteger]
"""(H, W) grey or (H, W, 3) blue, green, red; uint8 or uint16. Rendered images are grey, uint8."""

BODY = "body"
"""Name of the frame of the true poses."""


@dataclass(frozen=True, eq=False)
class Imu:
    """Measurements of the inertial sensor, in its own frame."""

    stamps_ns: Ints  # (N,)
    gyro: Floats  # (N, 3) rad/s
    accel: Floats  # (N, 3) m/s², specific force: (0, 0, +9.81) at rest
    rate_hz: float  # samples per second
    noise: ImuNoise | None  # its noise; None if unknown
    # name of that frame; `BODY`, or another one whose pose on the body is unknown
    frame: str = BODY
    # (4, 4) of that frame on the body as the recording has it, if that is wrong
    recorded_pose: Floats | None = None


@dataclass(frozen=True, eq=False)
class BodyTruth:
    """True states of the body at the rate of the inertial sensor."""

    stamps_ns: Ints  # (N,)
    world_from_body: Floats  # (N, 4, 4)
    velocity: Floats  # (N, 3) in the world, m/s
    gyro_bias: Floats  # (N, 3) rad/s
    accel_bias: Floats  # (N, 3) m/s²


@dataclass(frozen=True, eq=False)
class MoverTruth:
    """True poses (F, 4, 4) of a moving body, at the stamps of the frames."""

    name: str
    world_from_mover: Floats


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording without its images."""

    name: str
    rig: Rig
    body_from_cam0: Floats  # (4, 4)
    fps: float  # nominal frames per second
    stamps_ns: tuple[Ints, ...]  # for each camera, (F,) the recorded stamps, with jitter
    dropped: tuple[Bools, ...]  # for each camera, (F,) bool: missing frames
    # true poses of cam0 at the F true times of exposure; the stamps are those recorded by cam0,
    # also of dropped frames
    cam0_truth: Trajectory
    body_truth: BodyTruth
    imu: Imu | None  # its measurements, or None
    movers: tuple[MoverTruth, ...]  # true poses of moving bodies
    has_depth: bool  # whether shots contain the depth of cam0
    has_colour: bool = False  # whether their images are in colour

    def __len__(self) -> int:
        return len(self.cam0_truth)

    @property
    def body_from_cams(self) -> Floats:
        """(n, 4, 4) poses of all cameras."""
        poses, rig = [self.body_from_cam0], self.rig
        if rig.cam1_from_cam0 is not None:
            poses.append(self.body_from_cam0 @ inverse(rig.cam1_from_cam0))
        return np.stack(poses + [self.body_from_cam0 @ each.cam0_from_cam for each in rig.further])

    @property
    def path_m(self) -> float:
        """Length of the path of cam0."""
        steps = np.diff(self.cam0_truth.positions, axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True, eq=False)
class Shot:
    """The images of one frame."""

    index: int  # number of the frame, 0…F-1
    images: tuple[Pixels | None, ...]  # for each camera; None if dropped
    depth: Floats32 | None = None  # (H, W) float32 z in cam0, metres, infinite for the sky; or None


Write = Callable[[Path, Recording, Iterator[Shot], str], None]
"""Writes a whole recording to a path that does not exist yet (a folder, or a file for MCAP).

Shots are taken one by one, so that some are rendered while others are encoded; the last argument is
the codec of the images. The caller passes a temporary path and renames it at the end.
"""
