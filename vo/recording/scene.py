"""What grows in the map view: which pieces are new and which are settled. Knows no viewer.

A run of N frames must not log N paths of N points each, so that what can still change (the
smoother's window, the local map) is logged whole each time, and the rest once, when it settles.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vo.types import Bytes, Floats, KeyframePose, Landmarks


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

    def update(self, keyframes: tuple[KeyframePose, ...]) -> tuple[list[Floats], list[Floats]]:
        """Take in one step's keyframes.

        Returns:
            Newly settled lines (2, 3), and the strips (N, 3) of what is in the window, one for each
            segment, tied to the settled path.
        """
        oldest = min(keyframe.frame_index for keyframe in keyframes)
        leaving = [self._window.pop(index) for index in sorted(self._window) if index < oldest]
        lines = [line for keyframe in leaving if (line := self._settle(keyframe)) is not None]
        self._tie = leaving[-1] if leaving else self._tie
        self._window.update({keyframe.frame_index: keyframe for keyframe in keyframes})
        return lines, self._strips()

    def _settle(self, keyframe: KeyframePose) -> Floats | None:
        return self._settled.extend(keyframe.world_from_cam0[:3, 3], keyframe.segment)

    def _strips(self) -> list[Floats]:
        chain = [self._window[index] for index in sorted(self._window)]
        if self._tie is not None:
            chain.insert(0, self._tie)
        segments = np.array([keyframe.segment for keyframe in chain])
        positions = np.array([keyframe.world_from_cam0[:3, 3] for keyframe in chain])
        return [positions[segments == segment] for segment in np.unique(segments)]


@dataclass(frozen=True, eq=False)
class Points:
    """Points to draw: positions (N, 3) and colours (N, 3) uint8 RGB."""

    xyz: Floats
    colours: Bytes


class GrowingMap:
    """Landmarks of the local map, coloured by height, and those that have left it."""

    def __init__(self) -> None:
        lut = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)
        self._lut = np.ascontiguousarray(lut[:, 0, ::-1])
        self._ids = np.empty(0, dtype=np.int64)
        self._points = Points(np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8))
        self._half_range = 0.0

    def update(self, landmarks: Landmarks, world_from_cam0: Floats) -> tuple[Points, Points]:
        """Take in the local map; gives it and the points that have left it, to be drawn."""
        left = ~np.isin(self._ids, landmarks.ids)
        settled = Points(self._points.xyz[left], self._points.colours[left])
        self._ids = landmarks.ids
        self._points = Points(landmarks.xyz, self._colours(landmarks.xyz, world_from_cam0))
        return self._points, settled

    def _colours(self, xyz: Floats, world_from_cam0: Floats) -> Bytes:
        """By height above the camera, so that a street that climbs keeps its colours."""
        height = world_from_cam0[1, 3] - xyz[:, 1]  # y points down
        if not self._half_range and len(xyz):
            self._half_range = float(np.percentile(np.abs(height), 90)) or 1.0
        share = np.clip(0.5 + 0.5 * height / (self._half_range or 1.0), 0.0, 1.0)
        return np.asarray(self._lut[(30 + 195 * share).astype(np.int64)])  # TURBO's ends are dark
