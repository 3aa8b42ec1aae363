"""A walk around the middle of the room, and a simple sensor, for tests of rendering."""

from __future__ import annotations

import numpy as np

from data_synth.cameras import load_rig
from data_synth.motion.spline import BODY_FROM_LOOKING_AHEAD, PosePath
from data_synth.recipe import Effects
from data_synth.sensor.exposure import Settings
from data_synth.sensor.photometrics import develop
from vo.base.types import Bytes, Floats, Floats32

RIG = load_rig("pinhole")
BASELINE_M = 0.12
_LAP_S = 8.0


def world_from_cam0(times_s: Floats) -> Floats:
    """Poses (N, 4, 4) on a lap of 8 s counter-clockwise, looking ahead and outward."""
    rng = np.random.default_rng(1)
    around = 2 * np.pi * np.arange(8) / 8
    scale = 1.0 + rng.uniform(-0.07, 0.07, 8)
    controls = np.column_stack(
        [
            1.85 * scale * np.cos(around),
            1.35 * scale * np.sin(around),
            1.45 + rng.uniform(-0.18, 0.18, 8),
            around + np.deg2rad(65.0) + rng.uniform(-0.14, 0.14, 8),
            np.deg2rad(-7.0) + rng.uniform(-0.09, 0.09, 8),
            rng.uniform(-0.05, 0.05, 8),
        ]
    )
    poses = PosePath(controls, _LAP_S / 8, 1, _LAP_S, turns=1).world_from_body(np.array(times_s))
    poses[:, :3, :3] = poses[:, :3, :3] @ BODY_FROM_LOOKING_AHEAD
    return poses


def grey_levels(image: Floats32) -> Bytes:
    """Image of a sensor with usual noise."""
    return develop(image, Settings(), Effects(), 1.0, None, np.random.default_rng(0))
