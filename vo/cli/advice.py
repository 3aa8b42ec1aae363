"""What a run's summary means in plain words, and what to try when it is not good."""

from __future__ import annotations

from typing import Literal, NamedTuple

from vo.results.summary import Summary
from vo.types import ImageDefect

Grade = Literal["good", "caution", "bad"]

_FEW_INLIERS = 50
_MOST_RANGES = 3
_MOSTLY = 0.5
_LONG_WITHOUT_MAP = 0.1  # of all frames
_CAUSES = {
    ImageDefect.BLACK: "exposure too short, lens cap on, lights off?",
    ImageDefect.WHITE: "exposure too long?",
    ImageDefect.ONE_GREY: "is the lens covered, or the camera out of focus?",
}


class Verdict(NamedTuple):
    """A run in one sentence."""

    grade: Grade
    sentence: str


def verdict(summary: Summary) -> Verdict:
    """How good a run was, the worst news first."""
    frames, tracked = summary.frames, summary.tracked
    if not tracked:
        return Verdict("bad", f"no path: none of the {frames} frames has a pose")
    whole = tracked + summary.interpolated >= frames
    have = f"all {frames} frames have a pose" if whole else f"{tracked} of {frames} frames do"
    segments = len(summary.segments)
    apart = f", in {segments} segments that are not connected" if segments > 1 else ""
    if summary.status != "finished":
        return Verdict("bad", f"{summary.status}: {have}{apart}")
    if not whole:
        share = tracked / frames
        have = f"{tracked} of {frames} frames have a pose ({share:.1%})"
        if share < _MOSTLY:
            return Verdict("bad", f"mostly lost: {have}{apart}")
        return Verdict("caution", f"with gaps: {have}{apart}")
    if segments > 1 or _is_poor(summary):
        return Verdict("caution", f"complete, but not to be trusted: {have}{apart}")
    if summary.warnings:
        return Verdict("good", f"complete, with notes: {have}")
    return Verdict("good", f"complete: {have}")


def advice(summary: Summary, *, is_recorded: bool = False) -> list[str]:
    """What can be done about what was wrong, most promising first; empty after a good run."""
    lines = []
    mono = summary.facts.mode == "mono"
    lights = dict.fromkeys(ImageDefect.of(r.reason) for r in summary.without_pose)
    lines += [
        f"images are {light.value}: {_CAUSES[light]} vo info --contact-sheet sheet.png shows them"
        for light in lights
        if light is not None
    ]
    if lines and not summary.tracked:
        return lines
    if not summary.tracked or summary.starting > _LONG_WITHOUT_MAP * summary.frames:
        if mono:
            lines.append(
                "one camera finds no depth while it stands still or only turns: begin where it "
                "moves sideways (--start N), or give it a second camera"
            )
        else:
            lines.append(
                "check the calibration: baseline, focal length, left and right not swapped"
            )
            lines.append("if all is too far away for the baseline, --mode mono does without it")
    if summary.lost:
        how = "vo view shows it" if is_recorded else "record with --rrd, then vo view"
        lines.append(f"look at what happened in {_ranges(summary)}: {how}")
        lines.append(
            "--config accurate, or --set features.count=3000; images that are blurred, dark or "
            "full of moving things cannot be tracked"
        )
    elif _is_poor(summary):
        lines.append("few landmarks agree: check the calibration, or try --config accurate")
    return lines


def _is_poor(summary: Summary) -> bool:
    return bool(summary.tracked) and (summary.median_inliers or 0.0) < _FEW_INLIERS


def _ranges(summary: Summary) -> str:
    """The frames that were lost, as people would say them."""
    lost = [r for r in summary.without_pose if r.state == "lost"]
    said = [
        str(r.first) if r.first == r.last else f"{r.first} to {r.last}" for r in lost[:_MOST_RANGES]
    ]
    more = ", …" if len(lost) > _MOST_RANGES else ""
    return f"frames {', '.join(said)}{more}" if said else "the frames that were lost"
