"""What was found between two images, as plain values for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from vo.base.geometry.transforms import rotation_angle
from vo.tools.pairs.image_pair import ImagePair, PairOptions
from vo.tools.pairs.two_view_records import Fit, RelativePose


def pair_record(pair: ImagePair, options: PairOptions, names: tuple[str, str]) -> dict[str, Any]:
    """The record that `vo match --json` prints (docs/features.md)."""
    features, matching = options.config.features, options.config.matching
    return {
        "images": [
            {"name": name, "width": size[0], "height": size[1], "keypoints": len(keypoints)}
            for name, size, keypoints in zip(names, pair.sizes, pair.keypoints, strict=True)
        ],
        "detector": features.detector,
        "descriptor": features.descriptor,
        "matcher": "gms" if options.grid_motion else matching.method,
        "matches": len(pair.matches.query),
        "inliers": int(pair.inlier.sum()),
        "model": None if pair.fit is None else _model(pair.fit),
        "failure": None if pair.failure is None else pair.failure.text,
        "failure_reason": None if pair.failure is None else pair.failure.reason.name.lower(),
        "chance": _chance(pair),
        "pose": None if pair.pose is None else _pose(pair.pose),
        "pose_failure": None if pair.pose_failure is None else pair.pose_failure.text,
        "ms": {step: round(ms, 3) for step, ms in pair.stage_ms.items()},
    }


def _chance(pair: ImagePair) -> dict[str, int] | None:
    fit = pair.fit if pair.failure is None else pair.failure.refused
    return None if fit is None else fit.evidence._asdict()


def _model(fit: Fit) -> dict[str, Any]:
    return {
        "kind": fit.kind.value,
        "method": fit.method,
        "matrix": fit.matrix.tolist(),
        "symmetric_error_px": fit.symmetric_px,
        "sampson_error_px": float(np.median(fit.error_px[fit.inlier])),
    }


def _pose(pose: RelativePose) -> dict[str, Any]:
    motion = pose.second_from_first
    return {
        "second_from_first": motion.tolist(),
        "has_translation": pose.has_translation,
        "rotation_deg": float(np.rad2deg(rotation_angle(motion[:3, :3]))),
        "alternative": None if pose.alternative is None else pose.alternative.tolist(),
        "in_front": pose.in_front,
        "parallax_deg": pose.parallax_deg,
    }
