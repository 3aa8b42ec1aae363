"""Motion of a camera during the exposure of one image, row after row."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from vo.base.types import Floats

_STEP_S = 2e-3


class Shutter(NamedTuple):
    """Poses of a camera from the start of the exposure of the first row to the end of the last.

    Poses between them are interpolated linearly.
    """

    rotations: Floats  # (M, 3, 3) of world_from_cam, evenly spaced in time
    origins: Floats  # (M, 3)
    first: float  # number (with fraction) of the pose in the middle of the first row's exposure
    per_row: float  # number of poses from one row to the next
    width: float  # poses that pass during the exposure of a row
    step_s: float  # seconds from one pose to the next


def static_shutter(world_from_cam: Floats) -> Shutter:
    """Shutter of a camera that does not move."""
    rotation = np.array(world_from_cam[None, :3, :3], dtype=np.float64)
    origin = np.array(world_from_cam[None, :3, 3], dtype=np.float64)
    return Shutter(rotation, origin, 0.0, 0.0, 0.0, 0.0)


def moving_shutter(
    world_from_cam: Callable[[Floats], Floats],
    time_s: float,
    rows: int,
    exposure_s: float,
    readout_s: float = 0.0,
) -> Shutter:
    """Shutter of a camera on its path.

    `world_from_cam`: poses (N, 4, 4) at times (N,) in seconds. `time_s`: the middle of the exposure
    of the image's middle row. `readout_s`: time from the first row to the last.
    """
    whole = exposure_s + readout_s
    if whole <= 0.0:
        return static_shutter(world_from_cam(np.array([time_s]))[0])
    steps = max(1, math.ceil(whole / _STEP_S))
    poses = world_from_cam(time_s + whole * (np.arange(steps + 1) / steps - 0.5))
    step = whole / steps
    return Shutter(
        rotations=np.ascontiguousarray(poses[:, :3, :3]),
        origins=np.ascontiguousarray(poses[:, :3, 3]),
        first=0.5 * exposure_s / step,
        per_row=readout_s / step / max(1, rows - 1),
        width=exposure_s / step,
        step_s=step,
    )
