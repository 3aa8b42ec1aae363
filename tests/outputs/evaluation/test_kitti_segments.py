from __future__ import annotations

import numpy as np
import pytest

from vo.base.geometry.transforms import so3_exp
from vo.base.types import Floats
from vo.outputs.evaluation.pose_errors import KITTI_LENGTHS_M, segment_drift


def straight(metres: float, step_m: float = 1.0) -> Floats:
    poses = np.tile(np.eye(4), (round(metres / step_m) + 1, 1, 1))
    poses[:, 2, 3] = np.arange(len(poses)) * step_m
    return poses


def test_a_perfect_path_has_no_drift() -> None:
    drift = segment_drift(straight(1000.0), straight(1000.0))
    assert drift is not None
    assert [d.length_m for d in drift.lengths] == list(KITTI_LENGTHS_M)
    assert drift.translation_percent == 0.0
    assert drift.rotation_deg_per_m == 0.0


def test_scale_error_is_drift_in_percent() -> None:
    estimate = straight(1000.0)
    estimate[:, :3, 3] *= 1.02
    drift = segment_drift(estimate, straight(1000.0))
    assert drift is not None
    # The devkit ends a sub-path at the first pose beyond its length, here one metre further.
    for of_length in drift.lengths:
        expected = 2.0 * (of_length.length_m + 1.0) / of_length.length_m
        assert of_length.translation_percent == pytest.approx(expected)


def test_constant_turn_rate_error_is_drift_in_degrees_per_metre() -> None:
    estimate = straight(60.0, 0.1)
    for i in range(len(estimate)):
        estimate[i, :3, :3] = so3_exp(np.array([0.0, np.deg2rad(0.01) * i, 0.0]))
    drift = segment_drift(estimate, straight(60.0, 0.1))
    assert drift is not None
    assert [d.length_m for d in drift.lengths] == [5.0, 10.0, 20.0, 50.0]
    assert drift.rotation_deg_per_m == pytest.approx(0.1, rel=0.03)


def test_sub_paths_start_at_every_tenth_pose_only_on_long_paths() -> None:
    long, short = (segment_drift(straight(m), straight(m)) for m in (150.0, 7.0))
    assert long is not None
    assert short is not None
    assert [(d.length_m, d.count) for d in long.lengths] == [(100.0, 5)]
    assert [(d.length_m, d.count) for d in short.lengths] == [(5.0, 2)]


def test_a_path_shorter_than_all_lengths_has_no_drift() -> None:
    assert segment_drift(straight(4.0), straight(4.0)) is None
