"""Records a run for the rerun viewer: as an `.rrd` file, live in a viewer, or both."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import rerun as rr

from vo.recording import entities
from vo.recording.blueprint import make_blueprint
from vo.recording.map_layer import MapLayer
from vo.recording.outlet import Outlet, open_file, open_viewer
from vo.recording.plot_layer import PlotLayer
from vo.recording.recorder import ImageChoice, TakeSnapshot
from vo.recording.tally import Tally
from vo.recording.tape import Tape
from vo.recording.timelines import Timelines
from vo.recording.trajectories import RunIndex, add_trajectory
from vo.recording.truth import errors_along, laid_onto_path, laid_onto_pose
from vo.recording.view_layer import ViewLayer
from vo.types import Estimate, Floats, Rig, Trajectory

_FRAMES_PER_BATCH = 25
_BATCH_S = 5.0  # whichever comes first
_LIVE_BATCH_S = 0.2


class RerunRecorder:
    """Writes a run to an `.rrd` file, a viewer or both as it goes on.

    The file opens up to the last seconds also when the run is killed. A disk that fills up or a
    viewer that is closed ends the recording with a warning, never the run.

    Args:
        path: the file to write, if any; one that exists is replaced.
        images: size at which images are recorded.
        viewer: URL of a viewer that is running, if any.
    """

    def __init__(
        self, path: Path | None, *, images: ImageChoice = "half", viewer: str | None = None
    ) -> None:
        self._path = path
        self._images: ImageChoice = images
        self._viewer = viewer
        self._batch_s = _BATCH_S if viewer is None else _LIVE_BATCH_S
        self._outlets: list[Outlet] = []
        self._truth: Trajectory | None = None

    def begin(self, name: str, rig: Rig, ground_truth: Trajectory | None) -> None:
        """Open the file and the viewer.

        Raises:
            OutputError: the file cannot be written, or no viewer answers.
        """
        self._truth = ground_truth if ground_truth is not None and len(ground_truth) else None
        self._has_scale = rig.is_metric
        self._truth_shown = False
        self._outlets = self._open(name, rig)
        self._tape = Tape(self._outlets, Timelines())
        self._index, self._tally = RunIndex(), Tally(name, rig)
        self._view = ViewLayer(self._tape, self._images, has_right=rig.is_stereo)
        self._map = MapLayer(self._tape)
        self._plots = PlotLayer(self._tape)
        for layer in (self._view, self._map, self._plots):
            layer.fix_styles()
        self._fix_summary(self._tally.beginning())
        self._send()

    def record(self, estimate: Estimate, snapshot: TakeSnapshot) -> None:
        """Note one frame, and send what there is from time to time."""
        if not self._outlets:
            return
        moment = self._index.add(estimate)
        self._tally.add(estimate)
        shown = snapshot()
        self._view.add(moment, estimate, shown.view)
        self._map.add(moment, estimate, shown)
        self._plots.add(moment, estimate, shown.view)
        self._show_truth_at_start(estimate)
        self._waiting += 1
        if self._waiting >= _FRAMES_PER_BATCH or time.monotonic() - self._sent >= self._batch_s:
            self._send()

    def finish(self, causal: Trajectory, smoothed: Trajectory) -> None:
        """Log both whole paths and what became of the run; close."""
        if not self._outlets:
            return
        if len(self._index):
            self._add_paths(causal, smoothed)
        self._send()
        for outlet in self._outlets:
            outlet.close()
        self._outlets = []

    def _open(self, name: str, rig: Rig) -> list[Outlet]:
        blueprint = make_blueprint(
            rig, has_truth=self._truth is not None, has_images=self._images != "none"
        )
        outlets = []
        if self._path is not None:
            outlets.append(open_file(self._path, name, blueprint))
        if self._viewer is not None:
            outlets.append(open_viewer(self._viewer, name, blueprint))
        return outlets

    def _send(self) -> None:
        self._tape.send()
        self._waiting, self._sent = 0, time.monotonic()

    def _show_truth_at_start(self, estimate: Estimate) -> None:
        """Lay the truth onto the first pose; a mono path has no scale yet to lay it onto."""
        pose = estimate.world_from_cam0
        if self._truth is None or self._truth_shown or pose is None or not self._has_scale:
            return
        positions = laid_onto_pose(self._truth, estimate.stamp_ns, pose)
        if positions is not None:
            self._truth_shown = True
            self._map.fix_truth(positions)

    def _add_paths(self, causal: Trajectory, smoothed: Trajectory) -> None:
        add_trajectory(self._tape, entities.CAUSAL_POSES, causal, self._index)
        add_trajectory(self._tape, entities.SMOOTHED_POSES, smoothed, self._index)
        pieces = self._index.by_segment(smoothed)
        if pieces:
            self._map.finish(self._index.last, pieces)
            self._lay_truth_onto(max(pieces, key=len))
        errors = {
            name: self._add_errors(f"{entities.ERROR_PLOT}/{name}", path)
            for name, path in (("smoothed", smoothed), ("causal", causal))
            if self._truth is not None
        }
        length = sum(np.linalg.norm(np.diff(p.positions, axis=0), axis=1).sum() for p in pieces)
        tracked = sum(self._index.moment(s) is not None for s in smoothed.stamps_ns.tolist())
        self._fix_summary(self._tally.ending(tracked, float(length), errors))

    def _lay_truth_onto(self, path: Trajectory) -> None:
        if self._truth is None:
            return
        during_ns = self._index.first.stamp_ns, self._index.last.stamp_ns
        positions = laid_onto_path(self._truth, path, during_ns, with_scale=not self._has_scale)
        if positions is not None:
            self._map.fix_truth(positions)

    def _add_errors(self, entity: str, path: Trajectory) -> Floats:
        """Note the error of each pose, every segment laid onto the truth by itself; gives all."""
        assert self._truth is not None
        every = []
        for piece in self._index.by_segment(path):
            found = errors_along(self._truth, piece, with_scale=not self._has_scale)
            if found is None:
                continue
            every.append(found[1])
            for stamp_ns, error in zip(found[0].tolist(), found[1].tolist(), strict=True):
                moment = self._index.moment(stamp_ns)
                if moment is not None:
                    self._plots.add_number(moment, entity, error)
        return np.concatenate([np.empty(0), *every])

    def _fix_summary(self, text: str) -> None:
        document = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        self._tape.fix(entities.SUMMARY, document)
