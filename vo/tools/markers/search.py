"""Markers with their poses in images, and over a recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np

from vo.base.types import Bytes, Camera, Frame
from vo.engine.markers.marker_problem import square_points
from vo.tools.markers.boards import MarkerBoard
from vo.tools.markers.detection import MarkerDetector
from vo.tools.markers.image_markers import DetectedMarker, FrameMarkers, Marker, PlanePose
from vo.tools.markers.plane_pose import plane_pose

_ENLARGED, _MAX_PIXELS = 4.0, 3e7


class MarkerFinder:
    """Finds markers and their poses in the images of one camera.

    `length_m`: side of the black square; None for no poses. `camera`: of the images; None for no
    poses. `board`: that the markers belong to, None for single ones.
    """

    def __init__(
        self,
        detector: MarkerDetector,
        length_m: float | None,
        camera: Camera | None,
        board: MarkerBoard | None = None,
    ) -> None:
        self.detector = detector
        self._length_m = length_m
        self._camera = camera
        self._board = board

    def find(self, image: Bytes, frame_index: int = 0, stamp_ns: int = 0) -> FrameMarkers:
        """What an image (H, W) shows."""
        detected = self.detector.detect(image, self._camera)
        markers = tuple(Marker(each, self._pose(each)) for each in detected)
        result = FrameMarkers(frame_index, stamp_ns, markers)
        if self._board is None or self._camera is None:
            return result
        return replace(result, board=self._board.pose(self._camera, image, detected))

    def find_all(self, frames: Iterable[Frame]) -> Iterator[FrameMarkers]:
        """What each frame of a recording shows, by its left image."""
        for frame in frames:
            yield self.find(frame.image0, frame.index, frame.stamp_ns)

    def _pose(self, marker: DetectedMarker) -> PlanePose | None:
        if self._camera is None or self._length_m is None:
            return None
        points = square_points(self._length_m)
        return plane_pose(self._camera, points, marker.corners, marker.sigma_px)


def find_too_small(detector: MarkerDetector, image: Bytes) -> DetectedMarker | None:
    """A marker that is only found in the enlarged image, in pixels of the original."""
    factor = min(_ENLARGED, (_MAX_PIXELS / image.size) ** 0.5)
    large = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC)
    for marker in detector.detect(np.asarray(large, dtype=np.uint8)):
        corners = (marker.corners + 0.5) / factor - 0.5
        return replace(marker, corners=corners, sigma_px=marker.sigma_px / factor)
    return None
