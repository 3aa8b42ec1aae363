"""Summary of a run as text in its recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vo.base.geometry.quantiles import median
from vo.base.records.metric_scale import MetricScale
from vo.base.types import Estimate, Floats, Rig, State


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
        return f"**{self.name}**, {kind}, {self.rig.cam0.width} x {self.rig.cam0.height} px\n"


def _rms(errors: Floats) -> str:
    return f"{np.sqrt(np.mean(errors**2)):.3f} m" if len(errors) else "-"
