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

from vo.base.types import Bools, Floats, Floats32, ImuNoise, Ints, Rig, Trajectory

GRAVITY_M_S2 = 9.81

Pixels = NDArray[np.unsignedinteger]
"""(H, W) grey or (H, W, 3) blue, green, red; uint8 or uint16. Rendered images are grey, uint8."""

BODY = "body"
"""Name of the frame of the true poses."""


@dataclass(frozen=True, eq=False)
class Imu:
    """Measurements of the inertial sensor, in its own frame.

    Attributes:
        stamps_ns: (N,).
        gyro: (N, 3) rad/s.
        accel: (N, 3) m/s², specific force: (0, 0, +9.81) at rest.
        rate_hz: samples per second.
        noise: its noise; None if unknown.
        frame: name of that frame; `BODY`, or another one whose pose on the body is unknown.
        recorded_pose: (4, 4) of that frame on the body as the recording has it, if that is wrong.
    """

    stamps_ns: Ints
    gyro: Floats
    accel: Floats
    rate_hz: float
    noise: ImuNoise | None
    frame: str = BODY
    recorded_pose: Floats | None = None


@dataclass(frozen=True, eq=False)
class BodyTruth:
    """True states of the body at the rate of the inertial sensor.

    Attributes:
        stamps_ns: (N,).
        world_from_body: (N, 4, 4).
        velocity: (N, 3) in the world, m/s.
        gyro_bias: (N, 3) rad/s.
        accel_bias: (N, 3) m/s².
    """

    stamps_ns: Ints
    world_from_body: Floats
    velocity: Floats
    gyro_bias: Floats
    accel_bias: Floats


@dataclass(frozen=True, eq=False)
class MoverTruth:
    """True poses (F, 4, 4) of a moving body, at the stamps of the frames."""

    name: str
    world_from_mover: Floats


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording without its images.

    Attributes:
        name: short, for titles.
        rig: the cameras.
        body_from_cam0: (4, 4).
        fps: nominal frames per second.
        stamps_ns: for each camera, (F,) the recorded stamps, with jitter.
        dropped: for each camera, (F,) bool: missing frames.
        cam0_truth: true poses of cam0 at the F true times of exposure; the stamps are those
            recorded by cam0, also of dropped frames.
        body_truth: true states of the body.
        imu: its measurements, or None.
        movers: true poses of moving bodies.
        has_depth: whether shots contain the depth of cam0.
        has_colour: whether their images are in colour.
    """

    name: str
    rig: Rig
    body_from_cam0: Floats
    fps: float
    stamps_ns: tuple[Ints, ...]
    dropped: tuple[Bools, ...]
    cam0_truth: Trajectory
    body_truth: BodyTruth
    imu: Imu | None
    movers: tuple[MoverTruth, ...]
    has_depth: bool
    has_colour: bool = False

    def __len__(self) -> int:
        return len(self.cam0_truth)

    @property
    def path_m(self) -> float:
        """Length of the path of cam0."""
        steps = np.diff(self.cam0_truth.positions, axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True, eq=False)
class Shot:
    """The images of one frame.

    Attributes:
        index: number of the frame, 0…F-1.
        images: for each camera; None if dropped.
        depth: (H, W) float32 z in cam0, metres, infinite for the sky; or None.
    """

    index: int
    images: tuple[Pixels | None, ...]
    depth: Floats32 | None = None


Write = Callable[[Path, Recording, Iterator[Shot], str], None]
"""Writes a whole recording to a path that does not exist yet (a folder, or a file for MCAP).

Shots are taken one by one, so that some are rendered while others are encoded; the last argument is
the codec of the images. The caller passes a temporary path and renames it at the end.
"""
