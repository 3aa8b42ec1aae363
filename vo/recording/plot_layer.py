"""Time series of how tracking goes and how long it takes, and the log of what happened."""

from __future__ import annotations

import rerun as rr

from vo.recording import entities
from vo.types import Estimate, State

_LEVELS = {
    State.STARTING: rr.TextLogLevel.INFO,
    State.TRACKING: rr.TextLogLevel.INFO,
    State.LOST: rr.TextLogLevel.WARN,
}


class PlotLayer:
    """Logs numbers and events of each frame."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._stages: list[str] = []
        self._told: tuple[State, str, int] | None = None

    def log_styles(self) -> None:
        """Log names and colours of the series known beforehand."""
        for name, colour in (("matches", entities.SKY), ("inliers", entities.GREEN)):
            self._log_style(f"{entities.TRACKING_PLOT}/{name}", name, colour)
        self._log_style(f"{entities.TIME_PLOT}/total", "total", entities.GREY)

    def log(self, estimate: Estimate) -> None:
        """Log a frame's numbers, and what changed."""
        self._log_number(f"{entities.TRACKING_PLOT}/matches", estimate.matches)
        self._log_number(f"{entities.TRACKING_PLOT}/inliers", estimate.inliers)
        self._log_number(f"{entities.TIME_PLOT}/total", sum(estimate.stage_ms.values()))
        for stage, milliseconds in estimate.stage_ms.items():
            if stage not in self._stages:
                self._add_stage(stage)
            self._log_number(f"{entities.TIME_PLOT}/{stage}", milliseconds)
        self._log_change(estimate)

    def _add_stage(self, stage: str) -> None:
        colours = entities.STAGE_COLOURS
        colour = colours[len(self._stages) % len(colours)]
        self._log_style(f"{entities.TIME_PLOT}/{stage}", stage, colour)
        self._stages.append(stage)

    def _log_change(self, estimate: Estimate) -> None:
        """Log the state when it, its reason or the segment changes."""
        now = (estimate.state, estimate.reason, estimate.segment)
        if now == self._told:
            return
        self._told = now
        text = f"{estimate.state}, segment {estimate.segment}"
        if estimate.reason:
            text += f": {estimate.reason}"
        self._stream.log(entities.EVENTS, rr.TextLog(text, level=_LEVELS[estimate.state]))

    def _log_number(self, entity: str, number: float) -> None:
        self._stream.log(entity, rr.Scalars(number))

    def _log_style(self, entity: str, name: str, colour: entities.Colour) -> None:
        style = rr.SeriesLines(names=name, colors=[colour], widths=1.5)
        self._stream.log(entity, style, static=True)
