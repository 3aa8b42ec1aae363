"""Records the whole map for other programs: what all exports of it share, and the PLY file."""

from __future__ import annotations

import time
from collections.abc import Container
from pathlib import Path

from vo.base.files.complete_file import writing
from vo.base.types import Estimate, Rig, Trajectory
from vo.outputs.recorders.map_spool import Model
from vo.outputs.recorders.reconstruction import Reconstruction
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, TakeSnapshot
from vo.recordings.formats.ply import write_ply

_MIN_S = 1.0  # between the end of one checkpoint and the begin of the next
_MAX_RATIO = 1.0 / 30.0  # of the time that they may take


class MapRecorder:
    """Writes the map again and again during a run, for a killed process, and at its end.

    `store`: what was in the map, shared by all exports of a run; None for its own.
    """

    _frames: Container[int] | None = None  # of the keyframes that are written; None for all

    def __init__(self, store: Reconstruction | None) -> None:
        self._store = Reconstruction() if store is None else store
        self._ended, self._took_s = time.monotonic(), 0.0  # of the last checkpoint

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame.

        Raises:
            OSError: the disk is full.
        """
        self._store.add(estimate, snapshot())
        began = time.monotonic()
        if began - self._ended >= max(_MIN_S, self._took_s / _MAX_RATIO):
            self._write_map(None, NO_FINDINGS)
            self._ended = time.monotonic()
            self._took_s = self._ended - began

    def flush(self) -> None:
        """Do nothing: what is written during a run is complete."""

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Write the map in metres, where loops have placed it.

        Raises:
            OSError: the disk is full.
        """
        self._write_map(smoothed, findings)
        del self._store  # whose files vanish with the last export

    def _write_map(self, smoothed: Trajectory | None, findings: Findings) -> None:
        scales, closures = findings.scales, findings.closures
        self._write(self._store.models(smoothed, self._frames, scales, closures))

    def _write(self, models: list[Model]) -> None:
        raise NotImplementedError


class PlyRecorder(MapRecorder):
    """Writes all points that were in the map.

    `path`: the file; an existing one is replaced.
    """

    def __init__(self, path: Path, store: Reconstruction | None = None) -> None:
        super().__init__(store)
        self._path = path

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Check that the file can be written.

        Raises:
            OutputError: it cannot be written.
        """
        self._name = name
        with writing(f"points {self._path}", "choose another `ply`"):
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_ply(self._path, 0, (), name)
            self._store.open(self._path.parent)

    def _write(self, models: list[Model]) -> None:
        count = sum(model.point_count for model in models)
        parts = ((part.xyz, part.grey) for model in models for part in model.points())
        write_ply(self._path, count, parts, self._name)
