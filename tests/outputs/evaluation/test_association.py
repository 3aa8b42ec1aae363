from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo.base.errors import EvaluationError
from vo.base.geometry.transforms import se3_exp
from vo.base.types import Ints, Trajectory
from vo.outputs.evaluation.association import associate, coverage, nearest_pairs

STAMPS = st.lists(st.integers(0, 200), min_size=1, max_size=30, unique=True).map(
    lambda stamps: np.array(sorted(stamps), dtype=np.int64)
)


def turning(stamps_s: np.ndarray[Any, Any]) -> Trajectory:
    """Motion of constant velocity and turn rate, for which SE(3) interpolation is exact."""
    poses = np.array([se3_exp(s * np.array([0.1, 0.2, 0.3, 1.0, 0.5, 2.0])) for s in stamps_s])
    return Trajectory(np.round(stamps_s * 1e9).astype(np.int64), poses)


@given(first=STAMPS, second=STAMPS, tolerance=st.integers(0, 20))
def test_pairs_are_one_to_one_increasing_and_near(
    first: Ints, second: Ints, tolerance: int
) -> None:
    rows, partners = nearest_pairs(first, second, tolerance)
    assert (np.diff(rows) > 0).all()
    assert (np.diff(partners) > 0).all()
    assert (np.abs(first[rows] - second[partners]) <= tolerance).all()


@given(first=STAMPS, second=STAMPS)
def test_equal_stamps_are_always_paired(first: Ints, second: Ints) -> None:
    rows, partners = nearest_pairs(first, second, 0)
    assert first[rows].tolist() == np.intersect1d(first, second).tolist()
    assert second[partners].tolist() == first[rows].tolist()


def test_of_two_candidates_the_nearer_is_paired() -> None:
    first, second = np.array([8, 11]), np.array([10, 40, 70])
    rows, partners = nearest_pairs(first, second, 5)
    assert (rows.tolist(), partners.tolist()) == ([1], [0])


def test_nearest_pairs_are_within_the_tolerance() -> None:
    estimate, reference = turning(np.array([0.0, 1.0, 2.0])), turning(np.array([0.004, 1.02, 2.0]))
    matched = associate(estimate, reference)
    assert matched.stamps_ns.tolist() == [0, 2_000_000_000]
    np.testing.assert_array_equal(matched.reference, reference.world_from_cam[[0, 2]])
    assert matched.seconds.tolist() == [0.0, 2.0]
    assert matched.longest_gap_s == 2.0


def test_interpolation_is_exact_between_poses() -> None:
    times = np.array([0.33, 0.5, 1.71])
    matched = associate(turning(times), turning(np.arange(0.0, 3.0, 0.25)), interpolated=True)
    np.testing.assert_allclose(matched.reference, turning(times).world_from_cam, atol=1e-9)
    assert matched.method == "interpolated"


def test_interpolation_bridges_no_gap_and_no_end() -> None:
    reference = turning(np.array([0.0, 0.1, 0.2, 0.3, 5.0, 5.1, 5.2]))
    estimate = turning(np.array([-1.0, -0.005, 0.15, 2.0, 5.1, 5.205, 9.0]))
    matched = associate(estimate, reference, interpolated=True)
    assert matched.stamps_ns.tolist() == [-5_000_000, 150_000_000, 5_100_000_000, 5_205_000_000]


@pytest.mark.parametrize("interpolated", [False, True])
def test_error_without_overlap_names_both_time_spans(interpolated: bool) -> None:
    estimate, reference = turning(np.array([0.0, 1.0])), turning(np.array([100.0, 101.5]))
    with pytest.raises(EvaluationError, match=r"estimate 0\.000 to 1\.000 s.*100\.000 to 101\.500"):
        associate(estimate, reference, interpolated=interpolated)


def test_coverage_is_a_fraction_of_the_duration() -> None:
    assert coverage(np.array([25, 75]), np.array([0, 100])) == 0.5
    assert coverage(np.array([5]), np.array([5])) == 1.0
