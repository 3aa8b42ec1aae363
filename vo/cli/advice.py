"""The verdict on a run as a sentence, and advice for runs with problems."""

from __future__ import annotations

from vo.base.failures import Failure, FailureReason, ImageDefect
from vo.outputs.results.summary import Summary
from vo.outputs.results.verdict import MIN_INLIERS

_MAX_RANGES = 3
_MAX_STARTING = 0.1  # of all frames
_CAUSES = {
    ImageDefect.BLACK: "exposure too short, lens cap on, lights off?",
    ImageDefect.WHITE: "exposure too long?",
    ImageDefect.ONE_GREY: "is the lens covered, or the camera out of focus?",
    ImageDefect.CUT: "a damaged stream: check cable, network or file",
    ImageDefect.SMALL: "record larger ones, at least 320x240",
    ImageDefect.DARK: "more light, or longer exposure?",
    ImageDefect.LOW_CONTRAST: "fog, a dirty lens, or wrong exposure?",
    ImageDefect.INTERLACED: "deinterlace the video first, or keep every second row",
    ImageDefect.NOISY: "more light, or lower gain?",
    ImageDefect.BLURRED: "focus, shorter exposure, or slower motion?",
}
_NEEDS_TRANSLATION = frozenset(
    {
        FailureReason.PURE_ROTATION,
        FailureReason.LITTLE_PARALLAX,
        FailureReason.AMBIGUOUS_PLANE,
        FailureReason.OTHER_ROTATION,
        FailureReason.FEW_GOOD_POINTS,
    }
)


def verdict_sentence(summary: Summary) -> str:
    """The verdict on a run, with the number of frames that it is about."""
    frames, tracked = summary.frames, summary.tracked
    word = summary.verdict.word
    if not tracked:
        what = (
            "the only frame has no pose"
            if frames == 1
            else f"none of the {frames} frames has a pose"
        )
        return f"{word}: {what}"
    segments = len(summary.segments)
    apart = f", in {segments} segments that are not connected" if segments > 1 else ""
    if tracked + summary.interpolated >= frames:
        what = "the only frame has a pose" if frames == 1 else f"all {frames} frames have a pose"
        return f"{word}: {what}{apart}"
    return f"{word}: {tracked} of {frames} frames have a pose ({tracked / frames:.1%}){apart}"


def advice(summary: Summary, *, is_recorded: bool = False) -> list[str]:
    """Advice for the problems of a run, most promising first; empty after a good run."""
    lines = []
    mono = summary.facts.mode == "mono"
    defects = dict.fromkeys(r.defect for r in summary.without_pose)
    lines += [
        f"images are {defect.value}: {_CAUSES[defect]} (see vo info --picture sheet.png)"
        for defect in defects
        if defect is not None
    ]
    if lines and not summary.tracked:
        return lines
    if not summary.tracked or summary.starting > _MAX_STARTING * summary.frames:
        if mono:
            lines += _monocular_start_advice(summary.main_failure)
        else:
            lines.append(
                "check the calibration (baseline, focal length), and that left and right are not "
                "swapped"
            )
            lines.append("if the scene is too far away for the baseline, use --mode mono")
    if summary.lost:
        how = "use vo view" if is_recorded else "record with --rrd, then use vo view"
        lines.append(f"to inspect {_lost_ranges(summary)}, {how}")
        lines.append(
            "use --config accurate, or --set features.count=3000; blurred or dark images, or those "
            "filled by moving objects, cannot be tracked"
        )
    elif _is_poor(summary):
        lines.append("few inlier landmarks: check the calibration, or use --config accurate")
    return lines


def _monocular_start_advice(failure: Failure | None) -> list[str]:
    """Advice for the most frequent failure of a single camera without a map."""
    if failure is None:
        return []
    if failure.reason is FailureReason.LITTLE_MOTION:
        return ["start where the camera begins to move (--start N), or leave frames out (--stride)"]
    if failure.reason in _NEEDS_TRANSLATION:
        return [
            "a single camera needs translation to initialise the map: start where it moves "
            "sideways (--start N), or use two cameras"
        ]
    if failure.reason is FailureReason.FEW_FEATURES:
        return ["look at the images (vo info --picture sheet.png); textured scenes are needed"]
    if failure.defect is not None:
        return []
    return [
        "successive images have little in common: check their order and rate (vo info), and that "
        "no rain, snow or moving object fills them"
    ]


def _is_poor(summary: Summary) -> bool:
    return bool(summary.tracked) and (summary.median_inliers or 0.0) < MIN_INLIERS


def _lost_ranges(summary: Summary) -> str:
    """The lost frames in words."""
    lost = [r for r in summary.without_pose if r.state == "lost"]
    texts = [
        str(r.first) if r.first == r.last else f"{r.first} to {r.last}" for r in lost[:_MAX_RANGES]
    ]
    more = ", …" if len(lost) > _MAX_RANGES else ""
    return f"frames {', '.join(texts)}{more}" if texts else "the lost frames"
