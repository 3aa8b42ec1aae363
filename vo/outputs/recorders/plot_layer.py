"""Time series of tracking, errors and wall time, and the log of events."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from vo.base.failures import describe
from vo.base.geometry.quantiles import median, percentiles
from vo.base.geometry.rig_overlap import is_rig
from vo.base.geometry.similarity import Similarity, umeyama
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.records.metric_scale import MetricScale
from vo.base.records.snapshot import FeatureState, View
from vo.base.types import Bools, Estimate, Floats, Ints, Rig, State, Trajectory
from vo.outputs.recorders import entities
from vo.outputs.recorders.timelines import Batch, Moment

_SERIES = {
    f"{entities.TRACKING_PLOT}/matches": ("matches", entities.SKY),
    f"{entities.TRACKING_PLOT}/inliers": ("inliers", entities.GREEN),
    f"{entities.REPROJECTION_PLOT}/median": ("median", entities.GREEN),
    f"{entities.REPROJECTION_PLOT}/p95": ("95 %", entities.SKY),
    f"{entities.TIME_PLOT}/total": ("total", entities.GREY),
    f"{entities.ERROR_PLOT}/causal": ("causal", entities.ORANGE),
    f"{entities.ERROR_PLOT}/smoothed": ("smoothed", entities.SKY),
}
_LOST = f"{entities.TRACKING_PLOT}/lost"
_CHANGES = {
    State.STARTING: ("INFO", "starting"),
    State.TRACKING: ("INFO", "tracking"),
    State.LOST: ("WARN", "lost"),
}


class PlotLayer:
    """Logs numbers and events of each frame."""

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._stages: list[str] = []
        self._state: State | None = None
        self._segment = 0

    def log_styles(self) -> None:
        """Log names and colours of the series, except for the stages, which are not known yet."""
        for entity, (name, colour) in _SERIES.items():
            self._log_style(entity, name, colour)
        crosses = rr.SeriesPoints(
            names="lost", colors=[entities.VERMILION], markers="cross", marker_sizes=5.0
        )
        self._batch.log_static(_LOST, crosses)

    def add(self, moment: Moment, estimate: Estimate, view: View) -> None:
        """Add the numbers and events of a frame."""
        self.add_number(moment, f"{entities.TRACKING_PLOT}/matches", estimate.matches)
        self.add_number(moment, f"{entities.TRACKING_PLOT}/inliers", estimate.inliers)
        if estimate.state == State.LOST:
            self.add_number(moment, _LOST, 0.0)
        self._add_reprojection(moment, view)
        self._add_times(moment, estimate)
        self._add_events(moment, estimate)

    def add_number(self, moment: Moment, entity: str, number: float) -> None:
        """Add a point of a series."""
        self._batch.add(moment, entity, rr.Scalars, scalars=np.array([number], dtype=np.float64))

    def _add_reprojection(self, moment: Moment, view: View) -> None:
        if view.error_px is None:
            return
        error_px = view.error_px[view.feature_state == FeatureState.TRACKED]
        error_px = error_px[~np.isnan(error_px)]
        if len(error_px):
            median, p95 = percentiles(error_px, (50, 95))
            self.add_number(moment, f"{entities.REPROJECTION_PLOT}/median", median)
            self.add_number(moment, f"{entities.REPROJECTION_PLOT}/p95", p95)

    def _add_times(self, moment: Moment, estimate: Estimate) -> None:
        total = sum(estimate.stage_ms.values())
        self.add_number(moment, f"{entities.TIME_PLOT}/total", total)
        for stage, milliseconds in estimate.stage_ms.items():
            if stage not in self._stages:
                colours = entities.STAGE_COLOURS
                colour = colours[len(self._stages) % len(colours)]
                self._log_style(f"{entities.TIME_PLOT}/{stage}", stage, colour)
                self._stages.append(stage)
            self.add_number(moment, f"{entities.TIME_PLOT}/{stage}", milliseconds)

    def _add_events(self, moment: Moment, estimate: Estimate) -> None:
        """Add changes of state and segment, and keyframes."""
        before, self._state = self._state, estimate.state
        segment, self._segment = self._segment, estimate.segment
        if estimate.segment != segment:
            self._add_event(moment, "WARN", f"new segment {estimate.segment}")
        if estimate.state != before:
            level, event = _CHANGES[estimate.state]
            if before == State.LOST:
                event = "recovered" if estimate.state == State.TRACKING else event
            reason = f": {describe(estimate.failure)}" if estimate.failure else ""
            self._add_event(moment, level, event + reason)
        if estimate.is_keyframe:
            counts = f"{estimate.inliers} of {estimate.matches} matches agree"
            self._add_event(moment, "DEBUG", f"keyframe: {counts}")

    def _add_event(self, moment: Moment, level: str, text: str) -> None:
        self._batch.add(moment, entities.EVENTS, rr.TextLog, text=[text], level=[level])

    def _log_style(self, entity: str, name: str, colour: entities.Colour) -> None:
        self._batch.log_static(entity, rr.SeriesLines(names=name, colors=[colour], widths=1.5))


@dataclass
class Counters:
    """Counts frames while they are recorded, and describes the run in Markdown."""

    name: str
    rig: Rig
    states: dict[State, int] = field(default_factory=lambda: dict.fromkeys(State, 0))
    keyframes: set[int] = field(default_factory=set)
    segments: set[int] = field(default_factory=set)
    inliers: list[int] = field(default_factory=list)
    offset_px: float = 0.0
    scales: Mapping[int, MetricScale] = field(default_factory=dict)

    def add(self, estimate: Estimate) -> None:
        """Add a frame."""
        self.states[estimate.state] += 1
        self.keyframes |= {keyframe.frame_index for keyframe in estimate.keyframes}
        self.offset_px = estimate.disparity_offset_px
        if estimate.world_from_cam0 is not None:
            self.segments.add(estimate.segment)
            self.inliers.append(estimate.inliers)

    def initial_text(self) -> str:
        """Text before the first frame; it remains if the run is killed."""
        return f"{self._title()}\nThe run has not finished yet.\n"

    def final_text(self, tracked: int, path_length: float, errors: Mapping[str, Floats]) -> str:
        """Text at the end of the run.

        `tracked`: number of frames with a smoothed pose. `errors`: position errors of each path
        against the ground truth, where known.
        """
        frames = sum(self.states.values())
        unit = "m" if self.rig.is_metric else "map units"
        rows = {
            "frames": str(frames),
            "tracked": f"{tracked} ({tracked / max(frames, 1):.0%})",
            "lost": str(self.states[State.LOST]),
            "without a map": str(max(frames - tracked - self.states[State.LOST], 0)),
            "segments": str(len(self.segments)),
            "keyframes": str(len(self.keyframes)),
            "path": f"{path_length:.2f} {unit}",
            "inliers, median": f"{median(self.inliers):.0f}" if self.inliers else "-",
        }
        values = {scale.value for scale in self.scales.values()}
        if len(values) == 1 and len(self.scales) == len(self.segments):
            rows["path"] += f" = {path_length * min(values):.2f} m"
        for segment, scale in self.scales.items():
            text = f"{scale.value:.4g} m ± {scale.relative_sigma:.2%} ({scale.source})"
            rows[f"map unit of segment {segment}"] = text
        if self.rig.is_stereo:
            rows["disparity offset"] = f"{self.offset_px:+.2f} px"
        rows |= {f"ATE, {path}": _rms(values) for path, values in errors.items()}
        lines = "".join(f"- {name}: **{value}**\n" for name, value in rows.items())
        return f"{self._title()}\n{lines}"

    def _title(self) -> str:
        kind = "rgbd" if self.rig.has_depth else "stereo" if self.rig.is_stereo else "mono"
        kind = f"{len(self.rig.cameras)} cameras" if is_rig(self.rig) else kind
        return f"**{self.name}**, {kind}, {self.rig.cam0.width} x {self.rig.cam0.height} px\n"


def _rms(errors: Floats) -> str:
    return f"{np.sqrt(np.mean(errors**2)):.3f} m" if len(errors) else "-"


def aligned_at_pose(truth: Trajectory, stamp_ns: int, world_from_cam0: Floats) -> Floats | None:
    """True positions (N, 3), moved such that the true pose at `stamp_ns` is `world_from_cam0`.

    None if the ground truth does not cover that time.
    """
    if not _covers(truth, np.array([stamp_ns]))[0]:
        return None
    nearest = int(np.argmin(np.abs(truth.stamps_ns - stamp_ns)))
    world_from_truth = world_from_cam0 @ inverse(truth.world_from_cam[nearest])
    return transform_points(world_from_truth, truth.positions)


def aligned_to_path(
    truth: Trajectory, path: Trajectory, during_ns: tuple[int, int], *, with_scale: bool
) -> Floats | None:
    """True positions (N, 3) between two times, aligned with a path by least squares.

    None if the alignment is not determined.
    """
    stamps, true = _positions_at(truth, path.stamps_ns)
    similarity = _fit(true, path.positions[np.isin(path.stamps_ns, stamps)], with_scale)
    if similarity is None:
        return None
    first, last = during_ns
    shown = (truth.stamps_ns >= first) & (truth.stamps_ns <= last)
    return similarity.transform_points(truth.positions[shown])


def position_errors(
    truth: Trajectory, path: Trajectory, *, with_scale: bool
) -> tuple[Ints, Floats] | None:
    """Stamps (n,) and position errors (n,) of a path aligned with the ground truth.

    In metres, also if the path has arbitrary scale; None if the alignment is not determined.
    """
    stamps, true = _positions_at(truth, path.stamps_ns)
    found = path.positions[np.isin(path.stamps_ns, stamps)]
    similarity = _fit(found, true, with_scale)
    if similarity is None:
        return None
    return stamps, np.linalg.norm(similarity.transform_points(found) - true, axis=1)


def _fit(source: Floats, target: Floats, with_scale: bool) -> Similarity | None:
    try:
        return umeyama(source, target, with_scale=with_scale)
    except ValueError:
        return None


def _positions_at(truth: Trajectory, stamps_ns: Ints) -> tuple[Ints, Floats]:
    """The stamps (n,) that the ground truth covers, and true positions (n, 3) at them."""
    stamps = stamps_ns[_covers(truth, stamps_ns)]
    # Relative times: float64 is not exact for nanoseconds since the epoch.
    times, known = stamps - truth.stamps_ns[0], truth.stamps_ns - truth.stamps_ns[0]
    true = [np.interp(times, known, axis) for axis in truth.positions.T]
    return stamps, np.stack(true, axis=1)


def _covers(truth: Trajectory, stamps_ns: Ints) -> Bools:
    """Stamps within the ground truth, or at most half its step outside."""
    step = int(np.median(np.diff(truth.stamps_ns))) // 2 if len(truth) > 1 else 0
    first, last = truth.stamps_ns[0] - step, truth.stamps_ns[-1] + step
    return np.asarray((stamps_ns >= first) & (stamps_ns <= last))
