"""Rectangles and polygons as text."""

from __future__ import annotations

from pathlib import Path

import pytest

from vo.base.images.image_areas import anchored, parse_area, split_cameras


def test_four_numbers_are_a_rectangle_of_the_left_camera() -> None:
    area = parse_area("10, 20, 30, 5")
    assert area.cameras == (0,)
    assert area.corners == ((10, 20), (39, 20), (39, 24), (10, 24))


def test_six_numbers_or_more_are_a_polygon() -> None:
    area = parse_area("right:0,0,9.6,0,0,-8,3,3")
    assert area.cameras == (1,)
    assert area.corners == ((0, 0), (10, 0), (0, -8), (3, 3))


@pytest.mark.parametrize(
    ("text", "cameras"),
    [("left:1,2,3,4", (0,)), ("right:1,2,3,4", (1,)), ("BOTH:1,2,3,4", (0, 1))],
)
def test_cameras_are_named_before_a_colon(text: str, cameras: tuple[int, ...]) -> None:
    assert parse_area(text).cameras == cameras


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "is no area"),
        ("a,b,c,d", "is no area"),
        ("middle:1,2,3,4", "is no area"),
        ("1,2,3", "has 3 numbers"),
        ("1,2,3,4,5,6,7", "has 7 numbers"),
        ("1,2,0,4", "is 0 x 4 pixels"),
        ("1,2,3,-4", "is 3 x -4 pixels"),
        ("1,2,inf,4", "no pixels"),
        ("1,2,nan,4", "no pixels"),
        ("1,2,1e30,4", "no pixels"),
        ("0,0,5,5,9,9", "on one line"),
    ],
)
def test_others_are_refused(text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        parse_area(text)


def test_paths_keep_colons_of_their_own() -> None:
    assert split_cameras("C:/masks/left.png") == (None, "C:/masks/left.png")
    assert split_cameras("right:C:/m.png") == ((1,), "C:/m.png")
    assert anchored("right:m.png", Path("/robot")) == "right:/robot/m.png"
    assert anchored("/other/m.png", Path("/robot")) == "/other/m.png"
