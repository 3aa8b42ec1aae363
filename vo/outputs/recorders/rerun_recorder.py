"""Records a run for the rerun viewer: to an `.rrd` file, to a running viewer, or both."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from vo.base.types import Estimate, Floats, Rig, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.entities import make_blueprint
from vo.outputs.recorders.loop_layer import LoopLayer, MarkerLayer
from vo.outputs.recorders.map_layer import MapLayer
from vo.outputs.recorders.plot_layer import (
    Counters,
    PlotLayer,
    aligned_at_pose,
    aligned_to_path,
    position_errors,
)
from vo.outputs.recorders.recorder import NO_FINDINGS, Findings, ImageChoice, TakeSnapshot
from vo.outputs.recorders.sink import Sink, open_file, open_viewer
from vo.outputs.recorders.timelines import Batch, RunIndex, Timelines, add_trajectory
from vo.outputs.recorders.view_layer import ViewLayer

_FRAMES_PER_BATCH = 25
_BATCH_S = 1.0  # a batch ends with whichever comes first
_LIVE_BATCH_S = 0.2


class RerunRecorder:
    """Writes a run to an `.rrd` file, a viewer or both.

    If the run is killed, the file is valid up to the last seconds. A full disk or a closed viewer
    ends the recording with a warning, not the run.

    `path`: the file to write, None for none; an existing one is replaced. `viewer`: URL of a
    running viewer, None for none.
    """

    def __init__(
        self, path: Path | None, *, images: ImageChoice = "half", viewer: str | None = None
    ) -> None:
        self._path = path
        self._images: ImageChoice = images
        self._viewer = viewer
        self._batch_s = _BATCH_S if viewer is None else _LIVE_BATCH_S
        self._sinks: list[Sink] = []
        self._truth: Trajectory | None = None

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Open the file and the viewer.

        Raises:
            OutputError: the file cannot be written, or no viewer answers.
        """
        self._truth = ground_truth if ground_truth is not None and len(ground_truth) else None
        self._has_scale = rig.is_metric
        self._truth_is_shown = False
        self._sinks = self._open(name, rig)
        self._batch = Batch(self._sinks, Timelines())
        self._index, self._counters = RunIndex(), Counters(name, rig)
        self._view = ViewLayer(self._batch, self._images, has_right=rig.is_stereo)
        self._map = MapLayer(self._batch)
        self._plots = PlotLayer(self._batch)
        for layer in (self._view, self._map, self._plots):
            layer.log_styles()
        self._log_summary(self._counters.initial_text())
        self._send()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Add a frame; rows are sent in batches."""
        if not self._sinks:
            return
        moment = self._index.add(estimate)
        self._counters.add(estimate)
        current = snapshot()
        self._view.add(moment, estimate, current.view)
        self._map.add(moment, estimate, current)
        self._plots.add(moment, estimate, current.view)
        self._show_truth_at_start(estimate)
        self._waiting += 1
        if self._waiting >= _FRAMES_PER_BATCH or time.monotonic() - self._sent >= self._batch_s:
            self._send()

    def flush(self) -> None:
        """Send the rows that wait."""
        if self._sinks and self._waiting:
            self._send()

    def finish(
        self, causal: Trajectory, smoothed: Trajectory, findings: Findings = NO_FINDINGS
    ) -> None:
        """Log both complete paths and the summary; close."""
        if not self._sinks:
            return
        if len(self._index):
            self._add_paths(causal, smoothed, findings)
        self._send()
        for sink in self._sinks:
            sink.close()
        self._sinks = []

    def _open(self, name: str, rig: Rig) -> list[Sink]:
        blueprint = make_blueprint(
            rig, has_truth=self._truth is not None, has_images=self._images != "none"
        )
        sinks = []
        if self._path is not None:
            sinks.append(open_file(self._path, name, blueprint))
        if self._viewer is not None:
            sinks.append(open_viewer(self._viewer, name, blueprint))
        return sinks

    def _send(self) -> None:
        self._batch.send()
        self._waiting, self._sent = 0, time.monotonic()

    def _show_truth_at_start(self, estimate: Estimate) -> None:
        """Align the ground truth at the first pose; in mono, the scale is still unknown."""
        pose = estimate.world_from_cam0
        if self._truth is None or self._truth_is_shown or pose is None or not self._has_scale:
            return
        positions = aligned_at_pose(self._truth, estimate.stamp_ns, pose)
        if positions is not None:
            self._truth_is_shown = True
            self._map.log_ground_truth(positions)

    def _add_paths(self, causal: Trajectory, smoothed: Trajectory, findings: Findings) -> None:
        closures, markers = findings.closures, findings.markers
        self._counters.scales = findings.scales
        add_trajectory(self._batch, entities.CAUSAL_POSES, causal, self._index)
        add_trajectory(self._batch, entities.SMOOTHED_POSES, smoothed, self._index)
        if closures is not None:
            odometry = self._index.by_segment(closures.odometry)
            LoopLayer(self._batch, self._index.by_frame).log(closures, smoothed, odometry)
        if markers is not None:
            MarkerLayer(self._batch, self._index.by_frame, self._view.scale).log(markers)
        pieces = self._index.by_segment(smoothed)
        connected = {} if closures is None else closures.worlds
        worlds = self._index.by_world(smoothed, connected)
        if pieces:
            self._map.finish(self._index.last, pieces)
            self._align_truth_to(max(worlds, key=len))
        errors = {
            name: self._add_errors(f"{entities.ERROR_PLOT}/{name}", parts)
            for name, parts in (("smoothed", worlds), ("causal", self._index.by_segment(causal)))
            if self._truth is not None
        }
        length = sum(np.linalg.norm(np.diff(p.positions, axis=0), axis=1).sum() for p in pieces)
        tracked = sum(self._index.moment(s) is not None for s in smoothed.stamps_ns.tolist())
        self._log_summary(self._counters.final_text(tracked, float(length), errors))

    def _align_truth_to(self, path: Trajectory) -> None:
        if self._truth is None:
            return
        during_ns = self._index.first.stamp_ns, self._index.last.stamp_ns
        positions = aligned_to_path(self._truth, path, during_ns, with_scale=not self._has_scale)
        if positions is not None:
            self._map.log_ground_truth(positions)

    def _add_errors(self, entity: str, parts: Sequence[Trajectory]) -> Floats:
        """Add the error of each pose, with each part of a path aligned separately; all errors."""
        assert self._truth is not None
        all_errors = []
        for part in parts:
            found = position_errors(self._truth, part, with_scale=not self._has_scale)
            if found is None:
                continue
            all_errors.append(found[1])
            for stamp_ns, error in zip(found[0].tolist(), found[1].tolist(), strict=True):
                moment = self._index.moment(stamp_ns)
                if moment is not None:
                    self._plots.add_number(moment, entity, error)
        return np.concatenate([np.empty(0), *all_errors])

    def _log_summary(self, text: str) -> None:
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._batch.log_static(entities.SUMMARY, document)
