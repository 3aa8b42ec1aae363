"""Paths divided by segments and by worlds."""

from __future__ import annotations

from dataclasses import replace

import exact_run
import numpy as np

from vo.outputs.recorders.timelines import RunIndex


def test_segments_of_a_world_are_together_and_others_apart() -> None:
    index = RunIndex()
    segments = [0, 0, 0, 1, 1, 2, 2, 2, 2]
    for frame, segment in enumerate(segments):
        index.add(replace(exact_run.estimate(frame), segment=segment))
    path = exact_run.smoothed()
    stamps = path.stamps_ns // 100_000_000
    rest = stamps[9:].tolist()
    pieces = [(piece.stamps_ns // 100_000_000).tolist() for piece in index.by_segment(path)]
    assert pieces == [[0, 1, 2], [3, 4], [5, 6, 7, 8, *rest]]
    worlds = index.by_world(path, {2: 0})
    found = [(world.stamps_ns // 100_000_000).tolist() for world in worlds]
    assert found == [[0, 1, 2, 5, 6, 7, 8, *rest], [3, 4]]
    np.testing.assert_array_equal(worlds[1].world_from_cam, path.world_from_cam[3:5])
