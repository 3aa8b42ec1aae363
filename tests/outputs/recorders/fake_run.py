"""A short synthetic run: keyframes, landmarks, one lost frame and a second segment."""

from functools import partial

import numpy as np

from vo.base.failures import Failure, FailureReason
from vo.base.geometry.transforms import make_transform, so3_exp
from vo.base.records.snapshot import FeatureState, Snapshot, View
from vo.base.types import (
    Camera,
    Estimate,
    KeyframePose,
    Landmarks,
    Rig,
    Sightings,
    State,
    Trajectory,
)
from vo.outputs.recorders.recorder import Recorder

FRAMES = 22
LOST_FRAME = 6
FEATURES = 30
LANDMARKS = 20
CAMERA = Camera(width=65, height=48, fx=50.0, fy=52.0, cx=31.5, cy=23.0)
RIG = Rig(CAMERA, CAMERA, np.eye(4))


def pose(frame: int) -> np.ndarray:
    rotation = so3_exp(np.array([0.01, 0.05, -0.02]) * frame)
    return make_transform(rotation, np.array([300.0 + 0.1 * frame**2, 0.02 * frame, 0.5 * frame]))


def stamp_ns(frame: int, first_ns: int = 0) -> int:
    return first_ns + frame * 103_456_789


def trajectory(first_ns: int = 0, *, frames: range = range(FRAMES)) -> Trajectory:
    tracked = [frame for frame in frames if frame != LOST_FRAME]
    stamps = np.array([stamp_ns(frame, first_ns) for frame in tracked], dtype=np.int64)
    return Trajectory(stamps, np.array([pose(frame) for frame in tracked]))


def view(frame: int) -> View:
    rng = np.random.default_rng(frame)
    xy = rng.uniform(0.0, 45.0, (FEATURES, 2)).astype(np.float32)
    previous = xy - np.float32(1.5)
    previous[:5] = np.nan
    state = np.full(FEATURES, FeatureState.TRACKED, dtype=np.uint8)
    state[:5], state[5:8] = FeatureState.NEW, FeatureState.REJECTED
    image = rng.integers(0, 255, (CAMERA.height, CAMERA.width), dtype=np.uint8)
    right_u = (xy[:, 0] - 3.0).astype(np.float32)
    error_px = np.linspace(0.0, 4.0, FEATURES).astype(np.float32)
    right_u[:5] = error_px[:5] = np.nan
    return View(
        image,
        image[:, ::-1].copy(),
        xy,
        state,
        previous,
        CAMERA.matrix,
        right_u=right_u,
        error_px=error_px,
        baseline_m=0.1,
        cam0_from_image0=np.eye(4),
    )


def keyframes(frame: int, first_ns: int = 0) -> tuple[KeyframePose, ...]:
    window = [k for k in range(max(0, frame - 4), frame + 1, 2) if k != LOST_FRAME]
    return tuple(
        KeyframePose(k, stamp_ns(k, first_ns), int(k > LOST_FRAME), pose(k), 1e-4 * np.eye(6))
        for k in window
    )


def landmarks(frame: int) -> Landmarks:
    ids = np.arange(LANDMARKS) + 5 * frame
    xyz = np.stack([ids * 0.1, ids % 7 - 3.0, 5.0 + ids * 0.2], axis=1)
    sightings = tuple(
        Sightings(k.frame_index, ids, np.zeros((len(ids), 2))) for k in keyframes(frame)
    )
    grey = (10 * ids % 256).astype(np.uint8)
    return Landmarks(ids, xyz, grey, 0.01 + 0.001 * ids, sightings)


def estimate(frame: int, first_ns: int = 0) -> Estimate:
    is_lost = frame == LOST_FRAME
    return Estimate(
        frame_index=frame,
        stamp_ns=stamp_ns(frame, first_ns),
        state=State.LOST if is_lost else State.TRACKING,
        failure=Failure(FailureReason.FEW_MATCHES, 3, 80) if is_lost else None,
        segment=int(frame >= LOST_FRAME),
        world_from_cam0=None if is_lost else pose(frame),
        is_keyframe=is_keyframe(frame),
        features=FEATURES,
        matches=22,
        inliers=20,
        keyframes=keyframes(frame, first_ns) if is_keyframe(frame) else (),
        landmark_ids=landmarks(frame).ids if is_keyframe(frame) else None,
        stage_ms={"features": 5.0, "tracking": 3.0},
    )


def is_keyframe(frame: int) -> bool:
    return frame % 2 == 0 and frame != LOST_FRAME


def snapshot(frame: int) -> Snapshot:
    if not is_keyframe(frame):
        return Snapshot(view(frame), None)
    neighbours = {k: 5 + k for k in range(max(0, frame - 4), frame, 2)}
    return Snapshot(view(frame), landmarks(frame), neighbours)


def record(recorder: Recorder, frame: int, first_ns: int = 0) -> None:
    recorder.record(estimate(frame, first_ns), partial(snapshot, frame))
