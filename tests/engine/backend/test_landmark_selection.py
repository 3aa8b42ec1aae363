"""Landmarks of a window."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vo.base.geometry.projection import Intrinsics
from vo.base.types import Bools
from vo.engine.backend.landmark_selection import choose_landmarks
from vo.engine.backend.window_problem import WindowProblem


def _problem(seen: Bools, fixed: list[bool]) -> WindowProblem:
    """Of who sees whom, (K, M)."""
    keyframe, point = np.nonzero(seen)
    nothing = np.zeros(len(point))
    return WindowProblem(
        sigma_disparity_px=0.4,
        intrinsics=Intrinsics(1.0, 1.0, 0.0, 0.0),
        baseline_m=0.0,
        world_from_cam=np.tile(np.eye(4), (len(seen), 1, 1)),
        fixed=np.array(fixed),
        points=np.zeros((seen.shape[1], 3)),
        keyframe=keyframe,
        point=point,
        xy=np.zeros((len(point), 2)),
        disparity=nothing,
        sigma_px=nothing,
    )


def test_landmarks_that_cannot_hold_a_pose_take_no_part() -> None:
    seen = np.array([[1, 1, 0], [0, 1, 0], [0, 1, 1]], dtype=bool)
    assert choose_landmarks(_problem(seen, [False] * 3), 10).tolist() == [False, True, False]
    assert not choose_landmarks(_problem(seen, [True, True, True]), 10).any()


def test_a_keyframe_that_has_just_turned_away_has_its_share() -> None:
    seen = np.zeros((6, 100), dtype=bool)
    seen[:4, :60] = True
    seen[4:, 60:] = True  # seen less often
    chosen = choose_landmarks(_problem(seen, [True] + 5 * [False]), 40)
    assert chosen[:60].sum() == 20
    assert chosen[60:].sum() == 20


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 40))
def test_the_best_ranked_within_any_keyframe_are_taken(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    seen = rng.random((rng.integers(2, 6), rng.integers(1, 40))) < 0.5
    times = seen.sum(axis=0)
    best: dict[int, int] = {}
    for row in seen:
        mine = sorted(np.flatnonzero(row).tolist(), key=lambda m: -times[m])
        for rank, m in enumerate(mine):
            best[m] = min(best.get(m, rank), rank)
    candidates = [m for m in best if times[m] >= 2]
    wanted = sorted(candidates, key=lambda m: (best[m], -times[m], m))[:most]
    chosen = choose_landmarks(_problem(seen, len(seen) * [False]), most)
    assert np.flatnonzero(chosen).tolist() == sorted(wanted)
