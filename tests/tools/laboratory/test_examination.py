"""Features of one image, their spread, and homographies from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vo.base.errors import SourceError
from vo.tools.laboratory.examination import spread
from vo.tools.laboratory.images import is_image, read_homography


def test_spread_is_the_ratio_of_cells_with_a_point() -> None:
    shape = (80, 160)  # 16 x 8 cells of 10 pixels
    v, u = np.mgrid[5:80:10, 5:160:10]
    every = np.column_stack([u.ravel(), v.ravel()]).astype(np.float32)
    assert spread(every, shape) == 1
    assert spread(every[:64], shape) == 0.5
    assert spread(np.repeat(every[:1], 9, axis=0), shape) == 1 / 128
    assert spread(np.empty((0, 2), np.float32), (1, 1)) == 0
    corners = np.array([[-0.5, -0.5], [159.5, 79.5]], np.float32)
    assert spread(corners, shape) == 2 / 128


@pytest.mark.parametrize("text", ["1 0 5\n0 1 0\n0 0 1\n", "1, 0, 5, 0, 1, 0, 0, 0, 1"])
def test_a_homography_is_nine_numbers(text: str, tmp_path: Path) -> None:
    path = tmp_path / "H"
    path.write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_homography(path), [[1, 0, 5], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("text", ["", "1 2 3", "a b c d e f g h i", "nan 0 0 0 1 0 0 0 1"])
def test_other_texts_are_no_homography(text: str, tmp_path: Path) -> None:
    path = tmp_path / "H"
    with pytest.raises(SourceError, match="No such file"):
        read_homography(path)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(SourceError, match="not nine numbers|no inverse"):
        read_homography(path)


def test_images_are_known_by_their_suffix(tmp_path: Path) -> None:
    assert is_image(Path("a.PNG"))
    assert not is_image(Path("a/*.png"))
    assert not is_image(Path("a.mp4"))
    (tmp_path / "folder.png").mkdir()
    assert not is_image(tmp_path / "folder.png")
