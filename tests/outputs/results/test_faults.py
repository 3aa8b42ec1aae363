from __future__ import annotations

import pytest

from vo.base.faults import Fault, FaultKind
from vo.outputs.results.fault_warnings import fault_warnings
from vo.outputs.results.run_statistics import FaultLog, FaultRecord

STEP, REPEATED = FaultKind.IMPLAUSIBLE_STEP, FaultKind.REPEATED_IMAGES


def test_faults_are_collected_by_kind() -> None:
    log = FaultLog()
    log.add([Fault(STEP, is_handled=True, value=-4.0)], frame=7)
    log.add([Fault(REPEATED, is_handled=True), Fault(STEP, is_handled=False, value=3.0)], frame=9)
    log.add([Fault(FaultKind.WRONG_LENS, value=2.0)])
    assert log.records() == (
        FaultRecord(REPEATED, True, 1, 9, 9, 0.0),
        FaultRecord(STEP, False, 2, 7, 9, -4.0),
        FaultRecord(FaultKind.WRONG_LENS, False, 0, None, None, 2.0),
    )


@pytest.mark.parametrize("is_handled", [True, False])
@pytest.mark.parametrize("kind", list(FaultKind))
def test_every_kind_has_two_texts(kind: FaultKind, is_handled: bool) -> None:
    (text,) = fault_warnings([FaultRecord(kind, is_handled, 2, 3, 4, 0.5)])
    (whole,) = fault_warnings([FaultRecord(kind, is_handled, 0, None, None, 0.5)])
    assert "{" not in text + whole and len(text) > 30


def test_faults_of_frames_that_are_tracked_anew_are_withdrawn() -> None:
    log = FaultLog()
    log.add([Fault(FaultKind.WRONG_STEREO_CALIBRATION, value=9.0), Fault(REPEATED)], frame=7)
    log.withdraw_from(8)
    assert len(log.records()) == 2
    log.withdraw_from(3)
    assert [record.kind for record in log.records()] == [REPEATED]  # seen in the images


def test_many_implausible_steps_are_not_handled() -> None:
    step = Fault(FaultKind.IMPLAUSIBLE_STEP, is_handled=True)
    for frames, is_handled in (((9, 15), True), ((9, 15, 19), False), ((9, 800, 1500), True)):
        log = FaultLog()
        for frame in frames:
            log.add([step], frame)
        (record,) = log.records()
        assert record.is_handled is is_handled and record.frames == len(frames)
