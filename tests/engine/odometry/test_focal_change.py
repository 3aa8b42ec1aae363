"""A lens that zooms during the recording."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from recorded_walk import Recording, Run, track

from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes, Frame


def zoomed(frame: Frame, recording: Recording) -> Frame:
    """The frame, with a focal length that grows by 6 % within a second, from frame 15 on."""
    camera = recording.rig.cam0
    factor = 1.0 + 0.06 * float(np.clip((frame.index - 15) / 15.0, 0.0, 1.0))
    centre = np.array([camera.cx, camera.cy])
    matrix = np.column_stack([np.eye(2) * factor, (1.0 - factor) * centre])

    def zoom(image: Bytes) -> Bytes:
        size = image.shape[::-1]
        return np.asarray(
            cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REFLECT), np.uint8
        )

    return replace(frame, images=tuple(None if i is None else zoom(i) for i in frame.images))


def changes(run: Run) -> list[Fault]:
    faults = [fault for estimate in run.estimates for fault in estimate.faults]
    return [fault for fault in faults if fault.kind is FaultKind.FOCAL_LENGTH_CHANGE]


@pytest.mark.parametrize("cameras", ["stereo", "mono"])
def test_a_zoom_is_a_fault(recording: Recording, cameras: str) -> None:
    rig = recording.rig if cameras == "stereo" else recording.mono_rig
    frames = list(recording.frames) if cameras == "stereo" else recording.mono()
    found = changes(track(rig, [zoomed(frame, recording) for frame in frames]))
    assert found
    assert not any(fault.is_handled for fault in found)
    assert 0.007 < max(fault.value for fault in found) < 0.06


@pytest.mark.parametrize("cameras", ["stereo", "mono"])
def test_a_fixed_lens_has_no_such_fault(cameras: str, request: pytest.FixtureRequest) -> None:
    assert not changes(request.getfixturevalue(cameras))
