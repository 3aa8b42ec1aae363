"""States of keyframes before those that have them, to begin an estimate of all with."""

from __future__ import annotations

import numpy as np

from vo.base.geometry.transforms import inverse
from vo.base.types import Floats
from vo.engine.inertial.states import GRAVITY, States, Steps, joined


def with_earlier(states: States, world_from_cam: Floats, steps: Steps) -> States:
    """The states with those of the keyframes before them, which follow from the newest back.

    Images lead back within a segment, samples from one to another, whose scale is that at which its
    last motion is as long as by the velocity.

    Args:
        states: of keyframes from the last one on.
        world_from_cam: (n, 4, 4) of n keyframes, in the units and the frame of their segment.
        steps: n - 1 measurements between them.
    """
    to_cam = inverse(steps.imu_from_cam)
    for row in range(len(steps.duration_s) - 1, -1, -1):
        first, measured = states.rows(slice(0, 1)), steps.inertial[row]
        duration, log_scale = float(steps.duration_s[row]), first.log_scale
        if steps.is_visual[row] or measured is None:
            motion = inverse(world_from_cam[row + 1]) @ world_from_cam[row]
            motion[:3, 3] *= np.exp(log_scale[0])
            imu_motion = steps.imu_from_cam @ motion @ to_cam
            rotation = first.rotation[0] @ imu_motion[:3, :3]
            position = first.position[0] + first.rotation[0] @ imu_motion[:3, 3]
            velocity = (first.position[0] - position) / duration
        else:
            rotation = first.rotation[0] @ measured.rotation.T
            velocity = first.velocity[0] - GRAVITY * duration - rotation @ measured.velocity
            way = velocity * duration + 0.5 * GRAVITY * duration**2 + rotation @ measured.position
            position = first.position[0] - way
            if row > 0 and steps.is_visual[row - 1]:
                length = float(np.linalg.norm(steps.visual[row - 1, :3, 3])) + 1e-9
                metres = float(np.linalg.norm(velocity)) * steps.duration_s[row - 1] + 1e-9
                log_scale = np.log([metres / length])
        before = first._replace(
            rotation=rotation[None],
            position=position[None],
            velocity=velocity[None],
            log_scale=log_scale,
        )
        states = joined(before, states)
    return states
