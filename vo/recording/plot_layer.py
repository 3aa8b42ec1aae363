"""Time series of how tracking goes and how long it takes, and the log of what happened."""

from __future__ import annotations

import numpy as np
import rerun as rr

from vo.failures import describe
from vo.geometry.quantiles import percentiles
from vo.recording import entities
from vo.recording.tape import Tape
from vo.recording.timelines import Moment
from vo.types import Estimate, FeatureState, State, View

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

    def __init__(self, tape: Tape) -> None:
        self._tape = tape
        self._stages: list[str] = []
        self._state: State | None = None
        self._segment = 0

    def fix_styles(self) -> None:
        """Log names and colours of the series known beforehand."""
        for entity, (name, colour) in _SERIES.items():
            self._fix_style(entity, name, colour)
        crosses = rr.SeriesPoints(
            names="lost", colors=[entities.VERMILION], markers="cross", marker_sizes=5.0
        )
        self._tape.fix(_LOST, crosses)

    def add(self, moment: Moment, estimate: Estimate, view: View) -> None:
        """Note a frame's numbers, and what changed."""
        self.add_number(moment, f"{entities.TRACKING_PLOT}/matches", estimate.matches)
        self.add_number(moment, f"{entities.TRACKING_PLOT}/inliers", estimate.inliers)
        if estimate.state == State.LOST:
            self.add_number(moment, _LOST, 0.0)
        self._add_reprojection(moment, view)
        self._add_times(moment, estimate)
        self._add_events(moment, estimate)

    def add_number(self, moment: Moment, entity: str, number: float) -> None:
        """Note a point of a series."""
        self._tape.add(moment, entity, rr.Scalars, scalars=np.array([number], dtype=np.float64))

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
                self._fix_style(f"{entities.TIME_PLOT}/{stage}", stage, colour)
                self._stages.append(stage)
            self.add_number(moment, f"{entities.TIME_PLOT}/{stage}", milliseconds)

    def _add_events(self, moment: Moment, estimate: Estimate) -> None:
        """Note changes of state and segment, and keyframes."""
        before, self._state = self._state, estimate.state
        segment, self._segment = self._segment, estimate.segment
        if estimate.segment != segment:
            self._say(moment, "WARN", f"new segment {estimate.segment}")
        if estimate.state != before:
            level, what = _CHANGES[estimate.state]
            if before == State.LOST:
                what = "recovered" if estimate.state == State.TRACKING else what
            why = f": {describe(estimate.failure)}" if estimate.failure else ""
            self._say(moment, level, what + why)
        if estimate.is_keyframe:
            counts = f"{estimate.inliers} of {estimate.matches} matches agree"
            self._say(moment, "DEBUG", f"keyframe: {counts}")

    def _say(self, moment: Moment, level: str, text: str) -> None:
        self._tape.add(moment, entities.EVENTS, rr.TextLog, text=[text], level=[level])

    def _fix_style(self, entity: str, name: str, colour: entities.Colour) -> None:
        self._tape.fix(entity, rr.SeriesLines(names=name, colors=[colour], widths=1.5))
