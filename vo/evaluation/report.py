"""The whole comparison of two trajectories: `evaluate`, and the record that it gives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vo.errors import EvaluationError
from vo.evaluation.alignment import Alignment, AlignMethod, align_poses
from vo.evaluation.ape import absolute_errors, rotation_errors_alone
from vo.evaluation.association import Matched, associate, coverage
from vo.evaluation.kitti import SegmentDrift, segment_drift
from vo.evaluation.rpe import pairs_over_frames, pairs_over_metres, relative_errors
from vo.evaluation.statistics import PoseErrors, Statistics, path_distances
from vo.types import Floats, Ints, Mode, Trajectory

_LOOSE_ROLL_RAD = 0.1


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What came out of comparing an estimate with a reference.

    Attributes:
        matched: poses of the same moments, the estimate as given.
        alignment: how the estimate was laid onto the reference.
        aligned: (N, 4, 4) the matched estimated poses after that, in the reference's world.
        ate: absolute errors of the aligned poses.
        rotation_alone_deg: (N,) angles left when rotations are aligned by themselves, which a
            straight path does not spoil.
        rpe_frames: errors of the motion over `delta_frames` matched poses; None with too few poses.
        rpe_metres: errors of the motion over `delta_m` metres; None where no pair fits.
        segments: drift over sub-paths; None where the path is too short.
        delta_frames: number of matched poses for `rpe_frames`.
        delta_m: metres for `rpe_metres`.
        path_m: length of the reference's path through the matched poses.
        coverage: share of the reference's time between first and last matched pose, 0 to 1.
        estimate_poses: number of poses in the estimate.
        reference_poses: number of poses in the reference.
        notes: what a reader of the numbers should know.
    """

    matched: Matched
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
        """Everything but the arrays, ready for JSON; units stand in the keys."""
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
    """Compare an estimated trajectory with the true one.

    Args:
        estimate: what is judged.
        reference: what is true, poses of the same camera.
        align: what may be changed to lay the estimate onto the reference; `auto` is `sim3` for a
            mono estimate, else `se3`.
        mode: what made the estimate; `auto` when that is not known.
        tolerance_s: largest difference between stamps of one moment.
        interpolated: whether to interpolate the reference at the estimate's stamps.
        delta_frames: number of matched poses over which the relative error is taken.
        delta_m: metres over which it is taken; by default about a tenth of the path, at most 100.

    Raises:
        EvaluationError: no common moments, or too little to align.
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
        raise EvaluationError(f"tolerance is {tolerance_s} s; give 0 or more")
    if delta_frames < 1:
        raise EvaluationError(f"delta is {delta_frames} frames; give 1 or more")
    if delta_m is not None and not (math.isfinite(delta_m) and delta_m > 0.0):
        raise EvaluationError(f"delta is {delta_m} m; give more than 0")


def _rpe(estimate: Floats, reference: Floats, pairs: Ints) -> PoseErrors | None:
    return relative_errors(estimate, reference, pairs) if len(pairs) else None


def _round_tenth(path_m: float) -> float:
    """The number of …, 0.5, 1, 2, 5, …, 100 that is nearest to a tenth of the path."""
    tenth = min(path_m / 10.0, 100.0)
    if tenth <= 0.0:
        return 1.0
    power = 10.0 ** math.floor(math.log10(tenth))
    return float(min((power * step for step in (1, 2, 5, 10)), key=lambda x: abs(x - tenth)))


def _notes(
    matched: Matched, alignment: Alignment, ate: PoseErrors, possible: int
) -> tuple[str, ...]:
    notes = []
    if len(matched) < 0.5 * possible:
        notes.append(
            f"only {len(matched)} of {possible} poses have a partner within "
            f"{matched.tolerance_s:g} s; interpolating the reference may find more"
        )
    if alignment.reference_from_estimate.is_on_line:
        notes.append("the path is one straight line: the roll about it comes from the rotations")
    elif alignment.kind in ("se3", "sim3") and _is_roll_loose(matched.reference, ate):
        notes.append(
            "the path is nearly straight, so errors of position decide the roll about it: "
            "judge rotation by 'rotation alone' and RPE, not by ATE"
        )
    return tuple(notes)


def _is_roll_loose(reference: Floats, ate: PoseErrors) -> bool:
    """Whether the position errors could turn an alignment by some degrees about the path's line."""
    positions = reference[:, :3, 3] - reference[:, :3, 3].mean(axis=0)
    spreads = np.linalg.svd(positions, compute_uv=False) / math.sqrt(len(positions))
    return bool(ate.translation.rmse > _LOOSE_ROLL_RAD * spreads[1])


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
