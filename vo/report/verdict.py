"""How good a run was, in plain words and a few numbers."""

from __future__ import annotations

from typing import Literal, NamedTuple

from vo.evaluation.report import Evaluation
from vo.report.entry import Entry
from vo.report.quantities import duration, length, number, share

Grade = Literal["good", "caution", "bad"]

_ALIGNED = {
    "none": "not aligned",
    "se3": "aligned by rotation and translation",
    "sim3": "aligned by rotation, translation and scale",
    "scale": "aligned by scale",
}
_KITTI_M = 100.0
_MOSTLY = 0.5


class Figure(NamedTuple):
    """A number that sums a run up: its name, the value with its unit, and what it means."""

    name: str
    value: str
    meaning: str


class Verdict(NamedTuple):
    """What to say first of a run."""

    grade: Grade
    word: str
    sentences: tuple[str, ...]


def verdict(entry: Entry) -> Verdict:
    """A run in a few sentences, the worst news first."""
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    sentences = [_coverage(entry)]
    if entry.evaluation is not None:
        sentences.append(_accuracy(entry.evaluation, is_whole=len(summary["segments"]) < 2))
    elif tracked:
        sentences.append("There is no truth to compare with: nothing here says how exact it is.")
    if not tracked:
        return Verdict("bad", "no path", tuple(sentences))
    if summary["status"] != "finished":
        return Verdict("bad", str(summary["status"]), tuple(sentences))
    if tracked < _MOSTLY * frames:
        return Verdict("bad", "mostly lost", tuple(sentences))
    if tracked < frames:
        return Verdict("caution", "with gaps", tuple(sentences))
    if summary["warnings"]:
        return Verdict("caution", "complete, with warnings", tuple(sentences))
    return Verdict("good", "complete", tuple(sentences))


def _coverage(entry: Entry) -> str:
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    if not tracked:
        return f"None of the {frames} frames has a pose."
    what = "All" if tracked == frames else f"{tracked} of"
    text = f"{what} {frames} frames have a pose"
    if tracked < frames:
        text += f" ({share(tracked, frames)})"
    segments = len(summary["segments"])
    if segments > 1:
        text += f", in {segments} segments that are not connected"
    return f"{text}, over a path of {length(summary['path_m'], entry.run.unit)}."


def _accuracy(evaluation: Evaluation, *, is_whole: bool) -> str:
    ate = evaluation.ate.translation
    what = "The path" if is_whole else f"The longest segment ({len(evaluation.matched)} poses)"
    text = f"{what} is {length(ate.rmse)} off the truth (root mean square"
    text += f", {_ALIGNED[evaluation.alignment.kind]})"
    if evaluation.path_m > 0.0:
        text += f", {number(100.0 * ate.rmse / evaluation.path_m, 2)} % of its length"
    text += f", and {length(ate.max)} at worst"
    segments = evaluation.segments
    if segments is None:
        return f"{text}."
    lengths = [each.length_m for each in segments.lengths]
    span = f"{lengths[0]:g} m" if len(lengths) == 1 else f"{lengths[0]:g} to {lengths[-1]:g} m"
    return (
        f"{text}; it drifts by {number(segments.translation_percent)} % over stretches of {span}."
    )


def figures(entry: Entry) -> list[Figure]:
    """The numbers that sum a run up, also those of the table that compares runs."""
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    span_s = _span_s(entry)
    return [
        Figure("frames with a pose", share(tracked, frames), f"{tracked} of {frames}"),
        *_judged_figures(entry, is_whole=len(summary["segments"]) < 2),
        Figure(
            "path",
            length(summary["path_m"], entry.run.unit),
            "in map units: one camera cannot know the scale"
            if entry.run.unit != "m"
            else f"in {duration(span_s)}"
            if span_s
            else "",
        ),
        Figure(
            "frames per second",
            number(summary["frames_per_s"]),
            f"{duration(summary['wall_s'])} for {frames} frames",
        ),
        Figure("keyframes", str(summary["keyframes"]), f"{summary['landmarks']} landmarks"),
        Figure("inliers", _or_dash(summary["median_inliers"]), "median over frames with a pose"),
        Figure("memory", f"{summary['peak_rss_mb']:.0f} MB", "at most, without the smoother"),
    ]


def _judged_figures(entry: Entry, *, is_whole: bool) -> list[Figure]:
    evaluation = entry.evaluation
    if evaluation is None:
        return []
    ate, frames, segments = evaluation.ate, evaluation.rpe_frames, evaluation.segments
    meaning = f"rmse, {evaluation.alignment.kind}" + ("" if is_whole else ", longest segment")
    found = [Figure("ATE", length(ate.translation.rmse), meaning)]
    if entry.causal_ate_m is not None:
        found.append(Figure("ATE, causal", length(entry.causal_ate_m), "as known at the time"))
    if segments is not None:
        is_kitti = segments.lengths[0].length_m >= _KITTI_M
        drift = number(100.0 * segments.rotation_deg_per_m)
        found.append(
            Figure(
                "drift",
                f"{number(segments.translation_percent)} %",
                f"t_rel{' as on KITTI' if is_kitti else ''}, and {drift} ° per 100 m",
            )
        )
    if frames is not None:
        found.append(
            Figure(
                "RPE",
                length(frames.translation.rmse),
                f"from pose to pose, and {number(frames.rotation.rmse)} °",
            )
        )
    scale = evaluation.alignment.scale_error_percent
    if scale is not None:
        found.append(Figure("scale error", f"{number(scale, 2)} %", "longer is positive"))
    return found


def _span_s(entry: Entry) -> float:
    stamps = entry.run.trajectory.stamps_ns
    return float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) > 1 else 0.0


def _or_dash(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"
