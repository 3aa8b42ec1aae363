"""What a run keeps of every frame is small, however long the run."""

from __future__ import annotations

import tracemalloc

import numpy as np

from vo.base.types import KeyframePose
from vo.engine.trajectory.store import TrajectoryStore

FRAMES = 5000


def _keep(history: TrajectoryStore, first: int, last: int) -> None:
    """Frames of which every third is a keyframe."""
    for number in range(first, last):
        if number % 3 == 0:
            pose = KeyframePose(number, number, 0, np.eye(4), np.eye(6))
            history.store(number // 3, pose)
        history.add(number, number, 0, number // 3, np.eye(4))


def test_the_path_takes_less_than_450_bytes_a_frame() -> None:
    history = TrajectoryStore()
    _keep(history, 0, 300)
    tracemalloc.start()
    try:
        _keep(history, 300, FRAMES)
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(history.frames) == FRAMES
    # With a keyframe every third frame, which also keeps its pose in the odometry frame.
    assert taken / (FRAMES - 300) < 450
