"""Places that many loops have led to are searched seldom, and no more of them is stored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from place_samples import make_place, random_descriptors, small_vocabulary

from vo.engine.mapping.keyframe import FrameId
from vo.engine.memory.search_pauses import SearchPauses
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Loop, Place, PlaceKey

LOOK = random_descriptors(np.random.default_rng(1), 60)
OTHER_LOOK = random_descriptors(np.random.default_rng(2), 60)


@pytest.fixture
def database() -> Iterator[KeyframeDatabase]:
    with KeyframeDatabase(small_vocabulary(depth=5)) as database:
        for number in range(4):
            database.add(make_place(number, LOOK))
        yield database


def _place(number: int, seconds: float, *, is_same: bool = True) -> Place:
    place = make_place(1000 * number, LOOK if is_same else OTHER_LOOK)
    return replace(place, frame=FrameId(number, round(1e9 * seconds), 0))


def _loop(earlier: PlaceKey, later: Place) -> Loop:
    return Loop(earlier, later.key, np.eye(4), 1.0, np.eye(7), 50)


def _seen(database: KeyframeDatabase, times: int) -> SearchPauses:
    """After so many visits at intervals of 20 s, each with a loop to the last one stored."""
    pauses, earlier = SearchPauses(database), PlaceKey(0, 0)
    for number in range(1, times + 1):
        place = _place(number, 20.0 * number)
        database.add(place, removes_redundant=False)
        assert not pauses.skips(place)
        removed = pauses.note(place, [_loop(earlier, place)])
        assert removed == ((place.key,) if number >= 80 else ())
        earlier = earlier if removed else place.key
    return pauses


def _pause_s(database: KeyframeDatabase, pauses: SearchPauses, times: int) -> float:
    """Seconds after the last loop at which a keyframe of the same place is searched."""
    every = np.arange(0.1, 12.0, 0.1)
    for n, seconds in enumerate(every):
        place = _place(times + 1 + n, 20.0 * times + seconds)
        database.add(place, removes_redundant=False)
        if not pauses.skips(place):
            return float(seconds)
    return np.inf


@pytest.mark.parametrize(
    ("times", "expected_s"), [(2, 0.1), (3, 0.5), (40, 0.5), (80, 2.0), (200, 2.0)]
)
def test_pauses_grow_with_the_loops_of_a_place(
    database: KeyframeDatabase, times: int, expected_s: float
) -> None:
    pauses = _seen(database, times)
    assert _pause_s(database, pauses, times) == pytest.approx(expected_s, abs=0.05)


@pytest.mark.parametrize("failures", [0, 1, 2, 3])
def test_keyframes_until_a_loop_to_a_place_with_many_are_removed(
    database: KeyframeDatabase, failures: int
) -> None:
    """After three searches without a loop they stay, and all keyframes are searched."""
    pauses = _seen(database, 100)
    places = [_place(101, 2000.7), *(_place(102 + n, 2015.0 + 0.6 * n) for n in range(4))]
    for number, place in enumerate(places):
        database.add(place, removes_redundant=False)
        assert pauses.skips(place) == (number == 0)
        if number == failures + 1:
            break
        assert number == 0 or pauses.note(place, []) == ()
    removed = pauses.note(place, [_loop(PlaceKey(0, 0), place)])
    stay = 4 if failures == 3 else 0
    assert removed == tuple(each.key for each in places[stay : failures + 2])
    assert len(database) == 4 + 79 + stay


def test_stored_keyframes_are_bounded_in_a_place_that_is_visited_again_and_again(
    database: KeyframeDatabase,
) -> None:
    """Every second search fails."""
    pauses = SearchPauses(database)
    for number in range(1, 400):
        place = _place(number, 20.0 * number)
        database.add(place, removes_redundant=False)
        if not pauses.skips(place):
            pauses.note(place, [_loop(PlaceKey(0, 0), place)] if number % 2 else [])
    assert len(database) < 170


def test_a_keyframe_that_shows_something_else_is_searched_and_stays(
    database: KeyframeDatabase,
) -> None:
    pauses = _seen(database, 100)
    elsewhere = _place(101, 2000.7, is_same=False)
    database.add(elsewhere, removes_redundant=False)
    assert not pauses.skips(elsewhere)
