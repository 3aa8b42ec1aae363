"""Trajectories to compare: a smooth walk, and a noisy estimate of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vo.base.geometry.transforms import se3_exp
from vo.base.types import Ints, Trajectory

MakeWalk = Callable[..., Trajectory]
MakeNoisy = Callable[..., Trajectory]


@pytest.fixture
def make_walk() -> MakeWalk:
    """A walk of `count` poses, about `step_m` apart, with rotations about all three axes."""

    def make(count: int = 60, step_m: float = 0.5, seed: int = 0) -> Trajectory:
        rng = np.random.default_rng(seed)
        poses, pose = [], se3_exp(rng.normal(size=6))
        for _ in range(count):
            poses.append(pose)
            turn = rng.normal(scale=0.06, size=3)
            pose = pose @ se3_exp(np.array([*turn, 0.02, 0.01, step_m]))
        return Trajectory(1_600_000_000_000_000_000 + stamps_at_10_hz(count), np.array(poses))

    return make


@pytest.fixture
def make_noisy() -> MakeNoisy:
    """The same poses with independent random errors."""

    def make(true: Trajectory, size: float = 0.02, seed: int = 1) -> Trajectory:
        rng = np.random.default_rng(seed)
        moves = [se3_exp(rng.normal(scale=size, size=6)) for _ in range(len(true))]
        return Trajectory(true.stamps_ns, true.world_from_cam @ np.array(moves))

    return make


def stamps_at_10_hz(count: int) -> Ints:
    return np.arange(count, dtype=np.int64) * 100_000_000
