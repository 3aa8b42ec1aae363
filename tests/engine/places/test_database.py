from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from place_samples import make_place, random_descriptors, small_vocabulary

from vo.base.errors import OutputError
from vo.base.types import Bytes
from vo.engine.places.database import KeyframeDatabase
from vo.engine.places.records import Place, PlaceKey
from vo.engine.places.vocabulary import similarity

VOCABULARY = small_vocabulary()


def _scenes(count: int, features: int = 60) -> list[Bytes]:
    """Descriptors of different places."""
    random = np.random.default_rng(7)
    return [random_descriptors(random, features) for _ in range(count)]


def _seen_again(descriptor: Bytes, seed: int) -> Bytes:
    """The same place with a quarter of its features replaced."""
    random = np.random.default_rng(seed)
    changed = descriptor.copy()
    quarter = len(changed) // 4
    changed[:quarter] = random_descriptors(random, quarter)
    return changed


def _assert_equal(a: Place, b: Place) -> None:
    assert (a.key, a.frame, a.is_metric) == (b.key, b.frame, b.is_metric)
    assert a.is_doubted == b.is_doubted
    for name in ("odom_from_cam", "covariance", "descriptor", "thumbnail"):
        assert getattr(a, name).dtype == getattr(b, name).dtype
        assert np.array_equal(getattr(a, name), getattr(b, name))
    for name, value in vars(a.landmarks).items():
        assert value.dtype == getattr(b.landmarks, name).dtype
        assert np.array_equal(value, getattr(b.landmarks, name))


def test_a_place_seen_again_is_the_first_candidate() -> None:
    """Without a removed one: 60 places, each seen again with a quarter of its features replaced."""
    scenes = _scenes(60)
    with KeyframeDatabase(VOCABULARY) as database:
        for n, scene in enumerate(scenes):
            database.add(make_place(n, scene))
        for n, scene in enumerate(scenes):
            candidates = database.query(_seen_again(scene, n))
            assert candidates[0].key == PlaceKey(0, n)
            assert [c.score for c in candidates[1:]] <= [candidates[0].score] * 4


def test_long_stretches_that_look_alike_do_not_hide_the_place() -> None:
    """Doors and walls of a corridor are the same everywhere, the rest of a place is its own."""
    walls, *rest = _scenes(104)
    scenes = [np.concatenate([walls, own]) for own in rest]
    with KeyframeDatabase(VOCABULARY) as database:
        for n, scene in enumerate(scenes):
            database.add(make_place(n, scene, segment=0 if n < 3 else 1 + (n - 3) // 20))
        found = database.query(_seen_again(scenes[1], 1))
        assert len(found) == 5 and found[0].key == PlaceKey(0, 1)
        assert found[0].score > 1.2 * found[1].score


def test_neighbours_and_covisible_keyframes_are_no_candidates() -> None:
    scenes = _scenes(1) * 40
    with KeyframeDatabase(VOCABULARY) as database:
        for n, scene in enumerate(scenes):
            database.add(make_place(n, scene), removes_redundant=False)
        found = database.query(database.get(PlaceKey(0, 30)))
        assert len(found) == 1  # all are one group of consecutive keyframes
        assert found[0].key.keyframe < 20


def test_the_last_keyframes_of_an_ended_segment_are_candidates() -> None:
    scene = _scenes(1)[0]
    with KeyframeDatabase(VOCABULARY) as database:
        for n in range(5):
            database.add(make_place(n, _scenes(6)[n + 1] if n else scene, segment=0))
        database.add(make_place(5, scene, segment=1))
        assert database.query(database.get(PlaceKey(0, 5)))[0].key == PlaceKey(0, 0)


def test_places_in_the_file_are_as_those_in_memory(tmp_path: Path) -> None:
    places = [make_place(n, scene) for n, scene in enumerate(_scenes(20))]
    with KeyframeDatabase(VOCABULARY, memory_bytes=30_000, folder=tmp_path) as database:
        for place in places:
            database.add(place)
        assert database.file_bytes == 18 * 12_288  # of 10 kB each; two are in memory
        assert list(tmp_path.iterdir()) == []  # the file has no name
        for place in places:
            _assert_equal(place, database.get(place.key))


def test_a_folder_without_room_is_one_error_and_loses_nothing() -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    places = [make_place(n, scene) for n, scene in enumerate(_scenes(3))]
    with KeyframeDatabase(VOCABULARY, memory_bytes=15_000) as database:
        database.add(places[0])
        database._blocks._file = open("/dev/full", "r+b", buffering=0)  # noqa: SIM115
        with pytest.raises(OutputError, match="No space left on device"):
            database.add(places[1])
        assert list(database) == [places[0].key]
        _assert_equal(places[0], database.get(places[0].key))


def test_redundant_keyframes_are_removed_but_for_ends_and_protected_ones() -> None:
    ids = np.arange(30)
    scenes = _scenes(10)
    with KeyframeDatabase(VOCABULARY) as database:
        database.protect(PlaceKey(0, 2))
        removed = []
        for n, scene in enumerate(scenes):
            removed += database.add(make_place(n, scene, ids))
        # 0 is the first and 9 the last one of the segment.
        assert removed == [PlaceKey(0, n) for n in (1, 3, 4, 5, 6, 7, 8)]
        assert list(database) == [PlaceKey(0, n) for n in (0, 2, 9)]
        with pytest.raises(KeyError):
            database.get(PlaceKey(0, 1))


def test_keyframes_with_landmarks_of_their_own_stay() -> None:
    with KeyframeDatabase(VOCABULARY) as database:
        for n, scene in enumerate(_scenes(30)):
            assert database.add(make_place(n, scene)) == ()  # 3 observe each landmark
        assert len(database) == 30


def test_covisible_keyframes_by_common_landmarks() -> None:
    with KeyframeDatabase(VOCABULARY) as database:
        for n, scene in enumerate(_scenes(6)):
            database.add(make_place(n, scene, np.arange(10 * n, 10 * n + 25)))
        expected = [
            (PlaceKey(0, 1), 15),
            (PlaceKey(0, 3), 15),
            (PlaceKey(0, 0), 5),
            (PlaceKey(0, 4), 5),
        ]
        assert database.covisible(PlaceKey(0, 2)) == expected
        assert database.covisible(PlaceKey(0, 2), 10) == expected[:2]


def test_landmarks_of_different_sessions_are_different() -> None:
    with KeyframeDatabase(VOCABULARY) as database:
        for session, scene in enumerate(_scenes(2)):
            database.add(make_place(0, scene, session=session))
        assert database.covisible(PlaceKey(0, 0)) == []


def test_scores_are_those_of_pairs_of_bags() -> None:
    """Also beyond a block of the index, with keyframes removed in between."""
    scenes = _scenes(40, 20)
    bags = [VOCABULARY.bag(s) for s in scenes]
    from vo.engine.places.inverted_index import InvertedIndex

    index = InvertedIndex(VOCABULARY.words)
    for n in range(1500):
        index.add(bags[n % 40])
    removed = [n for n in range(1500) if n % 3 or n > 1400]
    for n in removed:
        index.remove(n)
    scores = index.scores(bags[5])
    expected = [similarity(bags[5], bags[n % 40]) for n in range(1500)]
    assert np.all(scores[removed] == 0)
    kept = np.setdiff1d(np.arange(1500), removed)
    assert np.allclose(scores[kept], np.array(expected)[kept], atol=1e-6)
    assert scores.max() == pytest.approx(1.0, abs=1e-6)
