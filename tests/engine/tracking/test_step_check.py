"""Steps that the motion of other frames supports, and steps that it does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.transforms import make_transform
from vo.base.types import Floats
from vo.engine.mapping.tracked_frame import Observations, TrackedFrame
from vo.engine.tracking.step_check import MapAgreement, Step, StepCheck

INTERVAL_S = 0.05
NOTHING = Observations(
    np.empty(0, np.int64),
    np.empty((0, 2)),
    np.empty((0, 2)),
    *(np.empty(0) for _ in range(4)),
    np.empty((0, 2)),
)


def pose(x: float) -> Floats:
    return make_transform(np.eye(3), np.array([x, 0.0, 0.0]))


def tracked(x: float, ratio: float) -> TrackedFrame:
    inlier = np.arange(100) < round(100 * ratio)
    return TrackedFrame(pose(x), np.arange(100), NOTHING, inlier, 100)


class Walk:
    """A walk at 1 m/s along x whose speed varies by 2 cm/s from frame to frame."""

    def __init__(self, *, is_metric: bool = True, scale: float = 1.0) -> None:
        self.check = StepCheck(is_metric=is_metric)
        self.check.restart(0)
        self.scale, self.frame = scale, 0
        self.x, self.velocity = 0.0, scale
        for n in range(20):
            speed = scale * (1.0 + 0.02 * (-1) ** n)
            assert self.step(speed * INTERVAL_S, 0.8) is None

    def step(self, dx: float, ratio: float, frames: int = 1) -> Failure | None:
        """Failure of a step after so many frames; it is added unless it fails."""
        interval_s = frames * INTERVAL_S
        stamp_ns = round((self.frame + frames) * INTERVAL_S * 1e9)
        predicted = pose(self.x + self.velocity * interval_s)
        step = Step(stamp_ns, pose(self.x), predicted, pose(self.x + dx), ratio)
        failure = self.check.failure(step)
        if failure is None:
            self.check.update(step)
            self.frame += frames
            self.x, self.velocity = self.x + dx, dx / interval_s
        else:
            self.check.reject(step)
        return failure


def test_a_jump_that_few_landmarks_confirm_is_implausible() -> None:
    failure = Walk().step(0.25, 0.35)
    assert failure is not None and failure.reason is FailureReason.IMPLAUSIBLE_STEP
    assert 60.0 < failure.value < 100.0  # 0.2 m in excess: 80 m/s² of usually 1 (at least)


def test_a_jump_that_as_many_as_usual_confirm_is_believed() -> None:
    assert Walk().step(0.25, 0.8) is None


def test_few_landmarks_alone_are_no_reason() -> None:
    assert Walk().step(0.05, 0.2) is None


def test_braking_and_starting_are_plausible() -> None:
    walk = Walk()
    for dx in (0.04, 0.03, 0.02, 0.01, *[0.0] * 30, 0.01, 0.02, 0.03, 0.04, 0.05):
        assert walk.step(dx, 0.5) is None


def test_a_step_over_missing_frames_is_plausible() -> None:
    assert Walk().step(5 * 0.05 + 0.03, 0.4, frames=5) is None


def test_a_wrong_pose_is_left_out_and_the_path_goes_on() -> None:
    walk = Walk()
    assert walk.step(0.25, 0.35) is not None
    assert walk.step(0.10, 0.35, frames=2) is None


def test_a_jump_that_the_next_frame_confirms_is_believed() -> None:
    walk = Walk()
    assert walk.step(0.25, 0.6) is not None
    assert walk.step(0.30, 0.65, frames=2) is None


def test_two_wrong_poses_do_not_confirm_each_other() -> None:
    walk = Walk()
    assert walk.step(0.25, 0.35) is not None
    assert walk.step(0.30, 0.30, frames=2) is not None


def test_without_a_scale_the_speed_is_the_unit() -> None:
    for scale in (0.01, 1.0, 100.0):
        walk = Walk(is_metric=False, scale=scale)
        assert walk.step(scale * 0.055, 0.35) is None
        assert walk.step(scale * 0.25, 0.35) is not None


def test_no_camera_is_faster_than_sound() -> None:
    check = StepCheck(is_metric=True)
    check.restart(0)
    step = Step(100_000_000, pose(0.0), pose(0.0), pose(50.0), 0.9)
    failure = check.failure(step)
    assert failure is not None and failure.reason is FailureReason.IMPLAUSIBLE_SPEED
    assert failure.value == 500.0


def confirming(in_view: int, found: int, inliers: int) -> TrackedFrame:
    pixels, ones = np.zeros((found, 2)), np.ones(found)
    rows = np.arange(found)
    seen = Observations(rows, pixels, pixels, ones, ones, ones, ones, pixels)
    return TrackedFrame(np.eye(4), rows, seen, rows < inliers, in_view=in_view)


@pytest.mark.parametrize("frame", [confirming(1000, 200, 190), confirming(200, 190, 130)])
def test_a_fifth_frame_in_a_row_that_confirms_little_is_a_fault(frame: TrackedFrame) -> None:
    agreement = MapAgreement(is_metric=True)
    assert [agreement.update(frame) for _ in range(4)] == [()] * 4
    (fault,) = agreement.update(frame)
    assert fault == Fault(FaultKind.TWO_MOTIONS, value=1.0 - frame.inlier_ratio)
    assert not fault.is_handled


def test_single_frames_and_new_maps_are_no_fault() -> None:
    agreement = MapAgreement(is_metric=True)
    few, usual = confirming(1000, 200, 190), confirming(1000, 600, 560)
    assert not any(agreement.update(each) for each in [few, few, few, few, usual] * 3)
    for _ in range(4):
        agreement.update(few)
    agreement.restart()
    assert agreement.update(few) == ()


@pytest.mark.parametrize(("agreeing", "is_bent"), [(82, True), (92, False)])
@pytest.mark.parametrize("is_metric", [False, True])
def test_landmarks_of_one_camera_that_are_found_elsewhere_than_before_are_a_fault(
    agreeing: int, is_bent: bool, is_metric: bool
) -> None:
    """Found as the map has them: 98 of 100, and later less, as after a quick turn."""
    agreement = MapAgreement(is_metric=is_metric)
    assert not any(agreement.update(confirming(110, 100, 98)) for _ in range(40))
    found = [agreement.update(confirming(110, 100, agreeing)) for _ in range(10)]
    kinds = [fault.kind for faults in found for fault in faults]
    assert set(kinds) == ({FaultKind.BENT_MAP} if is_bent and not is_metric else set())
    assert not any(found[:4])


@pytest.mark.parametrize("agreeing", [100, 82])
def test_a_lens_that_always_disagrees_a_little_is_no_bent_map(agreeing: int) -> None:
    agreement = MapAgreement(is_metric=False)
    assert not any(agreement.update(confirming(110, 100, agreeing)) for _ in range(60))


@pytest.mark.parametrize(
    ("correlation", "ratio", "is_fault"),
    [(0.92, 0.33, True), (0.96, 0.33, False), (0.86, 0.5, False)],
    ids=["moving light", "quick turns", "dark"],
)
def test_a_scene_that_changes_its_look_is_a_fault(
    correlation: float, ratio: float, is_fault: bool
) -> None:
    agreement = MapAgreement(is_metric=True)
    frame = tracked(0.0, ratio)
    scored = replace(frame, observed=replace(NOTHING, score=np.full(100, correlation)))
    found = [agreement.update(scored) for _ in range(40)]
    assert not any(found[:29])
    kinds = [fault.kind for fault in found[-1]]
    assert kinds == [FaultKind.CHANGING_APPEARANCE] * is_fault
