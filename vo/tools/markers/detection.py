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
_MIN_SMALL_CORRELATION = 0.95  # textures have many likenesses
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
    without a single wrong bit.
    """

    def __init__(
        self, name: str, refinement: Refinement = Refinement.LINES, *, is_strict: bool = False
    ) -> None:
        self.name = name
        self._refinement = refinement
        self._dictionary = dictionary(name)
        self.cells = int(self._dictionary.markerSize) + 2
        self._detector = cv2.aruco.ArucoDetector(
            self._dictionary, _parameters(refinement, is_strict=is_strict)
        )

    def detect(self, image: Bytes, camera: Camera | None = None) -> list[DetectedMarker]:
        """The markers of an image (H, W), by increasing id, and from top to bottom.

        `image`: uint8, as recorded. `camera`: whose lens bends straight lines; None without
        distortion.
        """
        found, ids, _ = self._detector.detectMarkers(image)
        if ids is None:
            return []
        markers = []
        for corners, number in zip(found, np.asarray(ids).ravel().tolist(), strict=True):
            corners = np.asarray(corners, dtype=np.float64).reshape(4, 2)
            marker = self._checked(image, int(number), corners, camera)
            if marker is not None:
                markers.append(marker)
        return sorted(markers, key=lambda each: (each.id, *each.corners.mean(axis=0)[::-1]))

    def _checked(
        self, image: Bytes, number: int, corners: Floats, camera: Camera | None
    ) -> DetectedMarker | None:
        """The marker with refined corners; None if it is a chance likeness."""
        lines = refine_corners(image, corners, self.cells, camera)
        if lines is None:
            return None
        refined = DetectedMarker(number, lines.corners, lines.sigma_px)
        is_small = refined.side_px < MIN_SIDE_PX
        least = _MIN_SMALL_CORRELATION if is_small else _MIN_CORRELATION
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
        _, ids, _, which = self._all.detectMarkersMultiDict(image)
        if ids is not None:
            for index in sorted(set(np.asarray(which).ravel().tolist())):
                self._count(CANDIDATES[index], image)
        first, second = ([*self._counts.most_common(2), ("", 0), ("", 0)])[:2]
        return first[0] if first[1] >= second[1] + _MIN_LEAD else None

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

    def _count(self, name: str, image: Bytes) -> None:
        if name not in self._single:
            self._single[name] = MarkerDetector(name, is_strict=True)
        numbers = [marker.id for marker in self._single[name].detect(image)]
        if numbers:
            self._counts[name] += len(numbers)
            self._ids.setdefault(name, set()).update(numbers)


def find_dictionary(images: Iterable[Bytes], what: str) -> str | None:
    """The dictionary whose markers images (H, W) show, None if they show none.

    Raises:
        ConfigError: two dictionaries fit equally well.
    """
    search = DictionarySearch()
    for image in images:
        search.add(image)
    return search.found(what)


def make_detector(
    name: str, refinement: Refinement, images: Iterable[Bytes], what: str
) -> MarkerDetector | None:
    """A detector of a dictionary, which is found in images if its name is `auto`.

    Returns None if no image shows a marker of any dictionary.

    Raises:
        ConfigError: two dictionaries fit equally well.
    """
    chosen: str | None = name
    if name == AUTO:
        chosen = find_dictionary(images, what)
    return None if chosen is None else MarkerDetector(chosen, refinement)


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
