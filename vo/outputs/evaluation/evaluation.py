"""Evaluation of an estimated trajectory: `evaluate`, and the record of its results."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vo.base.errors import EvaluationError
from vo.base.types import Floats, Ints, Mode, Trajectory
from vo.outputs.evaluation.alignment import Alignment, AlignMethod, align_poses
from vo.outputs.evaluation.association import MatchedPoses, associate, coverage
from vo.outputs.evaluation.conventions import convention_notes
from vo.outputs.evaluation.pose_errors import (
    PoseErrors,
    SegmentDrift,
    Statistics,
    absolute_errors,
    pairs_over_frames,
    pairs_over_metres,
    path_distances,
    relative_errors,
    rotation_errors_alone,
    segment_drift,
)

_UNCERTAIN_ROLL_RAD = 0.1
_UNITS = (1000.0, 100.0, 0.01, 0.001)
_UNIT_ERROR = 0.05


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Results of an evaluation.

    Attributes:
        matched: poses of the same times, before alignment.
        alignment: alignment of the estimate with the reference.
        aligned: (N, 4, 4) aligned estimated poses, in the reference's world.
        ate: absolute errors of the aligned poses.
        rotation_alone_deg: (N,) rotation errors after an alignment by rotations alone, reliable on
            straight paths too.
        rpe_frames: relative errors over `delta_frames` matched poses; None with too few poses.
        rpe_metres: relative errors over `delta_m` metres; None if there is no such pair.
        segments: drift over sub-paths; None if the path is too short.
        delta_frames: step for `rpe_frames`, in matched poses.
        delta_m: step for `rpe_metres`, in metres.
        path_m: length of the reference path through the matched poses.
        coverage: fraction (0 to 1) of the reference's duration between first and last matched pose.
        estimate_poses: number of poses in the estimate.
        reference_poses: number of poses in the reference.
        notes: caveats for the reader of the figures.
    """

    matched: MatchedPoses
    alignment: Alignment
    aligned: Floats
    ate: PoseErrors
    rotation_alone_deg: Floats
    rpe_frames: PoseErrors | None
    rpe_metres: PoseErrors | None
    segments: SegmentDrift | None
    delta_frames: int
    delta_m: float
    path_m: float
    coverage: float
    estimate_poses: int
    reference_poses: int
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """All figures but the arrays, ready for JSON; keys contain units."""
        return {
            "matched": len(self.matched),
            "estimate_poses": self.estimate_poses,
            "reference_poses": self.reference_poses,
            "coverage": self.coverage,
            "duration_s": float(self.matched.seconds[-1]),
            "longest_gap_s": self.matched.longest_gap_s,
            "path_m": self.path_m,
            "association": {
                "method": self.matched.method,
                "tolerance_s": self.matched.tolerance_s,
            },
            "alignment": _alignment_dict(self.alignment),
            "scale_error_percent": self.alignment.scale_error_percent,
            "ate": {
                **self.ate.to_dict(),
                "rotation_alone_deg": Statistics.of(self.rotation_alone_deg).to_dict(),
            },
            "rpe_frames": _rpe_dict(self.rpe_frames, "delta_frames", self.delta_frames),
            "rpe_metres": _rpe_dict(self.rpe_metres, "delta_m", self.delta_m),
            "segments": None if self.segments is None else self.segments.to_dict(),
            "notes": list(self.notes),
        }


