"""Time series of tracking, errors and wall time, and the log of events."""

from __future__ import annotations

import numpy as np
import rerun as rr

from vo.base.failures import describe
from vo.base.geometry.quantiles import percentiles
from vo.base.types import Estimate, FeatureState, State, View
from vo.outputs.recorders import entities
from vo.outputs.recorders.batch import Batch
from vo.outputs.recorders.timelines import Moment

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
