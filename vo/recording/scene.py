"""What grows in the map view: which pieces are new and which are settled. Knows no viewer.

A run of N frames must not log N paths of N points each, so that what can still change (the
smoother's window, the local map) is logged whole each time, and the rest once, when it settles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vo.types import Bytes, Floats, Floats32, KeyframePose, Landmarks

_UNKNOWN_GREY = 160
_BRIGHTER = 0.35  # share of white mixed in: dark points would not show on the dark ground
_CERTAIN, _UNCERTAIN = 0.003, 0.1  # standard deviation as a share of the distance
_SMALLEST, _LARGEST, _STEPS = 0.9, 2.6, 4  # ui points, radius of a landmark by its uncertainty


class GrowingPath:
    """A path that is handed on as one line from each pose to the next."""

    def __init__(self) -> None:
        self._last: Floats | None = None
        self._segment = -1

    def extend(self, position: Floats, segment: int) -> Floats | None:
        """The new line (2, 3), or None at the start of a segment."""
        line = None
        if self._last is not None and segment == self._segment:
            line = np.stack([self._last, position])
        self._last, self._segment = position.copy(), segment
        return line


class SmoothedPath:
    """Keyframes that the smoother has let go of, and those it may still move."""

    def __init__(self) -> None:
        self._settled = GrowingPath()
        self._window: dict[int, KeyframePose] = {}
        self._tie: KeyframePose | None = None

    def update(
        self, keyframes: tuple[KeyframePose, ...]
    ) -> tuple[list[Floats], list[Floats], list[KeyframePose]]:
        """Take in one step's keyframes.

        Returns:
            Newly settled lines (2, 3); the strips (N, 3) of what is in the window, one for each
            segment, tied to the settled path; the newly settled keyframes.
        """
        oldest = min(keyframe.frame_index for keyframe in keyframes)
        leaving = [self._window.pop(index) for index in sorted(self._window) if index < oldest]
        lines = [line for keyframe in leaving if (line := self._settle(keyframe)) is not None]
        self._tie = leaving[-1] if leaving else self._tie
        self._window.update({keyframe.frame_index: keyframe for keyframe in keyframes})
        return lines, self._strips(), leaving

    @property
    def window(self) -> list[KeyframePose]:
        """Keyframes that may still move, oldest first."""
        return [self._window[index] for index in sorted(self._window)]

    def _settle(self, keyframe: KeyframePose) -> Floats | None:
        return self._settled.extend(keyframe.world_from_cam0[:3, 3], keyframe.segment)

    def _strips(self) -> list[Floats]:
        chain = self.window
        if self._tie is not None:
            chain.insert(0, self._tie)
        segments = np.array([keyframe.segment for keyframe in chain])
        positions = np.array([keyframe.world_from_cam0[:3, 3] for keyframe in chain])
        return [positions[segments == segment] for segment in np.unique(segments)]


class KeyframeGraph:
    """Which keyframes share landmarks, and where they are now."""

    def __init__(self) -> None:
        self._position: dict[int, Floats] = {}
        self._edges: dict[int, tuple[int, ...]] = {}

    def update(
        self, keyframes: tuple[KeyframePose, ...], newest: int, neighbours: tuple[int, ...]
    ) -> Floats:
        """Take in one step's keyframes, and those that share landmarks with a new one.

        Returns:
            (E, 2, 3) the ends of all edges at keyframes that have moved.
        """
        moved = {keyframe.frame_index for keyframe in keyframes}
        self._position.update({k.frame_index: k.world_from_cam0[:3, 3] for k in keyframes})
        if neighbours:
            self._edges[newest] = neighbours
        ends = [
            (self._position[a], self._position[b])
            for a in sorted(moved & self._edges.keys())
            for b in self._edges[a]
            if a in self._position and b in self._position
        ]
        return np.array(ends).reshape(-1, 2, 3)


@dataclass(frozen=True, eq=False)
class Points:
    """Points to draw: positions (N, 3), colours (N,) uint32 RGBA and radii (N,) in ui points."""

    xyz: Floats
    colours: NDArray[np.uint32]
    radii: Floats32


class GrowingMap:
    """Landmarks of the local map, grey as in the image, and those that have left it."""

    def __init__(self) -> None:
        self._ids = np.empty(0, dtype=np.int64)
        none = np.empty(0)
        self._points = Points(np.empty((0, 3)), none.astype(np.uint32), none.astype(np.float32))

    def update(self, landmarks: Landmarks, world_from_cam0: Floats) -> tuple[Points, Points]:
        """Take in the local map; gives it and the points that have left it, to be drawn."""
        before, left = self._points, ~np.isin(self._ids, landmarks.ids)
        settled = Points(before.xyz[left], before.colours[left], before.radii[left])
        self._ids = landmarks.ids
        distance = np.linalg.norm(landmarks.xyz - world_from_cam0[:3, 3], axis=1)
        colours = _colours(landmarks.grey, len(distance))
        self._points = Points(landmarks.xyz, colours, _radii(landmarks.sigma, distance))
        return self._points, settled


def _colours(grey: Bytes | None, count: int) -> NDArray[np.uint32]:
    level = np.full(count, _UNKNOWN_GREY) if grey is None else grey.astype(np.float64)
    shown = np.asarray(255 * _BRIGHTER + (1.0 - _BRIGHTER) * level).astype(np.uint32) & 0xFC
    return np.asarray(shown * 0x01010100 + 0xFF, dtype=np.uint32)


def _radii(sigma: Floats | None, distance: Floats) -> Floats32:
    """The less certain, the larger, in a few steps; negative means ui points."""
    if sigma is None:
        return np.full(len(distance), -_SMALLEST, dtype=np.float32)
    share = np.log(sigma / np.maximum(distance, 1e-9) / _CERTAIN) / np.log(_UNCERTAIN / _CERTAIN)
    step = np.round(np.nan_to_num(share, nan=1.0, posinf=1.0).clip(0.0, 1.0) * _STEPS) / _STEPS
    return np.asarray(-(_SMALLEST + (_LARGEST - _SMALLEST) * step), dtype=np.float32)
