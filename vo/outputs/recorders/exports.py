"""Files for other programs, and the recorders that write them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from vo.base.errors import OutputError
from vo.base.files.complete_file import is_full_disk
from vo.base.frozen import frozen
from vo.base.types import Estimate, Rig, Trajectory
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, Recorder, TakeSnapshot

_log = logging.getLogger(__name__)


@frozen()
class Exports:
    """Files for other programs; None where a file is not requested.

    Attributes:
        mcap: MCAP file for Foxglove.
        colmap: folder for a COLMAP model.
        ply: PLY file of the map's points.
    """

    mcap: Path | None = None
    colmap: Path | None = None
    ply: Path | None = None

    @property
    def files(self) -> dict[str, Path | None]:
        """The files and folders by their names."""
        return vars(self)

    def recorders(self) -> list[Recorder]:
        """One recorder for each requested file."""
        if not any(self.files.values()):
            return []
        from vo.outputs.recorders.reconstruction import Reconstruction

        recorders: list[Recorder] = []
        store = Reconstruction()
        if self.mcap is not None:
            # protobuf takes long to import
            from vo.outputs.recorders.mcap_recorder import McapRecorder

            recorders.append(McapRecorder(self.mcap))
        if self.colmap is not None:
            from vo.outputs.recorders.colmap import ColmapRecorder

            recorders.append(ColmapRecorder(self.colmap, store))
        if self.ply is not None:
            from vo.outputs.recorders.ply import PlyRecorder

            recorders.append(PlyRecorder(self.ply, store))
        return recorders


def with_exports(recorder: Recorder, exports: Exports, *, may_drop: bool = False) -> Recorder:
    """A recorder, together with those of the exports in a separate thread.

    `may_drop`: whether they may leave out frames, rather than let the run wait.
    """
    others = exports.recorders()
    if not others:
        return recorder
    from vo.outputs.recorders.background import BackgroundRecorder

    return SeveralRecorders(
        [recorder, BackgroundRecorder(SeveralRecorders(others), may_drop=may_drop)]
    )


class SeveralRecorders:
    """Passes a run to several recorders; one that fails is removed.

    `recorders`: any number of recorders.
    """

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        self._recorders = list(recorders)

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Begin all recorders.

        Raises:
            OutputError: an output of one of them cannot be written, but for a full disk.
        """
        for recorder in list(self._recorders):
            try:
                recorder.begin(name, rig, ground_truth)
            except OutputError as error:
                if not is_full_disk(error):
                    raise
                self._remove(recorder, error)

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Record a frame with all recorders; the snapshot is taken once."""
        snapshot = cache(snapshot)
        for recorder in list(self._recorders):
            try:
                recorder.record(estimate, snapshot)
            except Exception as error:  # of any kind: the run goes on
                self._remove(recorder, error)

    def flush(self) -> None:
        """Flush all recorders."""
        for recorder in list(self._recorders):
            try:
                recorder.flush()
            except Exception as error:
                self._remove(recorder, error)

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Finish all recorders."""
        for recorder in list(self._recorders):
            try:
                recorder.finish(causal, smoothed, findings)
            except Exception as error:
                self._remove(recorder, error)

    def _remove(self, recorder: Recorder, error: Exception) -> None:
        self._recorders.remove(recorder)
        cause = error.__cause__ or error
        reason = getattr(cause, "strerror", None) or f"{type(error).__name__}: {error}"
        name = type(recorder).__name__.removesuffix("Recorder")
        _log.warning("the %s output stopped and is incomplete: %s", name, reason)
