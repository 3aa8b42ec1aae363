"""Detection of markers in an image, with subpixel corners."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum
from typing import Any

import cv2
import numpy as np

from vo.base.errors import ConfigError
from vo.base.types import Bytes, Camera, Floats
from vo.engine.markers.dictionaries import AUTO, CANDIDATES, dictionary, smallest_containing
from vo.tools.markers.edge_lines import refine_corners
from vo.tools.markers.image_markers import DetectedMarker

_SUBPIX_SIGMA_PX, _APRILTAG_SIGMA_PX, _RAW_SIGMA_PX = 0.15, 0.12, 0.6
_MIN_CORRELATION = 0.75  # of the marker's pattern with what its cells show; of small ones, of which
_MIN_SMALL_CORRELATION = 0.95  # textures have many likenesses, and fewer of dictionaries with
_MIN_STRONG_CORRELATION = 0.88  # so many cells:
_STRONG_CELLS = 6
_ENLARGED, _MAX_ENLARGED_PIXELS = 2, 3e7
_LARGEST_PX = 30.0  # side of a marker that is also searched in the enlarged image
_CELL_PX = 8  # of a marker seen from the front, for that comparison
_MIN_LEAD = 2  # markers by which a dictionary is ahead of the next one
MIN_SIDE_PX = 20.0  # below this a pose is hardly worth its name


class Refinement(StrEnum):
    """How corners are refined."""

    LINES = "lines"
    SUBPIX = "subpix"
    APRILTAG = "apriltag"
    NONE = "none"


class MarkerDetector:
    """Detects the markers of one dictionary.

    `name`: of the dictionary, from `dictionary_name`, not `auto`. `is_strict`: accept only markers
    without a single wrong bit. `small`: search the image in double size too, where markers with
    sides of 12 to 20 pixels are found; it takes about three times as long.
    """

    def __init__(
        self,
        name: str,
        refinement: Refinement = Refinement.LINES,
        *,
        is_strict: bool = False,
        small: bool = False,
    ) -> None:
        self.name = name
        self._refinement = refinement
        self._small = small
        self._dictionary = dictionary(name)
        self.cells = int(self._dictionary.markerSize) + 2
        self._detector = cv2.aruco.ArucoDetector(
            self._dictionary, _parameters(refinement, is_strict=is_strict)
        )
        self._is_strict = is_strict

    def detect(self, image: Bytes, camera: Camera | None = None) -> list[DetectedMarker]:
        """The markers of an image (H, W), by increasing id, and from top to bottom.

        `image`: uint8, as recorded. `camera`: whose lens bends straight lines; None without
        distortion.
        """
        markers = self._found(self._detector, image, camera, 1)
        if self._small and image.size * _ENLARGED**2 <= _MAX_ENLARGED_PIXELS:
            size = image.shape[1] * _ENLARGED, image.shape[0] * _ENLARGED
            large = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
            detector = cv2.aruco.ArucoDetector(self._dictionary, self._of_small(max(size)))
            for marker in self._found(detector, large, camera and _enlarged(camera), _ENLARGED):
                if not any(_is_same(marker, other) for other in markers):
                    markers.append(marker)
        return sorted(markers, key=lambda each: (each.id, *each.corners.mean(axis=0)[::-1]))

    def _of_small(self, longest_px: int) -> Any:
        """Parameters for small markers in the enlarged image."""
        parameters = _parameters(self._refinement, is_strict=self._is_strict)
        parameters.maxMarkerPerimeterRate = 4.0 * _ENLARGED * _LARGEST_PX / longest_px
        parameters.minMarkerPerimeterRate = min(0.02, 4.0 * _ENLARGED * 10.0 / longest_px)
        parameters.perspectiveRemovePixelPerCell = 8
        parameters.perspectiveRemoveIgnoredMarginPerCell = 0.25
        return parameters

    def _found(
        self, detector: Any, image: Bytes, camera: Camera | None, scale: int
    ) -> list[DetectedMarker]:
        """Markers of an image enlarged by a scale, in pixels of the original."""
        found, ids, _ = detector.detectMarkers(image)
        if ids is None:
            return []
        markers = []
        for corners, number in zip(found, np.asarray(ids).ravel().tolist(), strict=True):
            corners = np.asarray(corners, dtype=np.float64).reshape(4, 2)
            marker = self._checked(image, int(number), corners, camera, scale)
            if marker is not None and scale > 1:
                corners = (marker.corners + 0.5) / scale - 0.5
                marker = DetectedMarker(marker.id, corners, marker.sigma_px / scale)
            if marker is not None:
                markers.append(marker)
        return markers

    def _checked(
        self, image: Bytes, number: int, corners: Floats, camera: Camera | None, scale: int
    ) -> DetectedMarker | None:
        """The marker with refined corners; None if it is a chance likeness."""
        lines = refine_corners(image, corners, self.cells, camera)
        if lines is None:
            return None
        refined = DetectedMarker(number, lines.corners, lines.sigma_px)
        is_small = refined.side_px < scale * MIN_SIDE_PX
        least = _MIN_SMALL_CORRELATION if is_small else _MIN_CORRELATION
        if is_small and scale > 1 and self.cells - 2 >= _STRONG_CELLS:
            least = _MIN_STRONG_CORRELATION
        if self._correlation(image, number, lines.corners) < least:
            return None
        if self._refinement is Refinement.LINES:
            return refined
        sigma = {
            Refinement.SUBPIX: _SUBPIX_SIGMA_PX,
            Refinement.APRILTAG: _APRILTAG_SIGMA_PX,
        }.get(self._refinement, _RAW_SIGMA_PX)
        return DetectedMarker(number, corners, sigma)

    def _correlation(self, image: Bytes, number: int, corners: Floats) -> float:
        """Correlation of the means of all cells with the marker's pattern."""
        side = self.cells * _CELL_PX
        square = np.array([(0, 0), (side, 0), (side, side), (0, side)], dtype=np.float32) - 0.5
        matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
        seen = cv2.warpPerspective(image, matrix, (side, side), flags=cv2.INTER_LINEAR)
        cells = seen.reshape(self.cells, _CELL_PX, self.cells, _CELL_PX)[:, 2:-2, :, 2:-2]
        means = cells.astype(np.float64).mean(axis=(1, 3)).ravel()
        pattern = np.asarray(self._dictionary.generateImageMarker(number, self.cells))
        expected = pattern.astype(np.float64).ravel()
        if means.std() < 1e-6 or expected.std() < 1e-6:
            return 0.0
        return float(np.corrcoef(means, expected)[0, 1])


