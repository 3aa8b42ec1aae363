"""Records the points of the map as a PLY file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from vo.base.errors import OutputError
from vo.base.records.metric_scale import MetricScale
from vo.base.types import Estimate, Rig, Trajectory
from vo.outputs.recorders.checkpoints import Checkpoints
from vo.outputs.recorders.reconstruction import Reconstruction
from vo.outputs.recorders.recorder import LoopClosures, TakeSnapshot
from vo.recordings.formats.ply import write_ply


class PlyRecorder:
    """Writes all points that were in the map, again and again during the run, and at its end.

    `path`: the file; an existing one is replaced.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._checkpoints = Checkpoints()
        self._scales: dict[int, MetricScale] = {}
        self._closures: LoopClosures | None = None

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Check that the file can be written.

        Raises:
            OutputError: it cannot be written.
        """
        self._name = name
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_ply(self._path, 0, (), name)
            self._reconstruction = Reconstruction(self._path.parent)
        except OSError as error:
            raise OutputError(
                f"points {self._path} cannot be written: {error.strerror or error}; "
                "choose another `ply`"
            ) from error

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame.

        Raises:
            OSError: the disk is full.
        """
        self._reconstruction.add(estimate, snapshot())
        if self._checkpoints.is_due:
            self._checkpoints.begin()
            self._write(None)
            self._checkpoints.end()

    def flush(self) -> None:
        """Do nothing: what is written during a run is complete."""

    def set_scales(self, scales: Mapping[int, MetricScale]) -> None:
        """Write the final points in metres."""
        self._scales = dict(scales)

    def set_loops(self, closures: LoopClosures) -> None:
        """Write the final points where loops have placed them."""
        self._closures = closures

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Write the points.

        Raises:
            OSError: the disk is full.
        """
        self._write(smoothed)
        self._reconstruction.close()

    def _write(self, smoothed: Trajectory | None) -> None:
        models = self._reconstruction.models(smoothed, scales=self._scales, closures=self._closures)
        count = sum(model.point_count for model in models)
        parts = ((part.xyz, part.grey) for model in models for part in model.points())
        write_ply(self._path, count, parts, self._name)
