"""Quality of a run in a few sentences and key figures."""

from __future__ import annotations

from typing import NamedTuple

from vo.base.printable import counted
from vo.outputs.evaluation.evaluation import Evaluation
from vo.outputs.report.entry import Entry
from vo.outputs.report.markup import duration, length, number, percentage
from vo.outputs.results.verdict import Grade, VerdictFacts, assess

_ALIGNED = {
    "none": "not aligned",
    "se3": "aligned by rotation and translation",
    "sim3": "aligned by rotation, translation and scale",
    "scale": "aligned by scale",
}
_KITTI_M = 100.0


class KeyFigure(NamedTuple):
    """A number that describes a run: name, value with unit, and meaning."""

    name: str
    value: str
    meaning: str


class Assessment(NamedTuple):
    """The verdict on a run, explained."""

    grade: Grade
    word: str
    sentences: tuple[str, ...]


def verdict(entry: Entry) -> Assessment:
    """Assess a run by its coverage, end and warnings."""
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    sentences = [_coverage(entry)]
    if entry.evaluation is not None:
        sentences.append(_accuracy(entry.evaluation, is_whole=len(summary["segments"]) < 2))
    elif tracked:
        sentences.append("There is no ground truth: the accuracy of the path is unknown.")
    assessed = assess(
        VerdictFacts(
            summary["status"],
            frames,
            tracked + summary.get("interpolated", 0),
            len(summary["segments"]),
            summary["median_inliers"],
            has_open_fault=not all(each["is_handled"] for each in summary["faults"]),
            disparity_offset_px=float(summary.get("disparity_offset_px") or 0.0),
            has_warnings=bool(summary["warnings"]),
        )
    )
    return Assessment(assessed.grade, assessed.word, tuple(sentences))


def _coverage(entry: Entry) -> str:
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    if not tracked:
        return f"None of the {frames} frames has a pose."
    what = "All" if tracked == frames else f"{tracked} of"
    text = f"{what} {frames} frames have a pose"
    if tracked < frames:
        text += f" ({percentage(tracked, frames)})"
    segments = len(summary["segments"])
    if segments > 1:
        text += f", in {segments} segments that are not connected"
    return f"{text}, over a path of {length(summary['path_m'], entry.run.unit)}."


def _accuracy(evaluation: Evaluation, *, is_whole: bool) -> str:
    ate = evaluation.ate.translation
    what = "The path" if is_whole else f"The longest segment ({len(evaluation.matched)} poses)"
    text = f"{what} is {length(ate.rmse)} away from the ground truth (root mean square"
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
        f"{text}; it drifts by {number(segments.translation_percent)} % over sub-paths of {span}."
    )


def key_figures(entry: Entry) -> list[KeyFigure]:
    """Key figures of a run, also used in the comparison of runs."""
    summary = entry.run.summary
    frames, tracked = summary["frames"], summary["tracked"]
    span_s = _span_s(entry)
    return [
        KeyFigure("frames with a pose", percentage(tracked, frames), f"{tracked} of {frames}"),
        *_evaluation_figures(entry, is_whole=len(summary["segments"]) < 2),
        KeyFigure(
            "path",
            length(summary["path_m"], entry.run.unit),
            "in map units: the scale of a single camera is unknown"
            if entry.run.unit != "m"
            else f"in {duration(span_s)}"
            if span_s
            else "",
        ),
        KeyFigure(
            "frames per second",
            number(summary["frames_per_s"]),
            f"{duration(summary['wall_s'])} for {counted(frames, 'frame')}",
        ),
        KeyFigure(
            "keyframes", str(summary["keyframes"]), counted(summary["landmarks"], "landmark")
        ),
        KeyFigure("inliers", _or_dash(summary["median_inliers"]), "median over frames with a pose"),
        KeyFigure(
            "memory",
            f"{summary['peak_rss_mb']:.0f} MB",
            "peak, without the process of the optimizer",
        ),
    ]


def _evaluation_figures(entry: Entry, *, is_whole: bool) -> list[KeyFigure]:
    evaluation = entry.evaluation
    if evaluation is None:
        return []
    ate, frames, segments = evaluation.ate, evaluation.rpe_frames, evaluation.segments
    meaning = f"rmse, {evaluation.alignment.kind}" + ("" if is_whole else ", longest segment")
    found = [KeyFigure("ATE", length(ate.translation.rmse), meaning)]
    if entry.causal_ate_m is not None:
        found.append(KeyFigure("ATE, causal", length(entry.causal_ate_m), "as known at that time"))
    if segments is not None:
        is_kitti = segments.lengths[0].length_m >= _KITTI_M
        drift = number(100.0 * segments.rotation_deg_per_m)
        found.append(
            KeyFigure(
                "drift",
                f"{number(segments.translation_percent)} %",
                f"t_rel{' as on KITTI' if is_kitti else ''}, and {drift} ° per 100 m",
            )
        )
    if frames is not None:
        found.append(
            KeyFigure(
                "RPE",
                length(frames.translation.rmse),
                f"from pose to pose, and {number(frames.rotation.rmse)} °",
            )
        )
    scale = evaluation.alignment.scale_error_percent
    if scale is not None:
        found.append(KeyFigure("scale error", f"{number(scale, 2)} %", "longer is positive"))
    return found


def _span_s(entry: Entry) -> float:
    stamps = entry.run.trajectory.stamps_ns
    return float(stamps[-1] - stamps[0]) * 1e-9 if len(stamps) > 1 else 0.0


def _or_dash(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"
