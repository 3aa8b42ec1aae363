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
from vo.engine.markers.dictionaries import (
    AUTO,
    CANDIDATES,
    STANDARD,
    dictionary,
    smallest_containing,
)
from vo.tools.markers.edge_lines import refine_corners
from vo.tools.markers.image_markers import DetectedMarker
from vo.tools.markers.patterns import (
    marker_cells,
    outer_cells,
    square_cells,
    standard_number,
)

_SUBPIX_SIGMA_PX, _APRILTAG_SIGMA_PX, _RAW_SIGMA_PX = 0.15, 0.12, 0.6
_MIN_CORRELATION = 0.75  # of the marker's pattern with what its cells show; of small ones, of which
_MIN_SMALL_CORRELATION = 0.95  # textures have many likenesses, and fewer of dictionaries with
_MIN_STRONG_CORRELATION = 0.88  # so many cells:
_STRONG_CELLS = 6
_ROUGH, _MAX_ROUGH = 0.15, 0.2  # deviation in a cell, of the contrast; ratio of cells above it
_BLURS_PX = (0.5, 2.0, 4.0, 6.0)  # of the pattern, whose cells have
_CELL_PX = 8
_ENLARGED, _MAX_ENLARGED_PIXELS = 2, 3e7
_LARGEST_PX = 30.0  # side of a marker that is also searched in the enlarged image
_STANDARD_DISTANCE_RATE = 0.05  # of the outline of a standard tag's square, to the next one
_MAX_WRONG, _MAX_WRONG_BEFORE = 3, 10  # of 41 bits of which others have 12; before refinement
_PLAIN_FRAME = ("ARUCO_ORIGINAL", 1023)  # a bright rectangle in a dark frame: no evidence
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
        self.cells = square_cells(name)
        self._is_strict = is_strict
        # OpenCV finds the squares of standard tags, but does not know their codes.
        self._is_standard = name == STANDARD
        if self._is_standard and refinement in (Refinement.SUBPIX, Refinement.APRILTAG):
            raise ConfigError(
                f"`refinement` is {refinement}, which OpenCV does not have for {name}; use lines"
            )
        self._dictionary = dictionary("7X7_50" if self._is_standard else name)
        self._detector = cv2.aruco.ArucoDetector(self._dictionary, self._parameters())

    def detect(self, image: Bytes, camera: Camera | None = None) -> list[DetectedMarker]:
        """The markers of an image (H, W), by increasing id, and from top to bottom.

        `image`: uint8, as recorded. `camera`: whose lens bends straight lines; None without
        distortion.
        """
        # In inverted grey levels the white square of a standard tag is a black one.
        image = ~image if self._is_standard else image
        markers = self._found(self._detector, image, camera, 1)
        if self._small and image.size * _ENLARGED**2 <= _MAX_ENLARGED_PIXELS:
            size = image.shape[1] * _ENLARGED, image.shape[0] * _ENLARGED
            large = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), np.uint8)
            detector = cv2.aruco.ArucoDetector(self._dictionary, self._of_small(max(size)))
            for marker in self._found(detector, large, camera and _enlarged(camera), _ENLARGED):
                _add(markers, marker)
        return sorted(markers, key=lambda each: (each.id, *each.corners.mean(axis=0)[::-1]))

    def _parameters(self) -> Any:
        parameters = _parameters(self._refinement, is_strict=self._is_strict)
        if self._is_standard:  # whose squares are in others
            parameters.minMarkerDistanceRate = _STANDARD_DISTANCE_RATE
        return parameters

    def _of_small(self, longest_px: int) -> Any:
        """Parameters for small markers in the enlarged image."""
        parameters = self._parameters()
        parameters.maxMarkerPerimeterRate = 4.0 * _ENLARGED * _LARGEST_PX / longest_px
        parameters.minMarkerPerimeterRate = min(0.02, 4.0 * _ENLARGED * 10.0 / longest_px)
        parameters.perspectiveRemovePixelPerCell = 8
        parameters.perspectiveRemoveIgnoredMarginPerCell = 0.25
        return parameters

    def _found(
        self, detector: Any, image: Bytes, camera: Camera | None, scale: int
    ) -> list[DetectedMarker]:
        """Markers of an image enlarged by a scale, in pixels of the original."""
        found, ids, squares = detector.detectMarkers(image)
        numbers = [] if ids is None else [int(each) for each in np.asarray(ids).ravel()]
        if self._is_standard:
            found, numbers = [*found, *squares], [-1] * (len(found) + len(squares))
        markers: list[DetectedMarker] = []
        for corners, number in zip(found, numbers, strict=True):
            corners = np.asarray(corners, dtype=np.float64).reshape(4, 2)
            marker = self._checked(image, number, corners, camera, scale)
            if marker is not None and scale > 1:
                corners = (marker.corners + 0.5) / scale - 0.5
                marker = DetectedMarker(marker.id, corners, marker.sigma_px / scale)
            if marker is not None and self._is_standard:
                _add(markers, marker)
            elif marker is not None:
                markers.append(marker)
        return markers

    def _checked(
        self, image: Bytes, number: int, corners: Floats, camera: Camera | None, scale: int
    ) -> DetectedMarker | None:
        """The marker with refined corners; None if it is a chance likeness."""
        if self._is_standard:  # a look before what takes longer
            found = self._standard(image, corners, _MAX_WRONG_BEFORE)
            if found is None:
                return None
            corners = np.roll(corners, found[1], axis=0)
        lines = refine_corners(image, corners, self.cells, camera)
        if lines is None:
            return None
        if self._is_standard:
            found = self._standard(image, lines.corners, 0 if self._is_strict else _MAX_WRONG)
            if found is None or found[1] != 0:
                return None
            number = found[0]
        refined = DetectedMarker(number, lines.corners, lines.sigma_px)
        is_small = refined.side_px < scale * MIN_SIDE_PX
        least = _MIN_SMALL_CORRELATION if is_small else _MIN_CORRELATION
        if is_small and scale > 1 and self.cells - 2 >= _STRONG_CELLS:
            least = _MIN_STRONG_CORRELATION
        if self._likeness(image, number, lines.corners, is_small=is_small) < least:
            return None
        if self._refinement is Refinement.LINES:
            return refined
        sigma = {
            Refinement.SUBPIX: _SUBPIX_SIGMA_PX,
            Refinement.APRILTAG: _APRILTAG_SIGMA_PX,
        }.get(self._refinement, _RAW_SIGMA_PX)
        return DetectedMarker(number, corners, sigma)

    def _standard(self, image: Bytes, corners: Floats, most_wrong: int) -> tuple[int, int] | None:
        return standard_number(255.0 - self._cell_levels(image, corners), most_wrong)

    def _likeness(self, image: Bytes, number: int, corners: Floats, *, is_small: bool) -> float:
        """Correlation of the means of all cells with the marker's pattern.

        0 where cells of no small marker vary more than blur explains: the picture has other cells.
        """
        view = self._view(image, corners)
        means = _insides(view).mean(axis=2).ravel()
        pattern = marker_cells(self.name, number)
        expected = pattern.astype(np.float64).ravel()
        if means.std() < 1e-6 or expected.std() < 1e-6:
            return 0.0
        with_margin = np.pad(pattern, 1, constant_values=255)
        if not is_small and _has_other_cells(
            view, ~with_margin if self._is_standard else with_margin
        ):
            return 0.0
        correlation = float(np.corrcoef(means, expected)[0, 1])
        return -correlation if self._is_standard else correlation

    def _cell_levels(self, image: Bytes, corners: Floats) -> Floats:
        """Mean grey levels (N, N) of the cells of a marker with these corners."""
        return np.asarray(_insides(self._view(image, corners)).mean(axis=2))

    def _view(self, image: Bytes, corners: Floats) -> Floats:
        """Grey levels of a marker with these corners, seen from the front."""
        rim = outer_cells(self.name)
        count = self.cells + 2 * rim
        low, high = rim * _CELL_PX, (rim + self.cells) * _CELL_PX
        square = np.array([(low, low), (high, low), (high, high), (low, high)], np.float32) - 0.5
        matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), square)
        size = count * _CELL_PX, count * _CELL_PX
        seen = cv2.warpPerspective(image, matrix, size, flags=cv2.INTER_LINEAR)
        return np.asarray(seen, dtype=np.float64)


