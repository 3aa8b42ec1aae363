from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vo.base.errors import SourceError
from vo.recordings.formats.warning_kinds import kind_of
from vo.recordings.sources.images import ImageFile
from vo.recordings.sources.listing import Shot
from vo.recordings.sources.pairing import copy_stamps, pair_by_stamp, tolerance_ns

MS = 1_000_000


def _shots(stamps_ms: list[float], side: str = "left") -> list[Shot]:
    return [
        Shot(round(s * MS), ImageFile(Path(f"{side}/{i}.png")), "here")
        for i, s in enumerate(stamps_ms)
    ]


def _pairs(left: list[float], right: list[float]) -> list[int | None]:
    found = pair_by_stamp(_shots(left), _shots(right, "right"))
    return [None if image is None else int(Path(image.name).stem) for image in found]


def test_pairs_similar_stamps() -> None:
    assert _pairs([0, 100, 200], [1.4, 98.6, 200.1]) == [0, 1, 2]


def test_images_without_partner_are_left_out(caplog: pytest.LogCaptureFixture) -> None:
    assert _pairs([0, 100, 300, 400], [0, 200, 300, 400]) == [0, None, 2, 3]
    assert "1 of 4 right images have no left image" in caplog.text
    assert [kind_of(record) for record in caplog.records] == ["unpaired_images"]


def test_no_image_has_two_partners() -> None:
    assert _pairs([0, 100], [97, 101]) == [None, 1]
    assert _pairs([96, 100, 300, 400, 500], [99]) == [None, 0, None, None, None]


@pytest.mark.parametrize(("offset_ms", "found"), [(4.9, [0, 1]), (-4.9, [0, 1]), (5.1, [None] * 2)])
def test_tolerance_is_at_most_5_ms(offset_ms: float, found: list[int | None]) -> None:
    assert _pairs([10, 110], [10 + offset_ms, 110 + offset_ms]) == found


@pytest.mark.parametrize(
    ("stamps_ms", "expected_ms"), [([0, 100, 200], 5), ([0, 4, 8], 2), ([7], 5), ([0, 4, 900], 2)]
)
def test_tolerance_is_half_the_interval_of_fast_cameras(
    stamps_ms: list[int], expected_ms: int
) -> None:
    assert tolerance_ns(np.array(stamps_ms) * MS) == expected_ms * MS


def test_one_image_on_each_side() -> None:
    assert _pairs([5], [6]) == [0]
    assert _pairs([5], [60]) == [None]


_times = st.lists(st.integers(0, 2000), min_size=1, max_size=30, unique=True).map(sorted)


@given(_times, _times)
def test_pairs_are_one_to_one_in_order_and_close(left: list[int], right: list[int]) -> None:
    found = _pairs(list(map(float, left)), list(map(float, right)))
    used = [j for j in found if j is not None]
    assert used == sorted(set(used))
    for i, j in enumerate(found):
        if j is not None:
            assert abs(left[i] - right[j]) <= 5


def test_right_images_get_the_stamps_of_left_images_of_the_same_name() -> None:
    left = [
        Shot(i * 100, ImageFile(Path(f"left/{name}.png")), "here") for i, name in enumerate("abc")
    ]
    found = copy_stamps(left, [Path("right/c.jpg"), Path("right/a.jpg"), Path("right/x.jpg")])
    assert [(s.stamp_ns, s.image.name) for s in found] == [(0, "right/a.jpg"), (200, "right/c.jpg")]


def test_error_if_names_and_counts_differ() -> None:
    with pytest.raises(SourceError, match="left has 3 images and right has 2, with no name"):
        copy_stamps(_shots([0, 1, 2]), [Path("right/x.png"), Path("right/y.png")])
