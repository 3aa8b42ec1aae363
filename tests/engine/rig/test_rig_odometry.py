"""The path by four cameras, and by those that are left of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from rig_walks import Walk, ate, edited, track

import vo
from vo.base.faults import FaultKind
from vo.base.types import Bytes, Frame


def test_four_cameras_give_the_metric_path(walk: Walk) -> None:
    estimates, path = track(walk.rig, walk.frames)
    assert all(estimate.state.has_pose for estimate in estimates)
    assert len(path) == len(walk.frames)
    assert ate(path, walk.truth) < 0.002  # of 3.4 m; a pair of the cameras gives 0.0015
    assert np.median([estimate.inliers for estimate in estimates]) > 500
    keyframes = [pose for estimate in estimates for pose in estimate.keyframes]
    newest = {pose.frame_index: pose for pose in keyframes}
    assert all(pose.covariance is not None for pose in newest.values() if pose.frame_index < 30)


def test_threads_make_no_difference(walk: Walk) -> None:
    first, second = (track(walk.rig, walk.frames[:12], [f"threads={count}"])[1] for count in (1, 3))
    assert np.array_equal(first.world_from_cam, second.world_from_cam)


@pytest.mark.parametrize("camera", [0, 2])
def test_a_covered_camera_is_left_out_and_named(walk: Walk, camera: int) -> None:
    def cover(frame: Frame) -> Frame:
        images = list(frame.images)
        if 10 <= frame.index < 25:
            images[camera] = np.full_like(frame.image0, 7)
        return replace(frame, images=tuple(images))

    estimates, path = track(walk.rig, edited(walk.frames, cover))
    assert len(path) == len(walk.frames)
    assert ate(path, walk.truth) < 0.003
    kinds = [{fault.kind for fault in estimate.faults} for estimate in estimates]
    told = [FaultKind.CAMERA_LEFT_OUT in each for each in kinds]
    assert told == [10 <= index < 25 for index in range(len(walk.frames))]
    (fault,) = [f for f in estimates[20].faults if f.kind is FaultKind.CAMERA_LEFT_OUT]
    assert fault == (FaultKind.CAMERA_LEFT_OUT, True, 1, f"cam{camera}")


def test_a_frozen_camera_is_left_out(walk: Walk) -> None:
    def freeze(frame: Frame) -> Frame:
        if frame.index < 10:
            return frame
        return replace(frame, images=(*frame.images[:3], walk.frames[10].images[3]))

    estimates, path = track(walk.rig, edited(walk.frames, freeze))
    assert len(path) == len(walk.frames)
    assert ate(path, walk.truth) < 0.003
    assert FaultKind.CAMERA_LEFT_OUT in {f.kind for f in estimates[20].faults}


def test_missing_images_do_not_stop_it(walk: Walk) -> None:
    def drop(frame: Frame) -> Frame:
        images = (
            None if number == frame.index % 4 else image
            for number, image in enumerate(frame.images)
        )
        return replace(frame, images=tuple(images))

    _, path = track(walk.rig, edited(walk.frames, drop))
    assert len(path) == len(walk.frames)
    assert ate(path, walk.truth) < 0.004


@pytest.mark.parametrize("missing", [range(1), range(12, 13), range(15, 35)])
def test_frames_that_camera_0_lacks_have_poses(walk: Walk, missing: range) -> None:
    def drop(frame: Frame) -> Frame:
        is_missing = frame.index in missing
        return replace(frame, images=(None, *frame.images[1:])) if is_missing else frame

    estimates, path = track(walk.rig, edited(walk.frames, drop))
    assert np.array_equal(path.stamps_ns, walk.truth.stamps_ns)
    assert ate(path, walk.truth) < 0.005
    kinds = [{fault.kind for fault in estimate.faults} for estimate in estimates]
    told = [FaultKind.CAMERA_LEFT_OUT in each for each in kinds]
    assert told == [index in missing for index in range(len(walk.frames))]


def test_two_cameras_that_see_nothing_in_common_go_on_without_the_first(apart: Walk) -> None:
    frames = [
        replace(frame, images=(None, frame.images[1])) if 20 <= frame.index < 70 else frame
        for frame in apart.frames
    ]
    estimates, path = track(apart.rig, frames)
    assert all(estimate.state.has_pose for estimate in estimates[20:])
    assert {estimate.segment for estimate in estimates} == {0}
    assert ate(path, apart.truth, with_scale=True) < 0.02


def test_all_black_frames_are_lost_and_found_again(walk: Walk) -> None:
    def black(frame: Frame) -> Frame:
        if not 15 <= frame.index < 18:
            return frame
        return replace(frame, images=tuple(np.zeros_like(frame.image0) for _ in frame.images))

    estimates, path = track(walk.rig, edited(walk.frames, black))
    assert [e.frame_index for e in estimates if not e.state.has_pose] == [15, 16, 17]
    assert {e.segment for e in estimates} == {0}
    assert ate(path, walk.truth) < 0.003


def test_after_long_darkness_a_new_segment_is_joined_where_the_place_is_known(walk: Walk) -> None:
    count, dark = len(walk.frames), 12
    there_and_back = [*range(count), *[count - 1] * dark, *range(count - 1, -1, -1)]
    frames = []
    for index, number in enumerate(there_and_back):
        images = walk.frames[number].images
        if count <= index < count + dark:
            images = tuple(np.zeros_like(walk.frames[0].image0) for _ in images)
        frames.append(Frame(index, 100_000_000 * index, images))
    settings = ["memory.loops=true", "tracking.recover_frames=5"]
    estimates, path = track(walk.rig, frames, settings)
    assert [estimates[count - 1].segment, estimates[count + dark].segment] == [0, 1]
    lost = [e.frame_index for e in estimates if not e.state.has_pose]
    assert lost == list(range(count, count + dark))
    # One path: the way back is on the way there, and not in a frame of its own.
    assert len(path) == 2 * count
    apart = path.positions[:count] - path.positions[: count - 1 : -1]
    assert np.linalg.norm(apart, axis=1).max() < 0.02


def test_an_implausible_step_that_few_landmarks_confirm_gets_no_pose(walk: Walk) -> None:
    def jump(frame: Frame) -> Frame:
        """Images of 0.4 s later, of which noise hides the lower part."""
        if frame.index != 15:
            return frame
        images = [image.copy() for image in walk.frames[19].images if image is not None]
        noise = np.random.default_rng(1).integers(0, 255, (90, 320), np.uint8)
        for image in images:
            image[150:] = noise
        return replace(frame, images=tuple(images))

    estimates, path = track(walk.rig, edited(walk.frames, jump))
    assert not estimates[15].state.has_pose
    assert FaultKind.IMPLAUSIBLE_STEP in {fault.kind for fault in estimates[15].faults}
    assert {e.segment for e in estimates} == {0}
    assert len(path) == len(walk.frames) - 1 and ate(path, walk.truth) < 0.003


def test_a_program_gives_the_images_of_all_cameras(walk: Walk) -> None:
    _, path = track(walk.rig, walk.frames[:8])
    overrides = ["memory.loops=false"]
    with vo.Odometry(walk.rig, overrides=overrides) as odometry:
        for frame in walk.frames[:8]:
            left, right, *further = frame.images
            odometry.track(frame.stamp_ns, left, right, further=further)
    assert np.array_equal(odometry.trajectory().world_from_cam, path.world_from_cam)
    assert odometry.summary().facts.mode == "rig"


def test_a_program_may_lack_any_image(walk: Walk) -> None:
    with vo.Odometry(walk.rig, overrides=["memory.loops=false"]) as odometry:
        for frame in walk.frames[:8]:
            left, right, *further = frame.images
            here = [None if frame.index == n else i for n, i in enumerate((left, right), start=3)]
            assert odometry.track(frame.stamp_ns, *here, further=further).state.has_pose
        with pytest.raises(vo.InputError, match="left is None, and so are all others"):
            odometry.track(walk.frames[8].stamp_ns, None)
    assert odometry.summary().unpaired == 2
    pair = walk.rig.first(2)
    with vo.Odometry(pair) as odometry, pytest.raises(vo.InputError, match="left"):
        odometry.track(0, None, walk.frames[0].images[1])


def noisy(image: Bytes) -> Bytes:
    noise = np.random.default_rng(0).normal(0.0, 1.5, image.shape)
    return np.asarray(np.rint(image + noise).clip(0, 255), np.uint8)


@pytest.mark.parametrize("change", [np.copy, noisy])
def test_frames_of_a_moving_rig_whose_images_all_repeat_get_no_pose(
    walk: Walk, change: Callable[[Bytes], Bytes]
) -> None:
    frozen, last = range(18, 23), walk.frames[17]

    def freeze(frame: Frame) -> Frame:
        if frame.index not in frozen:
            return frame
        # One camera is covered meanwhile, and another one gives nothing.
        images = (None if i is None else change(i) for i in last.images[:2])
        return replace(frame, images=(*images, np.full_like(last.image0, 7), None))

    estimates, path = track(walk.rig, edited(walk.frames, freeze))
    repeated = [FaultKind.REPEATED_IMAGES in {f.kind for f in e.faults} for e in estimates]
    assert repeated == [index in frozen for index in range(len(walk.frames))]
    assert [estimate.world_from_cam0 is None for estimate in estimates] == repeated
    assert {estimate.segment for estimate in estimates} == {0}
    assert len(path) == len(walk.frames) - len(frozen) and ate(path, walk.truth) < 0.003


def test_a_rig_that_stands_still_has_poses(walk: Walk) -> None:
    """The images are the same byte by byte, and the way goes on from where it has stopped."""
    numbers = [*range(20), *[19] * 5, *range(20, 30)]
    frames = [Frame(i, 100_000_000 * i, walk.frames[n].images) for i, n in enumerate(numbers)]
    _, path = track(walk.rig, frames)
    assert len(path) == len(frames)
    stood = path.positions[19:25]
    assert np.linalg.norm(stood - stood[0], axis=1).max() < 0.002