def _insides(view: Floats) -> Floats:
    """Grey levels (N, N, M) inside of the cells of a view."""
    count = len(view) // _CELL_PX
    cells = view.reshape(count, _CELL_PX, count, _CELL_PX)[:, 2:-2, :, 2:-2]
    return cells.swapaxes(1, 2).reshape(count, count, -1)


def _has_other_cells(view: Floats, pattern: Bytes) -> bool:
    """Whether levels vary inside of cells, by more than any blur of the pattern explains.

    `pattern`: with the margin, of one cell, that the view lacks.
    """
    sharp = np.kron(pattern, np.ones((_CELL_PX, _CELL_PX)))
    for sigma_px in _BLURS_PX:
        blurred = cv2.GaussianBlur(sharp, (0, 0), sigma_px)[_CELL_PX:-_CELL_PX, _CELL_PX:-_CELL_PX]
        scale = np.cov(view.ravel(), blurred.ravel())[0, 1] / blurred.var()
        rest = _insides(view - scale * blurred).std(axis=2)
        if np.mean(rest > _ROUGH * 255.0 * scale) <= _MAX_ROUGH:
            return False
    return True


def _enlarged(camera: Camera) -> Camera:
    """The camera of the enlarged image."""
    fx, fy = camera.fx * _ENLARGED, camera.fy * _ENLARGED
    cx, cy = ((c + 0.5) * _ENLARGED - 0.5 for c in (camera.cx, camera.cy))
    size = camera.width * _ENLARGED, camera.height * _ENLARGED
    return Camera(*size, fx, fy, cx, cy, camera.distortion_model, camera.distortion)


def _add(markers: list[DetectedMarker], marker: DetectedMarker) -> None:
    """Add a marker, unless one at its place is known."""
    for other in markers:
        away = np.linalg.norm(marker.corners.mean(axis=0) - other.corners.mean(axis=0))
        if away < 0.5 * max(marker.side_px, other.side_px):
            return
    markers.append(marker)


class DictionarySearch:
    """Finds the dictionary whose markers images show, one image after the other."""

    def __init__(self) -> None:
        dictionaries = [dictionary(name) for name in CANDIDATES if name != STANDARD]
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
        indices = [] if ids is None else sorted(set(np.asarray(which).ravel().tolist()))
        if not sum(self._count(CANDIDATES[index], image, small=small) for index in indices):
            self._count(STANDARD, image, small=small)

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

    def _count(self, name: str, image: Bytes, *, small: bool) -> int:
        if name not in self._single or small:
            self._single[name] = MarkerDetector(name, is_strict=True, small=small)
        found = self._single[name].detect(image)
        numbers = [each.id for each in found if (name, each.id) != _PLAIN_FRAME]
        if numbers:
            self._counts[name] += len(numbers)
            self._ids.setdefault(name, set()).update(numbers)
        return len(numbers)


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
