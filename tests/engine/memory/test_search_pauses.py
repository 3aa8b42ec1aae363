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
    """After so many visits at intervals of 20 s, each with a loop to the one before."""
    pauses, earlier = SearchPauses(database), PlaceKey(0, 0)
    for number in range(1, times + 1):
        place = _place(number, 20.0 * number)
        database.add(place, removes_redundant=False)
        assert not pauses.skips(place)
        assert pauses.note(place, [_loop(earlier, place)]) == ()
        earlier = place.key
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
    ("times", "expected_s"), [(2, 0.1), (3, 0.5), (40, 0.5), (80, 2.0), (200, 10.0)]
)
def test_pauses_grow_with_the_loops_of_a_place(
    database: KeyframeDatabase, times: int, expected_s: float
) -> None:
    pauses = _seen(database, times)
    assert _pause_s(database, pauses, times) == pytest.approx(expected_s, abs=0.05)


@pytest.mark.parametrize("has_loop", [True, False])
def test_keyframes_between_loops_to_a_place_with_many_are_removed(
    database: KeyframeDatabase, has_loop: bool
) -> None:
    """Without a loop after them they stay."""
    pauses = _seen(database, 100)
    between, again = _place(101, 2000.7), _place(102, 2015.0)
    for place in (between, again):
        database.add(place, removes_redundant=False)
    assert pauses.skips(between) and not pauses.skips(again)
    loops = [_loop(PlaceKey(0, 0), again)] if has_loop else []
    assert pauses.note(again, loops) == ((between.key,) if has_loop else ())
    assert (between.key in database) != has_loop


def test_a_keyframe_that_shows_something_else_is_searched_and_stays(
    database: KeyframeDatabase,
) -> None:
    pauses = _seen(database, 100)
    elsewhere = _place(101, 2000.7, is_same=False)
    database.add(elsewhere, removes_redundant=False)
    assert not pauses.skips(elsewhere)
