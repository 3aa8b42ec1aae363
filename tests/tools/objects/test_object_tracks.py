"""Reports of one instance have one id through a recording."""

from __future__ import annotations

import numpy as np

from vo.tools.objects.stored_objects import FoundObject
from vo.tools.objects.tracks import ObjectTracker


def found(name: str, u: float, v: float) -> FoundObject:
    outline = np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 30.0], [0.0, 30.0]]) + (u, v)
    return FoundObject(name, 0, 0.95, 20, outline, np.eye(3), None)


def test_two_instances_that_move_keep_their_ids() -> None:
    tracker = ObjectTracker()
    for frame in range(10):
        left, right = found("a", 5.0 * frame, 0.0), found("a", 200.0 - 5.0 * frame, 50.0)
        pair = [left, right] if frame % 2 else [right, left]
        ids = tracker.update(frame, pair)
        assert ids == ([1, 0] if frame % 2 else [0, 1])
    assert [(track.first, track.last, track.frames) for track in tracker.tracks] == [(0, 9, 10)] * 2


def test_an_instance_that_was_hidden_continues() -> None:
    tracker = ObjectTracker()
    assert tracker.update(0, [found("a", 0, 0), found("b", 0, 100)]) == [0, 1]
    for frame in range(1, 5):
        tracker.update(frame, [])
    assert tracker.update(5, [found("a", 90, 0)]) == [0]
    for frame in range(6, 40):
        tracker.update(frame, [])
    assert tracker.update(40, [found("a", 90, 0)]) == [2]


def test_another_object_at_the_same_place_is_another_track() -> None:
    tracker = ObjectTracker()
    assert tracker.update(0, [found("a", 0, 0)]) == [0]
    assert tracker.update(1, [found("b", 0, 0)]) == [1]
