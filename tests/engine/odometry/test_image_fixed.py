"""The robot's own body in the image: its features are left out, from the first frame on."""

from __future__ import annotations

import pytest
from own_body import with_body
from recorded_walk import Recording, Run, aligned, track

from vo.base.faults import FaultKind
from vo.outputs.results.run_statistics import FaultLog


def _faults(run: Run) -> dict[FaultKind, bool]:
    """Kinds of faults, and whether they were handled, without those of frames tracked anew."""
    log = FaultLog()
    for estimate in run.estimates:
        if estimate.tracked_anew_from is not None:
            log.withdraw_from(estimate.tracked_anew_from)
        log.add(estimate.faults, estimate.frame_index)
    return {record.kind: record.is_handled for record in log.records()}


_HANDLED = {FaultKind.IMAGE_FIXED_FEATURES: True}


def test_a_body_does_not_hold_the_path_in_stereo(recording: Recording, stereo: Run) -> None:
    run = track(recording.rig, [with_body(frame) for frame in recording.frames])
    assert _faults(run) == _HANDLED
    assert run.numbers == stereo.numbers
    clean, _ = aligned(stereo, recording, with_scale=False)
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 3 * clean + 0.002


def test_a_body_does_not_hold_the_path_in_mono(recording: Recording, mono: Run) -> None:
    run = track(recording.mono_rig, [with_body(frame) for frame in recording.mono()])
    assert _faults(run) == _HANDLED
    assert len(run.numbers) > 0.7 * len(mono.numbers)
    ate, _ = aligned(run, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


@pytest.mark.parametrize("cameras", ["stereo", "mono"])
def test_a_clean_walk_has_no_such_fault(cameras: str, request: pytest.FixtureRequest) -> None:
    assert not _faults(request.getfixturevalue(cameras))
