"""Verdict on a run: how complete its path is, and whether it can be trusted."""

from __future__ import annotations

from typing import Literal, NamedTuple

Grade = Literal["good", "caution", "bad"]

MIN_INLIERS = 50  # a smaller median is poor tracking
_MIN_TRACKED = 0.5  # of all frames
# Corrected bias of disparities from which a path is doubted: well calibrated recordings get none,
# and frames before the correction keep some of the error.
_MAX_OFFSET_PX = 0.2


class VerdictFacts(NamedTuple):
    """What a verdict depends on."""

    status: str  # how the run ended: `finished`, `interrupted` or `failed`
    frames: int  # number of frames
    posed: int  # number of frames with a pose
    segments: int  # number of connected parts of the path
    median_inliers: float | None  # over the tracked frames, None without one
    has_open_fault: bool  # whether a fault was found that was not handled
    disparity_offset_px: float  # bias of disparities that was corrected
    has_warnings: bool  # whether there are warnings


class Verdict(NamedTuple):
    """Quality of a run."""

    grade: Grade
    word: str
    is_trusted: bool  # whether the poses that there are can be relied on


def assess(facts: VerdictFacts) -> Verdict:
    """Assess a run by its worst problem: a path that may be wrong is never called complete."""
    if not facts.posed:
        return Verdict("bad", "no path", is_trusted=False)
    is_poor = (facts.median_inliers or 0.0) < MIN_INLIERS
    is_doubted = facts.has_open_fault or abs(facts.disparity_offset_px) >= _MAX_OFFSET_PX
    is_trusted = not (is_doubted or is_poor or facts.status == "failed")
    doubt = ", not to be trusted" if is_doubted else ", unreliable" if is_poor else ""
    if facts.status != "finished":
        return Verdict("bad", facts.status + doubt, is_trusted)
    if is_doubted:
        return Verdict("bad", "not to be trusted", is_trusted)
    if facts.posed < _MIN_TRACKED * facts.frames:
        return Verdict("bad", "mostly lost" + doubt, is_trusted)
    if facts.posed < facts.frames:
        return Verdict("caution", "with gaps" + doubt, is_trusted)
    if is_poor:
        return Verdict("caution", "unreliable", is_trusted)
    if facts.segments > 1:
        return Verdict("caution", "in separate segments", is_trusted)
    if facts.has_warnings:
        return Verdict("caution", "complete, with warnings", is_trusted)
    return Verdict("good", "complete", is_trusted)