def evaluate(
    estimate: Trajectory,
    reference: Trajectory,
    align: AlignMethod = "auto",
    mode: Mode = "auto",
    *,
    tolerance_s: float = 0.01,
    interpolated: bool = False,
    delta_frames: int = 1,
    delta_m: float | None = None,
) -> Evaluation:
    """Compare an estimated trajectory with the ground truth.

    `reference`: the ground truth, poses of the same camera. `align`: kind of alignment; `auto` is
    `sim3` for a mono estimate, else `se3`. `mode`: mode of the run that made the estimate; `auto`
    if unknown. `tolerance_s`: largest difference between the stamps of a pair. `interpolated`:
    interpolate the reference at the estimate's stamps. `delta_frames`: step of the relative error
    in matched poses. `delta_m`: step of the relative error in metres; by default about a tenth of
    the path, at most 100.

    Raises:
        EvaluationError: no common stamps, or too few poses or too little motion to align.
    """
    _check_settings(tolerance_s, delta_frames, delta_m)
    matched = associate(estimate, reference, tolerance_s=tolerance_s, interpolated=interpolated)
    alignment = align_poses(matched.estimate, matched.reference, align=align, mode=mode)
    aligned = alignment.reference_from_estimate.transform_poses(matched.estimate)
    path_m = float(path_distances(matched.reference[:, :3, 3])[-1])
    delta_m = _round_tenth(path_m) if delta_m is None else delta_m
    ate = absolute_errors(aligned, matched.reference)
    frame_pairs = pairs_over_frames(len(matched), delta_frames)
    metre_pairs = pairs_over_metres(aligned[:, :3, 3], delta_m)
    return Evaluation(
        matched=matched,
        alignment=alignment,
        aligned=aligned,
        ate=ate,
        rotation_alone_deg=rotation_errors_alone(aligned, matched.reference),
        rpe_frames=_rpe(aligned, matched.reference, frame_pairs),
        rpe_metres=_rpe(aligned, matched.reference, metre_pairs),
        segments=segment_drift(aligned, matched.reference),
        delta_frames=delta_frames,
        delta_m=delta_m,
        path_m=path_m,
        coverage=coverage(matched.stamps_ns, reference.stamps_ns),
        estimate_poses=len(estimate),
        reference_poses=len(reference),
        notes=_notes(matched, alignment, ate, min(len(estimate), len(reference))),
    )


def _check_settings(tolerance_s: float, delta_frames: int, delta_m: float | None) -> None:
    if not (math.isfinite(tolerance_s) and tolerance_s >= 0.0):
        raise EvaluationError(f"the tolerance is {tolerance_s} s; it must be 0 or more")
    if delta_frames < 1:
        raise EvaluationError(f"the delta is {delta_frames} frames; it must be 1 or more")
    if delta_m is not None and not (math.isfinite(delta_m) and delta_m > 0.0):
        raise EvaluationError(f"the delta is {delta_m} m; it must be above 0")


def _rpe(estimate: Floats, reference: Floats, pairs: Ints) -> PoseErrors | None:
    return relative_errors(estimate, reference, pairs) if len(pairs) else None


def _round_tenth(path_m: float) -> float:
    """A tenth of the path, rounded to 1, 2 or 5 times a power of ten; at most 100."""
    tenth = min(path_m / 10.0, 100.0)
    if tenth <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(tenth))
    return float(min((power * step for step in (1, 2, 5, 10)), key=lambda x: abs(x - tenth)))


def _notes(
    matched: MatchedPoses, alignment: Alignment, ate: PoseErrors, possible: int
) -> tuple[str, ...]:
    notes = []
    if len(matched) < 0.5 * possible:
        notes.append(
            f"only {len(matched)} of {possible} poses have a counterpart within "
            f"{matched.tolerance_s:g} s; `interpolated` may find more"
        )
    if alignment.reference_from_estimate.is_on_line:
        notes.append("the path is a straight line: the roll about it is aligned by rotations")
    elif alignment.kind in ("se3", "sim3") and _is_roll_uncertain(matched.reference, ate):
        notes.append(
            "the path is nearly straight, so the alignment's roll about it depends on position "
            "errors: judge rotation by 'rotation alone' and RPE, not by ATE"
        )
    scale = alignment.best_scale
    unit = next((f for f in _UNITS if scale is not None and abs(scale / f - 1.0) < _UNIT_ERROR), 0)
    if alignment.kind == "se3" and unit:
        notes.append(
            f"lengths of the reference are {unit:g} times those of the estimate: other units?"
        )
    return (*notes, *convention_notes(matched))


def _is_roll_uncertain(reference: Floats, ate: PoseErrors) -> bool:
    """Whether position errors could turn the alignment about the path by several degrees."""
    positions = reference[:, :3, 3] - reference[:, :3, 3].mean(axis=0)
    spreads = np.linalg.svd(positions, compute_uv=False) / math.sqrt(len(positions))
    return bool(ate.translation.rmse > _UNCERTAIN_ROLL_RAD * spreads[1])


def _alignment_dict(alignment: Alignment) -> dict[str, Any]:
    applied = alignment.reference_from_estimate
    return {
        "kind": alignment.kind,
        "reason": alignment.reason,
        "scale": applied.scale,
        "rotation": np.asarray(applied.rotation).tolist(),
        "translation_m": np.asarray(applied.translation).tolist(),
        "best_scale": alignment.best_scale,
    }


def _rpe_dict(errors: PoseErrors | None, name: str, delta: float) -> dict[str, Any] | None:
    return None if errors is None else {name: delta, "pairs": len(errors), **errors.to_dict()}
