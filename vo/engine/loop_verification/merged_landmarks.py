"""Landmarks of several keyframes of a segment, merged in the frame of the first one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

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
    first_from_odom, parts = inverse(places[0].odom_from_cam), [p.landmarks for p in places]
    points = [parts[0].xyz.astype(np.float64)]
    for place in places[1:]:
        moved = first_from_odom @ place.odom_from_cam
        points.append(transform_points(moved, place.landmarks.xyz.astype(np.float64)))
    xyz, sigma = np.concatenate(points), np.concatenate([p.sigma for p in parts])
    rows = np.flatnonzero((xyz[:, 2] > 0) & (sigma < _MAX_SIGMA))
    own = int(np.searchsorted(rows, len(points[0])))
    if len(places) > 1:
        ids = np.concatenate([p.id for p in parts])[rows]
        rows = rows[np.sort(np.unique(ids, return_index=True)[1])]

    def merged(name: str) -> Any:
        return np.concatenate([getattr(p, name) for p in parts]).take(rows, axis=0)

    return MergedLandmarks(
        own,
        xyz.take(rows, axis=0),
        merged("xy").astype(np.float64),
        sigma.take(rows).astype(np.float64),
        merged("descriptor"),
        merged("octave").astype(np.int32),
        merged("angle"),
        merged("patch"),
    )


class LandmarksInView(NamedTuple):
    """Rows (n,) of landmarks that another keyframe should see, pixels, relative sizes."""

    rows: Ints
    xy: Floats
    size: Floats


def in_view(there_from_here: Floats, xyz: Floats, here: Camera, there: Camera) -> LandmarksInView:
    """Landmarks (N, 3) that the camera `there` should see; there_from_here is a similarity."""
    moved = xyz @ there_from_here[:3, :3].T + there_from_here[:3, 3]
    depth = np.maximum(moved[:, 2], 1e-9)
    u = there.fx * moved[:, 0] / depth + there.cx
    v = there.fy * moved[:, 1] / depth + there.cy
    inside = (u >= 0) & (u < there.width) & (v >= 0) & (v < there.height) & (moved[:, 2] > 1e-6)
    rows = np.flatnonzero(inside)
    distance = np.maximum(np.linalg.norm(moved.take(rows, axis=0), axis=1), 1e-9)
    size = np.linalg.norm(xyz.take(rows, axis=0), axis=1)
    size = float(sim3.scale_of(there_from_here)) * size / distance
    size *= there.fx / here.fx
    alike = (size < _MAX_SIZE_RATIO) & (size > 1.0 / _MAX_SIZE_RATIO)
    rows = rows[alike]
    return LandmarksInView(rows, np.stack([u[rows], v[rows]], axis=1), size[alike])


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
