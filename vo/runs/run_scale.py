"""The metric scale of a run: measured at its end, and applied to what it writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vo.base.records.metric_scale import (
    MetricScale,
    ScaleFindings,
    ScaleSource,
    choose_scales,
    without_metric,
)
from vo.base.records.snapshot import Snapshot
from vo.base.types import Estimate, Trajectory
from vo.engine.map_alignment import MapAlignment
from vo.engine.trajectory.store import TrajectoryStore
from vo.outputs.recorders.recorder import Findings, LoopClosures, Recorder
from vo.runs.scaling.scale_sources import ScaleSources

if TYPE_CHECKING:
    from vo.engine.markers.marker_problem import MarkerView


class RunScale:
    """Measures the scale of a run once, and converts its path to metres.

    `findings` is None before, and without a source.
    """

    def __init__(self, sources: ScaleSources, of_rig: Sequence[ScaleSource] = ()) -> None:
        self.findings: ScaleFindings | None = None
        self._sources = sources
        self._all = (*sources.all, *of_rig)
        self._unscaled: Trajectory | None = None  # the path in units of the map

    @property
    def by_world(self) -> Mapping[int, MetricScale]:
        """By number of the world; empty before they are measured, and without any."""
        return {} if self.findings is None else self.findings.by_segment()

    def observe(self, estimate: Estimate, snapshot: Callable[[], Snapshot]) -> None:
        """Show a frame to the sources."""
        for source in self._all:
            source.observe(estimate, snapshot)

    def newest_markers(self) -> tuple[Sequence[MarkerView], Sequence[int]]:
        """Markers in the newest frame, and ids that it shows twice; none if it was not searched."""
        return ((), ()) if self._sources.markers is None else self._sources.markers.newest

    def apply(
        self,
        store: TrajectoryStore,
        folder: Path,
        map_alignment: MapAlignment,
    ) -> None:
        """Measure, convert and move the path, and write the files of markers and of the globe.

        Raises:
            OutputError: one of them cannot be written.
        """
        if not self._all or self.findings is not None:
            return
        path = store.path()
        self._unscaled = path.trajectory
        measured = [source.measure(path) for source in self._all]
        metric = store.metric
        found = choose_scales(measured)
        self.findings = without_metric(found, metric.by_map, metric.worlds_by_sensor)
        if self.by_world:
            store.apply_scales(self.by_world)
        notes = list(map_alignment.notes)
        if self._sources.markers is not None:
            self._sources.markers.write(folder, self.by_world)
            new = self._sources.markers.new_worlds(self.by_world)
            store.turn_worlds(new.poses)
            notes += new.notes
            self.findings = replace(self.findings, world_frames=new.frames)
        sensors = self._sources.moves, self._sources.wheel
        if any(sensors) and map_alignment.map_use is None:
            from vo.runs.scaling.moved_path import move_path

            moved = move_path(store, *sensors, map_alignment.accepted_loops)
            self.findings = replace(self.findings, positions=moved.positions, wheel=moved.wheel)
            notes += moved.notes
        if self._sources.on_globe is not None:
            from vo.runs.scaling.georeference import write_georeference

            notes += write_georeference(folder, store.path(), self._sources.on_globe)
        if self._sources.moves is not None:
            from vo.runs.scaling.georeference import write_positions

            write_positions(folder, store.path(), self._sources.moves)
        self.findings = replace(self.findings, notes=(*self.findings.notes, *notes))

    def finish(
        self,
        recorder: Recorder,
        causal: Trajectory,
        store: TrajectoryStore,
        closures: LoopClosures | None,
    ) -> None:
        """Finish a recorder, which gets paths and markers in units of the map, and the scales."""
        scales = store.scales_of_segments() if self.by_world else {}
        markers = self._sources.markers
        findings = Findings(scales, closures, None if markers is None else markers.seen())
        smoothed = store.trajectory() if self._unscaled is None else self._unscaled
        recorder.finish(causal, smoothed, findings)
