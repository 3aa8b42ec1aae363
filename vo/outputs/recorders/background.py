"""A recorder that works in a separate thread, beside the run."""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from dataclasses import replace
from typing import NamedTuple

from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, KeyframePose, Rig, Trajectory
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, Recorder, TakeSnapshot

_QUEUE_SIZE = 32  # frames; their images take most of the memory
_TIMEOUT_S = 20.0
_POLL_S = 0.02
_IDLE_S = 0.5  # without a frame, until the recorder is flushed

_log = logging.getLogger(__name__)


class _Frame(NamedTuple):
    estimate: Estimate
    snapshot: Snapshot


class _End(NamedTuple):
    causal: Trajectory
    smoothed: Trajectory
    findings: Findings


class BackgroundRecorder:
    """Passes frames to another recorder through a queue.

    While the queue is full, the run waits, because what was requested must not be incomplete. For a
    recorder to a live viewer, which may hang, `may_drop` is the better choice: frames are left out
    then, with a warning; their keyframe poses are passed with the next frame. A recorder that fails
    is stopped with a warning, and the run goes on.

    `queue_size`: maximum number of frames in the queue. `may_drop`: whether frames may be left out
    of the recording. `timeout_s`: with `may_drop`, time without progress after which `finish` no
    longer waits.
    """

    def __init__(
        self,
        recorder: Recorder,
        *,
        queue_size: int = _QUEUE_SIZE,
        may_drop: bool = False,
        timeout_s: float = _TIMEOUT_S,
    ) -> None:
        self._recorder = recorder
        self._queue: queue.Queue[_Frame | _End] = queue.Queue(queue_size)
        self._timeout_s = timeout_s if may_drop else math.inf
        self._may_drop = may_drop
        self._thread: threading.Thread | None = None
        self._progress = 0
        self._left_out = 0
        self._keyframes: dict[int, KeyframePose] = {}  # of frames that were left out

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Begin in the calling thread, so that errors are raised before the run."""
        self._recorder.begin(name, rig, ground_truth)
        # A daemon thread: a recorder that hangs must not prevent the program from ending.
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame to the queue."""
        if not self._wait_for_room():
            self._left_out += 1
            self._keyframes.update({k.frame_index: k for k in estimate.keyframes})
        else:
            self._queue.put_nowait(_Frame(self._with_missed_keyframes(estimate), snapshot()))

    def _wait_for_room(self) -> bool:
        """Whether there is room in the queue; only this thread adds to it."""
        while self._queue.full():
            if self._may_drop or self._thread is None or not self._thread.is_alive():
                return False
            time.sleep(_POLL_S)
        return True

    def flush(self) -> None:
        """Do nothing: the thread flushes while it waits for frames."""

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Wait until all frames are recorded, as long as there is progress."""
        if self._thread is None or not self._thread.is_alive():
            return
        if self._left_out:
            _log.warning(
                "%d frames are missing in the recording: recording is too slow", self._left_out
            )
        progress, since = -1, time.monotonic()
        is_queued = False
        while self._thread.is_alive():
            if not is_queued:
                is_queued = self._try_to_queue(_End(causal, smoothed, findings))
            self._thread.join(_POLL_S)
            if self._progress != progress:
                progress, since = self._progress, time.monotonic()
            elif time.monotonic() - since > self._timeout_s:
                _log.warning("recording hangs and is incomplete")
                return

    def _with_missed_keyframes(self, estimate: Estimate) -> Estimate:
        """Add the keyframe poses of frames that were left out."""
        if not self._keyframes:
            return estimate
        missed, self._keyframes = self._keyframes, {}
        keyframes = missed | {k.frame_index: k for k in estimate.keyframes}
        return replace(estimate, keyframes=tuple(keyframes[k] for k in sorted(keyframes)))

    def _try_to_queue(self, end: _End) -> bool:
        try:
            self._queue.put_nowait(end)
        except queue.Full:
            return False
        return True

    def _next(self) -> _Frame | _End:
        try:
            return self._queue.get(timeout=_IDLE_S)
        except queue.Empty:
            self._recorder.flush()
            return self._queue.get()

    def _work(self) -> None:
        try:
            while True:
                item = self._next()
                self._progress += 1
                if isinstance(item, _Frame):
                    self._recorder.record(item.estimate, _returning(item.snapshot))
                else:
                    self._recorder.finish(*item)
                    return
        except Exception as error:  # of any kind: the run goes on
            _log.warning("recording stopped: %s: %s", type(error).__name__, error)


def _returning(snapshot: Snapshot) -> TakeSnapshot:
    return lambda: snapshot
