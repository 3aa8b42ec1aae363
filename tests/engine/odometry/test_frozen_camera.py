"""Images that repeat while the camera moves, and a camera that stands still."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recorded_walk import COUNT, Recording, Run, aligned, changed, track

from vo.base.failures import FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.types import Bytes, Frame, State

RNG = np.random.default_rng(0)
FROZEN = range(18, 26)


def copy(image: Bytes) -> Bytes:
    return image.copy()


def noisy(image: Bytes) -> Bytes:
    grey = np.rint(image + RNG.normal(0.0, 1.5, image.shape))
    return np.asarray(grey.clip(0, 255), dtype=np.uint8)


def showing(frame: Frame, of: Frame, change: Callable[[Bytes], Bytes] = copy) -> Frame:
    return replace(frame, images=tuple(None if i is None else change(i) for i in of.images))


def repeated(run: Run) -> list[int]:
    kinds = [{fault.kind for fault in e.faults} for e in run.estimates]
    return [n for n, kind in enumerate(kinds) if FaultKind.REPEATED_IMAGES in kind]


@pytest.mark.parametrize("change", [copy, noisy])
def test_frozen_images_of_a_moving_camera_get_no_pose(
    recording: Recording, change: Callable[[Bytes], Bytes]
) -> None:
    last = recording.frames[FROZEN[0] - 1]
    frames = changed(recording.frames, FROZEN, lambda f: showing(f, last, change))
    run = track(recording.rig, frames)
    assert run.numbers == [n for n in range(COUNT) if n not in FROZEN]
    assert [n for n, s in enumerate(run.states) if s is not State.TRACKING] == list(FROZEN)
    assert {e.segment for e in run.estimates} == {0}
    assert repeated(run) == list(FROZEN)
    for number in FROZEN:
        estimate = run.estimates[number]
        assert estimate.world_from_cam0 is None and estimate.failure is not None
        assert estimate.failure.reason is FailureReason.REPEATED_IMAGE
        assert Fault(FaultKind.REPEATED_IMAGES, is_handled=True) in estimate.faults
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.005 * recording.path_m


def test_frozen_images_in_mono_get_no_pose(recording: Recording) -> None:
    frozen = range(22, 27)
    mono = recording.mono()
    frames = changed(mono, frozen, lambda f: showing(f, mono[frozen[0] - 1]))
    run = track(recording.mono_rig, frames)
    assert repeated(run) == list(frozen)
    assert not set(run.numbers) & set(frozen)
    assert run.states[-1] is State.TRACKING
    ate, _ = aligned(run, recording, with_scale=True)
    assert ate < 0.01 * recording.path_m


def test_every_second_image_repeated(recording: Recording) -> None:
    odd = range(1, COUNT, 2)
    frames = changed(recording.frames, odd, lambda f: showing(f, recording.frames[f.index - 1]))
    run = track(recording.rig, frames)
    assert run.numbers == list(range(0, COUNT, 2))
    assert repeated(run) == list(odd)
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.005 * recording.path_m


def test_a_frozen_right_image_is_not_used(recording: Recording) -> None:
    frozen = range(15, 30)

    def freeze(frame: Frame) -> Frame:
        return replace(frame, images=(frame.image0, recording.frames[14].images[1]))

    run = track(recording.rig, changed(recording.frames, frozen, freeze), takes_snapshots=True)
    assert set(run.states) == {State.TRACKING}
    fault = Fault(FaultKind.REPEATED_RIGHT_IMAGES, is_handled=True)
    assert [n for n, e in enumerate(run.estimates) if fault in e.faults] == list(frozen)
    assert all((run.snapshots[n].view.image1 is None) == (n in frozen) for n in range(COUNT))
    ate, _ = aligned(run, recording, with_scale=False)
    assert ate < 0.01 * recording.path_m


def standing(frame: Frame, count: int, change: Callable[[Bytes], Bytes]) -> list[Frame]:
    """Frames after one that show the same."""
    stamps_ns = frame.stamp_ns + 66_666_667 * np.arange(1, count + 1)
    return [
        replace(showing(frame, frame, change), index=frame.index + n, stamp_ns=stamp_ns)
        for n, stamp_ns in enumerate(stamps_ns.tolist(), start=1)
    ]


def test_a_camera_that_stands_keeps_its_pose(recording: Recording) -> None:
    first = recording.frames[0]
    run = track(recording.rig, [first, *standing(first, 8, noisy)])
    assert run.numbers == list(range(9))
    assert repeated(run) == []


def test_a_camera_that_stopped_after_all_gets_its_pose_later(recording: Recording) -> None:
    pause, at = 6, 20
    stopped = recording.frames[at - 1]
    late = [
        replace(f, index=f.index + pause, stamp_ns=f.stamp_ns + pause * 66_666_667)
        for f in recording.frames[at:30]
    ]
    run = track(recording.rig, [*recording.frames[:at], *standing(stopped, pause, copy), *late])
    assert run.numbers == list(range(30 + pause))
    stood = run.path[at - 1 : at + pause, :3, 3]
    np.testing.assert_allclose(stood, np.broadcast_to(stood[0], stood.shape), atol=0.002)
