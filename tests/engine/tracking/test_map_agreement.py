"""Frames that confirm little of the map."""

from __future__ import annotations

import numpy as np
import pytest

from vo.base.faults import Fault, FaultKind
from vo.engine.mapping.tracked_frame import Observations, TrackedFrame
from vo.engine.tracking.step_check import MapAgreement


def tracked(in_view: int, found: int, inliers: int) -> TrackedFrame:
    pixels, ones = np.zeros((found, 2)), np.ones(found)
    rows = np.arange(found)
    seen = Observations(rows, pixels, pixels, ones, ones, ones, ones, pixels)
    return TrackedFrame(np.eye(4), rows, seen, rows < inliers, in_view=in_view)


@pytest.mark.parametrize("frame", [tracked(1000, 200, 190), tracked(200, 190, 130)])
def test_a_fifth_frame_in_a_row_that_confirms_little_is_a_fault(frame: TrackedFrame) -> None:
    agreement = MapAgreement()
    assert [agreement.update(frame) for _ in range(4)] == [()] * 4
    (fault,) = agreement.update(frame)
    assert fault == Fault(FaultKind.TWO_MOTIONS, value=1.0 - frame.inlier_ratio)
    assert not fault.is_handled


def test_single_frames_and_new_maps_are_no_fault() -> None:
    agreement = MapAgreement()
    few, usual = tracked(1000, 200, 190), tracked(1000, 600, 560)
    assert not any(agreement.update(each) for each in [few, few, few, few, usual] * 3)
    for _ in range(4):
        agreement.update(few)
    agreement.restart()
    assert agreement.update(few) == ()
