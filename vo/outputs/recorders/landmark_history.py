"""Landmarks of the local map as points to draw, and those that have left it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vo.base.geometry.transforms import transform_points
from vo.base.types import Bools, Bytes, Floats, Floats32, Ints, Landmarks

_UNKNOWN_GREY = 160
_WHITE_RATIO = 0.35  # of white mixed in, so that dark points are visible on the dark background
_CERTAIN, _UNCERTAIN = 0.003, 0.1  # standard deviation relative to the distance
_MIN_RADIUS, _MAX_RADIUS, _STEPS = 0.9, 2.6, 4  # ui points, by uncertainty


@dataclass(frozen=True, eq=False)
class Points:
    """Points to draw; row i of each array belongs together."""

    xyz: Floats | Floats32  # (N, 3) in the world
    colours: NDArray[np.uint32]  # (N,) uint32 RGBA
    radii: Floats32  # (N,) in ui points, negative as rerun requires
    keyframe: Ints  # (N,) frame number of the last keyframe that observes the point, -1 if unknown

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, rows: Bools) -> Points:
        """The selected points."""
        return Points(self.xyz[rows], self.colours[rows], self.radii[rows], self.keyframe[rows])

    def moved(self, moves: Mapping[int, Floats]) -> Points:
        """The points, each moved with its keyframe.

        `moves`: motions (4, 4) in the world by frame number of keyframes.
        """
        xyz = self.xyz.copy()
        for frame in np.unique(self.keyframe).tolist():
            if frame in moves:
                rows = self.keyframe == frame
                xyz[rows] = transform_points(moves[frame], xyz[rows])
        return replace(self, xyz=xyz)


NO_POINTS = Points(
    np.empty((0, 3)), np.empty(0, np.uint32), np.empty(0, np.float32), np.empty(0, np.int64)
)


def concatenate(pieces: list[Points]) -> Points:
    """All points of several pieces."""
    pieces = pieces or [NO_POINTS]
    return Points(
        np.concatenate([piece.xyz for piece in pieces]),
        np.concatenate([piece.colours for piece in pieces]),
        np.concatenate([piece.radii for piece in pieces]),
        np.concatenate([piece.keyframe for piece in pieces]),
    )


class LandmarkHistory:
    """The landmarks of the local map when it was logged last."""

    def __init__(self) -> None:
        self._ids: Ints = np.empty(0, dtype=np.int64)
        self._points = NO_POINTS

    def update(self, landmarks: Landmarks, world_from_cam0: Floats) -> tuple[Points, Points]:
        """Replace the local map; its points, and the points that have left it."""
        settled = self._points.take(~np.isin(self._ids, landmarks.ids))
        self._ids = landmarks.ids
        distance = np.linalg.norm(landmarks.xyz - world_from_cam0[:3, 3], axis=1)
        colours = _colours(landmarks.grey, len(distance))
        radii = _radii(landmarks.sigma, distance)
        self._points = Points(landmarks.xyz, colours, radii, _last_keyframe(landmarks))
        return self._points, settled

    def move(self, moves: Mapping[int, Floats]) -> None:
        """Move the points with their re-posed keyframes."""
        self._points = self._points.moved(moves)


def _last_keyframe(landmarks: Landmarks) -> Ints:
    """Frame number (M,) of the last keyframe that observes each landmark, -1 without one."""
    keyframe = np.full(len(landmarks.ids), -1, dtype=np.int64)
    for each in landmarks.sightings:  # in time order
        keyframe[np.isin(landmarks.ids, each.ids)] = each.frame_index
    return keyframe


def _colours(grey: Bytes | None, count: int) -> NDArray[np.uint32]:
    level = np.full(count, _UNKNOWN_GREY) if grey is None else grey.astype(np.float64)
    shown = np.asarray(255 * _WHITE_RATIO + (1.0 - _WHITE_RATIO) * level).astype(np.uint32) & 0xFC
    return np.asarray(shown * 0x01010100 + 0xFF, dtype=np.uint32)


def _radii(sigma: Floats | None, distance: Floats) -> Floats32:
    """Radii (N,) that grow with the uncertainty, in a few steps; negative means ui points."""
    if sigma is None:
        return np.full(len(distance), -_MIN_RADIUS, dtype=np.float32)
    ratio = np.log(sigma / np.maximum(distance, 1e-9) / _CERTAIN) / np.log(_UNCERTAIN / _CERTAIN)
    step = np.round(np.nan_to_num(ratio, nan=1.0, posinf=1.0).clip(0.0, 1.0) * _STEPS) / _STEPS
    return np.asarray(-(_MIN_RADIUS + (_MAX_RADIUS - _MIN_RADIUS) * step), dtype=np.float32)
