"""AprilTag's tagStandard41h12, against codes and corners of AprilTag's own library."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from marker_views import Placed, developed, looking_at, random_background, render

from vo.base.errors import ConfigError
from vo.base.types import Bytes, Camera
from vo.engine.markers.dictionaries import STANDARD, dictionary_name, marker_count
from vo.tools.markers.boards import make_grid
from vo.tools.markers.detection import MarkerDetector, Refinement
from vo.tools.markers.patterns import marker_cells
from vo.tools.markers.printing import save_grid

# Tag 0 as the library draws it (apriltag_to_image), 1 white.
_TAG_0 = """
110111100
000000000
101111100
001111101
001001100
001010101
101111100
000000000
110100100
"""


def _page(number: int, cell_px: int, turns: int) -> Bytes:
    """A tag at (60, 80) on grey paper, turned to the left, slightly out of focus."""
    cells = np.pad(marker_cells(STANDARD, number), 1, constant_values=255)
    image = np.full((400, 500), 200, np.uint8)
    side = len(cells) * cell_px
    image[60 : 60 + side, 80 : 80 + side] = np.kron(
        np.clip(cells, 30, 230), np.ones((cell_px, cell_px), np.uint8)
    )
    return np.asarray(cv2.GaussianBlur(np.rot90(image, turns).copy(), (0, 0), 0.7), np.uint8)


def test_the_name_is_that_of_apriltag() -> None:
    assert dictionary_name("tagStandard41h12") == STANDARD
    assert marker_count(STANDARD) == 2115


def test_a_tag_has_the_cells_of_apriltags_own() -> None:
    rows = ["".join(map(str, row // 255)) for row in marker_cells(STANDARD, 0)]
    assert rows == _TAG_0.split()


@pytest.mark.parametrize(("cell_px", "small"), [(24, False), (8, False), (3, True)])
def test_tags_are_found_at_all_sizes_turned_by_any_quarter(cell_px: int, small: bool) -> None:
    detector = MarkerDetector(STANDARD, small=small)
    for n, number in enumerate(range(0, 2115, 140)):
        (marker,) = detector.detect(_page(number, cell_px, n % 4))
        assert marker.id == number
        assert marker.side_px == pytest.approx(5 * cell_px, abs=0.3)
        if n % 4 == 0:
            first = 80 + 3 * cell_px - 0.5, 60 + 3 * cell_px - 0.5
            np.testing.assert_allclose(marker.corners[0], first, atol=0.1)


def test_uneven_light_and_a_few_wrong_cells_do_not_matter() -> None:
    image = _page(77, 10, 0).astype(np.float64) * np.linspace(0.25, 1.0, 500)
    image[60 + 10 : 60 + 20, 80 + 10 : 80 + 40] = 40.0
    (marker,) = MarkerDetector(STANDARD).detect(np.asarray(image, np.uint8))
    assert marker.id == 77


def test_the_pose_covers_its_error_at_a_distance(camera: Camera) -> None:
    rng = np.random.default_rng(3)
    detector = MarkerDetector(STANDARD, small=True)
    for number, away in ((5, 1.0), (800, 2.0), (2114, 4.0)):
        truth = looking_at(np.array([0.1, -0.1, away]), 0.5, 1.0, 0.3)
        placed = Placed(STANDARD, number, 0.16, truth)
        image = developed(render(camera, placed, random_background(rng, (480, 640))), rng)
        (marker,) = detector.detect(image, camera)
        assert marker.id == number
        assert marker.side_px == pytest.approx(600.0 * 0.16 / away, rel=0.2)


def test_what_opencv_lacks_is_refused(tmp_path: object) -> None:
    with pytest.raises(ConfigError, match="use lines"):
        MarkerDetector(STANDARD, Refinement.SUBPIX)
    with pytest.raises(ConfigError, match=r"overlap; use 0\.024 or more"):
        save_grid(f"{tmp_path}/grid.pdf", STANDARD, make_grid(2, 2, 0.03, 0.01, STANDARD))  # type: ignore[arg-type]
