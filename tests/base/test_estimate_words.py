"""How an estimate reads for people."""

from __future__ import annotations

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.types import Estimate, State


def estimate(state: State, pose: np.ndarray | None, failure: Failure | None) -> Estimate:
    return Estimate(7, 1_400_000_000, state, failure, 0, pose, True, 90, 87, 80, ())


def test_an_estimate_fits_two_lines() -> None:
    pose = np.eye(4)
    pose[:3, 3] = [0.123456, -2.0, 31.41592]
    assert repr(estimate(State.TRACKING, pose, None)) == (
        "<vo.Estimate frame 7, 1400000000 ns: tracking at (0.1235, -2, 31.42),\n"
        "  80 of 87 matches agree, segment 0, keyframe>"
    )


def test_a_failure_is_printed_in_words() -> None:
    failure = Failure(FailureReason.FEW_FEATURES, 12, 50)
    assert f"{failure}" == str(failure) == "12 features in the image, 50 needed"
    assert repr(estimate(State.LOST, None, failure)) == (
        "<vo.Estimate frame 7, 1400000000 ns: lost, no pose: 12 features in the image, 50 needed>"
    )


def test_every_state_says_whether_there_is_a_pose() -> None:
    assert [state.name for state in State if state.has_pose] == ["TRACKING"]
