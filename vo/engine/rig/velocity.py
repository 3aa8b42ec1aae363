"""Motion of a rig's body while its cameras take their images one after the other.

An offset of the velocity is hardly observable: landmarks of a late camera follow it, and each new
one confirms it. The poses of neighbouring frames have no such offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vo.base.geometry.transforms import inverse, se3_exp, se3_log
from vo.base.types import Floats

_UNKNOWN_SIGMA = 0.5  # of a velocity of which nothing is known, rad/s and m/s
_KEPT = 0.9  # of the mean square of changes, by each frame


class VelocityPrior(NamedTuple):
    """What frames before say of the velocity (6,) of a body, in its own frame, per second.

    Attributes:
        before: (4, 4) world_from_body of the frame before.
        elapsed_s: since then.
        change: (6,) of the velocity from the mean since then.
        sigma: (6,) standard deviations.
    """

    before: Floats
    elapsed_s: float
    change: Floats
    sigma: Floats

    def velocity(self, world_from_body: Floats) -> Floats:
        """The expected one, for a pose of the body."""
        return mean_velocity(self.before, world_from_body, self.elapsed_s) + self.change

    def add_to(
        self, normal: Floats, gradient: Floats, world_from_body: Floats, velocity: Floats
    ) -> None:
        """Add to equations (12, 12) of a pose and its velocity, on which the former has a part."""
        weight = self.sigma**-2.0
        by_step = np.concatenate([np.eye(6) / self.elapsed_s, np.eye(6)], axis=1)
        normal += by_step.T @ (weight[:, None] * by_step)
        gradient += by_step.T @ (weight * (velocity - self.velocity(world_from_body)))


def mean_velocity(before: Floats, after: Floats, elapsed_s: float) -> Floats:
    """(6,) between two poses world_from_body (4, 4)."""
    return np.asarray(se3_log(inverse(before) @ after) / elapsed_s)


class BodyVelocity:
    """Follows the velocity of a body from frame to frame."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Begin with an unknown velocity."""
        self._mean: Floats | None = None
        self._change = np.zeros(6)
        self._sigma = np.full(6, _UNKNOWN_SIGMA)

    def prior(self, before: Floats, elapsed_s: float) -> VelocityPrior:
        """For the next frame, after one with the pose (4, 4)."""
        return VelocityPrior(before, elapsed_s, 0.5 * self._change, self._sigma)

    def update(
        self, before: Floats, after: Floats, elapsed_s: float, delay_s: Sequence[float]
    ) -> Floats | None:
        """Take in the next frame's pose.

        Returns:
            (V, 4, 4) motions of the body from the frame before to the times of its images, on a
            path of constant acceleration through the frames around it; None after the first.
        """
        mean, earlier = mean_velocity(before, after, elapsed_s), self._mean
        self._mean = mean
        if earlier is None:
            return None
        self._change = mean - earlier
        square = np.repeat((self._change.reshape(2, 3) ** 2).mean(axis=1), 3)
        self._sigma = np.sqrt(_KEPT * self._sigma**2 + (1.0 - _KEPT) * square)
        velocity, acceleration = 0.5 * (mean + earlier), self._change / elapsed_s
        steps = [d * velocity + 0.5 * d**2 * acceleration for d in delay_s]
        return np.stack([se3_exp(step) for step in steps])