def _enlarged(camera: Camera) -> Camera:
    """The camera of the enlarged image."""
    fx, fy = camera.fx * _ENLARGED, camera.fy * _ENLARGED
    cx, cy = ((c + 0.5) * _ENLARGED - 0.5 for c in (camera.cx, camera.cy))
    size = camera.width * _ENLARGED, camera.height * _ENLARGED
    return Camera(*size, fx, fy, cx, cy, camera.distortion_model, camera.distortion)


def _is_same(marker: DetectedMarker, other: DetectedMarker) -> bool:
    """Whether two markers are at one place."""
    away = np.linalg.norm(marker.corners.mean(axis=0) - other.corners.mean(axis=0))
    return bool(away < 0.5 * max(marker.side_px, other.side_px))


class DictionarySearch:
    """Finds the dictionary whose markers images show, one image after the other."""

    def __init__(self) -> None:
        dictionaries = [dictionary(name) for name in CANDIDATES]
        parameters = _parameters(Refinement.LINES, is_strict=True)
        self._all = cv2.aruco.ArucoDetector(dictionaries, parameters)
        self._single: dict[str, MarkerDetector] = {}
        self._counts: Counter[str] = Counter()
        self._ids: dict[str, set[int]] = {}

    def add(self, image: Bytes) -> str | None:
        """The largest dictionary of a kind that leads by two markers after this image (H, W)."""
        self._search(image, image, small=False)
        first, second = ([*self._counts.most_common(2), ("", 0), ("", 0)])[:2]
        return first[0] if first[1] >= second[1] + _MIN_LEAD else None

    def add_small(self, image: Bytes) -> None:
        """Count markers of an image (H, W) that are only found in double size."""
        height, width = image.shape
        size = width * _ENLARGED, height * _ENLARGED
        large = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
        self._search(image, large, small=True)

    def _search(self, image: Bytes, searched: Bytes, *, small: bool) -> None:
        _, ids, _, which = self._all.detectMarkersMultiDict(searched)
        if ids is not None:
            for index in sorted(set(np.asarray(which).ravel().tolist())):
                self._count(CANDIDATES[index], image, small=small)

    def found(self, what: str) -> str | None:
        """The dictionary with most markers, the smallest with all ids; None without any marker.

        Raises:
            ConfigError: two dictionaries fit `what` equally well.
        """
        most = max(self._counts.values(), default=0)
        best = [name for name in CANDIDATES if self._counts[name] == most]
        if not most:
            return None
        if len(best) > 1:
            raise ConfigError(
                f"the markers of {what} fit dictionaries {' and '.join(best)} equally; choose one: "
                "`dictionary`"
            )
        return smallest_containing(best[0], sorted(self._ids[best[0]]))

    def _count(self, name: str, image: Bytes, *, small: bool) -> None:
        if name not in self._single or small:
            self._single[name] = MarkerDetector(name, is_strict=True, small=small)
        numbers = [marker.id for marker in self._single[name].detect(image)]
        if numbers:
            self._counts[name] += len(numbers)
            self._ids.setdefault(name, set()).update(numbers)


def find_dictionary(images: Iterable[Bytes], what: str) -> str | None:
    """The dictionary whose markers images (H, W) show, None if they show none.

    Raises:
        ConfigError: two dictionaries fit equally well.
    """
    search, seen = DictionarySearch(), list(images)
    for image in seen:
        search.add(image)
    found = search.found(what)
    if found is None and len(seen) == 1 and seen[0].size * _ENLARGED**2 <= _MAX_ENLARGED_PIXELS:
        search.add_small(seen[0])
        found = search.found(what)
    return found


def make_detector(
    name: str, refinement: Refinement, images: Iterable[Bytes], what: str
) -> MarkerDetector | None:
    """A detector of a dictionary, of small markers too, found in images if its name is `auto`.

    Returns None if no image shows a marker of any dictionary.

    Raises:
        ConfigError: two dictionaries fit equally well.
    """
    chosen: str | None = name
    if name == AUTO:
        chosen = find_dictionary(images, what)
    return None if chosen is None else MarkerDetector(chosen, refinement, small=True)


def _parameters(refinement: Refinement, *, is_strict: bool) -> Any:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = {
        Refinement.LINES: cv2.aruco.CORNER_REFINE_SUBPIX,
        Refinement.SUBPIX: cv2.aruco.CORNER_REFINE_SUBPIX,
        Refinement.APRILTAG: cv2.aruco.CORNER_REFINE_APRILTAG,
        Refinement.NONE: cv2.aruco.CORNER_REFINE_NONE,
    }[refinement]
    parameters.minMarkerPerimeterRate = 0.02
    if is_strict:
        parameters.errorCorrectionRate = 0.0
    return parameters
