"""Graphs and their results are due at fixed numbers of keyframes and frames."""

from __future__ import annotations

from vo.engine.memory.graph_schedule import GraphSchedule


def _begun(keyframes: int, *, is_apart: bool) -> GraphSchedule:
    schedule = GraphSchedule()
    schedule.keyframes, schedule.frames = keyframes, 10 * keyframes
    assert schedule.may_begin and not schedule.is_due
    schedule.begin(is_apart=is_apart)
    return schedule


def test_a_result_is_due_three_keyframes_later_and_a_graph_after_ten_or_a_twentieth() -> None:
    for keyframes, spacing in ((20, 10), (400, 20)):
        schedule = _begun(keyframes, is_apart=False)
        due = []
        for more in range(1, 4):
            schedule.keyframes = keyframes + more
            due.append(schedule.is_due)
        assert due == [False, False, True] and not schedule.may_begin
        schedule.end()
        schedule.keyframes = keyframes + spacing - 1
        assert not schedule.may_begin
        schedule.keyframes += 1
        assert schedule.may_begin


def test_while_the_camera_is_apart_a_result_is_due_five_frames_later() -> None:
    """Or so many after it is found to be apart."""
    for is_apart in (True, False):
        schedule = _begun(20, is_apart=is_apart)
        assert not schedule.is_due_apart()
        schedule.frames += 4
        assert not schedule.is_due_apart()
        schedule.frames += 1
        assert schedule.is_due_apart()
        schedule.end()
        assert not schedule.is_due_apart()
