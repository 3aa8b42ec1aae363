"""Landmarks of several keyframes of a segment, merged in the frame of the first one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vo.base.frozen import frozen
from vo.base.geometry.transforms import inverse, transform_points
from vo.base.types import Bytes, Camera, Descriptors, Floats, Floats32, Ints
from vo.engine.geometry import sim3
from vo.engine.places.records import Place

_MAX_SIZE_RATIO = 2.5  # between the sizes of a landmark in both images
_MAX_SIGMA = 0.3  # relative standard deviation of a depth, above which a landmark is left out


@frozen(eq=False)
class MergedLandmarks:
    """Landmarks of some keyframes; rows belong together, those of the first keyframe come first.

    Attributes:
        own: number of landmarks that the first keyframe observes.
        xyz: (M, 3) in its frame.
        xy: (M, 2) pixels in the keyframe that each was taken from.
        sigma: (M,) standard deviation of the depth, relative to it.
    """

    own: int
    xyz: Floats
    xy: Floats
    sigma: Floats
    descriptor: Descriptors
    octave: NDArray[np.int32]
    angle: Floats32
    patch: Bytes


def merge_landmarks(places: Sequence[Place]) -> MergedLandmarks:
    """Landmarks of keyframes of one segment, each taken from the first keyframe that observes it.

    Only those in front of the first keyframe, whose depths are landmarks.
    """
    first = places[0]
    xyz, parts = [], []
    taken = np.empty(0, dtype=np.int64)
    counts = []
    for place in places:
        landmarks = place.landmarks
        points = landmarks.xyz.astype(np.float64)
        if place is not first:
            points = transform_points(inverse(first.odom_from_cam) @ place.odom_from_cam, points)
        good = (points[:, 2] > 0) & (landmarks.sigma < _MAX_SIGMA)
        rows = np.flatnonzero(good & ~np.isin(landmarks.id, taken))
        taken = np.concatenate([taken, landmarks.id[rows]])
        counts.append(len(rows))
        xyz.append(points[rows])
        parts.append((landmarks, rows))
    return MergedLandmarks(
        counts[0],
        np.concatenate(xyz),
        np.concatenate([p.xy[r].astype(np.float64) for p, r in parts]),
        np.concatenate([p.sigma[r].astype(np.float64) for p, r in parts]),
        np.concatenate([p.descriptor[r] for p, r in parts]),
        np.concatenate([p.octave[r] for p, r in parts]).astype(np.int32),
        np.concatenate([p.angle[r] for p, r in parts]),
        np.concatenate([p.patch[r] for p, r in parts]),
    )


class LandmarksInView(NamedTuple):
    """Rows (n,) of landmarks that another keyframe should see, pixels, relative sizes."""

    rows: Ints
    xy: Floats
    size: Floats


def in_view(
    there_from_here: Floats, landmarks: MergedLandmarks, here: Camera, there: Camera
) -> LandmarksInView:
    """Landmarks that the camera `there` should see; there_from_here is a similarity."""
    moved = landmarks.xyz @ there_from_here[:3, :3].T + there_from_here[:3, 3]
    unit = float(sim3.scale_of(there_from_here))
    depth = np.maximum(moved[:, 2], 1e-9)
    u = there.fx * moved[:, 0] / depth + there.cx
    v = there.fy * moved[:, 1] / depth + there.cy
    size = (
        unit
        * np.linalg.norm(landmarks.xyz, axis=1)
        / np.maximum(np.linalg.norm(moved, axis=1), 1e-9)
    )
    size *= there.fx / here.fx
    inside = (u >= 0) & (u < there.width) & (v >= 0) & (v < there.height) & (moved[:, 2] > 1e-6)
    inside &= (size < _MAX_SIZE_RATIO) & (size > 1.0 / _MAX_SIZE_RATIO)
    rows = np.flatnonzero(inside)
    return LandmarksInView(rows, np.stack([u[rows], v[rows]], axis=1), size[rows])


def observed_xy(landmarks: MergedLandmarks, rows: Ints, camera: Camera) -> Floats:
    """Pixels (n, 2) where the earlier keyframe observes landmarks, or should."""
    p = landmarks.xyz[rows]
    depth = np.where(np.abs(p[:, 2]) > 1e-9, p[:, 2], 1e-9)
    xy = np.stack(
        [camera.fx * p[:, 0] / depth + camera.cx, camera.fy * p[:, 1] / depth + camera.cy], axis=1
    )
    own = rows < landmarks.own
    xy[own] = landmarks.xy[rows[own]]
    return xy
