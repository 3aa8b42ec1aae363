"""What a run is recorded as, and the recorders that do it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from vo.recording.background import BackgroundRecorder
from vo.recording.recorder import Recorder, TakeSnapshot
from vo.types import Estimate, Rig, Trajectory

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Exports:
    """Files for other programs, each written if it has a place.

    Attributes:
        mcap: file for Foxglove.
        colmap: folder for COLMAP and what builds on it.
        ply: file of the map's points.
    """

    mcap: Path | None = None
    colmap: Path | None = None
    ply: Path | None = None

    def recorders(self) -> list[Recorder]:
        """One for each that was asked for."""
        recorders: list[Recorder] = []
        if self.mcap is not None:
            from vo.recording.mcap_recorder import McapRecorder  # protobuf takes long to import

            recorders.append(McapRecorder(self.mcap))
        if self.colmap is not None:
            from vo.recording.colmap import ColmapRecorder

            recorders.append(ColmapRecorder(self.colmap))
        if self.ply is not None:
            from vo.recording.ply import PlyRecorder

            recorders.append(PlyRecorder(self.ply))
        return recorders


def with_exports(recorder: Recorder, exports: Exports) -> Recorder:
    """A recorder and, beside it, those of the exports in a thread of their own."""
    beside = exports.recorders()
    if not beside:
        return recorder
    return SeveralRecorders([recorder, BackgroundRecorder(SeveralRecorders(beside))])


class SeveralRecorders:
    """Hands a run to several recorders; one that fails is left out from then on.

    Args:
        recorders: any number.
    """

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = list(recorders)

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Before the first frame.

        Raises:
            OutputError: what one of them writes cannot be written; nothing has been computed yet.
        """
        for recorder in self._recorders:
            recorder.begin(name, rig, ground_truth)

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """After each frame."""
        snapshot = cache(snapshot)
        for recorder in list(self._recorders):
            try:
                recorder.record(estimate, snapshot)
            except Exception as error:  # whatever it is, the run goes on
                self._give_up(recorder, error)

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """After the last frame."""
        for recorder in list(self._recorders):
            try:
                recorder.finish(causal, smoothed)
            except Exception as error:
                self._give_up(recorder, error)

    def _give_up(self, recorder: Recorder, error: Exception) -> None:
        self._recorders.remove(recorder)
        reason = getattr(error, "strerror", None) or f"{type(error).__name__}: {error}"
        name = type(recorder).__name__.removesuffix("Recorder")
        _log.warning("the %s output stopped and is not complete: %s", name, reason)
