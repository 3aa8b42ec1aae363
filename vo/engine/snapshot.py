"""The result of a frame, as an estimate and, with the local map, for display."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.faults import Fault, FaultKind
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.records.snapshot import FeatureState, Snapshot, View
from vo.base.types import Estimate, Floats, Floats32, Ints, Landmarks, Sightings, State
from vo.engine.frontend.image_faults import image_defect, missing_content
from vo.engine.frontend.preprocessing import PreprocessedFrame
from vo.engine.geometry.neighbours import far_from
from vo.engine.mapping.keyframe import Keyframe
from vo.engine.mapping.local_map import LocalMap
from vo.engine.mapping.lookup import rows_of
from vo.engine.mapping.tracked_frame import LastFrame, TrackedFrame
from vo.engine.tracking.motion_model import PosePrior
from vo.engine.trajectory.map_frame import Anchor

# Failures that leave out a frame which would mislead; the path goes on without it.
_FAULTS_OF_FAILURES = {
    FailureReason.REPEATED_IMAGE: FaultKind.REPEATED_IMAGES,
    FailureReason.IMPLAUSIBLE_STEP: FaultKind.IMPLAUSIBLE_STEP,
    FailureReason.IMPLAUSIBLE_SPEED: FaultKind.IMPLAUSIBLE_STEP,
}

# Failures that a defect of the image may explain.
_OF_IMAGES = frozenset(
    {
        FailureReason.FEW_FEATURES,
        FailureReason.FEW_MATCHES,
        FailureReason.NO_ESSENTIAL_MATRIX,
        FailureReason.FEW_GOOD_POINTS,
        FailureReason.FEW_LANDMARKS,
        FailureReason.FEW_INLIERS,
    }
)


class FrameResult(NamedTuple):
    """Result of a frame.

    Attributes:
        tracked: its pose and observations, None where it has none.
        is_keyframe: whether it is to become a keyframe.
        before: the tracked frame before it, or None.
        failure: why it was not tracked.
        faults: faults that tracking has found.
        keyframe: the keyframe that it has become, or None.
        predicted: its pose by an inertial sensor where it was not tracked, or None.
    """

    frame: PreprocessedFrame
    tracked: TrackedFrame | None = None
    is_keyframe: bool = False
    before: LastFrame | None = None
    failure: Failure | None = None
    faults: tuple[Fault, ...] = ()
    keyframe: Keyframe | None = None
    predicted: PosePrior | None = None

    @property
    def every_fault(self) -> tuple[Fault, ...]:
        """Faults of the images, of tracking, and that for which a frame was left out."""
        found = self.frame.faults + self.faults
        if self._is_left_alone:
            return (*found, Fault(FaultKind.LEFT_CAMERA_ALONE, is_handled=True))
        if self.failure is None or self.failure.reason not in _FAULTS_OF_FAILURES:
            return found
        kind = _FAULTS_OF_FAILURES[self.failure.reason]
        return (*found, Fault(kind, is_handled=True, value=self.failure.value))

    @property
    def _is_left_alone(self) -> bool:
        """Whether there is a right image that hardly any of the tracked landmarks agrees with."""
        if self.tracked is None or self.frame.right is None:
            return False
        return self.tracked.lacks_disparities

    @property
    def world_from_cam(self) -> Floats | None:
        """(4, 4) pose as tracked, None where it has none."""
        return None if self.tracked is None else self.tracked.world_from_cam


def make_estimate(result: FrameResult, state: State, segment: int, **others: Any) -> Estimate:
    """The estimate of a frame.

    Args:
        result: of the frame.
        state: of the odometry; a frame without a pose is `lost` where that is tracking.
        segment: number of its segment.
        others: fields that do not depend on the frame alone: its pose and what concerns the map.
    """
    frame, tracked = result.frame, result.tracked
    return Estimate(
        frame_index=frame.index,
        stamp_ns=frame.stamp_ns,
        state=State.LOST if tracked is None and state is State.TRACKING else state,
        failure=None if tracked is not None else _explained(result.failure, frame),
        segment=segment,
        is_keyframe=result.is_keyframe,
        features=feature_count(frame, tracked),
        matches=0 if tracked is None else len(tracked.observed),
        inliers=0 if tracked is None else tracked.inliers,
        median_disparity_px=None if tracked is None else tracked.median_disparity_px,
        tracked_anew_from=frame.misled[0].index if frame.misled else None,
        **others,
    )


def _explained(failure: Failure | None, frame: PreprocessedFrame) -> Failure | None:
    """A failure of a frame, with the defect of its image that explains it, if there is one."""
    for camera, image in enumerate(frame.images):
        defect = None if image is None else missing_content(image)
        if defect is not None:
            return Failure(FailureReason.IMAGE_DEFECT, defect=defect, camera=camera)
    if failure is None or failure.reason not in _OF_IMAGES:
        return failure
    return failure._replace(defect=image_defect(frame.image0))


def make_snapshot(
    result: FrameResult,
    local_map: LocalMap,
    anchor: Anchor | None,
    *,
    has_moved: bool,
) -> Snapshot:
    """The newest frame and the local map.

    Args:
        result: of the frame.
        local_map: the map.
        anchor: places the local map in the map frame; None before any loop.
        has_moved: whether keyframes were added or moved.
    """
    keyframe = result.keyframe
    landmarks = _landmarks(local_map) if has_moved else None
    if landmarks is not None and anchor is not None:
        sigma = None if landmarks.sigma is None else anchor.scale * landmarks.sigma
        landmarks = replace(landmarks, xyz=anchor.transform_points(landmarks.xyz), sigma=sigma)
    return Snapshot(
        view=_view(result, local_map),
        landmarks=landmarks,
        neighbours={} if keyframe is None else _neighbours(local_map, keyframe),
    )


def feature_count(frame: PreprocessedFrame, tracked: TrackedFrame | None) -> int:
    """Number of landmarks found in a frame and of other features that were extracted."""
    features_xy = frame.used_keypoints_xy
    if tracked is None:
        return len(features_xy)
    found_xy = tracked.observed.image_xy
    others = far_from(features_xy, found_xy) if len(features_xy) else ()
    return len(found_xy) + int(np.count_nonzero(others))


def _view(result: FrameResult, local_map: LocalMap) -> View:
    """Landmarks found in a frame, then the other features that were extracted."""
    frame, tracked, rig = result.frame, result.tracked, local_map.rig
    xy = frame.used_keypoints_xy
    feature_state = np.full(len(xy), FeatureState.NEW, dtype=np.uint8)
    if tracked is not None:
        found_xy = tracked.observed.image_xy
        xy = np.concatenate([found_xy.astype(np.float32), xy[far_from(xy, found_xy)]])
        found = np.where(tracked.inlier, FeatureState.TRACKED, FeatureState.REJECTED)
        feature_state = np.full(len(xy), FeatureState.NEW, dtype=np.uint8)
        feature_state[: len(found)] = found
    previous_xy = np.full((len(xy), 2), np.nan, np.float32)
    right_u, error_px = np.full((2, len(xy)), np.nan, np.float32)
    if tracked is not None:
        count = len(tracked.ids)
        previous_xy[:count] = _pixels_in(result.before, tracked.ids)
        observed = tracked.observed
        right_u[:count] = rig.right_pixels(observed.image_xy, observed.disparity)[:, 0]
        error_px[:count] = _reprojection_error(result, local_map)
    return View(
        image0=frame.image0,
        image1=None if frame.right is None else frame.right[0],
        xy=xy,
        feature_state=feature_state,
        previous_xy=previous_xy,
        camera_matrix=rig.matrix,
        right_u=right_u,
        error_px=error_px,
        lens=rig.lens,
        baseline_m=rig.baseline_m,
        cam0_from_image0=rig.cam0_from_rectified,
        path=frame.path,
        masks=frame.masks,
    )


def _landmarks(local_map: LocalMap) -> Landmarks:
    """The map's points, with the grey levels of their patches and their uncertainty."""
    keyframes, rig = local_map.keyframes, local_map.rig
    if not keyframes:
        return Landmarks(local_map.id.copy(), local_map.xyz.copy())
    u, v = np.rint(local_map.reference_xy).astype(np.int64).T
    height, width = local_map.images.shape[1:]
    slots = local_map.reference_slots()
    return Landmarks(
        ids=local_map.id.copy(),
        xyz=transform_points(rig.cam0_from_rectified, local_map.xyz),
        grey=local_map.images[slots, v.clip(0, height - 1), u.clip(0, width - 1)],
        sigma=local_map.position_sigma(np.arange(len(local_map))),
        # Arrays of a keyframe are replaced, never changed, so that they need no copy.
        sightings=tuple(Sightings(k.frame.index, k.landmark, k.image_xy) for k in keyframes),
    )


