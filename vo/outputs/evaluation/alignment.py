"""Alignment of an estimate with the reference: choice of the method, and the transform."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from vo.base.errors import EvaluationError
from vo.base.geometry.similarity import Similarity, line_direction, umeyama
from vo.base.geometry.transforms import skew, so3_exp
from vo.base.types import Floats, Mode

AlignMethod = Literal["auto", "none", "se3", "sim3", "scale"]
AlignKind = Literal["none", "se3", "sim3", "scale"]


@dataclass(frozen=True, eq=False)
class Alignment:
    """Alignment of an estimate with the reference."""

    # estimated parameters: none, rotation and translation (`se3`), these and scale (`sim3`), or
    # scale alone
    kind: AlignKind
    reason: str  # why this kind was chosen, in a few words
    reference_from_estimate: Similarity  # the transform that was applied
    # scale of the best similarity transform, applied or not; None where it is undefined
    best_scale: float | None

    @property
    def scale_error_percent(self) -> float | None:
        """Excess size of the estimate in percent; None if the scale was aligned."""
        if self.kind in ("sim3", "scale") or not self.best_scale:
            return None
        return 100.0 * (1.0 / self.best_scale - 1.0)


def choose_alignment(align: AlignMethod, mode: Mode) -> tuple[AlignKind, str]:
    """Kind of alignment and the reason for it; the scale of a mono estimate is arbitrary."""
    if align != "auto":
        return align, "as requested"
    if mode == "mono":
        return "sim3", "auto: mono estimate, scale unknown"
    if mode == "stereo":
        return "se3", "auto: stereo estimate, metric scale"
    return "se3", "auto: taken as metric"


def align_poses(
    estimate: Floats, reference: Floats, *, align: AlignMethod = "auto", mode: Mode = "auto"
) -> Alignment:
    """Find the alignment of matched poses, each (N, 4, 4) world_from_cam.

    Raises:
        EvaluationError: too few poses, or too little motion to determine the alignment.
    """
    kind, reason = choose_alignment(align, mode)
    similarity = _similarity(estimate, reference, with_scale=True, kind=kind)
    best_scale = None if similarity is None else similarity.scale
    if kind == "none" or similarity is None:
        applied = Similarity(1.0, np.eye(3), np.zeros(3))
    elif kind == "scale":
        applied = Similarity(similarity.scale, np.eye(3), np.zeros(3))
    elif kind == "sim3":
        applied = similarity
    else:
        applied = _without_scale(similarity, estimate, reference)
    return Alignment(kind, reason, applied, best_scale)


def _similarity(
    estimate: Floats, reference: Floats, *, with_scale: bool, kind: AlignKind
) -> Similarity | None:
    """Best similarity transform; None if it is undefined and `kind` is `none`."""
    source, target = estimate[:, :3, 3], reference[:, :3, 3]
    try:
        similarity = umeyama(source, target, with_scale=with_scale)
        if similarity.scale <= 0.0:
            raise ValueError("the best scale is not positive")
    except ValueError as error:
        if kind == "none":
            return None
        raise EvaluationError(
            f"{len(source)} matched poses cannot be aligned ({kind}): {error}; "
            "compare a longer part or use `align=none`"
        ) from error
    return _with_roll_resolved(similarity, estimate, reference)


def _without_scale(similarity: Similarity, estimate: Floats, reference: Floats) -> Similarity:
    """Best rigid transform; its rotation is the same (Umeyama, eq. 40, does not contain scale)."""
    mean_estimate, mean_reference = (
        estimate[:, :3, 3].mean(axis=0),
        reference[:, :3, 3].mean(axis=0),
    )
    translation = mean_reference - similarity.rotation @ mean_estimate
    return Similarity(1.0, similarity.rotation, translation, similarity.is_on_line)


def _with_roll_resolved(similarity: Similarity, estimate: Floats, reference: Floats) -> Similarity:
    """On a straight path, determine the rotation about the line from the cameras' orientations.

    Maximises trace(R(angle) M), where M is the sum of R R_estimate R_reference^T over the poses.
    """
    if not similarity.is_on_line:
        return similarity
    axis = line_direction(reference[:, :3, 3])
    turned = similarity.rotation @ estimate[:, :3, :3]
    total = np.einsum("nij,nkj->ik", turned, reference[:, :3, :3])
    sine, cosine = np.trace(skew(axis) @ total), np.trace(total) - axis @ total @ axis
    rotation = so3_exp(axis * np.arctan2(sine, cosine)) @ similarity.rotation
    centre = estimate[:, :3, 3].mean(axis=0)
    translation = reference[:, :3, 3].mean(axis=0) - similarity.scale * rotation @ centre
    return Similarity(similarity.scale, rotation, translation, is_on_line=True)
