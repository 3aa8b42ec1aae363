"""A recorder that works in a thread of its own, so that the run never waits for it."""

from __future__ import annotations

import logging
import queue
import threading
import time
from typing import NamedTuple

from vo.recording.recorder import Recorder, TakeSnapshot
from vo.types import Estimate, Rig, Snapshot, Trajectory

_ROOM = 32  # frames; their images are what takes space
_PATIENCE_S = 20.0

_log = logging.getLogger(__name__)


class _Frame(NamedTuple):
    estimate: Estimate
    snapshot: Snapshot


class BackgroundRecorder:
    """Hands frames to another recorder through a queue.

    Frames that come while the queue is full are left out of the recording; a recorder that fails or
    hangs is given up. Both are told as warnings.

    Args:
        recorder: what records.
        room: frames that may wait.
        patience_s: how long the end waits for a recorder that gets nothing done.
    """

    def __init__(
        self, recorder: Recorder, *, room: int = _ROOM, patience_s: float = _PATIENCE_S
    ) -> None:
        self._recorder = recorder
        self._waiting: queue.Queue[_Frame | tuple[Trajectory, Trajectory]] = queue.Queue(room)
        self._patience_s = patience_s
        self._thread: threading.Thread | None = None
        self._progress = 0
        self._left_out = 0

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Before the first frame; here, so that what is wrong is said before the run."""
        self._recorder.begin(name, rig, ground_truth)
        # A daemon: a recorder that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Queue a frame if there is room."""
        if self._waiting.full():
            self._left_out += 1
        else:
            self._waiting.put_nowait(_Frame(estimate, snapshot()))

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Wait until all is recorded, as long as it gets on."""
        if self._thread is None or not self._thread.is_alive():
            return
        if self._left_out:
            _log.warning("%d frames are not in the recording: it is too slow", self._left_out)
        seen, since = -1, time.monotonic()
        handed_over = False
        while self._thread.is_alive():
            if not handed_over:
                handed_over = self._hand_over((causal, smoothed))
            self._thread.join(0.05)
            if self._progress != seen:
                seen, since = self._progress, time.monotonic()
            elif time.monotonic() - since > self._patience_s:
                _log.warning("the recording hangs and is not complete")
                return

    def _hand_over(self, paths: tuple[Trajectory, Trajectory]) -> bool:
        try:
            self._waiting.put_nowait(paths)
        except queue.Full:
            return False
        return True

    def _work(self) -> None:
        try:
            while True:
                what = self._waiting.get()
                self._progress += 1
                if isinstance(what, _Frame):
                    self._recorder.record(what.estimate, _returning(what.snapshot))
                else:
                    self._recorder.finish(*what)
                    return
        except Exception as error:  # whatever it is, the run goes on
            _log.warning("recording stopped: %s: %s", type(error).__name__, error)


def _returning(snapshot: Snapshot) -> TakeSnapshot:
    return lambda: snapshot
