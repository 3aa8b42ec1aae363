from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest

from vo.base.errors import EvaluationError
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.types import Trajectory
from vo.outputs.evaluation.evaluation import evaluate
from vo.outputs.evaluation.pose_errors import pairs_over_metres, rotation_angles_deg

MakeWalk = Callable[..., Trajectory]


def test_a_perfect_estimate_has_no_error(make_walk: MakeWalk) -> None:
    true = make_walk()
    evaluation = evaluate(true, true)
    assert evaluation.rpe_frames is not None
    for errors in (evaluation.ate, evaluation.rpe_frames):
        assert errors.translation.max < 1e-9
        assert errors.rotation.max < 1e-6
    assert evaluation.coverage == 1.0
    assert evaluation.matched.longest_gap_s == pytest.approx(0.1)


def test_error_equals_a_known_offset(make_walk: MakeWalk) -> None:
    true = make_walk()
    away = make_transform(np.eye(3), np.array([3.0, 0.0, 4.0]))
    evaluation = evaluate(
        Trajectory(true.stamps_ns, away @ true.world_from_cam), true, "none", delta_frames=2
    )
    assert evaluation.ate.translation.min == pytest.approx(5.0)
    assert evaluation.ate.translation.max == pytest.approx(5.0)
    assert evaluation.ate.translation.std == pytest.approx(0.0, abs=1e-9)
    assert evaluation.rpe_frames is not None
    assert evaluation.rpe_frames.translation.max < 1e-9
    assert len(evaluation.rpe_frames) == len(true) - 2


def test_error_equals_a_known_camera_rotation(make_walk: MakeWalk) -> None:
    true = make_walk()
    turn = make_transform(so3_exp(np.array([0.0, np.deg2rad(7.0), 0.0])), np.zeros(3))
    evaluation = evaluate(Trajectory(true.stamps_ns, true.world_from_cam @ turn), true)
    assert evaluation.ate.rotation.min == pytest.approx(7.0)
    assert evaluation.ate.rotation.max == pytest.approx(7.0)
    assert evaluation.ate.translation.max < 1e-9


def test_a_jump_of_one_metre_affects_one_relative_error(make_walk: MakeWalk) -> None:
    true = make_walk(40)
    estimate = true.world_from_cam.copy()
    estimate[20:, 0, 3] += 1.0
    evaluation = evaluate(Trajectory(true.stamps_ns, estimate), true, "none")
    assert evaluation.rpe_frames is not None
    assert evaluation.rpe_frames.translation.max == pytest.approx(1.0)
    assert np.count_nonzero(evaluation.rpe_frames.translation_m > 1e-9) == 1


def test_mono_is_aligned_in_sim3_with_a_reason(make_walk: MakeWalk) -> None:
    true = make_walk()
    small = true.world_from_cam.copy()
    small[:, :3, 3] /= 8.0
    evaluation = evaluate(Trajectory(true.stamps_ns, small), true, mode="mono")
    assert evaluation.alignment.kind == "sim3"
    assert "mono" in evaluation.alignment.reason
    assert evaluation.ate.translation.max < 1e-9
    assert evaluation.to_dict()["alignment"]["scale"] == pytest.approx(8.0)


def test_dictionary_is_json_and_has_units(make_walk: MakeWalk, make_noisy: MakeWalk) -> None:
    true = make_walk()
    result = evaluate(make_noisy(true), true).to_dict()
    back = json.loads(json.dumps(result, allow_nan=False))
    assert back == result
    assert set(back["ate"]) == {"translation_m", "rotation_deg", "rotation_alone_deg"}
    assert set(back["ate"]["translation_m"]) == {"rmse", "mean", "median", "max", "min", "std"}
    assert back["rpe_metres"]["delta_m"] == 2.0
    assert back["path_m"] == pytest.approx(29.5, rel=0.01)


def test_metrics_that_need_a_longer_path_are_none(make_walk: MakeWalk) -> None:
    true = make_walk(3)
    evaluation = evaluate(true, true, delta_frames=5, delta_m=50.0)
    assert evaluation.rpe_frames is None
    assert evaluation.rpe_metres is None
    assert evaluation.segments is None
    assert evaluation.to_dict()["rpe_metres"] is None


def test_few_matches_are_noted(make_walk: MakeWalk) -> None:
    true = make_walk()
    late = np.where(np.arange(len(true)) < 10, true.stamps_ns, true.stamps_ns + 50_000_000)
    evaluation = evaluate(Trajectory(late, true.world_from_cam), true)
    assert "only 10 of 60" in evaluation.notes[0]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"tolerance_s": -1.0}, "the tolerance is -1.0 s"),
        ({"tolerance_s": float("nan")}, "tolerance is nan s"),
        ({"delta_frames": 0}, "delta is 0 frames"),
        ({"delta_m": 0.0}, "delta is 0.0 m"),
    ],
)
def test_settings_out_of_range(
    make_walk: MakeWalk, setting: dict[str, float], message: str
) -> None:
    with pytest.raises(EvaluationError, match=message):
        evaluate(make_walk(), make_walk(), **setting)  # type: ignore[arg-type]


def test_pairs_over_metres_on_a_path_with_a_stop() -> None:
    along = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 3.0])
    positions = np.column_stack([along, np.zeros(6), np.zeros(6)])
    assert pairs_over_metres(positions, 1.0).tolist() == [[0, 1], [1, 4], [2, 4], [3, 4], [4, 5]]
    assert pairs_over_metres(positions, 50.0).shape == (0, 2)
    assert pairs_over_metres(positions[:1], 1.0).shape == (0, 2)


@pytest.mark.parametrize("degrees", [0.0, 1e-6, 1.0, 90.0, 179.999999, 180.0])
def test_angles_are_accurate_at_both_ends(degrees: float) -> None:
    rotation = so3_exp(np.deg2rad(degrees) * np.array([0.6, 0.0, 0.8]))
    assert rotation_angles_deg(rotation[None])[0] == pytest.approx(degrees, abs=1e-9)


def test_rotation_alone_is_reliable_on_a_nearly_straight_path() -> None:
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (50, 1, 1))
    poses[:, 2, 3] = np.arange(50.0)
    poses[:, :3, 3] += rng.normal(scale=0.01, size=(50, 3))
    estimate = poses.copy()
    estimate[:, :3, 3] += rng.normal(scale=0.02, size=(50, 3))
    stamps_ns = np.arange(50) * 10**8
    evaluation = evaluate(Trajectory(stamps_ns, estimate), Trajectory(stamps_ns, poses))
    assert evaluation.ate.rotation.rmse > 5.0
    assert evaluation.rotation_alone_deg.max() < 1e-6
    assert "nearly straight" in evaluation.notes[0]
