from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vo.base.errors import EvaluationError
from vo.base.geometry.similarity import Similarity
from vo.base.geometry.transforms import se3_exp, so3_exp
from vo.base.types import Floats, Mode, Trajectory
from vo.outputs.evaluation.alignment import align_poses, choose_alignment
from vo.outputs.evaluation.pose_errors import absolute_errors

MakeWalk = Callable[..., Trajectory]


def moved(poses: Floats, scale: float = 1.0, *, seed: int = 3) -> Floats:
    rng = np.random.default_rng(seed)
    return Similarity(scale, so3_exp(rng.normal(size=3)), rng.normal(size=3)).transform_poses(poses)


@pytest.mark.parametrize(
    ("mode", "kind", "words"),
    [("mono", "sim3", "mono"), ("stereo", "se3", "stereo"), ("auto", "se3", "metric")],
)
def test_auto_follows_the_mode_and_gives_the_reason(mode: Mode, kind: str, words: str) -> None:
    chosen, reason = choose_alignment("auto", mode)
    assert chosen == kind
    assert words in reason


def test_explicit_alignment_overrides_the_mode() -> None:
    assert choose_alignment("se3", "mono") == ("se3", "as requested")


@pytest.mark.parametrize("scale", [1.0, 0.2])
def test_sim3_undoes_any_similarity(make_walk: MakeWalk, scale: float) -> None:
    true = make_walk().world_from_cam
    alignment = align_poses(moved(true, scale), true, align="sim3")
    aligned = alignment.reference_from_estimate.transform_poses(moved(true, scale))
    np.testing.assert_allclose(aligned, true, atol=1e-9)
    assert alignment.best_scale == pytest.approx(1.0 / scale)
    assert alignment.scale_error_percent is None


def test_se3_undoes_a_rigid_motion_and_reports_the_scale_error(make_walk: MakeWalk) -> None:
    true = make_walk().world_from_cam
    exact = align_poses(moved(true), true, align="se3")
    aligned = exact.reference_from_estimate.transform_poses(moved(true))
    np.testing.assert_allclose(aligned, true, atol=1e-9)
    assert exact.scale_error_percent == pytest.approx(0.0, abs=1e-9)
    large = align_poses(moved(true, 1.05), true, align="se3")
    assert large.reference_from_estimate.scale == 1.0
    assert large.scale_error_percent == pytest.approx(5.0)


def test_scale_alignment_changes_only_the_size(make_walk: MakeWalk) -> None:
    true = make_walk().world_from_cam
    small = true.copy()
    small[:, :3, 3] /= 4.0
    alignment = align_poses(small, true, align="scale")
    aligned = alignment.reference_from_estimate.transform_poses(small)
    np.testing.assert_allclose(aligned, true, atol=1e-9)


def test_none_leaves_the_estimate_unchanged(make_walk: MakeWalk) -> None:
    true = make_walk().world_from_cam
    alignment = align_poses(moved(true, 2.0), true, align="none")
    aligned = alignment.reference_from_estimate.transform_poses(moved(true, 2.0))
    np.testing.assert_array_equal(aligned, moved(true, 2.0))
    assert alignment.scale_error_percent == pytest.approx(100.0)


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_on_a_straight_path_orientations_determine_the_roll(align: str) -> None:
    true = np.array([se3_exp(np.array([0.3, 0.2, 0.1, 0, 0, 0]))] * 20)
    true[:, :3, 3] = np.outer(np.arange(20.0), [1.0, 2.0, 2.0])
    estimate = moved(true)
    alignment = align_poses(estimate, true, align=align)  # type: ignore[arg-type]
    aligned = alignment.reference_from_estimate.transform_poses(estimate)
    errors = absolute_errors(aligned, true)
    assert errors.translation.max < 1e-9
    assert errors.rotation.max < 1e-5
    assert alignment.reference_from_estimate.is_on_line


def test_two_poses_cannot_be_aligned_but_can_be_compared(make_walk: MakeWalk) -> None:
    true = make_walk(2).world_from_cam
    with pytest.raises(EvaluationError, match=r"2 matched poses.*at least 3.*`align=none`"):
        align_poses(true, true, align="se3")
    assert align_poses(true, true, align="none").best_scale is None


def test_an_estimate_without_motion_cannot_be_aligned(make_walk: MakeWalk) -> None:
    true = make_walk().world_from_cam
    with pytest.raises(EvaluationError, match="one place"):
        align_poses(np.repeat(true[:1], len(true), axis=0), true, align="sim3")
