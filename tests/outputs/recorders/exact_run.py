"""A synthetic run with exact geometry: a sliding map of four keyframes that observe points."""

from __future__ import annotations

from functools import partial

import numpy as np

from vo.base.geometry import cameras
from vo.base.geometry.transforms import inverse, make_transform, so3_exp, transform_points
from vo.base.records.snapshot import FeatureState, Snapshot, View
from vo.base.types import (
    Camera,
    Estimate,
    Floats,
    KeyframePose,
    Landmarks,
    Sightings,
    State,
    Trajectory,
)
from vo.outputs.recorders.recorder import Recorder

FRAMES, WINDOW, POINTS = 12, 4, 400
PINHOLE = Camera(160, 120, 100.0, 101.0, 79.5, 59.5)
LENSES = {
    "pinhole": PINHOLE,
    "radtan4": Camera(160, 120, 100.0, 101.0, 79.5, 59.5, "radtan", (-0.2, 0.05, 1e-3, -1e-3)),
    "radtan5": Camera(160, 120, 100.0, 101.0, 79.5, 59.5, "radtan", (-0.2, 0.05, 0.0, 0.0, -0.01)),
    "equidistant": Camera(160, 120, 70.0, 71.0, 79.5, 59.5, "equidistant", (0.01, 0.0, 0.0, 0.0)),
    "double_sphere": Camera(160, 120, 70.0, 71.0, 79.5, 59.5, "double_sphere", (-0.2, 0.55)),
}
CAM0_FROM_IMAGE0 = make_transform(so3_exp(np.array([0.02, -0.03, 0.01])), np.zeros(3))


def points() -> Floats:
    rng = np.random.default_rng(1)
    return rng.uniform((-6.0, -4.0, 5.0), (6.0, 4.0, 14.0), (POINTS, 3))


def pose(frame: int) -> Floats:
    """world_from_cam0."""
    rotation = so3_exp(np.array([0.0, 0.01, 0.004]) * frame)
    return make_transform(rotation, np.array([0.15 * frame, 0.01 * frame, 0.3 * frame]))


def smoothed() -> Trajectory:
    stamps = np.arange(FRAMES, dtype=np.int64) * 100_000_000
    return Trajectory(stamps, np.stack([pose(frame) for frame in range(FRAMES)]))


def sightings(frame: int, camera: Camera) -> Sightings:
    """Observations in a growing map: later frames observe landmarks with higher ids."""
    local = transform_points(inverse(pose(frame) @ CAM0_FROM_IMAGE0), points())
    pixels = cameras.project(camera, local)
    size = (camera.width - 1, camera.height - 1)
    with np.errstate(invalid="ignore"):
        inside = np.all((pixels >= 0) & (pixels <= size), axis=1)
    first = POINTS // FRAMES * max(frame - 2, 0) // 2
    ids = np.flatnonzero(inside & (np.arange(POINTS) >= first))
    return Sightings(frame, ids, pixels[ids])


def view(frame: int, camera: Camera) -> View:
    rng = np.random.default_rng(frame)
    image = rng.integers(0, 255, (camera.height, camera.width), dtype=np.uint8)
    xy = sightings(frame, camera).xy.astype(np.float32)
    return View(
        image0=image,
        image1=None,
        xy=xy,
        feature_state=np.full(len(xy), FeatureState.TRACKED, dtype=np.uint8),
        previous_xy=np.full_like(xy, np.nan),
        camera_matrix=camera.matrix,
        lens=camera if camera.is_distorted else None,
        cam0_from_image0=CAM0_FROM_IMAGE0,
    )


def estimate(frame: int, camera: Camera = PINHOLE, segment: int = 0) -> Estimate:
    """Every frame is a keyframe."""
    count = len(sightings(frame, camera).ids)
    return Estimate(
        frame_index=frame,
        stamp_ns=frame * 100_000_000,
        state=State.TRACKING,
        failure=None,
        segment=segment,
        world_from_cam0=pose(frame),
        is_keyframe=True,
        features=count,
        matches=count,
        inliers=count,
        keyframes=tuple(
            KeyframePose(k, k * 100_000_000, segment, pose(k), None) for k in window(frame)
        ),
        landmark_ids=landmarks(frame, camera).ids,
    )


def window(frame: int) -> range:
    return range(max(frame - WINDOW + 1, 0), frame + 1)


def landmarks(frame: int, camera: Camera) -> Landmarks:
    seen = tuple(sightings(k, camera) for k in window(frame))
    ids = np.unique(np.concatenate([each.ids for each in seen]))
    return Landmarks(ids, points()[ids], (ids % 256).astype(np.uint8), None, seen)


def snapshot(frame: int, camera: Camera = PINHOLE) -> Snapshot:
    return Snapshot(view(frame, camera), landmarks(frame, camera))


def record(recorder: Recorder, frame: int, camera: Camera = PINHOLE) -> None:
    recorder.record(estimate(frame, camera), partial(snapshot, frame, camera))
