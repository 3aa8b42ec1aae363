"""Interlaced recordings are reported, and clean ones are not."""

from __future__ import annotations

from dataclasses import replace

from recorded_walk import Recording, Run, track

from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes, Frame


def woven(frame: Frame, later: Frame) -> Frame:
    """Odd rows of the next frame."""

    def image(now: Bytes | None, after: Bytes | None) -> Bytes | None:
        if now is None or after is None:
            return now
        result = now.copy()
        result[1::2] = after[1::2]
        return result

    return replace(frame, images=tuple(map(image, frame.images, later.images)))


def interlaced(run: Run) -> list[Fault]:
    faults = [fault for e in run.estimates for fault in e.faults]
    return [fault for fault in faults if fault.kind is FaultKind.INTERLACED_IMAGES]


def test_interlaced_frames_are_reported_and_clean_ones_are_not(recording: Recording) -> None:
    clean = recording.frames[:9]
    frames = [woven(*pair) for pair in zip(clean[:-1], clean[1:], strict=True)]
    faults = interlaced(track(recording.rig, frames))
    assert len(faults) == 4  # from the second image examined on
    assert not any(fault.is_handled for fault in faults)
    assert not interlaced(track(recording.rig, clean))
