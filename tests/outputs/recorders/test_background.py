import logging
import threading
import time
from functools import partial

import fake_run
import pytest

from vo.base.errors import OutputError
from vo.outputs.recorders.background import BackgroundRecorder


class BlockedRecorder:
    """A recorder that is blocked until `go` is set, and then stores frame numbers."""

    def __init__(self, error: Exception | None = None) -> None:
        self.go = threading.Event()
        self.frames: list[int] = []
        self.keyframes: set[int] = set()
        self.finished = False
        self.flushed = 0
        self._error = error

    def begin(self, name, rig, ground_truth):
        pass

    def record(self, estimate, snapshot):
        self.go.wait(20.0)
        if self._error is not None:
            raise self._error
        self.frames.append(estimate.frame_index)
        self.keyframes |= {keyframe.frame_index for keyframe in estimate.keyframes}

    def flush(self):
        self.flushed = len(self.frames)

    def finish(self, causal, smoothed, findings):
        self.finished = True


def begun(inner, **options) -> BackgroundRecorder:
    recorder = BackgroundRecorder(inner, **options)
    recorder.begin("fake", fake_run.RIG, None)
    return recorder


def finish(recorder: BackgroundRecorder) -> None:
    recorder.finish(fake_run.trajectory(), fake_run.trajectory())


def test_all_frames_are_recorded_in_order():
    inner = BlockedRecorder()
    inner.go.set()
    recorder = begun(inner, queue_size=100)
    for frame in range(50):
        fake_run.record(recorder, frame)
    finish(recorder)
    assert inner.frames == list(range(50))
    assert inner.finished


def test_a_slow_viewer_loses_frames_without_blocking(caplog):
    inner = BlockedRecorder()
    recorder = begun(inner, queue_size=4, may_drop=True)
    taken = []

    def take(frame):
        taken.append(frame)
        return fake_run.snapshot(frame)

    began = time.monotonic()
    for frame in range(20):
        recorder.record(fake_run.estimate(frame), partial(take, frame))
    assert time.monotonic() - began < 1.0
    inner.go.set()
    with caplog.at_level(logging.WARNING):
        finish(recorder)
    assert inner.finished
    left_out = 20 - len(inner.frames)
    assert 15 <= left_out <= 16
    assert len(taken) == len(inner.frames)  # no snapshots of frames that are left out
    assert f"{left_out} frames are missing in the recording" in caplog.text


def test_a_slow_file_is_waited_for():
    inner = BlockedRecorder()
    recorder = begun(inner, queue_size=2, timeout_s=0.0)
    threading.Timer(0.3, inner.go.set).start()
    for frame in range(20):
        fake_run.record(recorder, frame)
    finish(recorder)
    assert inner.frames == list(range(20))
    assert inner.finished


def test_a_recorder_is_flushed_while_no_frame_comes():
    inner = BlockedRecorder()
    inner.go.set()
    recorder = begun(inner)
    for frame in range(3):
        fake_run.record(recorder, frame)
    while inner.flushed < 3:
        time.sleep(0.01)
    fake_run.record(recorder, 3)
    finish(recorder)
    assert inner.frames == list(range(4))


def test_a_recorder_that_failed_is_not_waited_for():
    inner = BlockedRecorder(ValueError("of some kind"))
    inner.go.set()
    recorder = begun(inner, queue_size=2)
    for frame in range(20):
        fake_run.record(recorder, frame)
    finish(recorder)
    assert inner.frames == []


def test_keyframes_of_lost_frames_come_with_the_next_frame():
    inner = BlockedRecorder()
    recorder = begun(inner, queue_size=2, may_drop=True)
    for frame in range(18):
        fake_run.record(recorder, frame)
    inner.go.set()
    while len(inner.frames) < 2:
        time.sleep(0.01)
    fake_run.record(recorder, 19)
    finish(recorder)
    assert len(inner.frames) < 6
    assert inner.keyframes == {frame for frame in range(18) if fake_run.is_keyframe(frame)}


def test_a_hanging_viewer_is_left_alone(caplog):
    inner = BlockedRecorder()
    recorder = begun(inner, may_drop=True, timeout_s=0.3)
    fake_run.record(recorder, 0)
    with caplog.at_level(logging.WARNING):
        finish(recorder)
    assert "hangs" in caplog.text
    inner.go.set()


def test_any_exception_is_one_warning(caplog):
    inner = BlockedRecorder(ValueError("of some kind"))
    inner.go.set()
    recorder = begun(inner)
    with caplog.at_level(logging.WARNING):
        for frame in range(5):
            fake_run.record(recorder, frame)
        finish(recorder)
    assert [record.getMessage() for record in caplog.records] == [
        "recording stopped: ValueError: of some kind"
    ]


def test_an_error_at_the_beginning_is_raised_before_the_run():
    class Closed(BlockedRecorder):
        def begin(self, name, rig, ground_truth):
            raise OutputError("cannot write")

    recorder = BackgroundRecorder(Closed())
    with pytest.raises(OutputError):
        recorder.begin("fake", fake_run.RIG, None)
    finish(recorder)