def _neighbours(local_map: LocalMap, keyframe: Keyframe) -> dict[int, int]:
    """Number of landmarks that each older keyframe shares with one, by frame index."""
    number, row = local_map.observation_rows()
    observed = np.zeros(len(local_map), dtype=bool)
    observed[local_map.rows(keyframe.landmark)] = True
    counts = np.bincount(number[observed[row]], minlength=len(local_map.keyframes)).tolist()
    shared = zip(local_map.keyframes, counts, strict=True)
    return {other.frame.index: n for other, n in shared if n and other.id < keyframe.id}


def _reprojection_error(result: FrameResult, local_map: LocalMap) -> Floats:
    """(n,) ideal pixels, NaN for landmarks that have been removed."""
    tracked, pose = result.tracked, result.world_from_cam
    if result.keyframe is not None:
        pose = result.keyframe.world_from_cam  # may have been moved since, with the map
    assert tracked is not None and pose is not None
    rows = local_map.rows(tracked.ids)
    there = rows >= 0
    in_cam = transform_points(inverse(pose), local_map.xyz[rows[there]])
    error_px = np.full(len(rows), np.nan)
    off = local_map.rig.project(in_cam) - tracked.observed.xy[there]
    error_px[there] = np.hypot(off[:, 0], off[:, 1])
    return error_px


def _pixels_in(last: LastFrame | None, ids: Ints) -> Floats32:
    """(n, 2) pixels of landmarks in an earlier frame, NaN where they were not found."""
    result = np.full((len(ids), 2), np.nan, np.float32)
    if last is not None:
        there = rows_of(ids, last.ids)
        here = np.flatnonzero(there >= 0)
        result[here] = last.image_xy[there[here]]
    return result
